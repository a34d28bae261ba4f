#include "solve/closed.h"

#include <algorithm>
#include <map>
#include <utility>

namespace barycast {

bool is_closed(const Cage<3>& cage) {
  const auto less = [](const Vec<3>& a, const Vec<3>& b) {
    return std::lexicographical_compare(a.data(), a.data() + 3, b.data(), b.data() + 3);
  };
  std::map<Vec<3>, uint32_t, decltype(less)> positions(less);
  std::map<std::pair<uint32_t, uint32_t>, int> balance;  // of an edge from its lower to its higher vertex
  for (const Element& element : cage.elements()) {
    const int count = element.corner_count();
    for (int i = 0; i < count; ++i) {
      const auto number = [&](int corner) {
        return positions.try_emplace(cage.corner(element, corner % count), positions.size()).first->second;
      };
      const uint32_t a = number(i), b = number(i + 1);
      if (a < b) ++balance[{a, b}];
      if (b < a) --balance[{b, a}];
    }
  }
  return std::all_of(balance.begin(), balance.end(), [](const auto& edge) { return edge.second == 0; });
}

}  // namespace barycast
