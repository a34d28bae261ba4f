#pragma once

// Expected failures as values: Result<T> holds a T or an Error. Nothing in this library throws for what
// a caller's data, a server or a network can cause, nothing exits, and nothing prints. Asking a Result
// that holds an Error for its value is a mistake of the program and throws std::bad_variant_access, and
// memory that runs out throws std::bad_alloc.
// An Error names the field at fault by its path ("cage.quads[12][3]", "header.options.samples"), so that
// a person can find it.

#include <string>
#include <utility>
#include <variant>

namespace barycast::client {

// The numbers are gRPC's.
enum class Code {
  kCancelled = 1,          // the caller gave up
  kUnknown = 2,            // also: a file that cannot be written
  kInvalidArgument = 3,    // the input is wrong and will stay wrong
  kDeadlineExceeded = 4,   // ClientSettings::time_max is over
  kNotFound = 5,           // a file that cannot be read
  kResourceExhausted = 8,  // over a limit of the server; or it was busy all the time
  kFailedPrecondition = 9,
  kOutOfRange = 11,
  kUnimplemented = 12,  // valid, but this server does not compute it
  kInternal = 13,
  kUnavailable = 14,  // no server answers
  kDataLoss = 15,     // the answer was incomplete or did not fit together
};

struct Error {
  Code code = Code::kInternal;
  std::string field = {};    // path of the field at fault, or a file with its line; may be empty
  std::string message = {};  // what is wrong and what to do, one sentence without the field
  bool is_input = false;     // the same request would be refused again: change the input

  // "field: message", or the message alone.
  std::string text() const { return field.empty() || message.starts_with(field) ? message : field + ": " + message; }
};

inline Error input_error(std::string field, std::string message, Code code = Code::kInvalidArgument) {
  return {.code = code, .field = std::move(field), .message = std::move(message), .is_input = true};
}

template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : state_(std::move(value)) {}
  Result(Error error) : state_(std::move(error)) {}

  bool ok() const { return state_.index() == 0; }
  explicit operator bool() const { return ok(); }

  T& value() & { return std::get<0>(state_); }
  const T& value() const& { return std::get<0>(state_); }
  T&& value() && { return std::get<0>(std::move(state_)); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  const Error& error() const { return std::get<1>(state_); }

 private:
  std::variant<T, Error> state_;
};

// Success or an Error.
struct Done {};
using Status = Result<Done>;

}  // namespace barycast::client
