#include "bind/mesh_kernel.h"

#include <algorithm>
#include <optional>
#include <string>

#include "smooth/laplacian.h"

namespace barycast {
namespace {

// Squared diagonals; the heat kernel then reaches over about a tenth of the cage.
constexpr double kSmoothingTimeLarge = 0.01;

KernelCache::Kernel find_or_factor(const QueryMesh& mesh, std::span<const double> times, KernelCache* cache,
                                   const std::atomic<bool>& cancel, std::vector<Warning>& warnings) {
  std::optional<Sha256Digest> key;
  if (cache != nullptr) {
    key = KernelCache::key(mesh, times);
    if (auto kernel = cache->find(*key)) return kernel;
  }
  const std::optional<MeshLaplacian> laplacian = polygon_laplacian(mesh, cancel);
  if (!laplacian) return nullptr;
  auto factored = HeatKernel::create(*laplacian, times);
  const bool found = factored.ok();
  if (!found) {
    // The faces are at fault, and the rows are right without them, only noisier: the summary says so.
    warnings.push_back({"faces", factored.error().message});
    factored = HeatKernel::create(MeshLaplacian{{}, Eigen::VectorXd::Zero(laplacian->area.size()), 0}, times);
  }
  const auto without_area = static_cast<size_t>((laplacian->area.array() <= 0.0).count());
  auto kernel = std::make_shared<const MeshKernel>(
      MeshKernel{std::move(factored).value(), laplacian->faces_skipped, without_area});
  if (found && key) cache->keep(*key, kernel);
  return kernel;
}

}  // namespace

KernelCache::Kernel find_mesh_kernel(const QueryMesh& mesh, std::span<const double> times, KernelCache* cache,
                                     const std::atomic<bool>& cancel, std::vector<Warning>& warnings) {
  if (*std::max_element(times.begin(), times.end()) > kSmoothingTimeLarge)
    warnings.push_back({"smoothing_time",
                        "denoising averages over a tenth of the cage and more, for the mesh has very long edges; leave "
                        "them out, or set a smaller time"});
  auto kernel = find_or_factor(mesh, times, cache, cancel, warnings);
  if (!kernel) return nullptr;
  if (kernel->faces_skipped > 0)
    warnings.push_back(
        {"faces", std::to_string(kernel->faces_skipped) +
                      " faces without area (or with more than 256 corners) do not take part in denoising"});
  if (kernel->nodes_without_area > 0)
    warnings.push_back({"points", std::to_string(kernel->nodes_without_area) +
                                      " positions belong to no face with area and were not denoised"});
  return kernel;
}

}  // namespace barycast
