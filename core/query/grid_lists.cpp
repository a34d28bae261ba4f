#include "query/grid_lists.h"

#include <algorithm>
#include <bit>

#include "base/parallel.h"

namespace barycast {
namespace {

// Blocks for cells of their own: at least, and for every four triangles. Beyond, cells list the blocks of neighbours.
constexpr size_t kOwnBlocksLeast = 400, kOwnBlocksPerFourTriangles = 3;
// Blocks with the cell's nearest triangle that are looked at for one that holds all of the cell's. Its slack may be
// larger by this factor.
constexpr size_t kSharingTries = 24;
constexpr float kSharingSlack = 1.5f;
// Entries of all lists. Beyond, cells know nothing and leave their points to Embree.
constexpr size_t kListedMax = size_t{1} << 22;
static_assert(kListedMax + kGridLengthMax + 1 < kGridFarBit >> kGridLengthBits, "lists begin below the top bit");

constexpr uint32_t kNone = 0xFFFFFFFFu;

// Multiplies and shifts of 64 bits (MurmurHash3's finalizer).
uint64_t hash_of(std::span<const uint32_t> key) {
  uint64_t hash = key.size();
  for (const uint32_t number : key) {
    hash = (hash ^ number) * 0xFF51AFD7ED558CCDu;
    hash ^= hash >> 33;
  }
  return hash;
}

// Whether all of them are in the block. Without branches: both are short, and in no order.
bool holds(const std::array<uint32_t, kBlockLanes>& block, std::span<const uint32_t> triangles) {
  bool all = true;
  for (const uint32_t triangle : triangles) {
    bool any = false;
    for (const uint32_t held : block) any |= held == triangle;
    all &= any;
  }
  return all;
}

}  // namespace

GridLists::GridLists(const NeighbourBlocks& neighbours, size_t triangle_count, GridTables& grid)
    : neighbours_(neighbours),
      grid_(grid),
      own_blocks_max_(kOwnBlocksLeast + kOwnBlocksPerFourTriangles * triangle_count / 4),
      bounds_(neighbours.distances.size(), kNone),
      blocks_with_(neighbours.triangle_deviation.size()),
      known_(1024, KnownList{0, 0, 0, kNone}) {
  grid_.lists = {0, 0};  // the first list: no slack, and any block
}

// Of blocks of their own where few are enough, of the blocks that the triangles are neighbours in otherwise.
uint32_t GridLists::list(std::span<Near> near, std::span<const TriangleSet> sets) {
  if (grid_.lists.size() > kListedMax) return kNoCell;
  float slack = 0.0f;
  if (sets.size() == 1) {
    if (const OwnBlock* const own = own_block(sets.front())) return own->list;
  } else if (!sets.empty() && own_blocks(sets, slack)) {
    return list_of(slack);
  }
  if (near.size() > kGridLengthMax) return kNoCell;
  order(near);
  list_.clear();
  double deviation = 0.0;
  for (const Near& n : near) {
    uint32_t& block = bounds_[n.block];
    if (block == kNone) block = new_block(neighbours_.triangles(n.block));
    list_.push_back(block);
    deviation = std::max(deviation, neighbours_.deviation[n.block]);
  }
  return list_of(static_cast<float>(deviation) + kBlockRounding);
}

// Blocks with these triangles, and perhaps others. False: there is no room for more blocks.
bool GridLists::own_blocks(std::span<const TriangleSet> sets, float& slack) {
  list_.clear();
  for (const TriangleSet& set : sets) {
    const OwnBlock* const own = own_block(set);
    if (own == nullptr) return false;
    list_.push_back(own->block);
    slack = std::max(slack, own->slack);
  }
  return true;
}

// None: there is no room for more blocks.
const GridLists::OwnBlock* GridLists::own_block(const TriangleSet& set) {
  const std::vector<Candidate>& candidates = blocks_with_[set.first];
  const size_t tries = std::min(kSharingTries, candidates.size());
  for (size_t i = candidates.size(); i > candidates.size() - tries; --i) {
    const Candidate& candidate = candidates[i - 1];
    if ((set.signature & ~candidate.signature) != 0 || candidate.slack > kSharingSlack * set.slack) continue;
    const OwnBlock& own = own_blocks_[candidate.own];
    if (holds(blocks_[own.block], set.triangles())) return &own;
  }
  if (own_blocks_.size() >= own_blocks_max_) return nullptr;
  const auto number = static_cast<uint32_t>(own_blocks_.size());
  for (const uint32_t triangle : set.triangles()) blocks_with_[triangle].push_back({set.signature, set.slack, number});
  BlockTriangles triangles = set.triangle;
  std::fill(triangles.begin() + set.count, triangles.end(), kNone);  // to the end
  std::sort(triangles.begin(), triangles.end());
  const uint32_t block = new_block({triangles.data(), set.count});
  own_blocks_.push_back({set.slack, block, new_list(std::array{block}, set.slack)});
  return &own_blocks_.back();
}

uint32_t GridLists::new_block(std::span<const uint32_t> triangles) {
  BlockTriangles& block = blocks_.emplace_back();
  for (size_t lane = 0; lane < kBlockLanes; ++lane) block[lane] = triangles[lane < triangles.size() ? lane : 0];
  return static_cast<uint32_t>(blocks_.size() - 1);
}

// Of list_: the same for the same blocks, whatever their order.
uint32_t GridLists::list_of(float slack) {
  key_ = list_;
  std::sort(key_.begin(), key_.end());
  KnownList& known = this->known(hash_of(key_));
  if (known.list != kNone) return known.list;
  const uint32_t list = new_list(list_, slack);
  known.key_begin = static_cast<uint32_t>(keys_.size());
  known.key_size = static_cast<uint32_t>(key_.size());
  known.list = list;
  keys_.insert(keys_.end(), key_.begin(), key_.end());
  if (2 * ++known_count_ > known_.size()) grow_known();
  return list;
}

// The place of key_, perhaps without a list yet.
GridLists::KnownList& GridLists::known(uint64_t hash) {
  for (size_t at = hash;; ++at) {
    KnownList& known = known_[at & (known_.size() - 1)];
    if (known.list == kNone) {
      known.hash = hash;
      return known;
    }
    if (known.hash == hash && std::ranges::equal(std::span(keys_).subspan(known.key_begin, known.key_size), key_))
      return known;
  }
}

void GridLists::grow_known() {
  std::vector<KnownList> before(2 * known_.size(), KnownList{0, 0, 0, kNone});
  before.swap(known_);
  for (const KnownList& known : before) {
    if (known.list == kNone) continue;
    size_t at = known.hash;
    while (known_[at & (known_.size() - 1)].list != kNone) ++at;
    known_[at & (known_.size() - 1)] = known;
  }
}

uint32_t GridLists::new_list(std::span<const uint32_t> blocks, float slack) {
  const auto begin = static_cast<uint32_t>(grid_.lists.size());
  grid_.lists.push_back(std::bit_cast<uint32_t>(slack));
  grid_.lists.insert(grid_.lists.end(), blocks.begin(), blocks.end());
  return begin << kGridLengthBits | static_cast<uint32_t>(blocks.size());
}

void GridLists::make_blocks(const FacetLevels& facets, int dimension) {
  grid_.blocks.resize(std::max<size_t>(1, blocks_.size()));
  parallel_build(blocks_.size(), 64, [&](size_t begin, size_t end) {
    for (size_t block = begin; block < end; ++block)
      for (size_t lane = 0; lane < kBlockLanes; ++lane) {
        const uint32_t triangle = blocks_[block][lane];
        set_lane(grid_.blocks[block], lane, facets.triangles[triangle].corners, triangle, dimension);
      }
  });
}

}  // namespace barycast
