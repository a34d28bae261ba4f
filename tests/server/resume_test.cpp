// Resumed streams: from any row, with any block size, the bytes of the unbroken stream; and what does not
// belong together is refused.

#include <cmath>

#include "fixture.h"

namespace barycast::server {
namespace {

using namespace testing;

constexpr uint32_t kSide = 12;
constexpr uint32_t kCount = kSide * kSide;

// A wavy sheet of quads inside the unit tetrahedron; or its points alone.
class Resume : public ServerTest {
 protected:
  std::vector<v1::ComputeCoordinatesRequest> request(bool smoothed) const {
    std::vector<double> x;
    for (uint32_t i = 0; i < kSide; ++i)
      for (uint32_t j = 0; j < kSide; ++j)
        x.insert(x.end(), {0.1 + 0.02 * i, 0.1 + 0.02 * j, 0.1 + 0.01 * ((i * j) % 5)});
    auto head = header(kCount, cage());
    head.mutable_header()->mutable_output()->set_gradients(true);
    if (!smoothed) return {head, points(x)};
    std::vector<uint32_t> corners;
    for (uint32_t i = 0; i + 1 < kSide; ++i)
      for (uint32_t j = 0; j + 1 < kSide; ++j) {
        const uint32_t a = i * kSide + j;
        corners.insert(corners.end(), {a, a + 1, a + kSide + 1, a + kSide});
      }
    const std::vector<uint32_t> counts(corners.size() / 4, 4);
    head.mutable_header()->mutable_queries()->set_face_count(counts.size());
    head.mutable_header()->mutable_queries()->set_corner_count(corners.size());
    return {head, points(x), faces(counts, corners)};
  }

  // A tetrahedron with a corner cut in three, so that rows are not affine and noise shows.
  static v1::Cage cage() {
    v1::Cage cage;
    *cage.mutable_control_vertices() = doubles(3, {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0.5, 0.5, 0.6});
    *cage.mutable_triangles() = indices(3, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 4, 2, 3, 4, 3, 1, 4});
    return cage;
  }

  static v1::Resume resume(const Answer& first, uint64_t row) {
    v1::Resume resume;
    resume.set_first_row(row);
    resume.set_numerics_version(first.header->numerics_version());
    resume.set_smoothing_time(first.header->options().smoothing_time());
    return resume;
  }

