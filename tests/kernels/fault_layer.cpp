// A Vulkan layer that makes a healthy driver fail in the ways real ones do, so that the tests run
// the code that handles it. Enable it with VK_ADD_LAYER_PATH=<its folder> and
// VK_INSTANCE_LAYERS=VK_LAYER_ENERGYPROF_fault; EP_FAULT lists faults, separated by commas:
//
//   device-lost:N       the Nth vkQueueSubmit of the process loses its device
//   device-lost-wait:N  the Nth vkWaitForFences does
//   hang:N              from the Nth vkQueueSubmit on, nothing is ever seen to finish
//   out-of-memory:N     the Nth vkAllocateMemory of the process fails
//   no-calibrated       calibrated timestamps are hidden
//   no-monotonic        calibrated timestamps know no CLOCK_MONOTONIC
//   valid-bits:N        timestamps have N bits, and wrap around 200 us after the first one
//   tick-period:X       a GPU tick takes X ns (the driver's takes 1 ns)
//   small-range         maxStorageBufferRange is 1 MiB
//   device-type:T       the device is of type integrated, discrete or virtual
//   counters:N          VK_KHR_performance_query is there, with counters that take N passes. They
//                       give their values only to who goes about it as Vulkan demands
//   counters-busy       another process holds the profiling lock
//
// N counts from 1. The counters start anew when EP_FAULT changes.
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan_core.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <sstream>
#include <string>
#include <string_view>
#include <thread>
#include <type_traits>
#include <vector>

namespace {

constexpr std::string_view layer_name = "VK_LAYER_ENERGYPROF_fault";
constexpr std::string_view counter_extension = VK_KHR_PERFORMANCE_QUERY_EXTENSION_NAME;

class Faults {
 public:
  /// Reads EP_FAULT.
  void load() {
    const char* variable = std::getenv("EP_FAULT");
    const std::string text = variable == nullptr ? "" : variable;
    if (text == text_) return;
    *this = Faults();
    text_ = text;
    std::istringstream stream(text);
    for (std::string item; std::getline(stream, item, ',');) {
      const size_t colon = item.find(':');
      values_[item.substr(0, colon)] = colon == std::string::npos ? "" : item.substr(colon + 1);
    }
  }

  [[nodiscard]] bool has(const std::string& name) const { return values_.contains(name); }
  [[nodiscard]] std::optional<std::string> text(const std::string& name) const {
    const auto found = values_.find(name);
    return found == values_.end() ? std::nullopt : std::optional(found->second);
  }
  [[nodiscard]] std::optional<uint64_t> number(const std::string& name) const {
    const auto value = text(name);
    return value ? std::optional<uint64_t>(std::stoull(*value)) : std::nullopt;
  }

  uint64_t submit_count = 0;
  uint64_t wait_count = 0;
  uint64_t allocation_count = 0;
  std::optional<uint64_t> first_tick;
  bool has_lock = false;
  std::optional<uint64_t> passes;  ///< begun since the query was reset

 private:
  std::string text_;
  std::map<std::string, std::string> values_;
};

/// The functions of the next layer or the driver. They must be asked for while the instance or
/// device is created: later the loader answers with the top of the chain.
struct InstanceNext {
  InstanceNext() = default;
  InstanceNext(VkInstance own, PFN_vkGetInstanceProcAddr get_function)
      : instance(own), get(get_function) {
    const auto load = [&](const char* name, auto& function) {
      function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(get(own, name));
    };
    load("vkDestroyInstance", destroy_instance);
    load("vkCreateDevice", create_device);
    load("vkGetPhysicalDeviceProperties", get_properties);
    load("vkGetPhysicalDeviceProperties2", get_properties2);
    load("vkGetPhysicalDeviceQueueFamilyProperties", get_queue_families);
    load("vkEnumerateDeviceExtensionProperties", enumerate_extensions);
    load("vkGetPhysicalDeviceCalibrateableTimeDomainsEXT", get_time_domains);
    load("vkGetPhysicalDeviceFeatures2", get_features2);
  }

