#pragma once

// A cage with its acceleration structures: what a cache holds, and the only object that concurrent
// computations share. Safe to use from any number of threads. Structures are built when a kind of
// coordinates first asks for them, once. Which index answered, fresh or cached, and what it holds, cannot
// change a bit of any row.

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <variant>
#include <vector>

#include "base/lazy.h"
#include "base/result.h"
#include "bind/options.h"
#include "cage/cage.h"
#include "cage/digest.h"

namespace barycast {

template <int D>
class DistanceIndex;
template <int D>
class LineIndex;
template <int D>
class WindingNumber;
class HarmonicPrediction;
class BallTables;
struct BallLeaf;
enum class BoundarySides;

// What answers the walks' distances: the grid, or Embree alone, which is slower (to compare with).
enum class DistanceEngine { kGrid, kEmbree };

// Lives where it was made: the structures refer to the cage.
template <int D>
struct CageStructures {
  CageStructures(Cage<D> of, DistanceEngine walks);
  ~CageStructures();

  // As CageIndex::prepare.
  void prepare(const ResolvedOptions& options, std::function<void(Status)> then) const;
  // Closest points of queries: after `prepare`, from the same engine whatever else has been built.
  const DistanceIndex<D>& closest_points(const ResolvedOptions& options) const;
  size_t bytes() const;
  // Whether the elements bound a volume (solve/closed.h); false in the plane, where it is not known. Found when first
  // asked for: microseconds for each of them.
  bool is_closed() const;

  const Cage<D> cage;
  const DistanceEngine engine;
  std::unique_ptr<const WindingNumber<D>> winding;
  Lazy<DistanceIndex<D>> elements;  // of Embree: any point, but slower
  Lazy<DistanceIndex<D>> walks;     // what harmonic coordinates ask for distances
  Lazy<LineIndex<D>> lines;         // mean value coordinates
  // Of harmonic coordinates, in space: inside a closed cage, and elsewhere.
  Lazy<HarmonicPrediction> inside, elsewhere;
  Lazy<BallTables> tables;  // of corrections inside a closed cage; they fill as points ask

 private:
  mutable std::once_flag closed_found_;
  mutable bool closed_ = false;
};

// Builds one of the predictions; `walks` is there. As CageIndex::prepare.
void prepare_prediction(const CageStructures<3>& structures, BoundarySides side, std::function<void(Status)> then);

extern template struct CageStructures<2>;
extern template struct CageStructures<3>;

// Whether a cage is one that the estimator can do. Errors: kInvalidArgument, with paths relative to the options
// ("estimator", "panels").
template <int D>
Status check_estimator(const Cage<D>& cage, const ResolvedOptions& options);

class CageIndex {
 public:
  using Structures = std::variant<std::unique_ptr<const CageStructures<2>>, std::unique_ptr<const CageStructures<3>>>;

  // Errors: those of Cage::create, and kInvalidArgument for a dimension other than 2 or 3.
  static Result<std::shared_ptr<const CageIndex>> create(const CageInput& input,
                                                         DistanceEngine engine = DistanceEngine::kGrid);
  // Whether `create` would succeed, without building anything. Errors: the same.
  static Status check(const CageInput& input);
  // Of such a cage, without its index: as the function of that name.
  static Status check_estimator(const CageInput& input, const ResolvedOptions& options);
  // Whether such a cage can have tables (Options::tables), without building anything: it is predicted, and closed.
  // Errors: those of `check`, and kInvalidArgument at "tables".
  static Status check_tables(const CageInput& input);
  ~CageIndex();

  int dimension() const;
  const CageDigest& digest() const { return digest_; }
  uint32_t control_vertex_count() const;
  uint32_t stencil_max() const;
  size_t element_count() const;
  uint64_t surface_triangles() const;  // as the function of cage.h
  bool is_closed() const;
  // The same of a cage without its index. Errors: those of `check`.
  static Result<bool> is_closed(const CageInput& input);
  std::span<const Warning> warnings() const;
  size_t bytes() const;  // memory held now, for the cache's bound

  // As the functions of these names.
  ResolvedOptions settle(const ResolvedOptions& options) const;
  Status check_estimator(const ResolvedOptions& options) const;
  // Builds what computations with these options need, here and now unless it is there or under way: milliseconds for
  // hundreds of elements, half a second for ten thousand, some seconds for a hundred thousand. `then` is called once:
  // before this returns, or later on the thread that builds; the index must live until then. Binding::create prepares
  // as well, and waits. Errors: kInternal when Embree fails, kResourceExhausted.
  void prepare(const ResolvedOptions& options, std::function<void(Status)> then) const;
  // The same, and waits.
  Status prepare(const ResolvedOptions& options) const;

  // Fills tables ahead of the points that will ask for them: after `prepare` with options that say so, on the threads
  // of the calling arena; all of them, as many as may be kept, `tables_max`, or those that `cancel` left time for.
  // Returns how many it made. Some tenths of a millisecond each; some thousands of them fill a cage.
  size_t fill_tables(size_t tables_max, const std::atomic<bool>& cancel) const;
  // The same in pieces, to let other work pass between them: the places of tables that are not there and may be kept,
  // valid as long as the index, and the tables of some of them.
  std::vector<const BallLeaf*> missing_tables(size_t tables_max, const std::atomic<bool>& cancel) const;
  size_t fill_tables(std::span<const BallLeaf* const> places, const std::atomic<bool>& cancel) const;
  // How many there are now; 0 before `prepare`.
  size_t table_count() const;

  const Structures& structures() const { return structures_; }

 private:
  const BallTables* tables() const;  // null before `prepare`
  CageIndex(Structures structures, const CageDigest& digest);
  Structures structures_;
  CageDigest digest_;
};

}  // namespace barycast
