// Untrusted bytes through decode, up to a valid cage and an assembled query set. The first byte chooses:
// even, an uploaded Cage; odd, a sequence of ComputeCoordinatesRequest, each after two bytes of length.
// Besides what the sanitizers find: a refusal has a message, and memory stays near what was sent.

#include <cstdint>
#include <cstdlib>
#include <optional>
#include <string>

#include "query_assembler.h"

namespace {

using namespace barycast;
using namespace barycast::server;

const Limits kLimits{.cage_bytes_max = 1 << 20};

template <class T>
void expect_explained(const Result<T>& result) {
  if (!result.ok() && (result.error().message.empty() || result.error().field.empty())) std::abort();
}

template <int D>
void create(const CageStorage& storage) {
  const Result<Cage<D>> cage = Cage<D>::create(storage.input());
  expect_explained(cage);
  if (cage.ok() && cage->elements().empty()) std::abort();
}

void take_cage(const CageStorage& storage) {
  if (digest(storage.input()).size_bytes > kLimits.cage_bytes_max) std::abort();
  storage.dimension == 2 ? create<2>(storage) : create<3>(storage);
}

void upload(const std::string& bytes) {
  const Result<CageStorage> storage = decode_cage_bytes(bytes, kLimits);
  expect_explained(storage);
  if (storage.ok()) take_cage(*storage);
}

void compute(const std::string& bytes) {
  std::optional<QueryAssembler> assembler;
  size_t at = 0;
  while (at + 2 <= bytes.size()) {
    const size_t length = static_cast<uint8_t>(bytes[at]) + 256u * static_cast<uint8_t>(bytes[at + 1]);
    v1::ComputeCoordinatesRequest request;
    const bool parsed = request.ParseFromString(bytes.substr(at + 2, length));
    at += 2 + length;
    if (!parsed) return;
    if (request.has_header()) {
      const Result<ComputePlan> plan = decode_header(request.header(), kLimits);
      expect_explained(plan);
      if (!plan.ok()) return;
      if (plan->cage) take_cage(*plan->cage);
      assembler.emplace(plan->counts, plan->cage ? plan->cage->dimension : 3);
    } else if (assembler) {
      const Status added = request.has_faces() ? assembler->add(request.faces()) : assembler->add(request.points());
      expect_explained(added);
      if (!added.ok()) return;
    }
  }
  if (assembler) expect_explained(assembler->take());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  const std::string bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  data[0] % 2 == 0 ? upload(bytes) : compute(bytes);
  return 0;
}
