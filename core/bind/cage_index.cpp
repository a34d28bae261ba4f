#include "bind/cage_index.h"

#include "estimate/ball_tables.h"
#include "query/distance_index.h"
#include "query/line_index.h"
#include "query/winding.h"
#include "solve/closed.h"
#include "solve/exact_mean_value.h"
#include "solve/panels.h"
#include "solve/prediction.h"

namespace barycast {
namespace {

template <int D>
Result<CageIndex::Structures> build(const CageInput& input, DistanceEngine engine) {
  auto cage = Cage<D>::create(input);
  if (!cage) return cage.error();
  if (auto status = check_distance_index(*cage); !status) return status.error();
  return CageIndex::Structures(
      std::unique_ptr<const CageStructures<D>>(std::make_unique<CageStructures<D>>(std::move(cage).value(), engine)));
}

template <int D>
Status check_of(const CageInput& input) {
  const auto cage = Cage<D>::create(input);
  return cage ? check_distance_index(*cage) : Status(cage.error());
}

template <int D>
Status check_estimator_of(const CageInput& input, const ResolvedOptions& options) {
  const auto cage = Cage<D>::create(input);
  return cage ? check_estimator(*cage, options) : Status(cage.error());
}

Status check_tables_of(const Cage<3>& cage) {
  if (const Status fits = HarmonicPrediction::check(cage.surface_triangles(), cage.control_vertex_count()); !fits)
    return invalid_argument("tables", fits.error().message);
  if (is_closed(cage)) return Done{};
  return invalid_argument("tables",
                          "only the inside of a closed cage has tables; this one is open, or its faces do not all "
                          "face one way");
}

bool is_closed_of(const Cage<2>&) {
  return false;  // not known
}
bool is_closed_of(const Cage<3>& cage) {
  return is_closed(cage);
}

template <int D>
Result<bool> is_closed_of(const CageInput& input) {
  const auto cage = Cage<D>::create(input);
  return cage ? Result<bool>(is_closed_of(*cage)) : Result<bool>(cage.error());
}

Status check_dimension(const CageInput& input) {
  if (input.dimension == 2 || input.dimension == 3) return Done{};
  return invalid_argument("cage.control_vertices", "must have 2 or 3 columns, has " + std::to_string(input.dimension));
}

}  // namespace

template <int D>
CageStructures<D>::CageStructures(Cage<D> of, DistanceEngine walks)
    : cage(std::move(of)), engine(walks), winding(std::make_unique<const WindingNumber<D>>(cage)) {}

template <int D>
CageStructures<D>::~CageStructures() = default;

template <int D>
void CageStructures<D>::prepare(const ResolvedOptions& options, std::function<void(Status)> then) const {
  const auto embree = [this] { return make_embree_distance_index<D>(cage); };
  const auto grid = [this] { return make_distance_grid<D>(cage); };
  if (options.coordinates == CoordinateKind::kHarmonic) {
    std::function<void(Status)> ready = std::move(then);
    if constexpr (D == 3) {
      if (options.estimator == Estimator::kPredicted)
        ready = [this, with_tables = options.tables, then = std::move(ready)](const Status& built) {
          if (!built) return then(built);
          if (!is_closed()) return prepare_prediction(*this, BoundarySides::kElsewhere, then);
          prepare_prediction(*this, BoundarySides::kInside, [this, with_tables, then](const Status& predicted) {
            if (!predicted || !with_tables) return then(predicted);
            tables.prepare(
                [this]() -> Result<std::unique_ptr<const BallTables>> {
                  return std::make_unique<const BallTables>(cage, *walks, *winding, *inside);
                },
                then);
          });
        };
    }
    return engine == DistanceEngine::kGrid ? walks.prepare(grid, std::move(ready))
                                           : walks.prepare(embree, std::move(ready));
  }
  if (options.estimator == Estimator::kExact) return then(Done{});
  elements.prepare(embree, [this, then = std::move(then)](const Status& built) {
    if (!built) return then(built);
    lines.prepare([this] { return make_line_index<D>(cage); }, then);
  });
}

void prepare_prediction(const CageStructures<3>& structures, BoundarySides side, std::function<void(Status)> then) {
  const auto& prediction = side == BoundarySides::kInside ? structures.inside : structures.elsewhere;
  prediction.prepare([&] { return HarmonicPrediction::create(structures.cage, *structures.walks, side); },
                     std::move(then));
}

template <int D>
const DistanceIndex<D>& CageStructures<D>::closest_points(const ResolvedOptions& options) const {
  return options.coordinates == CoordinateKind::kHarmonic ? *walks : *elements;
}

template <int D>
bool CageStructures<D>::is_closed() const {
  std::call_once(closed_found_, [&] { closed_ = is_closed_of(cage); });
  return closed_;
}

template <int D>
size_t CageStructures<D>::bytes() const {
  return cage.bytes() + winding->bytes() + elements.bytes() + walks.bytes() + lines.bytes() + inside.bytes() +
         elsewhere.bytes() + tables.bytes();
}

template struct CageStructures<2>;
template struct CageStructures<3>;

template <int D>
Status check_estimator(const Cage<D>& cage, const ResolvedOptions& options) {
  if (options.estimator == Estimator::kSampling) return Done{};
  if constexpr (D == 2) {
    return invalid_argument("estimator", "cages in the plane are sampled; the other estimators are for cages in space");
  } else {
    if (options.estimator == Estimator::kExact) return ExactMeanValue::check(cage);
    if (options.estimator == Estimator::kPredicted)
      return HarmonicPrediction::check(cage.surface_triangles(), cage.control_vertex_count());
    return Panels::check(cage, options.panels);
  }
}

template Status check_estimator<2>(const Cage<2>&, const ResolvedOptions&);
template Status check_estimator<3>(const Cage<3>&, const ResolvedOptions&);

ResolvedOptions CageIndex::settle(const ResolvedOptions& options) const {
  return barycast::settle(options, dimension(), control_vertex_count(), surface_triangles());
}

Status CageIndex::check_estimator(const ResolvedOptions& options) const {
  return std::visit([&](const auto& s) { return barycast::check_estimator(s->cage, options); }, structures_);
}

Status CageIndex::check_estimator(const CageInput& input, const ResolvedOptions& options) {
  if (options.estimator == Estimator::kSampling) return Done{};
  return input.dimension == 2 ? check_estimator_of<2>(input, options) : check_estimator_of<3>(input, options);
}

Status CageIndex::check_tables(const CageInput& input) {
  if (input.dimension != 3) {
    if (const Status sound = check(input); !sound) return sound;
    return invalid_argument("tables", "cages in the plane are not predicted, and have no tables");
  }
  const auto cage = Cage<3>::create(input);
  if (!cage) return cage.error();
  if (const Status fits = check_distance_index(*cage); !fits) return fits;
  return check_tables_of(*cage);
}

Status CageIndex::check(const CageInput& input) {
  if (Status known = check_dimension(input); !known) return known;
  return input.dimension == 2 ? check_of<2>(input) : check_of<3>(input);
}

Result<std::shared_ptr<const CageIndex>> CageIndex::create(const CageInput& input, DistanceEngine engine) {
  if (Status known = check_dimension(input); !known) return known.error();
  auto structures = input.dimension == 2 ? build<2>(input, engine) : build<3>(input, engine);
  if (!structures) return structures.error();
  return std::shared_ptr<const CageIndex>(new CageIndex(std::move(structures).value(), barycast::digest(input)));
}

CageIndex::CageIndex(Structures structures, const CageDigest& digest)
    : structures_(std::move(structures)), digest_(digest) {}

CageIndex::~CageIndex() = default;

size_t CageIndex::bytes() const {
  return sizeof(*this) + std::visit([](const auto& s) { return s->bytes(); }, structures_);
}

void CageIndex::prepare(const ResolvedOptions& options, std::function<void(Status)> then) const {
  std::visit([&](const auto& s) { s->prepare(options, std::move(then)); }, structures_);
}

Status CageIndex::prepare(const ResolvedOptions& options) const {
  return wait_for([&](std::function<void(Status)> then) { prepare(options, std::move(then)); });
}

const BallTables* CageIndex::tables() const {
  return std::visit([](const auto& s) { return s->tables.get(); }, structures_);
}

size_t CageIndex::fill_tables(size_t tables_max, const std::atomic<bool>& cancel) const {
  return fill_tables(missing_tables(tables_max, cancel), cancel);
}

std::vector<const BallLeaf*> CageIndex::missing_tables(size_t tables_max, const std::atomic<bool>& cancel) const {
  const BallTables* const tables = this->tables();
  return tables == nullptr ? std::vector<const BallLeaf*>() : tables->missing(tables_max, cancel);
}

size_t CageIndex::fill_tables(std::span<const BallLeaf* const> places, const std::atomic<bool>& cancel) const {
  const BallTables* const tables = this->tables();
  return tables == nullptr ? 0 : tables->build(places, cancel);
}

size_t CageIndex::table_count() const {
  const BallTables* const tables = this->tables();
  return tables == nullptr ? 0 : tables->table_count();
}

int CageIndex::dimension() const {
  return structures_.index() == 0 ? 2 : 3;
}

uint32_t CageIndex::control_vertex_count() const {
  return std::visit([](const auto& s) { return s->cage.control_vertex_count(); }, structures_);
}

uint32_t CageIndex::stencil_max() const {
  return std::visit([](const auto& s) { return s->cage.stencil_max(); }, structures_);
}

size_t CageIndex::element_count() const {
  return std::visit([](const auto& s) { return s->cage.elements().size(); }, structures_);
}

uint64_t CageIndex::surface_triangles() const {
  return std::visit([](const auto& s) { return s->cage.surface_triangles(); }, structures_);
}

bool CageIndex::is_closed() const {
  return std::visit([](const auto& s) { return s->is_closed(); }, structures_);
}

Result<bool> CageIndex::is_closed(const CageInput& input) {
  if (Status known = check_dimension(input); !known) return known.error();
  return input.dimension == 2 ? is_closed_of<2>(input) : is_closed_of<3>(input);
}

std::span<const Warning> CageIndex::warnings() const {
  return std::visit([](const auto& s) { return s->cage.warnings(); }, structures_);
}

}  // namespace barycast
