// Frame times of every algorithm on the Vulkan device and in plain C++ (the same traversal text),
// 640x360, one primary and one bounce ray a pixel.
//
//   trace_bench [--benchmark_filter=dragon/.*]
//
// Counters: Mrays/s; hit_ratio (rays that hit). LP_NUM_THREADS and taskset set the threads.
#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>

#include <iostream>
#include <memory>
#include <string>

#include "accel/gpu_triangles.h"
#include "accel/structure.h"
#include "accel/trace_cpu.h"
#include "app/scene.h"
#include "core/algorithms.h"
#include "kernels/device.h"
#include "kernels/runner.h"

namespace {

using namespace energyprof;

constexpr uint32_t width = 640;
constexpr uint32_t height = 360;

/// A model with its structure; the last one is kept.
struct Prepared {
  app::Scene scene;
  std::vector<gpu::Triangle> triangles;
  accel::Built built;
};

const Prepared& prepare(const std::string& model, const std::string& algorithm, bool tuned) {
  static std::string made;
  static Prepared prepared;
  const std::string key = model + algorithm + (tuned ? "tuned" : "paper");
  if (key == made) return prepared;
  if (prepared.scene.model != model) {
    prepared.scene = app::load_scene(model, [](std::string_view) {});
    prepared.triangles = accel::gpu_triangles(prepared.scene.mesh);
  }
  prepared.built =
      accel::build_structure(prepared.scene.mesh, find_algorithm(algorithm)->kind,
                             tuned ? accel::tuned_structures() : accel::StructureConfig{});
  made = key;
  return prepared;
}

gpu::FrameConstants camera(const app::Scene& scene) {
  return app::frame_constants(scene, scene.views.at(1), width, height, 1, 1);
}

void report_rays(benchmark::State& state, int64_t rays, int64_t hits) {
  state.counters["Mrays/s"] = benchmark::Counter(static_cast<double>(rays) * 1e-6,
                                                 benchmark::Counter::kIsIterationInvariantRate);
  state.counters["hit_ratio"] = static_cast<double>(hits) / static_cast<double>(rays);
}

void on_device(benchmark::State& state, const std::string& model, const std::string& algorithm,
               bool tuned) {
  const Prepared& prepared = prepare(model, algorithm, tuned);
  static kernels::Device device{kernels::DeviceRequest{"auto", false}};
  kernels::TraceProgram program(device, {.blob = prepared.built.blob,
                                         .triangles = prepared.triangles,
                                         .kernel = algorithm,
                                         .constants = camera(prepared.scene)});
  FrameRecord record = program.run_frame(0, Phase::warmup);
  uint32_t frame = 1;
  for (auto _ : state) {
    record = program.run_frame(frame++, Phase::timed);
    state.SetIterationTime(static_cast<double>(record.end_ns - record.begin_ns) * 1e-9);
  }
  report_rays(state, *record.ray_count, *record.hit_count);
}

void in_cpp(benchmark::State& state, const std::string& model, const std::string& algorithm,
            bool tuned) {
  const Prepared& prepared = prepare(model, algorithm, tuned);
  const oneapi::tbb::global_control threads(oneapi::tbb::global_control::max_allowed_parallelism,
                                            static_cast<size_t>(state.range(0)));
  gpu::FrameConstants constants = camera(prepared.scene);
  accel::FrameSums sums;
  for (auto _ : state) {
    ++constants.frame;
    const accel::CpuFrame frame =
        accel::trace_cpu(algorithm, {prepared.built.blob, prepared.triangles}, constants);
    state.PauseTiming();
    sums = accel::sum_hits(frame.hits);
    state.ResumeTiming();
  }
  report_rays(state, sums.ray_count, sums.hit_count);
}

void add(const std::string& model, const std::string& algorithm, bool tuned) {
  const std::string name = model + "/" + algorithm + (tuned ? "/tuned" : "/paper");
  benchmark::RegisterBenchmark((name + "/device").c_str(), on_device, model, algorithm, tuned)
      ->Unit(benchmark::kMillisecond)
      ->UseManualTime();
  benchmark::RegisterBenchmark((name + "/cpp").c_str(), in_cpp, model, algorithm, tuned)
      ->Unit(benchmark::kMillisecond)
      ->UseRealTime()
      ->Arg(1)
      ->Arg(2);
}

}  // namespace

int main(int argc, char** argv) {
  for (const char* model : {"teapot", "dragon"})
    for (const AlgorithmInfo& algorithm : algorithm_list)
      for (const bool tuned : {false, true}) add(model, std::string(algorithm.name), tuned);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
