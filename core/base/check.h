#pragma once

// Checks for programmer errors: a failed check prints the condition and its operands and aborts.
// Never used for anything that a caller's data can cause (that is result.h).

#include <cstdio>
#include <cstdlib>
#include <sstream>
#include <string>

namespace barycast::detail {

[[noreturn]] inline void check_failed(const char* condition, const char* where, int line, const std::string& operands) {
  std::fprintf(stderr, "check failed: %s%s at %s:%d\n", condition, operands.c_str(), where, line);
  std::abort();
}

template <class A, class B>
std::string operands_text(const A& a, const B& b) {
  std::ostringstream out;
  out << " (" << a << " against " << b << ")";
  return out.str();
}

}  // namespace barycast::detail

#define BARYCAST_CHECK(condition)                                                                \
  do {                                                                                           \
    if (!(condition)) ::barycast::detail::check_failed(#condition, __FILE_NAME__, __LINE__, ""); \
  } while (false)

#define BARYCAST_CHECK_OP(a, op, b)                                                          \
  do {                                                                                       \
    const auto& check_a = (a);                                                               \
    const auto& check_b = (b);                                                               \
    if (!(check_a op check_b))                                                               \
      ::barycast::detail::check_failed(#a " " #op " " #b, __FILE_NAME__, __LINE__,           \
                                       ::barycast::detail::operands_text(check_a, check_b)); \
  } while (false)
