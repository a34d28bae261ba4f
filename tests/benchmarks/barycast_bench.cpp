// Where the time of a binding goes: barycast_bench --cage C --model M [options]
//
// Binds the model's points to the cage in this process, cold unless told otherwise, and prints one JSON object for
// every variant: points, control_vertices, walks_per_second, the stages' seconds, total_s, peak_bytes, isa.
// --estimator, --engine, --isa, --threads and --samples take several values; every combination is a variant, and they
// run in turns, --repeats times each: medians are printed, and the least and the most of the totals.
//   build          the cage's index                       smooth_factor, smooth_solve   denoising
//   walk           samples, rays for mean value kinds     prune       rows: evaluated, pruned, corrected
//   moments, solve of the samples                         encode      rows to messages, float32
// walk, moments and solve are measured in a pass of their own, over the same points; in the binding they are one. Other
// estimators than sampling have no such pass: solve is to solve boundary elements, walk all that comes before
// denoising, or without it all of the rows. A prediction is solved for in build. With --tables predictions are
// corrected by tables, which are made as points ask. With --warm the cage holds what a binding of the same points left
// with it, which is not measured: no build, and all tables that may be kept.

#include <sys/resource.h>
#include <tbb/task_arena.h>

#include <hwy/targets.h>
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "base/parallel.h"
#include "base/workspace.h"
#include "bind/binding.h"
#include "bind/quantum.h"
#include "bind/sampler.h"
#include "encode.h"
#include "estimate/point_estimator.h"
#include "obj.h"

