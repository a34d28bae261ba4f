#include "log.h"

#include <fmt/chrono.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

namespace barycast::server {
namespace {

// Keys stay in the order in which people read them.
using Json = nlohmann::ordered_json;

constexpr const char* kRequestsLogger = "requests";

LogFormat format_in_use = LogFormat::kText;

std::string utc(spdlog::log_clock::time_point time) {
  const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch()).count();
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(std::chrono::system_clock::to_time_t(time)), ms % 1000);
}

std::string one_line(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

// Events become JSON here; what comes from the requests' logger is JSON already.
class JsonFormatter final : public spdlog::formatter {
 public:
  void format(const spdlog::details::log_msg& message, spdlog::memory_buf_t& out) override {
    const std::string payload(message.payload.data(), message.payload.size());
    const std::string_view level(spdlog::level::to_string_view(message.level).data(),
                                 spdlog::level::to_string_view(message.level).size());
    const bool is_json = std::string_view(message.logger_name.data(), message.logger_name.size()) == kRequestsLogger;
    const std::string line = is_json ? payload : event_json(payload, utc(message.time), std::string(level));
    out.append(line.data(), line.data() + line.size());
    out.push_back('\n');
  }
  std::unique_ptr<spdlog::formatter> clone() const override { return std::make_unique<JsonFormatter>(); }
};

double ms(double seconds) {
  return std::round(seconds * 1e6) / 1e3;
}

}  // namespace

void init_log(LogFormat format, const std::string& level) {
  format_in_use = format;
  spdlog::drop_all();
  const auto sink = std::make_shared<spdlog::sinks::stderr_sink_mt>();
  const auto events = std::make_shared<spdlog::logger>("barycastd", sink);
  spdlog::set_default_logger(events);
  spdlog::register_logger(std::make_shared<spdlog::logger>(kRequestsLogger, sink));
  spdlog::set_level(spdlog::level::from_str(level));
  if (format == LogFormat::kJson) {
    sink->set_formatter(std::make_unique<JsonFormatter>());
  } else {
    sink->set_pattern("%Y-%m-%dT%H:%M:%S.%e%z %l %v");
  }
}

void log_request(const RequestRecord& record) {
  // A server inside a test has no logger of its own for requests.
  static const std::shared_ptr<spdlog::logger> own = spdlog::get(kRequestsLogger);
  spdlog::logger& logger = own ? *own : *spdlog::default_logger_raw();
  if (!logger.should_log(spdlog::level::info)) return;
  logger.info("{}", format_in_use == LogFormat::kJson ? request_json(record, utc(spdlog::log_clock::now()), "info")
                                                      : request_text(record));
}

void log_event(const char* level, const std::string& message) {
  spdlog::log(spdlog::level::from_str(level), "{}", message);
}

std::string request_json(const RequestRecord& record, const std::string& time, const std::string& level) {
  const RequestFacts& facts = record.facts;
  Json json = {{"time", time},
               {"level", level},
               {"method", method_name(record.method)},
               {"code", record.outcome},
               {"ms", ms(record.seconds)},
               {"peer", record.peer},
               {"message", record.message}};
  json["cage"] = facts.cage.empty() ? Json() : Json(facts.cage);
  json["cache_hit"] = facts.cache_hit ? Json(*facts.cache_hit) : Json();
  json["points"] = facts.points;
  json["faces"] = facts.faces;
  json["control_vertices"] = facts.control_vertices;
  json["samples"] = facts.samples;
  json["rows"] = facts.rows;
  json["entries"] = facts.entries;
  Json& stages = json["stages_ms"] = Json::object();
  for (size_t i = 0; facts.stages && i < kStageNames.size(); ++i) stages[kStageNames[i]] = ms((*facts.stages)[i]);
  return one_line(json);
}

std::string request_text(const RequestRecord& record) {
  const RequestFacts& facts = record.facts;
  std::string text = fmt::format("{} {} ms={:.1f} peer={}", method_name(record.method), record.outcome,
                                 1e3 * record.seconds, record.peer);
  if (!facts.cage.empty()) text += " cage=" + facts.cage;
  if (facts.cache_hit) text += *facts.cache_hit ? " cache=hit" : " cache=miss";
  if (facts.points > 0) {
    text += fmt::format(" points={} faces={} control_vertices={} samples={} rows={} entries={}", facts.points,
                        facts.faces, facts.control_vertices, facts.samples, facts.rows, facts.entries);
  }
  for (size_t i = 0; facts.stages && i < kStageNames.size(); ++i)
    text += fmt::format(" {}_ms={:.1f}", kStageNames[i], 1e3 * (*facts.stages)[i]);
  if (!record.message.empty()) text += " message=" + record.message;
  // One line, and no control codes for the terminal that shows it.
  for (char& c : text)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = ' ';
  return text;
}

std::string event_json(const std::string& message, const std::string& time, const std::string& level) {
  return one_line({{"time", time}, {"level", level}, {"message", message}});
}

}  // namespace barycast::server
