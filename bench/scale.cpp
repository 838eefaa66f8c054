// How building and tracing grow with the number of triangles: a bumpy sphere of 10 thousand to 10
// million. Prints CSV, a line per size and structure or algorithm; scripts/plot_scale.py draws it.
//
//   scale_bench [LARGEST] > scale.csv
//
// what is "build" (paper's parameters), "build-tuned", or "frame" (640x360, primary and bounce ray,
// on the Vulkan device; sizes that it cannot hold are left out). Medians of 3 builds and 7 frames.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <numbers>
#include <vector>

#include "accel/gpu_triangles.h"
#include "accel/structure.h"
#include "analysis/stats.h"
#include "core/algorithms.h"
#include "kernels/device.h"
#include "kernels/runner.h"

namespace {

using namespace energyprof;

/// A sphere of 2 rows (rows - 1) 2 triangles with three octaves of bumps.
accel::Mesh bumpy_sphere(size_t triangle_count) {
  const auto rows = static_cast<uint32_t>(std::sqrt(static_cast<double>(triangle_count) / 4.0)) + 1;
  const uint32_t columns = 2 * rows;
  accel::Mesh mesh;
  for (uint32_t row = 0; row <= rows; ++row)
    for (uint32_t column = 0; column < columns; ++column) {
      const double v = std::numbers::pi * (row + 0.5) / (rows + 1.0);
      const double u = 2.0 * std::numbers::pi * column / columns;
      double radius = 1.0;
      for (const double octave : {5.0, 11.0, 23.0})
        radius += 0.4 / octave * std::sin(octave * u) * std::sin(octave * v);
      mesh.positions.emplace_back(radius * std::sin(v) * std::cos(u), radius * std::cos(v),
                                  radius * std::sin(v) * std::sin(u));
    }
  for (uint32_t row = 0; row < rows; ++row)
    for (uint32_t column = 0; column < columns; ++column) {
      const uint32_t next = (column + 1) % columns;
      const uint32_t a = row * columns + column;
      const uint32_t b = row * columns + next;
      mesh.triangles.emplace_back(a, b, a + columns);
      mesh.triangles.emplace_back(b, b + columns, a + columns);
    }
  return mesh;
}

gpu::FrameConstants camera() {
  gpu::FrameConstants c{};
  const float half = std::tan(std::numbers::pi_v<float> / 8.0f);
  c.origin_tmin = glm::vec4(0.0f, 0.0f, 3.2f, 1e-4f);
  c.right_tmax = glm::vec4(half * 16.0f / 9.0f, 0.0f, 0.0f, 1e13f);
  c.up = glm::vec4(0.0f, half, 0.0f, 0.0f);
  c.forward = glm::vec4(0.0f, 0.0f, -1.0f, 0.0f);
  c.width = 640;
  c.height = 360;
  c.seed = 1;
  c.bounce_count = 1;
  c.row_count = c.height;
  return c;
}

void time_frames(kernels::Device& device, const AlgorithmInfo& algorithm, const AccelBlob& blob,
                 const std::vector<gpu::Triangle>& triangles) {
  try {
    kernels::TraceProgram program(device, {.blob = blob,
                                           .triangles = triangles,
                                           .kernel = std::string(algorithm.name),
                                           .constants = camera()});
    std::vector<double> times_ms;
    for (uint32_t frame = 0; frame < 8; ++frame) {
      const FrameRecord record = program.run_frame(frame, Phase::timed);
      if (frame > 0)
        times_ms.push_back(static_cast<double>(record.end_ns - record.begin_ns) * 1e-6);
    }
    fmt::print("frame,{},{},{:.3f},,\n", algorithm.name, triangles.size(),
               analysis::median(times_ms));
  } catch (const std::runtime_error& error) {
    std::cerr << algorithm.name << ", " << triangles.size() << " triangles: " << error.what()
              << '\n';
  }
}

void build_and_trace(kernels::Device& device, const accel::Mesh& mesh) {
  const std::vector<gpu::Triangle> triangles = accel::gpu_triangles(mesh);
  const AlgorithmInfo* built_for = nullptr;
  for (const bool tuned : {false, true})
    for (const AlgorithmInfo& algorithm : algorithm_list) {
      // KD_STACK traverses the tree of KD_TREE.
      const bool is_new = built_for == nullptr || built_for->kind != algorithm.kind;
      if (!is_new && tuned) continue;
      accel::Built built;
      std::vector<double> times_ms;
      for (int i = 0; i < (is_new ? 3 : 1); ++i) {
        built = {};  // the old one first: two of 10 million triangles need not fit
        built = accel::build_structure(
            mesh, algorithm.kind, tuned ? accel::tuned_structures() : accel::StructureConfig{});
        times_ms.push_back(static_cast<double>(built.stats.build_ns) * 1e-6);
      }
      if (is_new)
        fmt::print(
            "build{},{},{},{:.3f},{:.2f},{}\n", tuned ? "-tuned" : "", algorithm.name,
            triangles.size(), analysis::median(times_ms),
            static_cast<double>(built.stats.blob_bytes) / static_cast<double>(triangles.size()),
            built.stats.sah_cost ? fmt::format("{:.2f}", *built.stats.sah_cost) : "");
      built_for = &algorithm;
      if (!tuned) time_frames(device, algorithm, built.blob, triangles);
      std::cout.flush();
    }
}

}  // namespace

int main(int argc, char** argv) {
  const size_t largest = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 10'000'000;
  kernels::Device device{kernels::DeviceRequest{}};
  fmt::print("what,name,triangles,ms,bytes_per_triangle,sah_cost\n");
  for (size_t count = 10'000; count <= largest; count = count * 10) {
    build_and_trace(device, bumpy_sphere(count));
    if (3 * count < largest) build_and_trace(device, bumpy_sphere(3 * count));
  }
  return 0;
}
