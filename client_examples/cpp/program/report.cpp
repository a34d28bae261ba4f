#include "report.h"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>

namespace barycast::program {
namespace {

std::string thousands(uint64_t value) {
  std::string text = std::to_string(value);
  for (size_t digits = 3; digits < text.size(); digits += 4) text.insert(text.size() - digits, 1, ',');
  return text;
}

std::string decimals(double value, const char* format = "%.3f") {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

void append(std::string& list, const std::string& item) {
  list += (list.empty() ? "" : ", ") + item;
}

// How coordinates were found.
std::string method(const client::ComputeOptions& options) {
  const uint32_t panels = options.panels.value_or(0), samples = options.samples.value_or(0);
  const bool sampling = options.estimator == client::Estimator::kSampling;
  const std::string estimator = name(options.estimator) + (options.tables ? " with tables" : "");
  if (const double target = options.target_error.value_or(0); target > 0)
    return estimator + " to a standard error of " + decimals(target, "%g") + ", preset " + name(options.preset) +
           ", denoise " + name(options.denoise) + ", seed " + std::to_string(options.seed);
  if (!sampling && samples == 0) return estimator + (panels > 0 ? ", at most " + thousands(panels) + " panels" : "");
  return (sampling ? "" : estimator + ", ") + std::to_string(samples) + " samples per point" +
         (options.tables ? " that no table serves" : "") + ", preset " + name(options.preset) + ", denoise " +
         name(options.denoise) + ", seed " + std::to_string(options.seed);
}

// Of the errors that the binding holds, if any: median and largest; and how many are above the target.
std::string errors(const client::Binding& binding) {
  std::vector<float> standard;
  for (size_t row = 0; 2 * row < binding.errors.size(); ++row) standard.push_back(binding.errors[2 * row]);
  std::sort(standard.begin(), standard.end());
  std::string text = "standard error of rows: ";
  if (!standard.empty()) {
    const double median = 0.5 * (double{standard[(standard.size() - 1) / 2]} + double{standard[standard.size() / 2]});
    text += "median " + decimals(median, "%.1e") + ", worst " + decimals(double{standard.back()}, "%.1e") + "; ";
  }
  return text + thousands(binding.report.rows_above_target) + " above the target of " +
         decimals(binding.report.options.target_error.value_or(0), "%g") + "\n";
}

// Longer than a daemon on this machine or a name's resolution takes.
constexpr std::chrono::milliseconds kWaitUntold{2000}, kPoll{20};

bool is_watched(bool quiet) {
  return !quiet && isatty(STDERR_FILENO) == 1;
}

void watch(const client::Client& client, const Arguments& arguments, const std::stop_token& done) {
  std::chrono::milliseconds waited{0};
  while (!done.stop_requested() && waited < kWaitUntold) {
    std::this_thread::sleep_for(kPoll);
    waited = client.answered() ? std::chrono::milliseconds(0) : waited + kPoll;
  }
  if (done.stop_requested()) return;
  std::fprintf(stderr, "\r\033[Kwaiting for a server at %s (up to %g s)\n", arguments.server->c_str(),
               arguments.retry_s);
}

}  // namespace

WaitingLine::WaitingLine(const client::Client& client, const Arguments& arguments) {
  if (!arguments.server || !is_watched(arguments.quiet)) return;
  watcher_ = std::jthread([&](const std::stop_token& done) { watch(client, arguments, done); });
}

ProgressBar::ProgressBar(bool quiet) : visible_(is_watched(quiet)) {}

ProgressBar::~ProgressBar() {
  if (drawn_) std::fputs("\r\033[K", stderr);
}

void ProgressBar::show(const client::Progress& progress) {
  if (!visible_) return;
  constexpr size_t kWidth = 40;
  const double part = static_cast<double>(std::min(progress.done, progress.total)) /
                      static_cast<double>(std::max<uint64_t>(progress.total, 1));
  const auto filled = static_cast<size_t>(part * kWidth);
  std::fprintf(stderr, "\r%-10s%3.0f%%|%s%s|", name(progress.stage).c_str(), 100 * part,
               std::string(filled, '#').c_str(), std::string(kWidth - filled, ' ').c_str());
  std::fflush(stderr);
  drawn_ = true;
}

std::string summary(const client::Binding& binding) {
  const client::Report& report = binding.report;
  const client::ComputeOptions& options = report.options;
  std::string stages, flagged, walks;
  double total = 0;
  for (const auto& [stage, seconds] : report.seconds) {
    if (stage == "total") {
      total = seconds;
    } else {
      append(stages, stage + " " + decimals(seconds));
    }
  }
  const auto add_count = [](std::string& list, uint64_t count, const char* label) {
    if (count > 0) append(list, thousands(count) + " " + label);
  };
  add_count(flagged, report.rows.on_cage, "on cage");
  add_count(flagged, report.rows.outside, "outside");
  add_count(flagged, report.rows.few_samples, "few samples");
  add_count(flagged, report.rows.no_samples, "no samples");
  add_count(flagged, report.rows.rank_deficient, "rank deficient");
  add_count(walks, report.walk_steps, "walk steps");
  add_count(walks, report.walks_capped, "capped");
  add_count(walks, report.walks_discarded, "discarded");
  add_count(walks, report.walk_reentries, "re-entries");
  uint64_t per_row_max = 0;
  for (size_t row = 0; row < binding.point_count(); ++row) {
    per_row_max = std::max(per_row_max, binding.offsets[row + 1] - binding.offsets[row]);
  }
  const double per_row =
      static_cast<double>(binding.indices.size()) / static_cast<double>(std::max<size_t>(binding.point_count(), 1));

  std::string text = thousands(report.points) + " points, " + thousands(report.control_vertices) +
                     " control vertices, " + name(options.coordinates) + ", " + method(options) + "\n";
  text += "seconds: " + decimals(total) + " in all (" + stages + ")\n";
  if (report.samples > 0) text += "samples: " + thousands(report.samples) + (walks.empty() ? "" : ", " + walks) + "\n";
  text += "coordinates per row: " + decimals(per_row, "%.1f") + " mean, " + std::to_string(per_row_max) + " max\n";
  text += "rows flagged: " + (flagged.empty() ? "none" : flagged) + "\n";
  text += "linear-precision error: " + decimals(report.linear_precision_error_max, "%.1e") +
          " diagonals before rounding to " + name(options.type) + "\n";
  if (options.target_error.value_or(0) > 0) text += errors(binding);
  for (const client::Warning& warning : report.warnings) {
    text += "warning: " + warning.field + ": " + warning.message + "\n";
  }
  return text;
}

}  // namespace barycast::program
