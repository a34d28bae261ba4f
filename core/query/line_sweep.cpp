#include <bit>

#include "query/line_index.h"
#include "query/meet_lanes.h"
#include "query/sweep_lanes.h"

namespace barycast {
namespace {

// Floats hold the cage as seen from within this many diagonals of its centre.
constexpr double kSweepReach = 2.0;

std::array<float, 3> in_floats(const Vec<3>& x) {
  return {static_cast<float>(x[0]), static_cast<float>(x[1]), static_cast<float>(x[2])};
}

class LineSweep final : public LineIndex<3> {
 public:
  LineSweep(const Cage<3>& cage, std::unique_ptr<const LineIndex<3>> everywhere)
      : cage_(cage), everywhere_(std::move(everywhere)), corners_(corners_of(cage)) {
    for (const ElementKind kind : {ElementKind::kTriangle, ElementKind::kQuad}) {
      size_t lane = kSweepLanes;
      for (uint32_t e = 0; e < cage.elements().size(); ++e) {
        if (cage.elements()[e].kind != kind) continue;
        if (lane == kSweepLanes) {
          blocks_.emplace_back();
          blocks_.back().quads = kind == ElementKind::kQuad;
          for (lane = 0; lane < kSweepLanes; ++lane) set(blocks_.back(), lane, e);
          lane = 0;
        }
        set(blocks_.back(), lane, e);
        blocks_.back().count = static_cast<uint32_t>(++lane);
      }
    }
  }

  void hits(const Vec<3>& origin, std::span<const Vec<3>> directions, double from, LineHits<3>& out) const override {
    if (origin.squaredNorm() > kSweepReach * kSweepReach) return everywhere_->hits(origin, directions, from, out);
    out.hits.clear();
    propose(origin, directions, out.candidates);
    for (const bool quads : {false, true})
      meet_candidates(corners_, quads, origin, directions, out.candidates[quads], from, out.hits);
    order_hits(directions.size(), out);
  }

  size_t bytes() const override {
    return sizeof(*this) + blocks_.capacity() * sizeof(SweepBlock) + corners_.capacity() * sizeof(ElementCorners) +
           everywhere_->bytes();
  }

 private:
  // Triangles and quads.
  void propose(const Vec<3>& origin, std::span<const Vec<3>> directions,
               std::array<std::vector<LineCandidate>, 2>& candidates) const {
    for (auto& of_kind : candidates) of_kind.clear();
    const size_t count = directions.size();
    thread_local std::vector<float> coordinates;
    thread_local std::vector<uint16_t> may_meet;
    coordinates.resize(3 * count);
    may_meet.resize(count);
    float *const x = coordinates.data(), *const y = x + count, *const z = y + count;
    for (size_t i = 0; i < count; ++i) {
      x[i] = static_cast<float>(directions[i][0]);
      y[i] = static_cast<float>(directions[i][1]);
      z[i] = static_cast<float>(directions[i][2]);
    }
    for (const SweepBlock& block : blocks_) {
      sweep_lines(block, in_floats(origin), {x, y, z, count}, may_meet.data());
      std::vector<LineCandidate>& of_kind = candidates[block.quads ? 1 : 0];
      size_t proposed = of_kind.size();
      // Room for all of them, and no look at it for each.
      for (const uint16_t lanes : may_meet) proposed += static_cast<size_t>(std::popcount(lanes));
      const size_t before = of_kind.size();
      of_kind.resize(proposed);
      LineCandidate* next = of_kind.data() + before;
      for (uint32_t i = 0; i < count; ++i)
        for (uint32_t lanes = may_meet[i]; lanes != 0; lanes &= lanes - 1)
          *next++ = {i, block.element[static_cast<size_t>(std::countr_zero(lanes))]};
    }
  }

  void set(SweepBlock& block, size_t lane, uint32_t e) const {
    const Element& element = cage_.elements()[e];
    block.element[lane] = e;
    for (int c = 0; c < element.corner_count(); ++c)
      for (size_t k = 0; k < 3; ++k)
        block.corner[static_cast<size_t>(c)][k][lane] =
            static_cast<float>(cage_.corner(element, c)[static_cast<Eigen::Index>(k)]);
  }

  const Cage<3>& cage_;
  std::unique_ptr<const LineIndex<3>> everywhere_;
  std::vector<ElementCorners> corners_;
  std::vector<SweepBlock> blocks_;
};

}  // namespace

Result<std::unique_ptr<const LineIndex<3>>> make_line_sweep(const Cage<3>& cage) {
  auto everywhere = make_embree_line_index<3>(cage);
  if (!everywhere) return everywhere.error();
  return std::unique_ptr<const LineIndex<3>>(std::make_unique<LineSweep>(cage, std::move(everywhere).value()));
}

template <int D>
Result<std::unique_ptr<const LineIndex<D>>> make_line_index(const Cage<D>& cage) {
  if constexpr (D == 3) {
    size_t triangles = 0;
    for (const Element& element : cage.elements()) triangles += element.kind == ElementKind::kQuad ? 2 : 1;
    if (triangles <= kSweptTrianglesMax) return make_line_sweep(cage);
  }
  return make_embree_line_index<D>(cage);
}

template Result<std::unique_ptr<const LineIndex<2>>> make_line_index(const Cage<2>&);
template Result<std::unique_ptr<const LineIndex<3>>> make_line_index(const Cage<3>&);

}  // namespace barycast
