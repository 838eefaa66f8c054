/// The open device as the rest of this folder sees it: handles, functions, and what they share.
#pragma once

#include <memory>
#include <string_view>
#include <utility>

#include "kernels/device.h"
#include "kernels/instance.h"

namespace energyprof::kernels {

struct Device::Context {
  std::unique_ptr<Instance> instance;
  PhysicalDevice physical;
  VkPhysicalDeviceMemoryProperties memory{};
  DeviceApi api;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  DeviceInfo info;
  std::vector<DeviceRefusal> refusals;
  int64_t timeout_ns = 0;
  /// Set once a submission did not end in time. The GPU may still run it: nothing is destroyed any
  /// more, for destroying what is in use is undefined and waiting for it may take forever.
  bool abandoned = false;

  Context() = default;
  ~Context();
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  /// True if buffers should lie in memory that the host reaches too.
  [[nodiscard]] bool shares_memory() const {
    return info.type == "integrated" || info.type == "cpu";
  }
};

using Context = Device::Context;

/// A handle that is destroyed with its owner.
template <typename Handle>
class Owned {
 public:
  using Destroy = void(VKAPI_PTR*)(VkDevice, Handle, const VkAllocationCallbacks*);

  Owned() = default;
  Owned(Context& context, Handle handle, Destroy destroy)
      : context_(&context), handle_(handle), destroy_(destroy) {}
  Owned(Owned&& other) noexcept
      : context_(other.context_),
        handle_(std::exchange(other.handle_, VK_NULL_HANDLE)),
        destroy_(other.destroy_) {}
  Owned& operator=(Owned&& other) noexcept {
    std::swap(context_, other.context_);
    std::swap(handle_, other.handle_);
    std::swap(destroy_, other.destroy_);
    return *this;
  }
  ~Owned() {
    if (handle_ != VK_NULL_HANDLE && !context_->abandoned) {
      destroy_(context_->device, handle_, nullptr);
    }
  }

  [[nodiscard]] Handle get() const { return handle_; }

 private:
  Context* context_ = nullptr;
  Handle handle_ = VK_NULL_HANDLE;
  Destroy destroy_ = nullptr;
};

/// A pool whose command buffers are reset together.
Owned<VkCommandPool> make_command_pool(Context& context);
/// `count` command buffers; they live as long as the pool.
std::vector<VkCommandBuffer> make_command_buffers(Context& context, VkCommandPool pool,
                                                  uint32_t count);
void begin_commands(Context& context, VkCommandBuffer commands);
/// For commands that are submitted several times.
void begin_repeated_commands(Context& context, VkCommandBuffer commands);
void end_commands(Context& context, VkCommandBuffer commands);
Owned<VkFence> make_fence(Context& context);

/// Hands `commands` to the queue; `fence` may be VK_NULL_HANDLE. `what` completes "cannot ...".
/// `more` goes to VkSubmitInfo::pNext.
void submit(Context& context, VkCommandBuffer commands, VkFence fence, std::string_view what,
            const void* more = nullptr);
/// Waits for `fence` and resets it. Throws DeviceLost when that takes longer than
/// DeviceRequest::timeout_ns, and abandons the device.
void wait_and_reset(Context& context, VkFence fence, std::string_view what);

}  // namespace energyprof::kernels
