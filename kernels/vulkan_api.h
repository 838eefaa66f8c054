/// The Vulkan functions this folder calls, found in libvulkan at run time, and what their results
/// mean.
#pragma once

#include <vulkan/vulkan_core.h>

#include <cstdint>
#include <string>
#include <string_view>

namespace energyprof::kernels {

/// What can be called before there is an instance.
struct LoaderApi {
  PFN_vkGetInstanceProcAddr get_instance_proc_addr = nullptr;
  PFN_vkCreateInstance create_instance = nullptr;
  PFN_vkEnumerateInstanceLayerProperties enumerate_instance_layer_properties = nullptr;
  PFN_vkEnumerateInstanceVersion enumerate_instance_version = nullptr;  ///< null: Vulkan 1.0
};

/// Functions of an instance and its physical devices.
struct InstanceApi {
  PFN_vkDestroyInstance destroy_instance = nullptr;
  PFN_vkEnumeratePhysicalDevices enumerate_physical_devices = nullptr;
  PFN_vkGetPhysicalDeviceProperties get_physical_device_properties = nullptr;
  PFN_vkGetPhysicalDeviceProperties2 get_physical_device_properties2 = nullptr;
  PFN_vkGetPhysicalDeviceMemoryProperties get_physical_device_memory_properties = nullptr;
  PFN_vkGetPhysicalDeviceQueueFamilyProperties get_physical_device_queue_family_properties =
      nullptr;
  PFN_vkEnumerateDeviceExtensionProperties enumerate_device_extension_properties = nullptr;
  PFN_vkCreateDevice create_device = nullptr;
  PFN_vkGetDeviceProcAddr get_device_proc_addr = nullptr;
  PFN_vkGetPhysicalDeviceFeatures2 get_physical_device_features2 = nullptr;
  /// From here on null where the extension is absent.
  PFN_vkEnumeratePhysicalDeviceQueueFamilyPerformanceQueryCountersKHR
      enumerate_performance_counters = nullptr;
  PFN_vkGetPhysicalDeviceQueueFamilyPerformanceQueryPassesKHR get_performance_query_passes =
      nullptr;
  PFN_vkGetPhysicalDeviceCalibrateableTimeDomainsEXT get_calibrateable_time_domains = nullptr;
  PFN_vkCreateDebugUtilsMessengerEXT create_debug_utils_messenger = nullptr;
  PFN_vkDestroyDebugUtilsMessengerEXT destroy_debug_utils_messenger = nullptr;
};

/// Functions of a device.
struct DeviceApi {
  PFN_vkDestroyDevice destroy_device = nullptr;
  PFN_vkGetDeviceQueue get_device_queue = nullptr;
  PFN_vkDeviceWaitIdle device_wait_idle = nullptr;
  PFN_vkQueueSubmit queue_submit = nullptr;
  PFN_vkCreateFence create_fence = nullptr;
  PFN_vkDestroyFence destroy_fence = nullptr;
  PFN_vkResetFences reset_fences = nullptr;
  PFN_vkWaitForFences wait_for_fences = nullptr;
  PFN_vkCreateBuffer create_buffer = nullptr;
  PFN_vkDestroyBuffer destroy_buffer = nullptr;
  PFN_vkGetBufferMemoryRequirements get_buffer_memory_requirements = nullptr;
  PFN_vkAllocateMemory allocate_memory = nullptr;
  PFN_vkFreeMemory free_memory = nullptr;
  PFN_vkBindBufferMemory bind_buffer_memory = nullptr;
  PFN_vkMapMemory map_memory = nullptr;
  PFN_vkCreateShaderModule create_shader_module = nullptr;
  PFN_vkDestroyShaderModule destroy_shader_module = nullptr;
  PFN_vkCreateDescriptorSetLayout create_descriptor_set_layout = nullptr;
  PFN_vkDestroyDescriptorSetLayout destroy_descriptor_set_layout = nullptr;
  PFN_vkCreatePipelineLayout create_pipeline_layout = nullptr;
  PFN_vkDestroyPipelineLayout destroy_pipeline_layout = nullptr;
  PFN_vkCreateComputePipelines create_compute_pipelines = nullptr;
  PFN_vkDestroyPipeline destroy_pipeline = nullptr;
  PFN_vkCreateDescriptorPool create_descriptor_pool = nullptr;
  PFN_vkDestroyDescriptorPool destroy_descriptor_pool = nullptr;
  PFN_vkAllocateDescriptorSets allocate_descriptor_sets = nullptr;
  PFN_vkUpdateDescriptorSets update_descriptor_sets = nullptr;
  PFN_vkCreateQueryPool create_query_pool = nullptr;
  PFN_vkDestroyQueryPool destroy_query_pool = nullptr;
  PFN_vkGetQueryPoolResults get_query_pool_results = nullptr;
  PFN_vkCreateCommandPool create_command_pool = nullptr;
  PFN_vkDestroyCommandPool destroy_command_pool = nullptr;
  PFN_vkResetCommandPool reset_command_pool = nullptr;
  PFN_vkAllocateCommandBuffers allocate_command_buffers = nullptr;
  PFN_vkBeginCommandBuffer begin_command_buffer = nullptr;
  PFN_vkEndCommandBuffer end_command_buffer = nullptr;
  PFN_vkCmdBindPipeline cmd_bind_pipeline = nullptr;
  PFN_vkCmdBindDescriptorSets cmd_bind_descriptor_sets = nullptr;
  PFN_vkCmdPushConstants cmd_push_constants = nullptr;
  PFN_vkCmdDispatch cmd_dispatch = nullptr;
  PFN_vkCmdPipelineBarrier cmd_pipeline_barrier = nullptr;
  PFN_vkCmdCopyBuffer cmd_copy_buffer = nullptr;
  PFN_vkCmdResetQueryPool cmd_reset_query_pool = nullptr;
  PFN_vkCmdWriteTimestamp cmd_write_timestamp = nullptr;
  PFN_vkCmdBeginQuery cmd_begin_query = nullptr;
  PFN_vkCmdEndQuery cmd_end_query = nullptr;
  /// Null unless performance queries were enabled.
  PFN_vkAcquireProfilingLockKHR acquire_profiling_lock = nullptr;
  PFN_vkReleaseProfilingLockKHR release_profiling_lock = nullptr;
  /// Null unless calibrated timestamps were enabled.
  PFN_vkGetCalibratedTimestampsEXT get_calibrated_timestamps = nullptr;
};

/// Loads libvulkan, which then stays loaded. Throws std::runtime_error if it cannot be found.
LoaderApi load_vulkan(const char* library = "libvulkan.so.1");
InstanceApi load_instance_api(const LoaderApi& loader, VkInstance instance);
DeviceApi load_device_api(const InstanceApi& instance, VkDevice device);

/// The name of a result: "VK_ERROR_DEVICE_LOST".
std::string result_name(VkResult result);

/// Nothing for VK_SUCCESS; else throws "cannot <what>: <result>" as DeviceLost, OutOfMemory or
/// std::runtime_error.
void check(VkResult result, std::string_view what);

/// A size for people: "212 MiB", "1.5 MiB", "96 bytes".
std::string size_text(uint64_t bytes);

}  // namespace energyprof::kernels
