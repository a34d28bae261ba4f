#pragma once

// Every tolerance of the library, in the cage's normalized frame (unit: the diagonal of its bounding
// box) unless said otherwise. Each says why it has the size it has.

namespace barycast {

// Thickness of the cage: where walks arrive and queries count as on the cage [SBC 5.1].
inline constexpr double kThicknessDefault = 1e-3;
inline constexpr double kThicknessMin = 1e-6;
inline constexpr double kThicknessMax = 1e-1;
// A query on the cage takes its frame from a location this many thicknesses away [SBC 4.5]: at two,
// walks still take a step before they arrive, so the samples span space.
inline constexpr double kFrameShift = 2.0;

// Larger coordinates are refused, in the caller's units: their squares and cubes would overflow.
inline constexpr double kCoordinateMax = 1e100;

// A control vertex set flatter than this (smallest over largest standard deviation) does not span
// space: coordinates grow with its reciprocal away from the cage, and their sum could not be one to the
// promised 1e-12. Measured on 1 x 1 x h boxes: 2e-13 at h = 1e-3, 2.9e-12 at 1e-4.
inline constexpr double kSpanRatioMin = 3e-4;
// An element shorter than this, or with less area than this times its longest edge squared, is
// degenerate: its normal and shares are lost to rounding, and walks end on it with a probability of that
// order.
inline constexpr double kDegenerate = 1e-10;

// Walks that wander beyond kReentryRadius come back through the sphere of radius kEnclosingRadius. The
// cage lies within 0.5 of the origin, so 0.52 clears it; re-entry from further out than 1.3 times that
// keeps the number of re-entries per walk near one.
inline constexpr double kEnclosingRadius = 0.52;
inline constexpr double kReentryRadius = 1.3 * kEnclosingRadius;

// Total weight of the pseudo-samples at the control vertices, in mean samples: measured on a box and on
// a character cage, 0.1 removes the outliers of nearly singular moments at a bias of 0.1 / samples.
inline constexpr double kPseudoSampleWeight = 0.1;
// Signed weights may let through this much more noise than their magnitudes would in the coordinates of the query;
// beyond, magnitudes take over.
inline constexpr double kSignedAmplificationMax = 10.0;
// ... and this much anywhere in the fits: smoothing carries fits from far points to near ones, where rounding that
// is magnified further would break the promise of linear precision.
inline constexpr double kSignedAmplificationMaxAnywhere = 1e4;
// Reciprocal condition below which a moment matrix counts as singular (paper preset).
inline constexpr double kMomentRcondMin = 1e-10;
// Rows from fewer samples say so [SBC 4.5 Limitations].
inline constexpr unsigned kSamplesFew = 20;

// Entries are dropped below this magnitude: the error of a deformation is this times the cage's motion.
inline constexpr double kPruneDefault = 1e-4;
inline constexpr double kPruneMax = 0.1;
// A gradient counts as many times more than a value: over a hundredth of the diagonal, the reach of a
// typical linearization, it moves a point as much as the value threshold does.
inline constexpr double kPruneGradientFactor = 100.0;
// The kept vertices of a row must have at least this second moment in every direction, the cage's own
// being one: the final correction then amplifies its residual by ten at most.
inline constexpr double kKeptSpanMin = 1e-2;

// Where the number of entries is limited, a vertex spans a new direction if it lies this far off the span of the
// kept ones, the cage's own standard deviation being one.
inline constexpr double kKeptOffSpanMin = 0.2;

// A face of the query mesh with less area than this times its longest edge squared is skipped by the
// smoother: its cotangents, near the reciprocal, would drown the others in rounding.
inline constexpr double kFaceAreaMin = 1e-6;
// Smoothed entries are collected down to this part of the pruning thresholds, so that the next largest
// ones are at hand where the kept ones do not span space.
inline constexpr double kCollectBelowPrune = 0.125;

// A query further out, in diagonals, is refused: its coordinates would exceed 1e9, and the cage shrink
// below the rounding of the query's own position.
inline constexpr double kQueryReachMax = 1e9;

// Closer to the cage than this, closed forms return the basis: positions within a unit box are rounded to 1e-16, so
// that a distance has two digits left.
inline constexpr double kExactOnCage = 1e-14;
// Where gradients of points on the cage are taken, this far off it: the limit is met to about this, and the gradient is
// rounded to 1e-16 over it.
inline constexpr double kExactGradientShift = 1e-8;
// Beyond this distance from the centre, terms of the closed form of mean value coordinates cancel to the inverse cube
// of the distance; integrals over triangles are smooth there.
inline constexpr double kExactFar = 4.0;

}  // namespace barycast