  VkInstance instance = VK_NULL_HANDLE;
  PFN_vkGetInstanceProcAddr get = nullptr;
  PFN_vkDestroyInstance destroy_instance = nullptr;
  PFN_vkCreateDevice create_device = nullptr;
  PFN_vkGetPhysicalDeviceProperties get_properties = nullptr;
  PFN_vkGetPhysicalDeviceProperties2 get_properties2 = nullptr;
  PFN_vkGetPhysicalDeviceQueueFamilyProperties get_queue_families = nullptr;
  PFN_vkEnumerateDeviceExtensionProperties enumerate_extensions = nullptr;
  PFN_vkGetPhysicalDeviceCalibrateableTimeDomainsEXT get_time_domains = nullptr;
  PFN_vkGetPhysicalDeviceFeatures2 get_features2 = nullptr;
};

struct DeviceNext {
  DeviceNext() = default;
  DeviceNext(VkDevice device, PFN_vkGetDeviceProcAddr get_function) : get(get_function) {
    const auto load = [&](const char* name, auto& function) {
      function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(get(device, name));
    };
    load("vkDestroyDevice", destroy_device);
    load("vkGetCalibratedTimestampsEXT", get_calibrated_timestamps);
    load("vkGetQueryPoolResults", get_query_results);
    load("vkQueueSubmit", queue_submit);
    load("vkWaitForFences", wait_for_fences);
    load("vkAllocateMemory", allocate_memory);
    load("vkCreateQueryPool", create_query_pool);
    load("vkDestroyQueryPool", destroy_query_pool);
    load("vkCmdResetQueryPool", reset_query_pool);
  }

  PFN_vkGetDeviceProcAddr get = nullptr;
  PFN_vkDestroyDevice destroy_device = nullptr;
  PFN_vkGetCalibratedTimestampsEXT get_calibrated_timestamps = nullptr;
  PFN_vkGetQueryPoolResults get_query_results = nullptr;
  PFN_vkQueueSubmit queue_submit = nullptr;
  PFN_vkWaitForFences wait_for_fences = nullptr;
  PFN_vkAllocateMemory allocate_memory = nullptr;
  PFN_vkCreateQueryPool create_query_pool = nullptr;
  PFN_vkDestroyQueryPool destroy_query_pool = nullptr;
  PFN_vkCmdResetQueryPool reset_query_pool = nullptr;
};

std::mutex mutex;
Faults faults;
std::map<void*, InstanceNext> instances;
std::map<void*, DeviceNext> devices;
std::set<void*> lost_devices;
std::set<VkQueryPool> counter_pools;          // the driver knows them as timestamps
std::set<VkCommandBuffer> counting_commands;  // they hold a query of counters

/// Handles of one instance, or of one device, begin with the same pointer.
void* key(const void* handle) { return *static_cast<void* const*>(handle); }

const InstanceNext& instance_of(const void* handle) { return instances.at(key(handle)); }
const DeviceNext& device_of(const void* handle) { return devices.at(key(handle)); }

/// The loader's link to the next layer.
template <typename Link, VkStructureType type>
Link* find_link(const void* chain) {
  auto* link = const_cast<Link*>(static_cast<const Link*>(chain));
  while (link != nullptr && (link->sType != type || link->function != VK_LAYER_LINK_INFO)) {
    link = const_cast<Link*>(static_cast<const Link*>(link->pNext));
  }
  return link;
}

VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info,
                                    const VkAllocationCallbacks* allocator, VkInstance* instance) {
  const std::lock_guard lock(mutex);
  faults.load();
  auto* link = find_link<VkLayerInstanceCreateInfo, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO>(
      info->pNext);
  const PFN_vkGetInstanceProcAddr get = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create = reinterpret_cast<PFN_vkCreateInstance>(get(nullptr, "vkCreateInstance"));
  const VkResult result = create(info, allocator, instance);
  if (result == VK_SUCCESS) instances[key(*instance)] = InstanceNext(*instance, get);
  return result;
}

void VKAPI_CALL destroy_instance(VkInstance instance, const VkAllocationCallbacks* allocator) {
  const std::lock_guard lock(mutex);
  const auto destroy = instance_of(instance).destroy_instance;
  instances.erase(key(instance));
  destroy(instance, allocator);
}

