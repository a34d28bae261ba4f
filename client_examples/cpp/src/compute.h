#pragma once

// One streamed computation, over as many attempts as it takes: points and faces out in blocks, rows back
// in order, on from the next row after a broken stream.

#include "connection.h"

namespace barycast::client {

class Computation {
 public:
  // Borrows everything until `run` returns.
  Computation(Connection& connection, const Cage& cage, const Points& points, const Faces& faces,
              const ComputeOptions& options, const ComputeCallbacks& callbacks)
      : connection_(connection),
        cage_(cage),
        points_(points),
        faces_(faces),
        options_(options),
        callbacks_(callbacks) {}

  // The report is complete where there is no failure.
  Outcome run(Retry& retry, Report& report);

 private:
  using Stream = grpc::ClientReaderWriterInterface<v1::ComputeCoordinatesRequest, v1::ComputeCoordinatesResponse>;

  Outcome attempt(CageBy by, Retry& retry, Report& report);
  v1::ComputeCoordinatesRequest header(CageBy by) const;
  // A failure of ours, for which the call is given up; the server's is in its status.
  Outcome receive(Stream& stream, Retry& retry, Report& report);
  Outcome use_header(const v1::ResponseHeader& header);
  Outcome use_rows(const v1::RowBlock& message, Retry& retry);
  Outcome use_summary(const v1::Summary& summary, Report& report) const;
  // Drops what was received, if the caller can do that too.
  Outcome start_over();

  Connection& connection_;
  const Cage& cage_;
  const Points& points_;
  const Faces& faces_;
  const ComputeOptions& options_;
  const ComputeCallbacks& callbacks_;

  // The header that the rows so far belong to, and what they were.
  std::optional<v1::ResponseHeader> header_;
  uint64_t next_row_ = 0;
  uint64_t attempt_begin_ = 0;  // first row of this attempt
  uint64_t entries_ = 0;
  RowCounts counts_;
  std::vector<uint64_t> resumed_rows_;
  int restarts_ = 0;
};

}  // namespace barycast::client
