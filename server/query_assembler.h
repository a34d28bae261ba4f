#pragma once

// Collects the blocks of points and faces of one request against the announced counts. A block that is
// malformed, or brings too much, is refused at once; memory follows what has arrived, never what was
// announced. Each block costs one pass and one copy. Not thread-safe.
//
// Errors (kInvalidArgument): "points.points..." and "faces...." for a block's arrays, "points[17]" and
// "faces[3].corner[1]" for one point or corner, counted over all blocks.

#include "barycast/v1/barycast.pb.h"
#include "base/result.h"
#include "bind/binding.h"
#include "decode.h"

namespace barycast::server {

class QueryAssembler {
 public:
  QueryAssembler(const QueryCounts& announced, int dimension) : announced_(announced), dimension_(dimension) {}

  Status add(const v1::PointBlock& block);
  Status add(const v1::FaceBlock& block);
  // After the last block. Errors: fewer than announced. Leaves the assembler empty.
  Result<QueryInput> take();

 private:
  Status append_faces(const std::vector<uint32_t>& counts, const std::vector<uint32_t>& corners);

  QueryCounts announced_;
  int dimension_;
  QueryInput queries_;
};

}  // namespace barycast::server
