// A real character that pokes out of its cage. Skipped, visibly, where the data are absent:
// BARYCAST_DATA names their folder.

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "support/rows.h"

namespace barycast {
namespace {

// Null where the data are absent.
const char* data_folder() {
  const char* folder = std::getenv("BARYCAST_DATA");
  return folder != nullptr && std::filesystem::exists(std::string(folder) + "/qmvc/Beast.obj") ? folder : nullptr;
}

testing::Shape read_obj(const std::string& name) {
  testing::Shape shape;
  shape.polygon_offsets = {0};
  std::ifstream file(std::string(data_folder()) + "/qmvc/" + name);
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string word;
    words >> word;
    if (word == "v") {
      double x[3];
      words >> x[0] >> x[1] >> x[2];
      shape.vertices.insert(shape.vertices.end(), x, x + 3);
    } else if (word == "f") {
      while (words >> word) shape.polygon_corners.push_back(static_cast<uint32_t>(std::stoi(word)) - 1);
      shape.polygon_offsets.push_back(static_cast<uint32_t>(shape.polygon_corners.size()));
    }
  }
  return shape;
}

TEST(Models, PointsOutsideTheCageAreBoundAndSaySo) {
  if (data_folder() == nullptr) GTEST_SKIP() << "set BARYCAST_DATA to the folder of cages and models";
  const auto index = testing::make_index(read_obj("Beast_Cage.obj"));
  const testing::Shape model = read_obj("Beast.obj");
  Options options;
  options.samples = 20;
  options.gradients = true;
  BindingSummary summary;
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(model.vertices), options, &summary);
  EXPECT_EQ(rows.row_count(), 28388u);
  EXPECT_LE(testing::promise_error<3>(*index, model.vertices, rows).worst(), 1);
  // Counted independently with the quads cut 8 x 8; with flat halves it would be 626.
  EXPECT_NEAR(double(summary.rows_outside), 616, 5);
}

// Where a model is, most points have balls; those near the cage walk.
TEST(Models, TablesAgreeWithManyWalks) {
  if (data_folder() == nullptr) GTEST_SKIP() << "set BARYCAST_DATA to the folder of cages and models";
  const auto index = testing::make_index(read_obj("FireHydrant_Cage.obj"));
  const std::vector<double> model = read_obj("FireHydrant.obj").vertices;
  std::vector<double> points;
  for (size_t i = 0; i < model.size(); i += 300) points.insert(points.end(), &model[i], &model[i + 3]);
  Options options;
  options.estimator = Estimator::kPredicted;
  options.samples = 4000;
  const RowBlock walked = testing::bind_or_die(index, testing::loose_points(points), options);
  options.samples.reset();
  options.tables = true;
  const RowBlock tables = testing::bind_or_die(index, testing::loose_points(points), options);
  double squared = 0.0;
  for (size_t i = 0; i < walked.row_count(); ++i) {
    const std::vector<double> a = testing::dense_row(walked, i, index->control_vertex_count()),
                              b = testing::dense_row(tables, i, index->control_vertex_count());
    for (size_t v = 0; v < a.size(); ++v) squared += (a[v] - b[v]) * (a[v] - b[v]);
  }
  EXPECT_LT(std::sqrt(squared / static_cast<double>(walked.row_count())), 0.002);
}

}  // namespace
}  // namespace barycast
