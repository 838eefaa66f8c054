/// The Vulkan device that a run traces on: which one, why not the others, and what it can do.
///
/// No Vulkan type appears here: code outside kernels/ needs no Vulkan header. libvulkan is loaded
/// at run time, so that the program also starts where there is none.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/clock.h"
#include "core/unit.h"

namespace energyprof::kernels {

/// The device is gone (VK_ERROR_DEVICE_LOST), or did not finish in time and is taken for gone. What
/// was created on it can only be destroyed; a new Device may well work.
class DeviceLost : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Device or host memory did not suffice; the text names what was to be allocated and its size.
class OutOfMemory : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A DRM device node, /dev/char/<major>:<minor>.
struct DrmNode {
  int64_t major = 0;
  int64_t minor = 0;
};

/// A hardware counter that the driver offers (VK_KHR_performance_query).
struct PerformanceCounter {
  std::string name;  ///< "GtiReadThroughput"
  std::string category;
  std::string description;
  std::string unit;                 ///< as Vulkan calls it: "bytes", "percentage", "generic"
  std::string scope;                ///< "command", "command buffer" or "render pass"
  Unit channel_unit = Unit::count;  ///< that TraceProgram::count_hardware() gives values in
  Quantity quantity = Quantity::utilization;
  bool is_chosen = false;  ///< counted by TraceProgram::count_hardware()
};

/// What a device says about itself.
struct DeviceInfo {
  std::string name;
  std::string type;         ///< "integrated", "discrete", "virtual", "cpu" or "other"
  std::string driver_name;  ///< empty where the driver does not tell (VK_KHR_driver_properties)
  std::string driver_info;  ///< the driver's version in words; its number where it has no words
  std::string api_version;  ///< "1.3.230"
  uint32_t vendor_id = 0;
  uint32_t device_id = 0;
  std::string uuid;                        ///< lower-case hex, grouped 8-4-4-4-12
  std::optional<std::string> pci_address;  ///< "0000:03:00.0"; absent: no VK_EXT_pci_bus_info
  std::optional<DrmNode> drm_primary;      ///< absent: no VK_EXT_physical_device_drm, or no node
  std::optional<DrmNode> drm_render;
  uint64_t max_storage_buffer_bytes = 0;   ///< maxStorageBufferRange
  uint32_t max_workgroup_invocations = 0;  ///< threads of one workgroup
  uint32_t max_workgroup_size_x = 0;
  uint32_t max_workgroup_size_y = 0;
  uint32_t max_workgroup_count_x = 0;  ///< workgroups of one dispatch
  uint32_t max_workgroup_count_y = 0;
  uint32_t subgroup_size = 0;
  double timestamp_period_ns = 0.0;    ///< of one GPU tick
  uint32_t timestamp_valid_bits = 0;   ///< of the compute queue; the counter wraps at 2^this
  bool calibrated_timestamps = false;  ///< GPU ticks can be read together with CLOCK_MONOTONIC
  std::string clock_note;  ///< how GPU time becomes host time on this device, and why so
  std::vector<PerformanceCounter> performance_counters;  ///< of the compute queue
  std::string no_counters_reason;  ///< why there are no performance counters; empty: there are
};

/// A device that was not taken.
struct DeviceRefusal {
  std::string name;
  std::string reason;
};

/// Every Vulkan device of the machine.
struct DeviceList {
  std::vector<DeviceInfo> usable;  ///< in the order in which "auto" prefers them
  std::vector<DeviceRefusal> unusable;
};

/// Looks at every Vulkan device without opening one. Throws std::runtime_error where there is no
/// Vulkan loader, driver or device.
DeviceList list_devices();

struct DeviceRequest {
  /// "auto": integrated before discrete before virtual before CPU devices. Anything else: the
  /// first, in the same order, whose name contains this text, upper and lower case alike.
  std::string name = "auto";
  /// Run with VK_LAYER_KHRONOS_validation and collect what it says.
  bool validation = false;
  /// With validation: let the layer check every buffer access in the shaders too. Slow.
  bool gpu_assisted_validation = false;
  /// Work that has not finished after this long counts as lost: a hung GPU must not hang the run.
  int64_t timeout_ns = 60 * ns_per_s;
};

/// An open device with one compute queue. Not thread-safe. Must outlive what is created on it.
class Device {
 public:
  /// Throws std::runtime_error: no Vulkan loader, driver or device, none that fits (with each one's
  /// reason), or validation wanted and its layer missing.
  explicit Device(const DeviceRequest& request = {});
  ~Device();
  Device(Device&&) noexcept;
  Device& operator=(Device&&) noexcept;

  [[nodiscard]] const DeviceInfo& info() const;
  /// The other devices and why each was not taken.
  [[nodiscard]] const std::vector<DeviceRefusal>& refusals() const;
  /// Warnings and errors of the validation layer so far; empty without validation.
  [[nodiscard]] std::vector<std::string> validation_messages() const;

  /// The Vulkan handles (kernels/context.h), for this folder only.
  struct Context;
  [[nodiscard]] Context& context() { return *context_; }

 private:
  std::unique_ptr<Context> context_;
};

}  // namespace energyprof::kernels