/// Takes the structure of this type out of a pNext chain, if there is one.
template <typename Info>
void take_out(const Info* info, VkStructureType type) {
  auto* link = reinterpret_cast<VkBaseOutStructure*>(const_cast<Info*>(info));
  for (; link->pNext != nullptr; link = link->pNext)
    if (link->pNext->sType == type) {
      link->pNext = link->pNext->pNext;
      return;
    }
}

VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                  const VkAllocationCallbacks* allocator, VkDevice* device) {
  const std::lock_guard lock(mutex);
  auto* link =
      find_link<VkLayerDeviceCreateInfo, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO>(info->pNext);
  const PFN_vkGetDeviceProcAddr get = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  // What only this layer has is not the driver's business.
  take_out(info, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PERFORMANCE_QUERY_FEATURES_KHR);
  VkDeviceCreateInfo reduced = *info;
  std::vector<const char*> extensions(info->ppEnabledExtensionNames,
                                      info->ppEnabledExtensionNames + info->enabledExtensionCount);
  if (faults.has("counters"))
    std::erase_if(extensions, [](std::string_view name) { return name == counter_extension; });
  reduced.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
  reduced.ppEnabledExtensionNames = extensions.data();
  const VkResult result =
      instance_of(physical).create_device(physical, &reduced, allocator, device);
  if (result == VK_SUCCESS) {
    devices[key(*device)] = DeviceNext(*device, get);
    lost_devices.erase(key(*device));
  }
  return result;
}

void VKAPI_CALL destroy_device(VkDevice device, const VkAllocationCallbacks* allocator) {
  const std::lock_guard lock(mutex);
  const auto destroy = device_of(device).destroy_device;
  devices.erase(key(device));
  destroy(device, allocator);
}

void change(VkPhysicalDeviceProperties& properties) {
  if (faults.has("small-range")) properties.limits.maxStorageBufferRange = 1u << 20u;
  if (const auto period = faults.text("tick-period")) {
    properties.limits.timestampPeriod = std::stof(*period);
  }
  const std::string type = faults.text("device-type").value_or("");
  if (type == "integrated") properties.deviceType = VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU;
  if (type == "discrete") properties.deviceType = VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU;
  if (type == "virtual") properties.deviceType = VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU;
}

void VKAPI_CALL get_properties(VkPhysicalDevice physical, VkPhysicalDeviceProperties* properties) {
  const std::lock_guard lock(mutex);
  instance_of(physical).get_properties(physical, properties);
  change(*properties);
}

void VKAPI_CALL get_properties2(VkPhysicalDevice physical,
                                VkPhysicalDeviceProperties2* properties) {
  const std::lock_guard lock(mutex);
  instance_of(physical).get_properties2(physical, properties);
  change(properties->properties);
}

void VKAPI_CALL get_queue_families(VkPhysicalDevice physical, uint32_t* count,
                                   VkQueueFamilyProperties* families) {
  const std::lock_guard lock(mutex);
  instance_of(physical).get_queue_families(physical, count, families);
  const auto bits = faults.number("valid-bits");
  if (families == nullptr || !bits) return;
  for (uint32_t i = 0; i < *count; ++i) {
    families[i].timestampValidBits = static_cast<uint32_t>(*bits);
  }
}

/// Answers a "how many, then give me them" call from a list.
template <typename T>
VkResult give(const std::vector<T>& items, uint32_t* count, T* out) {
  const auto available = static_cast<uint32_t>(items.size());
  if (out == nullptr) {
    *count = available;
    return VK_SUCCESS;
  }
  const uint32_t given = std::min(*count, available);
  std::copy_n(items.begin(), given, out);
  *count = given;
  return given < available ? VK_INCOMPLETE : VK_SUCCESS;
}

