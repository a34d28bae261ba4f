#pragma once

// Harmonic coordinates in the plane, inside and outside of closed or open polygons, from boundary integrals: a single
// layer with the kernel log r and total charge zero, plus a constant, so that the field is bounded far away (in the
// plane every walk arrives). Panels of constant density, graded towards the ends of each segment, where the density is
// singular; integrals in closed form; collocation at the panels' middles; a dense solve.
//
// Solved for the moments: the harmonic functions with the boundary values phi_v [y; 1] and [y; 1] [y; 1]^T. The row is
// the projection of those [SBC Eq. 7 to 10]; inside closed cages it has no effect in the limit. Segments must not cross
// one another between their ends.
//
// Third order in the panels. Measured, E at 64 a segment: a square 3.4e-6 (closed form); a star of 10 segments, closed
// or open, against 256 panels 6e-6 to 8e-6 inside and near, 4e-5 up to ten radii away. Cost: a dense solve of all
// panels with 3 columns a control vertex; 640 panels and 33 columns take 0.06 s, a point 50 us.

#include <Eigen/LU>
#include <cmath>
#include <vector>

#include "support/dense_rows.h"

namespace barycast::testing {

class BoundaryElements2d {
 public:
  explicit BoundaryElements2d(const Cage<2>& cage, int panels_per_segment = 64, double grading = 3.0)
      : cage_(cage), nodes_(node_count(cage)) {
    for (const Element& segment : cage.elements()) add_panels(segment, panels_per_segment, grading);
    solve();
  }

  // Rows of points (n x 2, in the caller's units), on the cage as well.
  DenseRows evaluate(std::span<const double> points) const {
    DenseRows rows = DenseRows::Zero(static_cast<Eigen::Index>(points.size() / 2), cage_.control_vertex_count());
    for (Eigen::Index i = 0; i < rows.rows(); ++i) {
      const Vec<2> x = normalized_point(cage_, points, static_cast<size_t>(i));
      const Eigen::RowVectorXd field = potentials(x) * density_;
      project(x, field, rows.row(i));
    }
    return rows;
  }

  Eigen::Index panels() const { return static_cast<Eigen::Index>(panels_.size()); }

 private:
  struct Panel {
    Vec<2> middle, tangent;
    double half;  // length
    const Element* segment;
    double first_share;  // of the segment's first corner, at the middle
  };

  // Breaks at t^q / (t^q + (1 - t)^q) for t equally spaced: the panels at an end have its distance to the power of
  // (q - 1) / q for their length.
  void add_panels(const Element& segment, int count, double grading) {
    const Vec<2>&a = cage_.corner(segment, 0), &b = cage_.corner(segment, 1);
    const double length = (b - a).norm();
    const auto from_end = [&](int i) {  // at most a half, so that nothing cancels
      const double t = std::pow(i, grading), rest = std::pow(count - i, grading);
      return t / (t + rest);
    };
    for (int i = 0; i < count; ++i) {
      // Counted from the nearer end.
      const bool late = 2 * i >= count;
      const int near = late ? count - 1 - i : i;
      const double low = from_end(near), high = from_end(near + 1), middle = (low + high) / 2;
      const Vec<2> at = late ? Vec<2>(b + middle * (a - b)) : Vec<2>(a + middle * (b - a));
      panels_.push_back({at, (b - a) / length, (high - low) / 2 * length, &segment, late ? middle : 1 - middle});
    }
  }

  // The mean of log |x - y| over every panel, and a 1 for the constant. Unknowns are charges, not densities: the panels
  // at the ends are short.
  Eigen::RowVectorXd potentials(const Vec<2>& x) const {
    Eigen::RowVectorXd result(panels() + 1);
    for (Eigen::Index j = 0; j < panels(); ++j) {
      const Panel& panel = panels_[static_cast<size_t>(j)];
      const Vec<2> to = x - panel.middle;
      const double h = panel.half, along = to.dot(panel.tangent);
      const double beside = std::abs(to[0] * panel.tangent[1] - to[1] * panel.tangent[0]);
      if (to.squaredNorm() > 1e6 * h * h) {
        // The closed form cancels: its series, to the fourth order.
        const double r2 = to.squaredNorm();
        result[j] = 0.5 * std::log(r2) - h * h * (along * along - beside * beside) / (6 * r2 * r2);
        continue;
      }
      const auto part = [&](double s) {
        const double r2 = s * s + beside * beside;
        return (r2 > 0 ? 0.5 * s * std::log(r2) : 0.0) + beside * std::atan2(s, beside);
      };
      result[j] = (part(along + h) - part(along - h)) / (2 * h) - 1;
    }
    result[panels()] = 1;
    return result;
  }

  // Columns: for every node phi [y; 1], then y0 y0, y0 y1, y1 y1.
  void solve() {
    const Eigen::Index n = panels();
    Eigen::MatrixXd matrix(n + 1, n + 1), values = Eigen::MatrixXd::Zero(n + 1, 3 * nodes_ + 3);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Panel& panel = panels_[static_cast<size_t>(i)];
      matrix.row(i) = potentials(panel.middle);
      const Vec<2>& y = panel.middle;
      for (size_t corner = 0; corner < 2; ++corner)
        values.block<1, 3>(i, 3 * panel.segment->node[corner]) +=
            (corner == 0 ? panel.first_share : 1 - panel.first_share) * homogeneous<2>(y).transpose();
      values.row(i).tail<3>() << y[0] * y[0], y[0] * y[1], y[1] * y[1];
    }
    matrix.row(n).setOnes();  // total charge
    matrix(n, n) = 0;
    density_ = matrix.partialPivLu().solve(values);
  }

  // Moments about the query, and the last row of M^-1 m.
  template <class Row>
  void project(const Vec<2>& x, const Eigen::RowVectorXd& field, Row&& row) const {
    const Vec<3> square = field.tail<3>();
    Vec<3> first = Vec<3>::Zero();  // of [y; 1]: the moments of all nodes
    for (Eigen::Index node = 0; node < nodes_; ++node) first += field.segment<3>(3 * node);
    Mat<3> second;
    second << square[0], square[1], first[0], square[1], square[2], first[1], first[0], first[1], first[2];
    Mat<3> about = Mat<3>::Identity();
    about.col(2).head<2>() = -x;
    second = about * second * about.transpose();
    const Vec<3> last = about.transpose() * second.fullPivLu().solve(Vec<3>::UnitZ());
    for (Eigen::Index node = 0; node < nodes_; ++node)
      add_node_value(cage_, static_cast<uint32_t>(node), field.segment<3>(3 * node).dot(last), row);
  }

  const Cage<2>& cage_;
  Eigen::Index nodes_;
  std::vector<Panel> panels_;
  Eigen::MatrixXd density_;  // charges and the constant, for every boundary value
};

}  // namespace barycast::testing
