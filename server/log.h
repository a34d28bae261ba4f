#pragma once

// The server's log on stderr: one line per event, one event per request. Text for people, or JSON for
// machines: every line is then one valid JSON object whatever a message or a peer contains (invalid UTF-8
// is replaced). Thread-safe. A line costs some microseconds, and a request writes one, at its end.

#include <string>

#include "request_record.h"

namespace barycast::server {

enum class LogFormat { kText, kJson };

// Sets up the log of this process; before any thread writes. `level`: a name that spdlog knows.
void init_log(LogFormat format, const std::string& level);

void log_request(const RequestRecord& record);
// Any other event; `level`: a name that spdlog knows.
void log_event(const char* level, const std::string& message);

// The line without its end, as log_request writes it in JSON; `time` as in "2024-05-01T12:00:00.000Z".
std::string request_json(const RequestRecord& record, const std::string& time, const std::string& level);
// The same for people, without time and level.
std::string request_text(const RequestRecord& record);
// Any other event in JSON.
std::string event_json(const std::string& message, const std::string& time, const std::string& level);

}  // namespace barycast::server