VkResult VKAPI_CALL enumerate_extensions(VkPhysicalDevice physical, const char* layer,
                                         uint32_t* count, VkExtensionProperties* out) {
  const std::lock_guard lock(mutex);
  if (layer != nullptr && layer == layer_name) return give<VkExtensionProperties>({}, count, out);
  const auto next = instance_of(physical).enumerate_extensions;
  if (!faults.has("no-calibrated") && !faults.has("counters")) {
    return next(physical, layer, count, out);
  }
  uint32_t all_count = 0;
  next(physical, layer, &all_count, nullptr);
  std::vector<VkExtensionProperties> all(all_count);
  next(physical, layer, &all_count, all.data());
  std::erase_if(all, [](const VkExtensionProperties& extension) {
    return faults.has("no-calibrated") &&
           std::string_view(extension.extensionName).ends_with("_calibrated_timestamps");
  });
  if (faults.has("counters")) {
    VkExtensionProperties extension{};
    counter_extension.copy(extension.extensionName, sizeof extension.extensionName - 1);
    all.push_back(extension);
  }
  return give(all, count, out);
}

VkResult VKAPI_CALL get_time_domains(VkPhysicalDevice physical, uint32_t* count,
                                     VkTimeDomainEXT* out) {
  const std::lock_guard lock(mutex);
  const auto next = instance_of(physical).get_time_domains;
  if (!faults.has("no-monotonic")) return next(physical, count, out);
  return give<VkTimeDomainEXT>({VK_TIME_DOMAIN_DEVICE_EXT, VK_TIME_DOMAIN_CLOCK_MONOTONIC_RAW_EXT},
                               count, out);
}

void VKAPI_CALL get_features2(VkPhysicalDevice physical, VkPhysicalDeviceFeatures2* features) {
  const std::lock_guard lock(mutex);
  instance_of(physical).get_features2(physical, features);
  auto* item = reinterpret_cast<VkBaseOutStructure*>(features);
  for (; item != nullptr; item = item->pNext)
    if (item->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PERFORMANCE_QUERY_FEATURES_KHR)
      reinterpret_cast<VkPhysicalDevicePerformanceQueryFeaturesKHR*>(item)
          ->performanceCounterQueryPools = faults.has("counters") ? VK_TRUE : VK_FALSE;
}

/// The counters of a GPU that there is not.
struct FakeCounter {
  const char* name;
  VkPerformanceCounterUnitKHR unit;
  VkPerformanceCounterStorageKHR storage;
  VkPerformanceCounterResultKHR result;
};
std::vector<FakeCounter> fake_counters() {
  VkPerformanceCounterResultKHR time{};
  time.uint64 = 5'000'000;
  VkPerformanceCounterResultKHR read{};
  read.float32 = 65'536.0F;
  VkPerformanceCounterResultKHR stall{};
  stall.float32 = 37.25F;
  VkPerformanceCounterResultKHR misses{};
  misses.uint32 = 4'000'000'000;
  return {{"GpuTime", VK_PERFORMANCE_COUNTER_UNIT_NANOSECONDS_KHR,
           VK_PERFORMANCE_COUNTER_STORAGE_UINT64_KHR, time},
          {"GtiReadThroughput", VK_PERFORMANCE_COUNTER_UNIT_BYTES_KHR,
           VK_PERFORMANCE_COUNTER_STORAGE_FLOAT32_KHR, read},
          {"EuStall", VK_PERFORMANCE_COUNTER_UNIT_PERCENTAGE_KHR,
           VK_PERFORMANCE_COUNTER_STORAGE_FLOAT32_KHR, stall},
          {"L3 misses", VK_PERFORMANCE_COUNTER_UNIT_GENERIC_KHR,
           VK_PERFORMANCE_COUNTER_STORAGE_UINT32_KHR, misses}};
}

VkResult VKAPI_CALL enumerate_counters(VkPhysicalDevice, uint32_t, uint32_t* count,
                                       VkPerformanceCounterKHR* counters,
                                       VkPerformanceCounterDescriptionKHR* descriptions) {
  const std::vector<FakeCounter> fakes = fake_counters();
  if (counters != nullptr) {
    for (size_t i = 0; i < std::min<size_t>(*count, fakes.size()); ++i) {
      counters[i].unit = fakes[i].unit;
      counters[i].storage = fakes[i].storage;
      counters[i].scope = VK_PERFORMANCE_COUNTER_SCOPE_COMMAND_KHR;
      std::snprintf(descriptions[i].name, sizeof descriptions[i].name, "%s", fakes[i].name);
      std::snprintf(descriptions[i].category, sizeof descriptions[i].category, "Fake");
      std::snprintf(descriptions[i].description, sizeof descriptions[i].description, "Not real");
    }
  }
  *count = static_cast<uint32_t>(fakes.size());
  return VK_SUCCESS;
}

