// How long the dragon takes from its .ply.gz in the page cache to a welded mesh, and which part of
// it each step takes. One thread:
//
//   energyprof models fetch dragon
//   taskset -c 0 mesh_load_bench --benchmark_repetitions=9
#include <benchmark/benchmark.h>

#include <filesystem>

#include "accel/bytes.h"
#include "accel/digest.h"
#include "accel/mesh.h"
#include "accel/models.h"

namespace accel = energyprof::accel;

namespace {

std::filesystem::path dragon_file() { return accel::model_file(*accel::find_model("dragon")); }

/// False, and the benchmark says why, unless the dragon has been fetched.
bool has_dragon(benchmark::State& state) {
  if (accel::is_available(*accel::find_model("dragon"))) return true;
  state.SkipWithError("the dragon is not in the cache: energyprof models fetch dragon");
  return false;
}

void read_mesh(benchmark::State& state) {
  if (!has_dragon(state)) return;
  for (auto _ : state) {
    const accel::Mesh mesh = accel::read_mesh(dragon_file());
    state.counters["triangles"] = static_cast<double>(mesh.triangles.size());
    state.counters["vertices"] = static_cast<double>(mesh.positions.size());
  }
}

void load_model(benchmark::State& state) {
  if (!has_dragon(state)) return;
  for (auto _ : state) {
    benchmark::DoNotOptimize(accel::load_model("dragon", [](std::string_view) {}));
  }
}

void inflate(benchmark::State& state) {
  if (!has_dragon(state)) return;
  const accel::Bytes packed = accel::read_file(dragon_file());
  for (auto _ : state) {
    const accel::Bytes text = accel::inflate_gzip("dragon", packed.view());
    state.counters["bytes"] = static_cast<double>(text.byte_count);
  }
}

void parse_and_weld(benchmark::State& state) {
  if (!has_dragon(state)) return;
  const accel::Bytes packed = accel::read_file(dragon_file());
  const accel::Bytes text = accel::inflate_gzip("dragon", packed.view());
  for (auto _ : state) benchmark::DoNotOptimize(accel::parse_mesh("dragon.ply", text.view()));
}

void weld(benchmark::State& state) {
  if (!has_dragon(state)) return;
  const accel::Mesh mesh = accel::read_mesh(dragon_file());
  for (auto _ : state) benchmark::DoNotOptimize(accel::weld(mesh));
}

void digest(benchmark::State& state) {
  if (!has_dragon(state)) return;
  const accel::Bytes packed = accel::read_file(dragon_file());
  for (auto _ : state) benchmark::DoNotOptimize(accel::sha256_hex(packed.view()));
}

BENCHMARK(read_mesh)->Unit(benchmark::kMillisecond);
BENCHMARK(load_model)->Unit(benchmark::kMillisecond);
BENCHMARK(inflate)->Unit(benchmark::kMillisecond);
BENCHMARK(parse_and_weld)->Unit(benchmark::kMillisecond);
BENCHMARK(weld)->Unit(benchmark::kMillisecond);
BENCHMARK(digest)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
