// Writes the seeds of decode_fuzz into the folder given: sound inputs of every shape.

#include <fstream>
#include <iostream>

#include "../server/messages.h"

namespace {

using namespace barycast::server::testing;
namespace v1 = barycast::v1;

std::string framed(const std::vector<v1::ComputeCoordinatesRequest>& requests) {
  std::string bytes(1, '\1');
  for (const auto& request : requests) {
    const std::string one = request.SerializeAsString();
    bytes += static_cast<char>(one.size() % 256);
    bytes += static_cast<char>(one.size() / 256);
    bytes += one;
  }
  return bytes;
}

std::string uploaded(const v1::Cage& cage) {
  return std::string(1, '\0') + cage.SerializeAsString();
}

v1::Cage polygons() {
  v1::Cage cage;
  *cage.mutable_control_vertices() = floats(3, {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0.5f, 1.5f, 0, 0, 0, 1});
  *cage.mutable_quads() = indices(4, {0, 1, 2, 3});
  *cage.mutable_polygons()->mutable_offsets() = indices(1, {0, 5, 8});
  *cage.mutable_polygons()->mutable_corners() = indices(1, {0, 1, 2, 4, 3, 0, 1, 5});
  return cage;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: decode_fuzz_seeds FOLDER\n";
    return 2;
  }
  auto meshed = header(4);
  meshed.mutable_header()->mutable_queries()->set_face_count(1);
  meshed.mutable_header()->mutable_queries()->set_corner_count(4);
  meshed.mutable_header()->mutable_options()->set_samples(50);
  meshed.mutable_header()->mutable_output()->set_gradients(true);
  auto named = header(1);
  named.mutable_header()->mutable_cage_digest()->set_sha256(std::string(32, 'x'));
  named.mutable_header()->mutable_cage_digest()->set_size_bytes(184);
  auto targeted = header(2);
  targeted.mutable_header()->mutable_options()->set_target_error(1e-3);
  targeted.mutable_header()->mutable_output()->set_errors(true);
  auto tabled = header(2);
  tabled.mutable_header()->mutable_options()->set_tables(true);
  const std::vector<std::string> seeds = {
      uploaded(tetrahedron()),
      uploaded(square()),
      uploaded(polygons()),
      framed({header(4), points(inner_points(4))}),
      framed({header(1, square()), points({0.5, 0.5}, 2)}),
      framed({meshed, points(inner_points(4)), faces({4}, {0, 1, 2, 3})}),
      framed({named, points(inner_points(1))}),
      framed({targeted, points(inner_points(2))}),
      framed({tabled, points(inner_points(2))}),
  };
  for (size_t i = 0; i < seeds.size(); ++i) {
    std::ofstream out(std::string(argv[1]) + "/seed" + std::to_string(i), std::ios::binary);
    out << seeds[i];
    if (!out.flush()) {
      std::cerr << "cannot write into " << argv[1] << "\n";
      return 1;
    }
  }
  return 0;
}
