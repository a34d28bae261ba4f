#include <bit>

#include "query/line_index.h"
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
      : cage_(cage), everywhere_(std::move(everywhere)) {
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

  std::unique_ptr<LinePencil<3>> pencil() const override { return std::make_unique<Pencil>(*this); }

  size_t bytes() const override {
    return sizeof(*this) + blocks_.capacity() * sizeof(SweepBlock) + everywhere_->bytes();
  }

 private:
  class Pencil final : public LinePencil<3> {
   public:
    explicit Pencil(const LineSweep& sweep)
        : sweep_(sweep), far_(sweep.everywhere_->pencil()), blocks_(sweep.blocks_.size()) {}

    void set_origin(const Vec<3>& origin) override {
      origin_ = origin;
      is_far_ = origin.squaredNorm() > kSweepReach * kSweepReach;
      if (is_far_) return far_->set_origin(origin);
      for (size_t i = 0; i < blocks_.size(); ++i) prepare_pencil(sweep_.blocks_[i], in_floats(origin), blocks_[i]);
    }

    void hits(const Vec<3>& direction, double from, std::vector<LineHit<3>>& out) override {
      if (is_far_) return far_->hits(direction, from, out);
      out.clear();
      const Line<3> line(origin_, direction);
      const std::array<float, 3> in_float = in_floats(direction);
      for (size_t i = 0; i < blocks_.size(); ++i)
        for (uint32_t lanes = may_meet(sweep_.blocks_[i], blocks_[i], in_float); lanes != 0; lanes &= lanes - 1)
          append_hits(line, sweep_.cage_, sweep_.blocks_[i].element[static_cast<size_t>(std::countr_zero(lanes))], from,
                      out);
      sort_hits(out);
    }

   private:
    const LineSweep& sweep_;
    std::unique_ptr<LinePencil<3>> far_;
    std::vector<PencilBlock> blocks_;
    Vec<3> origin_ = Vec<3>::Zero();
    bool is_far_ = false;
  };

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
