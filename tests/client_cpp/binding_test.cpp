// Posing, the report as JSON, and the file.

#include "barycast/client/binding.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>

namespace barycast::client::testing {
namespace {

// Two points over a segment of three vertices in the plane.
Binding small() {
  Binding binding;
  binding.offsets = {0, 2, 5};
  binding.indices = {0, 1, 0, 1, 2};
  binding.values = std::vector<float>{0.5f, 0.5f, 0.25f, 0.25f, 0.5f};
  binding.flags = {0, 0};
  binding.report.control_vertices = 3;
  binding.report.dimension = 2;
  return binding;
}

TEST(Deform, EvaluatesAboutTheCagesCentre) {
  const double far = 1e9;  // float32 weights times this alone would be off by tens
  Binding binding = small();
  binding.values = std::vector<float>{0.3f, 0.7f, 0.25f, 0.25f, 0.5f};
  const Result<std::vector<double>> points = deform(binding, std::vector<double>{far, 0, far + 1, 0, far, 1}, 2);
  ASSERT_TRUE(points);
  EXPECT_NEAR((*points)[0], far + 0.7, 1e-6);
  EXPECT_NEAR((*points)[1], 0, 1e-6);
  EXPECT_EQ((*points)[2], far + 0.25);
  EXPECT_EQ((*points)[3], 0.5);
}

TEST(Deform, RefusesWhatDoesNotFit) {
  EXPECT_FALSE(deform(small(), std::vector<double>{0, 0, 1, 1}, 2));
  EXPECT_FALSE(deform(small(), std::vector<double>(9, 0.0), 4));
  const Result<std::vector<double>> bad =
      deform(small(), std::vector<double>{0, 0, 0, std::numeric_limits<double>::quiet_NaN(), 0, 0}, 2);
  ASSERT_FALSE(bad);
  EXPECT_EQ(bad.error().field, "posed.control_vertices[1]");
}

TEST(Report, IsJson) {
  Report report;
  report.linear_precision_error_max = 1.5e-16;
  report.seconds = {{"cage", 0.25}};
  report.warnings = {{"cage", "a \"quote\", a \\, a tab\t, \xc3\xa9, \xf0\x9f\x99\x82, a stray \xff"}};
  const std::string text = to_json(report);
  EXPECT_NE(text.find("\"linear_precision_error_max\": 1.5e-16"), std::string::npos) << text;
  EXPECT_NE(text.find("\"seconds\": {\"cage\": 0.25}"), std::string::npos) << text;
  EXPECT_NE(text.find(R"(a \"quote\", a \\, a tab\u0009, \u00e9, \ud83d\ude42, a stray \ufffd)"), std::string::npos)
      << text;
}

TEST(Save, SaysWhyNot) {
  const Status absent = save(small(), "/nowhere/at/all.npz");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().field, "/nowhere/at/all.npz");
  EXPECT_TRUE(absent.error().is_input);
  EXPECT_FALSE(check_output("/"));
  EXPECT_FALSE(save(small(), "/dev/null"));  // no regular file
}

TEST(Save, ReplacesAFileAndLeavesNothingElse) {
  const std::filesystem::path folder = ::testing::TempDir() + "/barycast_save_test";
  std::filesystem::create_directories(folder);
  const std::string path = (folder / "b.npz").string();
  std::ofstream(path) << "old";
  ASSERT_TRUE(save(small(), path));
  EXPECT_GT(std::filesystem::file_size(path), 1000u);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder), {}), 1);
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace barycast::client::testing
