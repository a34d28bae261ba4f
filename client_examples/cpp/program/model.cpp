#include "model.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>

namespace barycast::program {

using client::input_error;
using client::Result;

Result<std::string> read_file(const std::string& path) {
  const auto failed = [&] {
    return input_error(path, std::string("cannot be read: ") + std::strerror(errno), client::Code::kNotFound);
  };
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "rb"), std::fclose);
  if (!file) return failed();
  std::string content;
  char part[65536];
  for (size_t got; (got = std::fread(part, 1, sizeof part, file.get())) > 0;) content.append(part, got);
  if (std::ferror(file.get()) != 0) return failed();
  return content;
}

Result<client::Cage> to_cage(const Model& model) {
  if (model.faces.size() == 0 && model.segments.empty()) {
    return input_error(model.path, "has neither faces nor lines, so it is no cage");
  }
  client::CageParts parts{.control_vertices = model.points, .segments = model.segments, .polygons = model.faces};
  const Result<std::vector<double>> flat = points_for(model, 2);
  if (model.faces.size() == 0 && flat) {
    parts.dimension = 2;
    parts.control_vertices = *flat;
  }
  Result<client::Cage> cage = client::Cage::create(std::move(parts));
  if (!cage) return input_error(model.path, cage.error().text());
  return cage;
}

Result<std::vector<double>> points_for(const Model& model, uint32_t dimension) {
  if (dimension == 3) return model.points;
  std::vector<double> points;
  for (size_t i = 0; i < model.points.size(); i += 3) {
    if (model.points[i + 2] != 0) {
      return input_error(model.path, "has a point with z other than 0 (point " + std::to_string(i / 3) +
                                         "), but the cage is two-dimensional");
    }
    points.insert(points.end(), {model.points[i], model.points[i + 1]});
  }
  return points;
}

}  // namespace barycast::program