namespace {

using namespace barycast;

struct Job {
  client::CageParts cage;
  QueryInput queries;
  CageInput cage_input() const {
    CageInput input;
    input.control_vertices = cage.control_vertices;
    input.triangles = cage.triangles;
    input.quads = cage.quads;
    return input;
  }
};

struct Variant {
  Estimator estimator;
  std::string estimator_name;
  DistanceEngine engine;
  std::string engine_name, isa;
  int threads;
  std::optional<uint32_t> samples;
};

// Of one run: seconds by name, and counts.
struct Run {
  std::map<std::string, double> stages;
  double total = 0.0;
  uint64_t walks = 0, steps = 0, rows = 0, encoded_bytes = 0, tables = 0;
};

class Stopwatch {
 public:
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(start_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

[[noreturn]] void fail(const std::string& text) {
  std::fprintf(stderr, "barycast_bench: %s\n", text.c_str());
  std::exit(2);
}

Job read_job(const std::string& cage_path, const std::string& model_path) {
  const auto cage = program::read_obj(cage_path), model = program::read_obj(model_path);
  if (!cage) fail(cage.error().text());
  if (!model) fail(model.error().text());
  Job job{.cage = {.control_vertices = cage->points},
          .queries = {.points = model->points, .face_offsets = {0}, .face_corners = {}}};
  for (size_t f = 0; f < cage->faces.size(); ++f) {
    const auto face = cage->faces.face(f);
    if (face.size() > 4) fail(cage_path + " has faces of more than four corners, which this program does not read");
    auto& list = face.size() == 3 ? job.cage.triangles : job.cage.quads;
    list.insert(list.end(), face.begin(), face.end());
  }
  for (size_t f = 0; f < model->faces.size(); ++f) {
    const auto face = model->faces.face(f);
    job.queries.face_corners.insert(job.queries.face_corners.end(), face.begin(), face.end());
    job.queries.face_offsets.push_back(static_cast<uint32_t>(job.queries.face_corners.size()));
  }
  return job;
}

// Samples, moments and solutions of all points, each for as many points at a time as fit a cache.
void time_estimates(const CageStructures<3>& structures, const QueryInput& queries, const ResolvedOptions& options,
                    Run& run) {
  const auto sampler = make_sampler<3>(options, structures);
  const Projection<3> projection(structures.cage);
  const size_t count = queries.points.size() / 3, piece = std::max<size_t>(1, 200'000 / options.samples);
  std::vector<SampleQuery<3>> all;
  std::vector<SampleSet<3>> samples(piece);
  std::vector<Moments<3>> moments(piece);
  std::vector<Projected<3>> projected(piece);
  PerThread<MomentAccumulator<3>> accumulators([&] { return MomentAccumulator<3>(structures.cage); });
  for (size_t i = 0; i < count; ++i) {
    const Vec<3> x = structures.cage.frame().to_normalized(Eigen::Map<const Vec<3>>(queries.points.data() + 3 * i));
    all.push_back(
        {x, structures.closest_points(options).closest(x).distance, QueryRandom(options.seed, position_key<3>(x))});
  }
  const auto estimate = [&](size_t begin, size_t size, Run& of) {
    Stopwatch watch;
    parallel_for(size, points_per_task(options.samples), [&](size_t from, size_t to) {
      std::visit(
          [&](const auto& s) {
            s.sample(std::span(all).subspan(begin + from, to - from), kNeverCancelled,
                     std::span(samples).subspan(from, to - from));
          },
          sampler);
    });
    of.stages["walk"] += watch.lap();
    parallel_for(size, 64, [&](size_t from, size_t to) {
      for (size_t i = from; i < to; ++i)
        accumulators.local().accumulate(samples[i].samples, Weights::kAsGiven, moments[i]);
    });
    of.stages["moments"] += watch.lap();
    parallel_for(size, 64, [&](size_t from, size_t to) {
      for (size_t i = from; i < to; ++i) projection.project(moments[i], PseudoSamples::kAlways, projected[i]);
    });
    of.stages["solve"] += watch.lap();
    for (size_t i = 0; i < size; ++i) {
      of.walks += samples[i].counts.started;
      of.steps += samples[i].counts.steps;
    }
  };
  Run first;  // makes room, which a binding's threads have at hand for all but their first points
  estimate(0, std::min(piece, count), first);
  for (size_t begin = 0; begin < count; begin += piece) estimate(begin, std::min(piece, count - begin), run);
}

std::unique_ptr<Binding> start(const Job& job, const std::shared_ptr<const CageIndex>& index,
                               const ResolvedOptions& options) {
  auto binding = Binding::create(index, job.queries, {.options = options});
  if (!binding) fail(binding.error().text());
  return std::move(*binding);
}

Run run_once(const Job& job, const Variant& variant, const ResolvedOptions& options, bool warm) {
  Run run;
  Stopwatch watch;
  const auto index = CageIndex::create(job.cage_input(), variant.engine);
  if (!index) fail(index.error().text());
  if (const Status built = (*index)->prepare(options); !built) fail(built.error().text());
  if (warm) {
    const auto before = start(job, *index, options);
    while (before->advance(kNeverCancelled) != Binding::Step::kDone) (void)before->take_block();
    watch.lap();
  } else {
    run.stages["build"] = watch.lap();
  }
  const auto binding = start(job, *index, options);
  for (bool done = false; !done;) {
    const Binding::Step step = binding->advance(kNeverCancelled);
    done = step == Binding::Step::kDone;
    if (step != Binding::Step::kBlock) continue;
    run.total += watch.lap();
    const RowBlock block = binding->take_block();
    run.encoded_bytes += server::encode_rows(block, {}).ByteSizeLong();
    run.rows += block.row_count();
    const double encoding = watch.lap();
    run.stages["encode"] += encoding;
    run.total += encoding;
  }
  run.total += watch.lap() + run.stages["build"];
  run.tables = (*index)->table_count();
  const BindingSummary& summary = binding->summary();
  run.stages["smooth_factor"] = summary.smoothing_factor_s;
  run.stages["smooth_solve"] = summary.smoothing_solve_s;
  run.stages["prune"] = summary.rows_s;
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<3>>>((*index)->structures());
  if (options.estimator == Estimator::kSampling) {
    time_estimates(structures, job.queries, options, run);
    return run;
  }
  run.stages["walk"] = summary.sampling_s;
  run.stages["solve"] = summary.solving_s;
  run.walks = summary.samples;
  run.steps = summary.walk_steps;
  return run;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

nlohmann::ordered_json report(const Job& job, const Variant& variant, const ResolvedOptions& options,
                              const std::vector<Run>& runs) {
  nlohmann::ordered_json out{{"points", job.queries.points.size() / 3},
                             {"control_vertices", job.cage.control_vertices.size() / 3},
                             {"elements", job.cage.triangles.size() / 3 + job.cage.quads.size() / 4},
                             {"estimator", variant.estimator_name},
                             {"samples", options.samples},
                             {"engine", variant.engine_name},
                             {"isa", variant.isa},
                             {"threads", variant.threads},
                             {"tables", runs[0].tables}};
  const auto of = [&](const auto& value) {
    std::vector<double> values;
    for (const Run& run : runs) values.push_back(value(run));
    return values;
  };
  const auto stage = [&](const std::string& name) {
    return median(of([&](const Run& run) { return run.stages.contains(name) ? run.stages.at(name) : 0.0; }));
  };
  const double walk = stage("walk");
  out["walks_per_second"] = walk > 0 ? static_cast<double>(runs[0].walks) / walk : 0.0;
  out["steps_per_walk"] =
      runs[0].walks > 0 ? static_cast<double>(runs[0].steps) / static_cast<double>(runs[0].walks) : 0.0;
  for (const char* name : {"build", "walk", "moments", "solve", "smooth_factor", "smooth_solve", "prune", "encode"})
    out["stages"][name] = stage(name);
  const std::vector<double> totals = of([](const Run& run) { return run.total; });
  out["total_s"] = median(totals);
  out["total_s_least"] = *std::min_element(totals.begin(), totals.end());
  out["total_s_most"] = *std::max_element(totals.begin(), totals.end());
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  out["peak_bytes"] = static_cast<uint64_t>(usage.ru_maxrss) * 1024;  // of the process, over all variants so far
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  std::string cage, model, coordinates = "harmonic", preset = "default", denoise = "auto";
  std::vector<std::string> engines = {"grid"}, isas = {"widest"};
  std::vector<int> threads = {tbb::this_task_arena::max_concurrency()};
  std::vector<uint32_t> samples;
  std::vector<std::string> estimators = {"sampling"};
  const std::map<std::string, Estimator> known = {{"sampling", Estimator::kSampling},
                                                  {"predicted", Estimator::kPredicted},
                                                  {"boundary-element", Estimator::kBoundaryElement},
                                                  {"exact", Estimator::kExact}};
  int repeats = 1;
  bool json = false, tables = false, warm = false, no_gradients = false;
  CLI::App app("Where the time of a binding goes, for every combination of the options.", "barycast_bench");
  app.add_option("--cage", cage, "OBJ of triangles and quads")->required();
  app.add_option("--model", model, "OBJ")->required();
  app.add_option("--coordinates", coordinates)->check(CLI::IsMember({"harmonic", "mean-value", "positive-mean-value"}));
  app.add_option("--estimator", estimators)->delimiter(',')->check(CLI::IsMember(known));
  app.add_option("--samples", samples, "of estimators that take any; default: the estimator's")->delimiter(',');
  app.add_option("--preset", preset)->check(CLI::IsMember({"default", "paper"}));
  app.add_option("--denoise", denoise)->check(CLI::IsMember({"auto", "none"}));
  app.add_option("--engine", engines)->delimiter(',')->check(CLI::IsMember({"grid", "embree"}));
  app.add_option("--threads", threads)->delimiter(',')->check(CLI::PositiveNumber);
  app.add_option("--isa", isas)->delimiter(',')->check(CLI::IsMember({"avx2", "avx512", "widest"}));
  app.add_flag("--tables", tables, "correct predictions by tables");
  app.add_flag("--warm", warm, "with what an earlier binding left with the cage");
  app.add_flag("--no-gradients", no_gradients, "values alone");
  app.add_option("--repeats", repeats)->check(CLI::PositiveNumber);
  app.add_flag("--json", json, "accepted for scripts; there is no other form");
  CLI11_PARSE(app, argc, argv);

  const Job job = read_job(cage, model);
  const bool has_wide = (hwy::SupportedTargets() & HWY_AVX3) != 0;
  std::vector<Variant> variants;
  for (const std::string& estimator : estimators)
    for (const std::string& engine : engines)
      for (std::string isa : isas)
        for (const int t : threads) {
          if (isa == "widest") isa = has_wide ? "avx512" : "avx2";
          if (isa == "avx512" && !has_wide) fail("this processor has no AVX-512");
          Variant variant{.estimator = known.at(estimator),
                          .estimator_name = estimator,
                          .engine = engine == "grid" ? DistanceEngine::kGrid : DistanceEngine::kEmbree,
                          .engine_name = engine,
                          .isa = isa,
                          .threads = t,
                          .samples = {}};
          if (samples.empty() || !takes_samples(variant.estimator)) variants.push_back(variant);
          if (!takes_samples(variant.estimator)) continue;
          for (const uint32_t m : samples) {
            variant.samples = m;
            variants.push_back(variant);
          }
        }
  std::vector<std::vector<Run>> runs(variants.size());
  std::vector<ResolvedOptions> options;
  for (const Variant& variant : variants) {
    Options choices;
    choices.coordinates = coordinates == "harmonic"     ? CoordinateKind::kHarmonic
                          : coordinates == "mean-value" ? CoordinateKind::kMeanValue
                                                        : CoordinateKind::kPositiveMeanValue;
    choices.preset = preset == "paper" ? Preset::kPaper : Preset::kDefault;
    choices.denoise = denoise == "none" ? Denoise::kNone : Denoise::kAuto;
    choices.estimator = variant.estimator;
    choices.samples = variant.samples;
    choices.gradients = !no_gradients;
    choices.tables = tables && variant.estimator == Estimator::kPredicted;
    const auto resolved = resolve(choices, job.queries.face_offsets.size() > 1);
    if (!resolved) fail(resolved.error().text());
    options.push_back(*resolved);
  }
  for (int repeat = 0; repeat < repeats; ++repeat)
    for (size_t v = 0; v < variants.size(); ++v) {
      hwy::SetSupportedTargetsForTest(variants[v].isa == "avx2" ? HWY_AVX2 : 0);
      tbb::task_arena arena(variants[v].threads);
      arena.execute([&] { runs[v].push_back(run_once(job, variants[v], options[v], warm)); });
    }
  for (size_t v = 0; v < variants.size(); ++v)
    std::printf("%s\n", report(job, variants[v], options[v], runs[v]).dump().c_str());
  return 0;
}
