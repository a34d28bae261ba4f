#include "arguments.h"

#include <CLI/CLI.hpp>
#include <iostream>

namespace barycast::program {

ParsedArguments parse_arguments(int argc, char** argv) {
  Arguments arguments;
  client::ComputeOptions& options = arguments.options;
  std::string coordinates = "harmonic", preset = "default", denoise = "auto", type = "float32", estimator = "auto";

  CLI::App app("barycast_bind: computes a model's coordinates with respect to a cage");
  app.set_version_flag("--version", "barycast_bind " BARYCAST_VERSION);
  app.add_option("CAGE", arguments.cage, "Faces of any size (.obj); or lines with z = 0, for a cage in the plane")
      ->required();
  app.add_option("MODEL", arguments.model, "Points (.obj); without faces: loose points")->required();
  app.add_option("-o,--output", arguments.output, "BIND.npz, for scipy.sparse.load_npz and barycast deform")
      ->required();
  app.add_option("--coordinates", coordinates)
      ->check(CLI::IsMember({"harmonic", "mean-value", "positive-mean-value"}))
      ->capture_default_str();
  app.add_option("--estimator", estimator, "How coordinates are found")
      ->check(CLI::IsMember({"auto", "sampling", "predicted", "boundary-element", "exact"}))
      ->capture_default_str();
  app.add_option("--panels", options.panels, "Boundary elements, at most (default: 1000)");
  app.add_option("--samples", options.samples,
                 "Walks or rays per point (default: 12 to correct a prediction, else 50)");
  app.add_option("--target-error", options.target_error,
                 "Predicted, instead of --samples: walks until a point's standard error is this, 1e-5 to 1");
  app.add_flag("--errors", options.errors, "With --target-error: also store every point's error");
  app.add_flag("--tables", options.tables,
               "Predicted, inside closed cages: tables that the server keeps with the cage instead of walks");
  app.add_option("--seed", options.seed)->capture_default_str();
  app.add_option("--preset", preset)->check(CLI::IsMember({"default", "paper"}))->capture_default_str();
  app.add_option("--denoise", denoise, "auto: over the model's faces, when it has any")
      ->check(CLI::IsMember({"auto", "none"}))
      ->capture_default_str();
  app.add_flag("--gradients", options.gradients, "Also store the gradient of every coordinate");
  app.add_option("--dtype", type)->check(CLI::IsMember({"float32", "float64"}))->capture_default_str();
  app.add_option("--influences", options.influences_max, "Keep at most this many coordinates per point (default: all)");
  app.add_option("--thickness", options.thickness, "Relative to the cage's diagonal (default: 1e-3)");
  app.add_option("--walk-steps-max", options.walk_steps_max, "Longest walk (default: 300; preset paper: 20)");
  app.add_option("--prune-below", options.prune_below, "Drop smaller coordinates (default: 1e-4; preset paper: 0)");
  std::string server;
  const CLI::Option* const named =
      app.add_option("--server", server, "HOST:PORT or unix:/path (default: a private barycastd is started)");
  app.add_option("--retry-seconds", arguments.retry_s, "How much time lost connections and busy answers may cost")
      ->check(CLI::Range(0.0, 86'400.0))
      ->capture_default_str();
  app.add_flag("--quiet", arguments.quiet, "Print nothing but errors");

  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& help) {
    return {std::nullopt, app.exit(help)};
  } catch (const CLI::ParseError& error) {
    std::cerr << "barycast_bind: " << error.what() << "; see barycast_bind --help\n";
    return {std::nullopt, kUsage};
  }
  if (named->count() > 0) arguments.server = server;
  // The checks above leave known names only.
  options.coordinates = client::coordinates_named(coordinates).value_or(options.coordinates);
  options.preset = client::preset_named(preset).value_or(options.preset);
  options.denoise = client::denoise_named(denoise).value_or(options.denoise);
  options.estimator = client::estimator_named(estimator).value_or(options.estimator);
  options.type = client::data_type_named(type).value_or(options.type);
  return {arguments, kDone};
}

}  // namespace barycast::program
