#include "compute.h"

#include <algorithm>

#include "messages.h"
#include "request_blocks.h"

namespace barycast::client {
namespace {

// Replicas of different builds behind one address could take turns for ever.
constexpr int kRestartsMax = 3;

Failure data_loss(std::string message, std::string field = "rows") {
  return {.error = {.code = Code::kDataLoss, .field = std::move(field), .message = std::move(message)}};
}

Failure build_changed() {
  return {.error = {.code = Code::kFailedPrecondition,
                    .field = "rows",
                    .message = "after a break another build answered, whose rows must not be mixed; compute again"},
          .build_changed = true};
}

void count(const std::vector<uint8_t>& flags, RowCounts& counts) {
  for (const uint8_t flag : flags) {
    counts.on_cage += (flag & kOnCage) != 0;
    counts.outside += (flag & kOutside) != 0;
    counts.few_samples += (flag & kFewSamples) != 0;
    counts.no_samples += (flag & kNoSamples) != 0;
    counts.rank_deficient += (flag & kRankDeficient) != 0;
  }
}

}  // namespace

Outcome Computation::run(Retry& retry, Report& report) {
  for (;;) {
    Outcome failure = connection_.retried(retry, cage_, [&](CageBy by) { return attempt(by, retry, report); });
    if (!failure || !failure->build_changed) return failure;
    if (Outcome refused = start_over()) return refused;
    retry.progressed();
  }
}

Outcome Computation::start_over() {
  if (!callbacks_.on_restart || ++restarts_ > kRestartsMax) return build_changed();
  callbacks_.on_restart();
  header_.reset();
  next_row_ = 0;
  entries_ = 0;
  counts_ = {};
  resumed_rows_.clear();
  return std::nullopt;
}

Outcome Computation::attempt(CageBy by, Retry& retry, Report& report) {
  Capabilities capabilities;
  if (Outcome failure = connection_.capabilities(retry, capabilities)) return failure;
  // Where only the summary is missing, the last row is asked for again: a resume must have one.
  attempt_begin_ = std::min<uint64_t>(next_row_, points_.size() - 1);
  report = {};
  CallContext context(retry, &cage_);
  const std::unique_ptr<Stream> stream = connection_.stub().ComputeCoordinates(&context.get());
  const SendMessage send = [&](const v1::ComputeCoordinatesRequest& message) { return stream->Write(message); };
  // The server computes once our side is closed, and answers earlier only to refuse: then its status says why.
  if (send(header(by)) && send_points(points_, capabilities.message_bytes_max, send) &&
      send_faces(faces_, capabilities.message_bytes_max, send)) {
    stream->WritesDone();
  }
  Outcome ours = receive(*stream, retry, report);
  if (ours) context.get().TryCancel();
  const grpc::Status status = stream->Finish();
  if (ours) return ours;
  if (!status.ok()) return context.failure(status);
  if (report.points == 0) {  // no summary
    return data_loss("the answer ended after " + std::to_string(next_row_) + " of " + std::to_string(points_.size()) +
                     " rows");
  }
  return std::nullopt;
}

v1::ComputeCoordinatesRequest Computation::header(CageBy by) const {
  v1::ComputeCoordinatesRequest request;
  v1::ComputeHeader& header = *request.mutable_header();
  if (by == CageBy::kInline) {
    *header.mutable_inline_cage() = to_message(cage_);
    *header.mutable_expected_digest() = to_message(cage_.digest());
  } else {
    *header.mutable_cage_digest() = to_message(cage_.digest());
  }
  header.mutable_queries()->set_point_count(points_.size());
  header.mutable_queries()->set_face_count(faces_.size());
  header.mutable_queries()->set_corner_count(faces_.corners.size());
  *header.mutable_options() = to_message(options_);
  *header.mutable_output() = output_message(options_);
  if (next_row_ > 0) {
    header.mutable_resume()->set_first_row(attempt_begin_);
    header.mutable_resume()->set_numerics_version(header_->numerics_version());
    header.mutable_resume()->set_smoothing_time(header_->options().smoothing_time());
  }
  return request;
}

Outcome Computation::receive(Stream& stream, Retry& retry, Report& report) {
  bool header_seen = false;
  for (v1::ComputeCoordinatesResponse response; stream.Read(&response);) {
    Outcome failure;
    if (response.has_header()) {
      header_seen = true;
      failure = use_header(response.header());
    } else if (!header_seen) {
      failure = data_loss("the answer did not begin with its header", "header");
    } else if (response.has_progress()) {
      const v1::Progress& progress = response.progress();
      // Not progress for `retry`: an attempt that starts over repeats it.
      if (callbacks_.on_progress) {
        callbacks_.on_progress({static_cast<Stage>(progress.stage()), progress.done(), progress.total()});
      }
    } else if (response.has_rows()) {
      failure = use_rows(response.rows(), retry);
    } else if (response.has_summary()) {
      failure = use_summary(response.summary(), report);
    }
    if (failure) return failure;
  }
  return std::nullopt;
}

Outcome Computation::use_header(const v1::ResponseHeader& header) {
  if (header.cage_digest().sha256().size() > 0 &&
      header.cage_digest().SerializeAsString() != to_message(cage_.digest()).SerializeAsString()) {
    return data_loss("the server answered for another cage", "header.cage_digest");
  }
  if (header.control_vertex_count() != cage_.control_vertex_count()) {
    return data_loss("the server counts other control vertices than the cage has", "header.control_vertex_count");
  }
  const v1::OutputOptions asked = output_message(options_);
  if (header.output().type() != asked.type() || header.output().gradients() != asked.gradients() ||
      header.output().errors() != asked.errors()) {
    return data_loss("the server writes rows otherwise than asked", "header.output");
  }
  if (options_.target_error && !header.options().has_target_error()) {
    return data_loss("the server knows no target error; ask for samples", "header.options.target_error");
  }
  if (options_.tables && !header.options().tables()) {
    return data_loss("the server knows no tables; leave them out", "header.options.tables");
  }
  if (next_row_ > 0 && header.numerics_version() != header_->numerics_version()) return build_changed();
  if (next_row_ > 0) resumed_rows_.push_back(next_row_);
  header_ = header;
  return std::nullopt;
}

Outcome Computation::use_rows(const v1::RowBlock& message, Retry& retry) {
  Result<RowBlock> block = from_message(message, *header_, cage_.dimension());
  if (!block) return Failure{.error = block.error()};
  const uint64_t rows = block->flags.size();
  if (next_row_ == points_.size() && block->first_row == attempt_begin_ && rows == 1) return std::nullopt;
  if (block->first_row != next_row_ || rows > points_.size() - next_row_) {
    return data_loss("sent rows from " + std::to_string(block->first_row) + " where row " + std::to_string(next_row_) +
                     " of " + std::to_string(points_.size()) + " was due");
  }
  next_row_ += rows;
  entries_ += block->indices.size();
  count(block->flags, counts_);
  const bool go_on = !callbacks_.on_rows || callbacks_.on_rows(*block);
  retry.progressed();  // however long the receiver took
  if (go_on) return std::nullopt;
  return Failure{.error = {.code = Code::kCancelled, .message = "cancelled by the receiver of the rows"}};
}

Outcome Computation::use_summary(const v1::Summary& summary, Report& report) const {
  if (next_row_ != points_.size()) {
    return data_loss("the answer ended after " + std::to_string(next_row_) + " of " + std::to_string(points_.size()) +
                     " rows");
  }
  report = make_report(*header_, summary, cage_.dimension());
  report.points = next_row_;
  report.entries = entries_;
  report.rows = counts_;
  report.resumed_rows = resumed_rows_;
  return std::nullopt;
}

}  // namespace barycast::client