void VKAPI_CALL get_counter_passes(VkPhysicalDevice, const VkQueryPoolPerformanceCreateInfoKHR*,
                                   uint32_t* passes) {
  const std::lock_guard lock(mutex);
  *passes = static_cast<uint32_t>(faults.number("counters").value_or(0));
}

VkResult VKAPI_CALL acquire_profiling_lock(VkDevice, const VkAcquireProfilingLockInfoKHR*) {
  const std::lock_guard lock(mutex);
  if (faults.has("counters-busy")) return VK_TIMEOUT;
  faults.has_lock = true;
  return VK_SUCCESS;
}

void VKAPI_CALL release_profiling_lock(VkDevice) {
  const std::lock_guard lock(mutex);
  faults.has_lock = false;
}

VkResult VKAPI_CALL create_query_pool(VkDevice device, const VkQueryPoolCreateInfo* info,
                                      const VkAllocationCallbacks* allocator, VkQueryPool* pool) {
  const std::lock_guard lock(mutex);
  VkQueryPoolCreateInfo replaced = *info;
  const bool counts = info->queryType == VK_QUERY_TYPE_PERFORMANCE_QUERY_KHR;
  if (counts) {
    replaced.pNext = nullptr;
    replaced.queryType = VK_QUERY_TYPE_TIMESTAMP;
  }
  const VkResult result = device_of(device).create_query_pool(device, &replaced, allocator, pool);
  if (result == VK_SUCCESS && counts) counter_pools.insert(*pool);
  return result;
}

void VKAPI_CALL destroy_query_pool(VkDevice device, VkQueryPool pool,
                                   const VkAllocationCallbacks* allocator) {
  const std::lock_guard lock(mutex);
  if (counter_pools.erase(pool) != 0) counting_commands.clear();
  device_of(device).destroy_query_pool(device, pool, allocator);
}

void VKAPI_CALL reset_query_pool(VkCommandBuffer commands, VkQueryPool pool, uint32_t first,
                                 uint32_t count) {
  const std::lock_guard lock(mutex);
  if (counter_pools.contains(pool)) {
    // Not in the commands that hold the query.
    if (!counting_commands.contains(commands)) faults.passes = 0;
    return;
  }
  device_of(commands).reset_query_pool(commands, pool, first, count);
}

void VKAPI_CALL begin_query(VkCommandBuffer commands, VkQueryPool, uint32_t, VkQueryControlFlags) {
  const std::lock_guard lock(mutex);
  if (faults.has_lock) counting_commands.insert(commands);
}

void VKAPI_CALL end_query(VkCommandBuffer, VkQueryPool, uint32_t) {}

/// Values if the query was reset and every pass ran, each with the lock held.
VkResult give_counters(size_t size, void* data) {
  const std::vector<FakeCounter> fakes = fake_counters();
  const bool all_chosen = size == fakes.size() * sizeof(VkPerformanceCounterResultKHR);
  const uint64_t passes = faults.number("counters").value_or(0);
  if (faults.passes != (uint64_t{1} << passes) - 1) return VK_NOT_READY;
  auto* results = static_cast<VkPerformanceCounterResultKHR*>(data);
  // With several passes the first one, GpuTime, is not chosen.
  for (size_t i = all_chosen ? 0 : 1; i < fakes.size(); ++i) *results++ = fakes[i].result;
  return VK_SUCCESS;
}

