/// The Vulkan instance, what its validation layer says, and a survey of the machine's devices.
#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "kernels/device_choice.h"
#include "kernels/vulkan_api.h"

namespace energyprof::kernels {

/// What the validation layer said. The layer may call from any thread.
class MessageLog {
 public:
  void add(std::string message);
  [[nodiscard]] std::vector<std::string> messages() const;

 private:
  mutable std::mutex mutex_;
  std::vector<std::string> messages_;
};

/// A physical device with what is needed to open it.
struct PhysicalDevice {
  VkPhysicalDevice handle = VK_NULL_HANDLE;
  uint32_t queue_family = 0;
  /// The extension that calibrates against CLOCK_MONOTONIC; absent: none does.
  std::optional<std::string> calibration_extension;
  /// The counters chosen, by Vulkan's index; empty: nothing is to be enabled for them.
  std::vector<uint32_t> counter_indices;
  std::vector<VkPerformanceCounterKHR> counters;  ///< same order as `counter_indices`
  uint32_t counter_pass_count = 0;
};

/// Owns a VkInstance.
class Instance {
 public:
  /// Throws std::runtime_error, saying what to install, if there is no loader, driver or layer.
  explicit Instance(bool validation, bool gpu_assisted = false);
  ~Instance();
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;

  [[nodiscard]] const InstanceApi& api() const { return api_; }
  [[nodiscard]] const std::shared_ptr<MessageLog>& log() const { return log_; }
  /// Gives the VkInstance up without destroying it: a device of it hangs.
  void abandon() { handle_ = VK_NULL_HANDLE; }

  struct Survey {
    std::vector<PhysicalDevice> devices;
    std::vector<Candidate> candidates;  ///< same order as `devices`
  };
  /// Every device. Throws std::runtime_error if there is none.
  [[nodiscard]] Survey survey() const;

 private:
  InstanceApi api_;
  VkInstance handle_ = VK_NULL_HANDLE;
  VkDebugUtilsMessengerEXT messenger_ = VK_NULL_HANDLE;
  std::shared_ptr<MessageLog> log_ = std::make_shared<MessageLog>();
};

}  // namespace energyprof::kernels
