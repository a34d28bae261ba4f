#pragma once

// Entries of rows between denoising and the final correction, which is in double: packed, since those of all nodes are
// held at once. A byte for the vertex, floats for value and gradient.

#include <cstdint>
#include <span>
#include <vector>

#include "estimate/row.h"

namespace barycast {

// The entries of some nodes in a row at a group of up to 256 control vertices; 65,535 entries at most.
template <int D>
class PackedRows {
 public:
  explicit PackedRows(bool gradients) : gradients_(gradients) {}

  // For the node under way, ascending by place in the group.
  void add(size_t place, double value, const Vec<D>& gradient) {
    places_.push_back(static_cast<uint8_t>(place));
    numbers_.push_back(static_cast<float>(value));
    if (gradients_)
      for (int k = 0; k < D; ++k) numbers_.push_back(static_cast<float>(gradient[k]));
  }
  void end_node() { ends_.push_back(static_cast<uint16_t>(places_.size())); }

  void clear() {
    ends_.clear();
    places_.clear();
    numbers_.clear();
  }

  // Appends the entries of the i-th node. vertices: of the group.
  void append_to(std::vector<RowEntry<D>>& row, size_t i, std::span<const uint32_t> vertices) const {
    const size_t stride = gradients_ ? 1 + D : 1;
    for (size_t e = i == 0 ? 0 : ends_[i - 1]; e < ends_[i]; ++e) {
      const float* const number = &numbers_[e * stride];
      RowEntry<D> entry{vertices[places_[e]], double{number[0]}, Vec<D>::Zero()};
      if (gradients_) entry.gradient = Eigen::Map<const Eigen::Matrix<float, D, 1>>(number + 1).template cast<double>();
      row.push_back(entry);
    }
  }

 private:
  bool gradients_;
  std::vector<uint16_t> ends_;  // by node
  std::vector<uint8_t> places_;
  std::vector<float> numbers_;
};

}  // namespace barycast
