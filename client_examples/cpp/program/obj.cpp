#include "obj.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <optional>
#include <string_view>

namespace barycast::program {
namespace {

using client::Done;
using client::Error;
using client::input_error;
using client::Result;
using client::Status;

constexpr int64_t kIndexMax = std::numeric_limits<uint32_t>::max();

// Whole, or nothing. A leading + is fine in files, and not for from_chars.
std::optional<double> parse(std::string_view text) {
  if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
  double value = 0;
  const auto [end, failure] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (end != text.data() + text.size() || text.empty()) return std::nullopt;
  if (failure == std::errc::result_out_of_range) return std::strtod(std::string(text).c_str(), nullptr);
  if (failure != std::errc()) return std::nullopt;
  return value;
}

class Parser {
 public:
  explicit Parser(std::string path) { model_.path = std::move(path); }

  Status parse_text(std::string_view text);
  Result<Model> finish();

 private:
  Status parse_line(std::string_view line);
  Status add_vertex();
  // Zero-based indices of the tokens after the first.
  Result<std::vector<int64_t>> corners(size_t least) const;
  Status add_face();
  Status add_segments();
  Error error(std::string message) const { return error(std::move(message), line_); }
  Error error(std::string message, size_t line) const {
    return input_error(model_.path + ":" + std::to_string(line), std::move(message));
  }

  Model model_;
  std::vector<std::string_view> tokens_;
  size_t line_ = 0;
  // Corners may name vertices that come later, so they are judged at the end.
  std::vector<size_t> face_lines_;     // one per corner
  std::vector<size_t> segment_lines_;  // one per corner
};

std::vector<std::string_view> split(std::string_view line) {
  constexpr std::string_view kSpace = " \t\r\n\v\f";
  std::vector<std::string_view> tokens;
  for (size_t begin = line.find_first_not_of(kSpace); begin != std::string_view::npos;) {
    const size_t end = std::min(line.find_first_of(kSpace, begin), line.size());
    tokens.push_back(line.substr(begin, end - begin));
    begin = line.find_first_not_of(kSpace, end);
  }
  return tokens;
}

Status Parser::parse_text(std::string_view text) {
  std::string held;  // lines that go on, joined
  size_t number = 0;
  while (!text.empty()) {
    const size_t end = std::min(text.find_first_of("\r\n"), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(end);
    const bool has_end = !text.empty();
    text.remove_prefix(text.starts_with("\r\n") ? 2 : has_end ? 1 : 0);
    ++number;
    if (held.empty()) line_ = number;  // errors name the first line
    // Not in comments: paths that end in a backslash are common there.
    const bool comment = line.find('#') != std::string_view::npos || held.find('#') != std::string::npos;
    held += line;
    if (!comment && held.ends_with('\\') && has_end) {
      held.back() = ' ';
      continue;
    }
    if (Status s = parse_line(held); !s) return s;
    held.clear();
  }
  return held.empty() ? Status(Done{}) : parse_line(held);
}

Status Parser::parse_line(std::string_view line) {
  line = line.substr(0, line.find('#'));
  tokens_ = split(line);
  if (tokens_.empty()) return Done{};
  if (tokens_[0] == "v") return add_vertex();
  if (tokens_[0] == "f") return add_face();
  if (tokens_[0] == "l") return add_segments();
  return Done{};
}

Status Parser::add_vertex() {
  // Further numbers (weights, colours) are not ours.
  for (size_t axis = 1; axis <= 3; ++axis) {
    const std::optional<double> value = axis < tokens_.size() ? parse(tokens_[axis]) : std::nullopt;
    if (!value) return error("v needs three numbers; repair or remove the line");
    if (!std::isfinite(*value)) return error("has a coordinate that is not finite; repair the line");
    model_.points.push_back(*value);
  }
  return Done{};
}

Result<std::vector<int64_t>> Parser::corners(size_t least) const {
  const auto count = static_cast<int64_t>(model_.points.size() / 3);
  std::vector<int64_t> indices;
  for (size_t i = 1; i < tokens_.size(); ++i) {
    const std::string_view vertex = tokens_[i].substr(0, tokens_[i].find('/'));
    int64_t index = 0;
    const std::string_view digits = vertex.starts_with('+') ? vertex.substr(1) : vertex;
    const auto [end, failure] = std::from_chars(digits.data(), digits.data() + digits.size(), index);
    if (failure != std::errc() || end != digits.data() + digits.size()) {
      return error("corners must be whole numbers like 3 or 3/1/2; repair or remove the line");
    }
    const int64_t from_zero = index > 0 ? index - 1 : count + index;
    if (index == 0 || from_zero < 0 || from_zero > kIndexMax) {
      return error(from_zero > kIndexMax
                       ? "names vertex " + std::to_string(index) + ", more than a file can hold"
                       : "names a vertex before the first; indices start at 1, negative ones count back");
    }
    indices.push_back(from_zero);
  }
  if (indices.size() < least) {
    return error("needs at least " + std::to_string(least) + " corners; repair or remove the line");
  }
  return indices;
}

Status Parser::add_face() {
  const Result<std::vector<int64_t>> indices = corners(3);
  if (!indices) return indices.error();
  for (const int64_t index : *indices) {
    face_lines_.push_back(line_);
    model_.faces.corners.push_back(static_cast<uint32_t>(index));
  }
  model_.faces.offsets.push_back(model_.faces.corners.size());
  return Done{};
}

Status Parser::add_segments() {
  const Result<std::vector<int64_t>> indices = corners(2);
  if (!indices) return indices.error();
  for (size_t i = 0; i + 1 < indices->size(); ++i) {
    for (const int64_t index : {(*indices)[i], (*indices)[i + 1]}) {
      segment_lines_.push_back(line_);
      model_.segments.push_back(static_cast<uint32_t>(index));
    }
  }
  return Done{};
}

Result<Model> Parser::finish() {
  const size_t count = model_.points.size() / 3;
  if (count == 0) return input_error(model_.path, "holds no vertices (lines that start with v)");
  const auto check = [&](const std::vector<uint32_t>& indices, const std::vector<size_t>& lines) -> Status {
    const auto bad = std::find_if(indices.begin(), indices.end(), [&](uint32_t index) { return index >= count; });
    if (bad == indices.end()) return Done{};
    return error("names vertex " + std::to_string(uint64_t{*bad} + 1) + ", the file has " + std::to_string(count),
                 lines[static_cast<size_t>(bad - indices.begin())]);
  };
  if (Status s = check(model_.faces.corners, face_lines_); !s) return s.error();
  if (Status s = check(model_.segments, segment_lines_); !s) return s.error();
  return std::move(model_);
}

}  // namespace

Result<Model> read_obj(const std::string& path) {
  std::string ending = path.substr(std::min(path.rfind('.'), path.size()));
  std::transform(ending.begin(), ending.end(), ending.begin(), [](unsigned char c) { return std::tolower(c); });
  if (ending != ".obj") {
    return input_error(path, "does not end in .obj; `barycast bind` also reads .ply, .stl and .npz");
  }
  const Result<std::string> content = read_file(path);
  if (!content) return content.error();
  Parser parser(path);
  if (Status s = parser.parse_text(*content); !s) return s.error();
  return parser.finish();
}

}  // namespace barycast::program