  // That the same requests from some row on give the rest of `whole`.
  void expect_resumable(std::vector<v1::ComputeCoordinatesRequest> requests, const Answer& whole);
};

// Everything about a row, as bytes; blocks may cut anywhere.
std::vector<std::string> row_bytes(const Answer& answer) {
  std::vector<std::string> rows;
  for (const v1::RowBlock& block : answer.rows) {
    const auto offsets = numbers<uint32_t>(block.offsets());
    const auto cut = [](const v1::Array& array, size_t per_entry, uint32_t begin, uint32_t end) {
      return array.data().substr(begin * per_entry, (end - begin) * per_entry);
    };
    for (size_t i = 0; i + 1 < offsets.size(); ++i)
      rows.push_back(cut(block.indices(), 4, offsets[i], offsets[i + 1]) +
                     cut(block.values(), 8, offsets[i], offsets[i + 1]) +
                     cut(block.gradients(), 24, offsets[i], offsets[i + 1]) + block.flags()[i] +
                     (block.errors().empty() ? "" : block.errors().substr(8 * i, 8)));
  }
  return rows;
}

void Resume::expect_resumable(std::vector<v1::ComputeCoordinatesRequest> requests, const Answer& whole) {
  const std::vector<std::string> expected = row_bytes(whole);
  for (const uint32_t row : {1u, 64u, kCount - 1}) {
    *requests[0].mutable_header()->mutable_resume() = resume(whole, row);
    requests[0].mutable_header()->mutable_output()->set_block_rows(17);
    const Answer rest = client_->compute(requests);
    ASSERT_EQ(rest.code, kOk) << rest.message;
    EXPECT_EQ(row_bytes(rest), std::vector<std::string>(expected.begin() + row, expected.end()));
  }
}

TEST_F(Resume, GivesTheBytesOfTheUnbrokenStream) {
  for (const bool smoothed : {false, true}) {
    const Answer whole = client_->compute(request(smoothed));
    ASSERT_EQ(whole.code, kOk) << whole.message;
    EXPECT_EQ(whole.header->options().smoothing_time() > 0.0, smoothed);
    const std::vector<std::string> expected = row_bytes(whole);
    ASSERT_EQ(expected.size(), kCount);
    for (const uint32_t row : {0u, 1u, 7u, 63u, 64u, 65u, kCount - 1})
      for (const uint32_t block_rows : {0u, 1u, 17u, 1000u}) {
        auto requests = request(smoothed);
        *requests[0].mutable_header()->mutable_resume() = resume(whole, row);
        requests[0].mutable_header()->mutable_output()->set_block_rows(block_rows);
        const Answer rest = client_->compute(requests);
        ASSERT_EQ(rest.code, kOk) << rest.message;
        EXPECT_EQ(rest.rows.at(0).first_row(), row);
        EXPECT_EQ(rest.summary->row_count(), kCount - row);
        EXPECT_EQ(row_bytes(rest), std::vector<std::string>(expected.begin() + row, expected.end()))
            << "row " << row << ", blocks of " << block_rows;
      }
  }
}

TEST_F(Resume, IsRefusedWhereRowsWouldNotBelongTogether) {
  const auto refused = [&](bool smoothed, const v1::Resume& resume, std::optional<double> smoothing_time = {}) {
    auto requests = request(smoothed);
    *requests[0].mutable_header()->mutable_resume() = resume;
    if (smoothing_time) requests[0].mutable_header()->mutable_options()->set_smoothing_time(*smoothing_time);
    const Answer answer = client_->compute(requests);
    EXPECT_FALSE(answer.header.has_value());
    return std::to_string(answer.code) + " " + answer.field();
  };
  const std::string mismatch = std::to_string(kFailedPrecondition) + " header.resume.smoothing_time";
  const Answer smooth = client_->compute(request(true));
  v1::Resume from = resume(smooth, 5);
  // Another smoothing time, by a bit; none; the right one with options that smooth otherwise; one where
  // nothing is smoothed.
  from.set_smoothing_time(std::nextafter(from.smoothing_time(), 1.0));
  EXPECT_EQ(refused(true, from), mismatch);
  from.clear_smoothing_time();
  EXPECT_EQ(refused(true, from), mismatch);
  EXPECT_EQ(refused(true, resume(smooth, 5), 2 * resume(smooth, 5).smoothing_time()), mismatch);
  EXPECT_EQ(refused(false, resume(smooth, 5)), mismatch);
  from = resume(smooth, 5);
  from.set_numerics_version(from.numerics_version() + 1);
  EXPECT_EQ(refused(true, from), std::to_string(kFailedPrecondition) + " header.resume.numerics_version");
  from.clear_numerics_version();
  EXPECT_EQ(refused(true, from), std::to_string(kFailedPrecondition) + " header.resume.numerics_version");
}

TEST_F(Resume, GivesTheErrorsOfTheUnbrokenStream) {
  auto requests = request(true);
  requests[0].mutable_header()->mutable_options()->set_target_error(2e-3);
  requests[0].mutable_header()->mutable_output()->set_errors(true);
  const Answer whole = client_->compute(requests);
  ASSERT_EQ(whole.code, kOk) << whole.message;
  EXPECT_EQ(whole.header->options().target_error(), 2e-3);
  expect_resumable(requests, whole);
}

TEST_F(Resume, GivesTheBytesOfTheUnbrokenStreamWithTables) {
  for (const bool smoothed : {false, true}) {
    auto requests = request(smoothed);
    requests[0].mutable_header()->mutable_options()->set_tables(true);
    if (smoothed) requests[0].mutable_header()->mutable_options()->set_denoise(v1::DENOISE_MESH);
    const Answer whole = client_->compute(requests);
    ASSERT_EQ(whole.code, kOk) << whole.message;
    EXPECT_TRUE(whole.header->options().tables());
    EXPECT_EQ(whole.header->options().smoothing_time() > 0.0, smoothed);
    expect_resumable(requests, whole);
  }
}

// The first request may state a time itself; the resume repeats it.
TEST_F(Resume, WorksWithAStatedSmoothingTime) {
  auto requests = request(true);
  requests[0].mutable_header()->mutable_options()->set_smoothing_time(1e-3);
  const Answer whole = client_->compute(requests);
  ASSERT_EQ(whole.code, kOk) << whole.message;
  *requests[0].mutable_header()->mutable_resume() = resume(whole, 100);
  const Answer rest = client_->compute(requests);
  ASSERT_EQ(rest.code, kOk) << rest.message;
  const auto expected = row_bytes(whole);
  EXPECT_EQ(row_bytes(rest), std::vector<std::string>(expected.begin() + 100, expected.end()));
}

}  // namespace
}  // namespace barycast::server
