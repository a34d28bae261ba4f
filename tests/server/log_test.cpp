// Lines of the log, without a server: JSON that any parser takes, whatever a request brings along.

#include "log.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace barycast::server {
namespace {

RequestRecord record(const std::string& nasty) {
  return {.method = Method::kUploadCage,
          .outcome = "INVALID_ARGUMENT",
          .message = nasty,
          .peer = nasty,
          .seconds = 0.0125,
          .facts = {.cage = nasty, .cache_hit = {}, .stages = {}}};
}

TEST(Log, JsonHoldsWhateverContent) {
  const std::string all_bytes = [] {
    std::string bytes;
    for (int c = 0; c < 256; ++c) bytes.push_back(static_cast<char>(c));
    return bytes;
  }();
  for (const std::string& nasty :
       {std::string("\"quoted\" and back\\slashed"), std::string("two\nlines\r\tand \x01 control \x7f"),
        std::string("\xC3\xA4 \xE2\x82\xAC \xF0\x9F\x90\xA7"), std::string("cut \xE2\x82"), std::string("a\0b", 3),
        all_bytes}) {
    const std::string line = request_json(record(nasty), "2024-05-01T12:00:00.000Z", "info");
    EXPECT_EQ(line.find('\n'), std::string::npos);
    const auto json = nlohmann::json::parse(line);
    EXPECT_EQ(json["method"], "UploadCage");
    EXPECT_EQ(json["code"], "INVALID_ARGUMENT");
    EXPECT_EQ(json["ms"], 12.5);
    EXPECT_TRUE(json["cache_hit"].is_null());
    EXPECT_EQ(nlohmann::json::parse(event_json(nasty, "now", "warning"))["level"], "warning");
  }
  const std::string sound = "\"\xE2\x82\xAC\"\n\\";
  EXPECT_EQ(nlohmann::json::parse(request_json(record(sound), "", ""))["message"], sound);
}

TEST(Log, TextIsOneLine) {
  EXPECT_EQ(request_text(record("two\nlines")),
            "UploadCage INVALID_ARGUMENT ms=12.5 peer=two lines cage=two lines message=two lines");
}

TEST(Log, StagesAreInMilliseconds) {
  RequestRecord done = record("");
  done.facts.stages = {0.001, 0, 0.25, 0, 0, 1.5};
  const auto json = nlohmann::json::parse(request_json(done, "", ""));
  EXPECT_EQ(json["stages_ms"]["cage"], 1.0);
  EXPECT_EQ(json["stages_ms"]["sampling"], 250.0);
  EXPECT_EQ(json["stages_ms"]["rows"], 1500.0);
  EXPECT_TRUE(json["cage"].is_null());
}

TEST(DurationHistogram, CountsEveryDurationOnce) {
  DurationHistogram histogram;
  for (const double seconds : {0.0, 1e-4, 0.0002, 0.09, 0.1, 1000.0}) histogram.observe(seconds);
  EXPECT_EQ(histogram.in_bucket(0), 2u);  // up to and with the bound
  EXPECT_EQ(histogram.in_bucket(1), 1u);
  EXPECT_EQ(histogram.in_bucket(9), 2u);
  EXPECT_EQ(histogram.in_bucket(DurationHistogram::kBounds.size()), 1u);
  EXPECT_NEAR(histogram.sum_s(), 1000.1903, 1e-6);
}

}  // namespace
}  // namespace barycast::server
