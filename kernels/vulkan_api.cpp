// Finds the functions of libvulkan and words their errors.
#include "kernels/vulkan_api.h"

#include <dlfcn.h>
#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

#include "kernels/device.h"

namespace energyprof::kernels {
namespace {

template <typename Function>
void load(const LoaderApi& loader, VkInstance instance, const char* name, Function& function) {
  function = reinterpret_cast<Function>(loader.get_instance_proc_addr(instance, name));
}

template <typename Function>
void load(const InstanceApi& api, VkDevice device, const char* name, Function& function) {
  function = reinterpret_cast<Function>(api.get_device_proc_addr(device, name));
}

/// The KHR and the EXT variant of a function are the same one.
template <typename Scope, typename Handle, typename Function>
void load_either(const Scope& scope, Handle handle, const char* khr, const char* ext,
                 Function& function) {
  load(scope, handle, khr, function);
  if (function == nullptr) load(scope, handle, ext, function);
}

}  // namespace

LoaderApi load_vulkan(const char* library) {
  // Never closed: drivers leave threads behind that still run code of theirs.
  void* handle = dlopen(library, RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr) {
    throw std::runtime_error(
        fmt::format("cannot load the Vulkan loader '{}': {}. Install libvulkan1, and a driver such "
                    "as mesa-vulkan-drivers.",
                    library, dlerror()));
  }
  LoaderApi api;
  api.get_instance_proc_addr =
      reinterpret_cast<PFN_vkGetInstanceProcAddr>(dlsym(handle, "vkGetInstanceProcAddr"));
  if (api.get_instance_proc_addr == nullptr) {
    throw std::runtime_error(
        fmt::format("cannot use '{}' as Vulkan loader: it has no vkGetInstanceProcAddr. "
                    "Install libvulkan1.",
                    library));
  }
  load(api, nullptr, "vkCreateInstance", api.create_instance);
  load(api, nullptr, "vkEnumerateInstanceLayerProperties", api.enumerate_instance_layer_properties);
  load(api, nullptr, "vkEnumerateInstanceVersion", api.enumerate_instance_version);
  return api;
}

InstanceApi load_instance_api(const LoaderApi& loader, VkInstance instance) {
  InstanceApi api;
  const auto get = [&](const char* name, auto& function) {
    load(loader, instance, name, function);
  };
  get("vkDestroyInstance", api.destroy_instance);
  get("vkEnumeratePhysicalDevices", api.enumerate_physical_devices);
  get("vkGetPhysicalDeviceProperties", api.get_physical_device_properties);
  get("vkGetPhysicalDeviceProperties2", api.get_physical_device_properties2);
  get("vkGetPhysicalDeviceMemoryProperties", api.get_physical_device_memory_properties);
  get("vkGetPhysicalDeviceQueueFamilyProperties", api.get_physical_device_queue_family_properties);
  get("vkEnumerateDeviceExtensionProperties", api.enumerate_device_extension_properties);
  get("vkCreateDevice", api.create_device);
  get("vkGetDeviceProcAddr", api.get_device_proc_addr);
  load_either(loader, instance, "vkGetPhysicalDeviceCalibrateableTimeDomainsKHR",
              "vkGetPhysicalDeviceCalibrateableTimeDomainsEXT", api.get_calibrateable_time_domains);
  get("vkGetPhysicalDeviceFeatures2", api.get_physical_device_features2);
  get("vkEnumeratePhysicalDeviceQueueFamilyPerformanceQueryCountersKHR",
      api.enumerate_performance_counters);
  get("vkGetPhysicalDeviceQueueFamilyPerformanceQueryPassesKHR", api.get_performance_query_passes);
  get("vkCreateDebugUtilsMessengerEXT", api.create_debug_utils_messenger);
  get("vkDestroyDebugUtilsMessengerEXT", api.destroy_debug_utils_messenger);
  return api;
}

DeviceApi load_device_api(const InstanceApi& instance, VkDevice device) {
  DeviceApi api;
  const auto get = [&](const char* name, auto& function) {
    load(instance, device, name, function);
  };
  get("vkDestroyDevice", api.destroy_device);
  get("vkGetDeviceQueue", api.get_device_queue);
  get("vkDeviceWaitIdle", api.device_wait_idle);
  get("vkQueueSubmit", api.queue_submit);
  get("vkCreateFence", api.create_fence);
  get("vkDestroyFence", api.destroy_fence);
  get("vkResetFences", api.reset_fences);
  get("vkWaitForFences", api.wait_for_fences);
  get("vkCreateBuffer", api.create_buffer);
  get("vkDestroyBuffer", api.destroy_buffer);
  get("vkGetBufferMemoryRequirements", api.get_buffer_memory_requirements);
  get("vkAllocateMemory", api.allocate_memory);
  get("vkFreeMemory", api.free_memory);
  get("vkBindBufferMemory", api.bind_buffer_memory);
  get("vkMapMemory", api.map_memory);
  get("vkCreateShaderModule", api.create_shader_module);
  get("vkDestroyShaderModule", api.destroy_shader_module);
  get("vkCreateDescriptorSetLayout", api.create_descriptor_set_layout);
  get("vkDestroyDescriptorSetLayout", api.destroy_descriptor_set_layout);
  get("vkCreatePipelineLayout", api.create_pipeline_layout);
  get("vkDestroyPipelineLayout", api.destroy_pipeline_layout);
  get("vkCreateComputePipelines", api.create_compute_pipelines);
  get("vkDestroyPipeline", api.destroy_pipeline);
  get("vkCreateDescriptorPool", api.create_descriptor_pool);
  get("vkDestroyDescriptorPool", api.destroy_descriptor_pool);
  get("vkAllocateDescriptorSets", api.allocate_descriptor_sets);
  get("vkUpdateDescriptorSets", api.update_descriptor_sets);
  get("vkCreateQueryPool", api.create_query_pool);
  get("vkDestroyQueryPool", api.destroy_query_pool);
  get("vkGetQueryPoolResults", api.get_query_pool_results);
  get("vkCreateCommandPool", api.create_command_pool);
  get("vkDestroyCommandPool", api.destroy_command_pool);
  get("vkResetCommandPool", api.reset_command_pool);
  get("vkAllocateCommandBuffers", api.allocate_command_buffers);
  get("vkBeginCommandBuffer", api.begin_command_buffer);
  get("vkEndCommandBuffer", api.end_command_buffer);
  get("vkCmdBindPipeline", api.cmd_bind_pipeline);
  get("vkCmdBindDescriptorSets", api.cmd_bind_descriptor_sets);
  get("vkCmdPushConstants", api.cmd_push_constants);
  get("vkCmdDispatch", api.cmd_dispatch);
  get("vkCmdPipelineBarrier", api.cmd_pipeline_barrier);
  get("vkCmdCopyBuffer", api.cmd_copy_buffer);
  get("vkCmdResetQueryPool", api.cmd_reset_query_pool);
  get("vkCmdWriteTimestamp", api.cmd_write_timestamp);
  get("vkCmdBeginQuery", api.cmd_begin_query);
  get("vkCmdEndQuery", api.cmd_end_query);
  get("vkAcquireProfilingLockKHR", api.acquire_profiling_lock);
  get("vkReleaseProfilingLockKHR", api.release_profiling_lock);
  load_either(instance, device, "vkGetCalibratedTimestampsKHR", "vkGetCalibratedTimestampsEXT",
              api.get_calibrated_timestamps);
  return api;
}

std::string result_name(VkResult result) {
  switch (result) {
    case VK_SUCCESS:
      return "VK_SUCCESS";
    case VK_NOT_READY:
      return "VK_NOT_READY";
    case VK_TIMEOUT:
      return "VK_TIMEOUT";
    case VK_INCOMPLETE:
      return "VK_INCOMPLETE";
    case VK_ERROR_OUT_OF_HOST_MEMORY:
      return "VK_ERROR_OUT_OF_HOST_MEMORY";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
      return "VK_ERROR_OUT_OF_DEVICE_MEMORY";
    case VK_ERROR_INITIALIZATION_FAILED:
      return "VK_ERROR_INITIALIZATION_FAILED";
    case VK_ERROR_DEVICE_LOST:
      return "VK_ERROR_DEVICE_LOST";
    case VK_ERROR_MEMORY_MAP_FAILED:
      return "VK_ERROR_MEMORY_MAP_FAILED";
    case VK_ERROR_LAYER_NOT_PRESENT:
      return "VK_ERROR_LAYER_NOT_PRESENT";
    case VK_ERROR_EXTENSION_NOT_PRESENT:
      return "VK_ERROR_EXTENSION_NOT_PRESENT";
    case VK_ERROR_FEATURE_NOT_PRESENT:
      return "VK_ERROR_FEATURE_NOT_PRESENT";
    case VK_ERROR_INCOMPATIBLE_DRIVER:
      return "VK_ERROR_INCOMPATIBLE_DRIVER";
    case VK_ERROR_TOO_MANY_OBJECTS:
      return "VK_ERROR_TOO_MANY_OBJECTS";
    case VK_ERROR_INVALID_SHADER_NV:
      return "VK_ERROR_INVALID_SHADER_NV";
    default:
      return fmt::format("VkResult {}", static_cast<int>(result));
  }
}

void check(VkResult result, std::string_view what) {
  if (result == VK_SUCCESS) return;
  const std::string text = fmt::format("cannot {}: {}", what, result_name(result));
  switch (result) {
    case VK_ERROR_DEVICE_LOST:
      throw DeviceLost(text + ". The driver reset the GPU; its kernel log may say why.");
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
    case VK_ERROR_OUT_OF_HOST_MEMORY:
      throw OutOfMemory(text + ". Free memory, or take a smaller model or image.");
    default:
      throw std::runtime_error(text + ".");
  }
}

std::string size_text(uint64_t bytes) {
  constexpr double mib = 1024.0 * 1024.0;
  if (bytes < 10'000) return fmt::format("{} bytes", bytes);
  // Rounded up, so that what does not fit never reads like the limit.
  return fmt::format("{} MiB", std::ceil(static_cast<double>(bytes) / mib * 100.0) / 100.0);
}

}  // namespace energyprof::kernels
