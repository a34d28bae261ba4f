#include <charconv>
#include <cmath>
#include <cstdint>

#include "barycast/client/binding.h"

namespace barycast::client {
namespace {

std::string number(double value) {
  // As Python's json writes and reads them; JSON itself has no such numbers.
  if (std::isnan(value)) return "NaN";
  if (std::isinf(value)) return value > 0 ? "Infinity" : "-Infinity";
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

std::string escape(uint32_t unit) {
  char text[8];
  const auto end = std::to_chars(text, text + sizeof text, unit, 16).ptr;
  return "\\u" + std::string(4 - static_cast<size_t>(end - text), '0') + std::string(text, end);
}

// Takes one character off UTF-8 text; a byte that starts none becomes U+FFFD.
uint32_t take_character(std::string_view& text) {
  const auto byte = [&](size_t i) { return static_cast<uint32_t>(static_cast<unsigned char>(text[i])); };
  const uint32_t first = byte(0);
  const size_t length = first < 0x80 ? 1 : first >> 5 == 6 ? 2 : first >> 4 == 14 ? 3 : first >> 3 == 30 ? 4 : 0;
  bool valid = length > 0 && length <= text.size();
  uint32_t character = length < 2 ? first : first & (0x7fu >> length);
  for (size_t i = 1; valid && i < length; ++i) {
    valid = byte(i) >> 6 == 2;
    character = character << 6 | (byte(i) & 0x3f);
  }
  text.remove_prefix(valid ? length : 1);
  return valid ? character : 0xfffd;
}

std::string quoted(std::string_view text) {
  std::string result = "\"";
  while (!text.empty()) {
    const uint32_t character = take_character(text);
    if (character == '"' || character == '\\') {
      result += '\\';
      result += static_cast<char>(character);
    } else if (character >= 0x20 && character < 0x7f) {
      result += static_cast<char>(character);
    } else if (character < 0x10000) {
      result += escape(character);
    } else {
      result += escape(0xd800 + ((character - 0x10000) >> 10)) + escape(0xdc00 + ((character - 0x10000) & 0x3ff));
    }
  }
  return result + '"';
}

class Object {
 public:
  Object& add(std::string_view key, std::string value) {
    text_ += (text_.empty() ? "" : ", ") + quoted(key) + ": " + value;
    return *this;
  }
  Object& add(std::string_view key, uint64_t value) { return add(key, std::to_string(value)); }
  Object& add(std::string_view key, double value) { return add(key, number(value)); }
  Object& add(std::string_view key, bool value) { return add(key, std::string(value ? "true" : "false")); }
  std::string text() const { return "{" + text_ + "}"; }

 private:
  std::string text_;
};

std::string to_json(const ComputeOptions& options) {
  Object object;
  object.add("coordinates", quoted(name(options.coordinates)))
      .add("preset", quoted(name(options.preset)))
      .add("estimator", quoted(name(options.estimator)))
      .add("samples", uint64_t{options.samples.value_or(0)})
      .add("panels", uint64_t{options.panels.value_or(0)})
      .add("seed", options.seed)
      .add("denoise", quoted(name(options.denoise)))
      .add("thickness", options.thickness.value_or(0))
      .add("walk_steps_max", uint64_t{options.walk_steps_max.value_or(0)})
      .add("prune_below", options.prune_below.value_or(0))
      .add("smoothing_time", options.smoothing_time.value_or(0))
      .add("dtype", quoted(name(options.type)))
      .add("gradients", options.gradients);
  object.add("influences_max", uint64_t{options.influences_max})
      .add("target_error", options.target_error.value_or(0))
      .add("errors", options.errors)
      .add("tables", options.tables);
  return object.text();
}

}  // namespace

std::string to_json(const Report& report) {
  Object rows, seconds;
  rows.add("on_cage", report.rows.on_cage)
      .add("outside", report.rows.outside)
      .add("few_samples", report.rows.few_samples)
      .add("no_samples", report.rows.no_samples)
      .add("rank_deficient", report.rows.rank_deficient);
  for (const auto& [stage, value] : report.seconds) seconds.add(stage, value);
  std::string warnings;
  for (const Warning& warning : report.warnings) {
    const Object object = Object().add("field", quoted(warning.field)).add("message", quoted(warning.message));
    warnings += (warnings.empty() ? "" : ", ") + object.text();
  }
  std::string resumed;
  for (const uint64_t row : report.resumed_rows) resumed += (resumed.empty() ? "" : ", ") + std::to_string(row);
  return Object()
      .add("dimension", uint64_t{report.dimension})
      .add("points", report.points)
      .add("control_vertices", report.control_vertices)
      .add("entries", report.entries)
      .add("options", to_json(report.options))
      .add("rows", rows.text())
      .add("linear_precision_error_max", report.linear_precision_error_max)
      .add("seconds", seconds.text())
      .add("cage_cache_hit", report.cage_cache_hit)
      .add("numerics_version", uint64_t{report.numerics_version})
      .add("warnings", "[" + warnings + "]")
      .add("resumed_rows", "[" + resumed + "]")
      .add("samples", report.samples)
      .add("walk_steps", report.walk_steps)
      .add("walks_capped", report.walks_capped)
      .add("walks_discarded", report.walks_discarded)
      .add("walk_reentries", report.walk_reentries)
      .add("rows_above_target", report.rows_above_target)
      .add("build_version", quoted(report.build_version))
      .text();
}

}  // namespace barycast::client
