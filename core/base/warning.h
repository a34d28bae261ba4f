#pragma once

// An oddity in the caller's data that was accepted, for the summary of the answer.

#include <string>

namespace barycast {

struct Warning {
  std::string field;    // path, for example "cage.quads[12]"
  std::string message;  // what was found and what was done about it
};

}  // namespace barycast
