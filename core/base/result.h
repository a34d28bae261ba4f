#pragma once

// Expected failures as values: Result<T> holds a T or an Error. Use it for whatever the caller's data
// can cause; a violated promise inside the program is a BARYCAST_CHECK instead (check.h).
// An Error names the field at fault by its path ("cage.quads[12].vertex[3]"), so that a person can
// find it; the service maps its code to a gRPC status in one place.

#include <string>
#include <utility>
#include <variant>

#include "base/check.h"

namespace barycast {

enum class ErrorCode {
  kInvalidArgument,     // the input is wrong and will stay wrong
  kResourceExhausted,   // larger than a limit
  kUnimplemented,       // valid, but not built yet
  kFailedPrecondition,  // valid, but something it refers to is missing or differs
  kCancelled,           // the caller gave up
  kInternal,            // a library we rely on failed
};

struct Error {
  ErrorCode code = ErrorCode::kInternal;
  std::string field;    // path of the field at fault; may be empty
  std::string message;  // what is wrong and what to do; never empty

  // "field: message", or the message alone.
  std::string text() const { return field.empty() ? message : field + ": " + message; }
};

inline Error invalid_argument(std::string field, std::string message) {
  return {ErrorCode::kInvalidArgument, std::move(field), std::move(message)};
}

template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : state_(std::move(value)) {}
  Result(Error error) : state_(std::move(error)) {}

  bool ok() const { return state_.index() == 0; }
  explicit operator bool() const { return ok(); }

  T& value() & {
    BARYCAST_CHECK(ok());
    return std::get<0>(state_);
  }
  const T& value() const& {
    BARYCAST_CHECK(ok());
    return std::get<0>(state_);
  }
  T&& value() && {
    BARYCAST_CHECK(ok());
    return std::get<0>(std::move(state_));
  }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }

  const Error& error() const {
    BARYCAST_CHECK(!ok());
    return std::get<1>(state_);
  }

 private:
  std::variant<T, Error> state_;
};

// Success or an Error.
struct Done {};
using Status = Result<Done>;

}  // namespace barycast
