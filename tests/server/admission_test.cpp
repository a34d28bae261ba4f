#include "admission.h"

#include <gtest/gtest.h>

namespace barycast::server {
namespace {

using Entered = std::variant<std::unique_ptr<Admission::Ticket>, Refusal>;

bool admitted(const Entered& entered) {
  return entered.index() == 0;
}

TEST(Admission, BoundsRequestsAndGivesThemBack) {
  Admission admission({.requests_max = 2, .bytes_max = 1000});
  Entered a = admission.enter(1), b = admission.enter(1);
  const Entered refused = admission.enter(1);
  EXPECT_TRUE(admitted(a));
  EXPECT_TRUE(admitted(b));
  ASSERT_FALSE(admitted(refused));
  EXPECT_EQ(std::get<Refusal>(refused).error.code, ErrorCode::kResourceExhausted);
  EXPECT_TRUE(std::get<Refusal>(refused).retry_after_ms.has_value());
  a = Entered(Refusal{});
  EXPECT_TRUE(admitted(admission.enter(1)));
}

TEST(Admission, BoundsBytes) {
  Admission admission({.requests_max = 10, .bytes_max = 1000});
  Entered a = admission.enter(600);
  EXPECT_FALSE(admitted(admission.enter(401)));
  EXPECT_TRUE(admitted(admission.enter(400)));
  EXPECT_FALSE(admitted(admission.enter(~uint64_t{0})));
  a = Entered(Refusal{});
  // Alone, a request is judged by its own limit only.
  EXPECT_TRUE(admitted(admission.enter(5000)));
}

}  // namespace
}  // namespace barycast::server
