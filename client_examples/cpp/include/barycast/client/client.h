#pragma once

// The client of one barycastd: the verbs of the API with plain arrays in and out. Positions are
// row-major n x d (d = 2 or 3), in the units and frame of the cage; indices count from 0.
// Every verb returns a Result (result.h): no exceptions for expected failures, no output, no exit.
// Lost connections and busy servers are retried within ClientSettings::retry_time_max; a computation
// whose connection breaks goes on from the next row, and its rows are bit for bit those of an unbroken
// one. All verbs may be called from several threads at once on one Client; callbacks run in the calling
// thread. A std::stop_token ends a verb with kCancelled within milliseconds. gRPC does not survive a
// fork: make Clients after it.

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <variant>
#include <vector>

#include "barycast/client/binding.h"
#include "barycast/client/cage.h"
#include "barycast/client/options.h"
#include "barycast/client/result.h"

namespace barycast::client {

struct ClientSettings {
  std::string address;  // as check_address takes it
  // Of one verb, over all its attempts; 0: no limit.
  std::chrono::milliseconds time_max{0};
  // How long a verb goes on trying without receiving anything new; 0: one attempt.
  std::chrono::milliseconds retry_time_max{15'000};
};

// Whether a server can have this address: "host:port" or "[::1]:port" with a port from 1 to 65535, "unix:/path", or the
// gRPC schemes dns, ipv4 and ipv6 with ports, unix-abstract, vsock and xds. gRPC itself would take a missing port for
// 443 and retry what it cannot read. Errors: it is none of these, with what one looks like; every verb says so, too.
Status check_address(const std::string& address);

// n x dimension, borrowed for the time of the call; float points travel as float.
struct Points {
  std::variant<std::span<const double>, std::span<const float>> values;
  uint32_t dimension = 3;

  size_t size() const {
    return dimension == 0 ? 0 : std::visit([](const auto& span) { return span.size(); }, values) / dimension;
  }
};

// What a server can do; see barycast/v1/barycast.proto.
struct Capabilities {
  std::vector<Coordinates> coordinates;
  std::vector<Preset> presets;
  std::vector<Estimator> estimators;
  std::string build_version;
  uint32_t numerics_version = 0;
  uint64_t cage_bytes_max = 0, points_max = 0, faces_max = 0, samples_max = 0, block_rows_max = 0;
  uint64_t message_bytes_max = 0, request_bytes_max = 0;
};

struct UploadOptions {
  bool fill_tables = false;  // so that computations with ComputeOptions::tables find them; seconds for some cages
};

struct Uploaded {
  CageDigest digest;  // as computed by the server
  std::vector<Warning> warnings;
  uint64_t tables = 0;  // that the cage has now
};

struct QuerySize {
  uint64_t points = 0, faces = 0, corners = 0;
};

struct Cost {
  uint64_t memory_bytes = 0, samples = 0, output_bytes = 0;
};

// Consecutive rows: row first_row + i has the entries offsets[i] ... offsets[i + 1] - 1.
struct RowBlock {
  uint64_t first_row = 0;
  std::vector<uint32_t> offsets;  // k + 1, starting at 0
  std::vector<uint32_t> indices;  // nnz: control vertices, ascending within a row
  Reals values;                   // nnz
  Reals gradients;                // nnz x d, or empty
  std::vector<uint8_t> flags;     // k, bits of RowFlag
  std::vector<float> errors;      // k x 2, or empty
};

struct Progress {
  Stage stage = Stage::kSampling;
  uint64_t done = 0, total = 0;
};

struct ComputeCallbacks {
  // Receives the rows as they arrive, in order and without gaps; false cancels. The server produces the next block
  // when the last was taken, so a slow callback slows the server and fills no memory.
  std::function<bool(const RowBlock&)> on_rows;
  // Now and then; may be empty.
  std::function<void(const Progress&)> on_progress = {};
  // After a break, a server of another numerics_version answered: rows start again at 0, and all that were received
  // must be dropped. Empty: this is the error kFailedPrecondition instead.
  std::function<void()> on_restart = {};
};

class Connection;

class Client {
 public:
  // Does not connect yet.
  explicit Client(const ClientSettings& settings);
  ~Client();
  Client(Client&&) noexcept;
  Client& operator=(Client&&) noexcept;

  Result<Capabilities> capabilities(const std::stop_token& stop = {});

  // Whether a server has answered and its connection was not lost since: while a verb is at work, false says that it
  // waits for one.
  bool answered() const;

  // Gives the server the cage to hold. `compute`, `bind` and `estimate` do it by themselves when they must: they name
  // the cage by its digest, upload it where it is missing, and send it along where it is missing again. Errors: an
  // invalid cage, one that is over the server's limit.
  Result<Uploaded> upload(const Cage& cage, const std::stop_token& stop = {});
  // Errors: also a cage that has no tables, where they are asked for: it is open, in the plane, or too large.
  Result<Uploaded> upload(const Cage& cage, const UploadOptions& options, const std::stop_token& stop = {});

  // What a computation would cost, or the error with which it would be refused.
  Result<Cost> estimate(const Cage& cage, const QuerySize& size, const ComputeOptions& options,
                        const std::stop_token& stop = {});

  // Coordinates of points as blocks of rows. faces: the mesh over the points that denoising runs over; empty: loose
  // points. Errors: no or non-finite points, faces that do not fit them, whatever the server refuses (with the path of
  // the field), kUnavailable, kCancelled, kDeadlineExceeded.
  Result<Report> compute(const Cage& cage, const Points& points, const Faces& faces, const ComputeOptions& options,
                         const ComputeCallbacks& callbacks, const std::stop_token& stop = {});

  // All rows of `compute` as one sparse matrix.
  Result<Binding> bind(const Cage& cage, const Points& points, const Faces& faces, const ComputeOptions& options = {},
                       const std::function<void(const Progress&)>& on_progress = {}, const std::stop_token& stop = {});

 private:
  std::unique_ptr<Connection> connection_;
};

}  // namespace barycast::client
