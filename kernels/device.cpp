// Opens a device, and submits to it.
#include "kernels/device.h"

#include <fmt/format.h>

#include <algorithm>

#include "kernels/context.h"

namespace energyprof::kernels {
namespace {

/// vkWaitForFences is asked for this long at a time.
constexpr int64_t wait_step_ns = 100 * ns_per_ms;

void open_device(Context& context, bool gpu_assisted_validation) {
  constexpr float priority = 1.0f;
  VkDeviceQueueCreateInfo queue{};
  queue.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO;
  queue.queueFamilyIndex = context.physical.queue_family;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;
  VkDeviceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO;
  info.queueCreateInfoCount = 1;
  info.pQueueCreateInfos = &queue;
  std::vector<const char*> extensions;
  if (context.physical.calibration_extension) {
    extensions.push_back(context.physical.calibration_extension->c_str());
  }
  VkPhysicalDevicePerformanceQueryFeaturesKHR queries{};
  queries.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PERFORMANCE_QUERY_FEATURES_KHR;
  queries.performanceCounterQueryPools = VK_TRUE;
  if (!context.physical.counter_indices.empty()) {
    extensions.push_back(VK_KHR_PERFORMANCE_QUERY_EXTENSION_NAME);
    info.pNext = &queries;
  }
  info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  info.ppEnabledExtensionNames = extensions.data();
  // The layer's own shader code writes to buffers.
  VkPhysicalDeviceFeatures instrumented{};
  instrumented.vertexPipelineStoresAndAtomics = VK_TRUE;
  instrumented.fragmentStoresAndAtomics = VK_TRUE;
  if (gpu_assisted_validation) info.pEnabledFeatures = &instrumented;
  const InstanceApi& api = context.instance->api();
  check(api.create_device(context.physical.handle, &info, nullptr, &context.device),
        fmt::format("open Vulkan device '{}'", context.info.name));
  context.api = load_device_api(api, context.device);
  context.api.get_device_queue(context.device, context.physical.queue_family, 0, &context.queue);
  api.get_physical_device_memory_properties(context.physical.handle, &context.memory);
}

}  // namespace

Context::~Context() {
  if (abandoned) {
    instance->abandon();
  } else if (device != VK_NULL_HANDLE) {
    api.device_wait_idle(device);
    api.destroy_device(device, nullptr);
  }
}

DeviceList list_devices() {
  const Instance instance(false);
  Instance::Survey survey = instance.survey();
  DeviceList list;
  for (const size_t i : rank_devices(survey.candidates)) {
    list.usable.push_back(survey.candidates[i].info);
  }
  for (const Candidate& candidate : survey.candidates) {
    if (!candidate.unusable.empty()) {
      list.unusable.push_back({candidate.info.name, candidate.unusable});
    }
  }
  return list;
}

Device::Device(const DeviceRequest& request) : context_(std::make_unique<Context>()) {
  context_->instance =
      std::make_unique<Instance>(request.validation, request.gpu_assisted_validation);
  Instance::Survey survey = context_->instance->survey();
  Choice choice = choose_device(survey.candidates, request.name);
  context_->physical = std::move(survey.devices[choice.index]);
  context_->info = std::move(survey.candidates[choice.index].info);
  context_->refusals = std::move(choice.refusals);
  context_->timeout_ns = request.timeout_ns;
  open_device(*context_, request.gpu_assisted_validation);
}

Device::~Device() = default;
Device::Device(Device&&) noexcept = default;
Device& Device::operator=(Device&&) noexcept = default;

const DeviceInfo& Device::info() const { return context_->info; }
const std::vector<DeviceRefusal>& Device::refusals() const { return context_->refusals; }
std::vector<std::string> Device::validation_messages() const {
  return context_->instance->log()->messages();
}

Owned<VkCommandPool> make_command_pool(Context& context) {
  VkCommandPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
  info.flags = VK_COMMAND_POOL_CREATE_TRANSIENT_BIT;
  info.queueFamilyIndex = context.physical.queue_family;
  VkCommandPool pool = VK_NULL_HANDLE;
  check(context.api.create_command_pool(context.device, &info, nullptr, &pool),
        "create a command pool");
  return {context, pool, context.api.destroy_command_pool};
}

std::vector<VkCommandBuffer> make_command_buffers(Context& context, VkCommandPool pool,
                                                  uint32_t count) {
  VkCommandBufferAllocateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
  info.commandPool = pool;
  info.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  info.commandBufferCount = count;
  std::vector<VkCommandBuffer> buffers(count);
  check(context.api.allocate_command_buffers(context.device, &info, buffers.data()),
        fmt::format("allocate {} command buffers", count));
  return buffers;
}

namespace {

void begin(Context& context, VkCommandBuffer commands, VkCommandBufferUsageFlags flags) {
  VkCommandBufferBeginInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
  info.flags = flags;
  check(context.api.begin_command_buffer(commands, &info), "record GPU commands");
}

}  // namespace

void begin_commands(Context& context, VkCommandBuffer commands) {
  begin(context, commands, VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT);
}

void begin_repeated_commands(Context& context, VkCommandBuffer commands) {
  begin(context, commands, 0);
}

void end_commands(Context& context, VkCommandBuffer commands) {
  check(context.api.end_command_buffer(commands), "record GPU commands");
}

Owned<VkFence> make_fence(Context& context) {
  VkFenceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO;
  VkFence fence = VK_NULL_HANDLE;
  check(context.api.create_fence(context.device, &info, nullptr, &fence), "create a fence");
  return {context, fence, context.api.destroy_fence};
}

void submit(Context& context, VkCommandBuffer commands, VkFence fence, std::string_view what,
            const void* more) {
  VkSubmitInfo info{};
  info.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO;
  info.pNext = more;
  info.commandBufferCount = 1;
  info.pCommandBuffers = &commands;
  check(context.api.queue_submit(context.queue, 1, &info, fence),
        fmt::format("{} on '{}'", what, context.info.name));
}

void wait_and_reset(Context& context, VkFence fence, std::string_view what) {
  const int64_t deadline_ns = now_ns() + context.timeout_ns;
  VkResult result = VK_TIMEOUT;
  while (result == VK_TIMEOUT) {
    const int64_t left_ns = deadline_ns - now_ns();
    if (left_ns <= 0) {
      context.abandoned = true;
      throw DeviceLost(fmt::format(
          "cannot {} on '{}': not finished after {:.3g} s, the device is taken for lost. "
          "Take a smaller model or image, or another device.",
          what, context.info.name, static_cast<double>(context.timeout_ns) / ns_per_s));
    }
    const auto step_ns = static_cast<uint64_t>(std::min(left_ns, wait_step_ns));
    result = context.api.wait_for_fences(context.device, 1, &fence, VK_TRUE, step_ns);
  }
  check(result, fmt::format("{} on '{}'", what, context.info.name));
  check(context.api.reset_fences(context.device, 1, &fence), "reset a fence");
}

}  // namespace energyprof::kernels
