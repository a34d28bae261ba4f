#pragma once

// A model from a file, and what it is to a binding: a cage, or points.

#include <string>
#include <vector>

#include "barycast/client/cage.h"

namespace barycast::program {

struct Model {
  std::string path;
  std::vector<double> points;      // n x 3
  client::Faces faces;             // over the points
  std::vector<uint32_t> segments;  // k x 2
};

// The file's bytes.
client::Result<std::string> read_file(const std::string& path);

// The model as a cage: of two dimensions when it has lines, no faces, and only z = 0.
client::Result<client::Cage> to_cage(const Model& model);

// The points for a cage of that dimension; for 2, z must be 0 everywhere and is dropped.
client::Result<std::vector<double>> points_for(const Model& model, uint32_t dimension);

}  // namespace barycast::program