/// The driver's ticks (1 ns) as the clock that EP_FAULT describes would show them.
uint64_t change(uint64_t ticks) {
  const double period = std::stod(faults.text("tick-period").value_or("1"));
  if (period != 1.0) ticks = static_cast<uint64_t>(static_cast<double>(ticks) / period);
  const auto bits = faults.number("valid-bits");
  if (!bits) return ticks;
  if (!faults.first_tick) faults.first_tick = ticks;
  const auto until_wrap = static_cast<uint64_t>(200'000.0 / period);
  return (ticks - *faults.first_tick - until_wrap) & ((uint64_t{1} << *bits) - 1);
}

VkResult VKAPI_CALL get_calibrated_timestamps(VkDevice device, uint32_t count,
                                              const VkCalibratedTimestampInfoEXT* infos,
                                              uint64_t* times, uint64_t* deviation) {
  const std::lock_guard lock(mutex);
  const auto next = device_of(device).get_calibrated_timestamps;
  const VkResult result = next(device, count, infos, times, deviation);
  for (uint32_t i = 0; i < count; ++i) {
    if (infos[i].timeDomain == VK_TIME_DOMAIN_DEVICE_EXT) times[i] = change(times[i]);
  }
  return result;
}

/// Timestamps as energyprof asks for them: 64-bit values, one after the other.
VkResult VKAPI_CALL get_query_results(VkDevice device, VkQueryPool pool, uint32_t first,
                                      uint32_t count, size_t size, void* data, VkDeviceSize stride,
                                      VkQueryResultFlags flags) {
  const std::lock_guard lock(mutex);
  if (counter_pools.contains(pool)) return give_counters(size, data);
  const VkResult result =
      device_of(device).get_query_results(device, pool, first, count, size, data, stride, flags);
  auto* ticks = static_cast<uint64_t*>(data);
  std::transform(ticks, ticks + count, ticks, [](uint64_t value) { return change(value); });
  return result;
}

VkResult VKAPI_CALL queue_submit(VkQueue queue, uint32_t count, const VkSubmitInfo* infos,
                                 VkFence fence) {
  const std::lock_guard lock(mutex);
  ++faults.submit_count;
  if (faults.submit_count == faults.number("device-lost")) lost_devices.insert(key(queue));
  if (lost_devices.contains(key(queue))) return VK_ERROR_DEVICE_LOST;
  const auto* pass = static_cast<const VkPerformanceQuerySubmitInfoKHR*>(infos->pNext);
  if (pass == nullptr || pass->sType != VK_STRUCTURE_TYPE_PERFORMANCE_QUERY_SUBMIT_INFO_KHR) {
    return device_of(queue).queue_submit(queue, count, infos, fence);
  }
  if (faults.has_lock && faults.passes && counting_commands.contains(*infos->pCommandBuffers)) {
    *faults.passes |= uint64_t{1} << pass->counterPassIndex;
  }
  VkSubmitInfo plain = *infos;
  plain.pNext = nullptr;
  return device_of(queue).queue_submit(queue, 1, &plain, fence);
}

VkResult VKAPI_CALL wait_for_fences(VkDevice device, uint32_t count, const VkFence* fences,
                                    VkBool32 all, uint64_t timeout_ns) {
  PFN_vkWaitForFences next = nullptr;
  bool hangs = false;
  {
    const std::lock_guard lock(mutex);
    ++faults.wait_count;
    if (faults.wait_count == faults.number("device-lost-wait")) lost_devices.insert(key(device));
    if (lost_devices.contains(key(device))) return VK_ERROR_DEVICE_LOST;
    hangs = faults.submit_count >= faults.number("hang").value_or(~uint64_t{0});
    next = device_of(device).wait_for_fences;
  }
  if (!hangs) return next(device, count, fences, all, timeout_ns);
  std::this_thread::sleep_for(std::chrono::nanoseconds(timeout_ns));
  return VK_TIMEOUT;
}

VkResult VKAPI_CALL allocate_memory(VkDevice device, const VkMemoryAllocateInfo* info,
                                    const VkAllocationCallbacks* allocator,
                                    VkDeviceMemory* memory) {
  const std::lock_guard lock(mutex);
  ++faults.allocation_count;
  if (faults.allocation_count == faults.number("out-of-memory")) {
    return VK_ERROR_OUT_OF_DEVICE_MEMORY;
  }
  return device_of(device).allocate_memory(device, info, allocator, memory);
}

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL get_device_function(VkDevice device, const char* name);
VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL get_instance_function(VkInstance instance,
                                                               const char* name);

template <typename Function>
PFN_vkVoidFunction erase_type(Function* function) {
  return reinterpret_cast<PFN_vkVoidFunction>(function);
}

PFN_vkVoidFunction find(const std::map<std::string_view, PFN_vkVoidFunction>& table,
                        const char* name) {
  const auto found = table.find(name);
  return found == table.end() ? nullptr : found->second;
}

PFN_vkVoidFunction own_device_function(const char* name) {
  static const std::map<std::string_view, PFN_vkVoidFunction> table{
      {"vkGetDeviceProcAddr", erase_type(get_device_function)},
      {"vkDestroyDevice", erase_type(destroy_device)},
      {"vkGetCalibratedTimestampsEXT", erase_type(get_calibrated_timestamps)},
      {"vkGetQueryPoolResults", erase_type(get_query_results)},
      {"vkQueueSubmit", erase_type(queue_submit)},
      {"vkWaitForFences", erase_type(wait_for_fences)},
      {"vkAllocateMemory", erase_type(allocate_memory)},
      {"vkCreateQueryPool", erase_type(create_query_pool)},
      {"vkDestroyQueryPool", erase_type(destroy_query_pool)},
      {"vkCmdResetQueryPool", erase_type(reset_query_pool)},
      {"vkCmdBeginQuery", erase_type(begin_query)},
      {"vkCmdEndQuery", erase_type(end_query)},
      {"vkAcquireProfilingLockKHR", erase_type(acquire_profiling_lock)},
      {"vkReleaseProfilingLockKHR", erase_type(release_profiling_lock)},
  };
  return find(table, name);
}

PFN_vkVoidFunction own_instance_function(const char* name) {
  static const std::map<std::string_view, PFN_vkVoidFunction> table{
      {"vkGetInstanceProcAddr", erase_type(get_instance_function)},
      {"vkCreateInstance", erase_type(create_instance)},
      {"vkDestroyInstance", erase_type(destroy_instance)},
      {"vkCreateDevice", erase_type(create_device)},
      {"vkGetPhysicalDeviceProperties", erase_type(get_properties)},
      {"vkGetPhysicalDeviceProperties2", erase_type(get_properties2)},
      {"vkGetPhysicalDeviceProperties2KHR", erase_type(get_properties2)},
      {"vkGetPhysicalDeviceQueueFamilyProperties", erase_type(get_queue_families)},
      {"vkEnumerateDeviceExtensionProperties", erase_type(enumerate_extensions)},
      {"vkGetPhysicalDeviceCalibrateableTimeDomainsEXT", erase_type(get_time_domains)},
      {"vkGetPhysicalDeviceFeatures2", erase_type(get_features2)},
      {"vkGetPhysicalDeviceFeatures2KHR", erase_type(get_features2)},
      {"vkEnumeratePhysicalDeviceQueueFamilyPerformanceQueryCountersKHR",
       erase_type(enumerate_counters)},
      {"vkGetPhysicalDeviceQueueFamilyPerformanceQueryPassesKHR", erase_type(get_counter_passes)},
  };
  return find(table, name);
}

PFN_vkVoidFunction VKAPI_CALL get_device_function(VkDevice device, const char* name) {
  if (const PFN_vkVoidFunction own = own_device_function(name)) return own;
  const std::lock_guard lock(mutex);
  return device_of(device).get(device, name);
}

PFN_vkVoidFunction VKAPI_CALL get_instance_function(VkInstance instance, const char* name) {
  if (const PFN_vkVoidFunction own = own_instance_function(name)) return own;
  if (const PFN_vkVoidFunction own = own_device_function(name)) return own;
  const std::lock_guard lock(mutex);
  return instance == nullptr ? nullptr : instance_of(instance).get(instance, name);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) VkResult VKAPI_CALL
vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface* negotiation) {
  negotiation->loaderLayerInterfaceVersion = 2;
  negotiation->pfnGetInstanceProcAddr = get_instance_function;
  negotiation->pfnGetDeviceProcAddr = get_device_function;
  negotiation->pfnGetPhysicalDeviceProcAddr = nullptr;
  return VK_SUCCESS;
}
