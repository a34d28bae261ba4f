#include "barycast/client/client.h"

#include <cmath>

#include "compute.h"
#include "connection.h"
#include "messages.h"

namespace barycast::client {
namespace {

Error final_error(const Retry& retry, Failure failure) {
  if (retry.stop().stop_requested() && failure.error.code != Code::kCancelled) {
    return {.code = Code::kCancelled, .message = "cancelled by the caller"};
  }
  return std::move(failure.error);
}

Status check_queries(const Cage& cage, const Points& points, const Faces& faces) {
  if (points.dimension != cage.dimension()) {
    return input_error("points", "have " + std::to_string(points.dimension) + " coordinates, the cage has " +
                                     std::to_string(cage.dimension()));
  }
  const auto check = [&](const auto& values) -> Status {
    if (values.empty()) return input_error("points", "there must be at least one point");
    if (values.size() % points.dimension != 0) {
      return input_error("points", "must hold a multiple of " + std::to_string(points.dimension) + " numbers");
    }
    for (size_t i = 0; i < values.size(); ++i) {
      if (std::isfinite(values[i])) continue;
      return input_error("points[" + std::to_string(i / points.dimension) + "]", "has a coordinate that is not finite");
    }
    return Done{};
  };
  if (Status s = std::visit(check, points.values); !s) return s;
  return check_faces(faces, points.size(), "faces");
}

template <class T>
void append(const std::vector<T>& from, std::vector<T>& to) {
  to.insert(to.end(), from.begin(), from.end());
}

template <class T>
void append(const Reals& from, std::vector<T>& to) {
  if (const auto* values = std::get_if<std::vector<T>>(&from)) append(*values, to);
}

template <class Real>
void make_empty(Binding& binding) {
  binding.values.emplace<std::vector<Real>>();
  binding.gradients.emplace<std::vector<Real>>();
}

// Reserves for all rows what the first block's rows took, with some room, so that growing copies rarely.
void reserve(const RowBlock& block, size_t points, Binding& binding) {
  const double per_row = static_cast<double>(block.indices.size()) / static_cast<double>(block.flags.size());
  const auto entries = static_cast<size_t>(1.1 * per_row * static_cast<double>(points));
  binding.offsets.reserve(points + 1);
  binding.flags.reserve(points);
  binding.indices.reserve(entries);
  std::visit([&](auto& values) { values.reserve(entries); }, binding.values);
}

void append(const RowBlock& block, size_t points, Binding& binding) {
  if (block.flags.empty()) return;
  if (block.first_row == 0) reserve(block, points, binding);
  const uint64_t begin = binding.offsets.back();
  for (size_t i = 1; i < block.offsets.size(); ++i) binding.offsets.push_back(begin + block.offsets[i]);
  append(block.indices, binding.indices);
  append(block.flags, binding.flags);
  append(block.errors, binding.errors);
  std::visit([&](auto& values) { append(block.values, values); }, binding.values);
  std::visit([&](auto& gradients) { append(block.gradients, gradients); }, binding.gradients);
}

}  // namespace

Client::Client(const ClientSettings& settings) : connection_(std::make_unique<Connection>(settings)) {}
Client::~Client() = default;
Client::Client(Client&&) noexcept = default;
Client& Client::operator=(Client&&) noexcept = default;

bool Client::answered() const {
  return connection_->answered();
}

Result<Capabilities> Client::capabilities(const std::stop_token& stop) {
  Retry retry = connection_->new_retry(stop);
  Capabilities result;
  const auto attempt = [&] { return connection_->capabilities(retry, result); };
  if (Outcome failure = connection_->retried(retry, attempt)) return final_error(retry, std::move(*failure));
  return result;
}

Result<Uploaded> Client::upload(const Cage& cage, const std::stop_token& stop) {
  return upload(cage, UploadOptions{}, stop);
}

Result<Uploaded> Client::upload(const Cage& cage, const UploadOptions& options, const std::stop_token& stop) {
  Retry retry = connection_->new_retry(stop);
  Uploaded result;
  const auto attempt = [&] { return connection_->upload(cage, options, retry, result); };
  if (Outcome failure = connection_->retried(retry, attempt)) return final_error(retry, std::move(*failure));
  return result;
}

Result<Cost> Client::estimate(const Cage& cage, const QuerySize& size, const ComputeOptions& options,
                              const std::stop_token& stop) {
  Retry retry = connection_->new_retry(stop);
  Cost result;
  const auto attempt = [&](CageBy by) {
    v1::EstimateCostRequest request;
    if (by == CageBy::kInline) {
      *request.mutable_inline_cage() = to_message(cage);
    } else {
      *request.mutable_cage_digest() = to_message(cage.digest());
    }
    request.mutable_queries()->set_point_count(size.points);
    request.mutable_queries()->set_face_count(size.faces);
    request.mutable_queries()->set_corner_count(size.corners);
    *request.mutable_options() = to_message(options);
    *request.mutable_output() = output_message(options);
    return connection_->estimate(request, cage, retry, result);
  };
  if (Outcome failure = connection_->retried(retry, cage, attempt)) return final_error(retry, std::move(*failure));
  return result;
}

Result<Report> Client::compute(const Cage& cage, const Points& points, const Faces& faces,
                               const ComputeOptions& options, const ComputeCallbacks& callbacks,
                               const std::stop_token& stop) {
  if (Status s = check_queries(cage, points, faces); !s) return s.error();
  Retry retry = connection_->new_retry(stop);
  Report report;
  Computation computation(*connection_, cage, points, faces, options, callbacks);
  if (Outcome failure = computation.run(retry, report)) return final_error(retry, std::move(*failure));
  return report;
}

Result<Binding> Client::bind(const Cage& cage, const Points& points, const Faces& faces, const ComputeOptions& options,
                             const std::function<void(const Progress&)>& on_progress, const std::stop_token& stop) {
  const auto start = std::chrono::steady_clock::now();
  Binding binding;
  const auto clear = [&] {
    binding = {};
    options.type == DataType::kFloat64 ? make_empty<double>(binding) : make_empty<float>(binding);
  };
  clear();
  const ComputeCallbacks callbacks{.on_rows =
                                       [&](const RowBlock& block) {
                                         append(block, points.size(), binding);
                                         return true;
                                       },
                                   .on_progress = on_progress,
                                   .on_restart = clear};
  Result<Report> report = compute(cage, points, faces, options, callbacks, stop);
  if (!report) return report.error();
  binding.report = std::move(*report);
  binding.cage_digest = cage.digest().hexadecimal();
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  binding.report.seconds.emplace_back("total", seconds.count());
  // Asked already, so there is nothing to wait for; without an answer the name of the build stays empty.
  if (Result<Capabilities> server = capabilities(stop)) binding.report.build_version = server->build_version;
  return binding;
}

}  // namespace barycast::client
