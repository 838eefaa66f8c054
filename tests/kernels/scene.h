// Small scenes, and what a frame of them must look like, worked out on the CPU.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/accel_blob.h"
#include "core/gpu_layout.h"
#include "kernels/runner.h"

namespace energyprof::kernels {

struct Corners {
  gpu::vec3 a{0.0f};
  gpu::vec3 b{0.0f};
  gpu::vec3 c{0.0f};
};

/// `count` triangles in the unit cube, each at most 0.4 across.
std::vector<Corners> random_triangles(uint32_t count, uint32_t seed);

/// A structure and its triangles.
struct Scene {
  AccelBlob blob;
  std::vector<gpu::Triangle> triangles;
};

/// A tree over the triangles: halves by number along the longest side, one triangle a leaf.
Scene build_halves(const std::vector<Corners>& triangles);

/// A tree as deep as there are triangles: each inner node has the rest as its left child and one
/// triangle as its right one, all split along x.
Scene build_chain(const std::vector<Corners>& triangles);

/// A camera in front of the unit cube that sees all of it, with one bounce.
gpu::FrameConstants looking_at_cube(uint32_t width, uint32_t height);

/// A frame as the CPU traces it.
struct ExpectedFrame {
  std::vector<gpu::PixelHits> hits;
  std::vector<gpu::PixelCounts> counts;  ///< zero from trace_brute_force()
  int64_t ray_count = 0;
  int64_t hit_count = 0;
  std::string checksum;
};

/// Every ray against every triangle.
ExpectedFrame trace_brute_force(const Scene& scene, gpu::FrameConstants constants, uint32_t frame);
/// The traversal of BVH_FTB_DF.
ExpectedFrame trace_tree(const Scene& scene, gpu::FrameConstants constants, uint32_t frame);

/// Sets an environment variable for as long as it lives.
class ScopedEnvironment {
 public:
  ScopedEnvironment(std::string name, const std::string& value);
  ~ScopedEnvironment();
  ScopedEnvironment(const ScopedEnvironment&) = delete;
  ScopedEnvironment& operator=(const ScopedEnvironment&) = delete;

 private:
  std::string name_;
  std::optional<std::string> before_;
};

/// Enables tests/kernels/fault_layer.cpp with these faults.
class ScopedFault {
 public:
  explicit ScopedFault(const std::string& faults);

 private:
  ScopedEnvironment path_;
  ScopedEnvironment layers_;
  ScopedEnvironment fault_;
};

/// Why the GPU tests cannot run here; empty: they can.
std::string no_device_reason();

/// A device with the validation layer, wherever that is installed. Every message of the layer,
/// until after the device is destroyed, fails the test.
class ValidatedDevice {
 public:
  explicit ValidatedDevice(DeviceRequest request = {});
  ~ValidatedDevice();
  ValidatedDevice(const ValidatedDevice&) = delete;
  ValidatedDevice& operator=(const ValidatedDevice&) = delete;

  Device& operator*() { return *device_; }
  Device* operator->() { return &*device_; }

 private:
  std::optional<Device> device_;
};

}  // namespace energyprof::kernels
