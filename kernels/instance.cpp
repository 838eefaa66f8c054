// Creates the instance and asks every device what it is.
#include "kernels/instance.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <span>
#include <stdexcept>

#include "kernels/performance_counters.h"
#include "kernels/pipeline.h"

namespace energyprof::kernels {
namespace {

constexpr const char* validation_layer = "VK_LAYER_KHRONOS_validation";
constexpr const char* no_driver_advice =
    "Install a driver (mesa-vulkan-drivers has one that runs on the CPU), and unset "
    "VK_DRIVER_FILES "
    "and VK_ICD_FILENAMES if they name a file that does not exist.";

/// Runs one of Vulkan's "how many, then give me them" functions.
template <typename T, typename Enumerate>
std::vector<T> enumerate(std::string_view what, Enumerate&& enumerate_into) {
  std::vector<T> items;
  VkResult result = VK_INCOMPLETE;
  while (result == VK_INCOMPLETE) {
    uint32_t count = 0;
    check(enumerate_into(&count, static_cast<T*>(nullptr)), what);
    items.resize(count);
    result = enumerate_into(&count, items.data());
    items.resize(count);
  }
  check(result, what);
  return items;
}

void require_validation_layer(const LoaderApi& loader) {
  const auto layers = enumerate<VkLayerProperties>(
      "list the Vulkan layers", [&](uint32_t* count, VkLayerProperties* out) {
        return loader.enumerate_instance_layer_properties(count, out);
      });
  const bool found = std::any_of(layers.begin(), layers.end(), [](const VkLayerProperties& layer) {
    return std::string_view(layer.layerName) == validation_layer;
  });
  if (!found) {
    throw std::runtime_error(
        fmt::format("cannot validate Vulkan calls: layer '{}' is not installed. Install "
                    "vulkan-validationlayers, or run without validation.",
                    validation_layer));
  }
}

VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT,
                                          VkDebugUtilsMessageTypeFlagsEXT,
                                          const VkDebugUtilsMessengerCallbackDataEXT* data,
                                          void* log) {
  static_cast<MessageLog*>(log)->add(data->pMessage);
  return VK_FALSE;
}

VkDebugUtilsMessengerCreateInfoEXT messenger_info(MessageLog& log) {
  VkDebugUtilsMessengerCreateInfoEXT info{};
  info.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT;
  info.messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT |
                         VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
  info.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT |
                     VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
  info.pfnUserCallback = on_message;
  info.pUserData = &log;
  return info;
}

std::string_view type_name(VkPhysicalDeviceType type) {
  switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU:
      return "integrated";
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU:
      return "discrete";
    case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU:
      return "virtual";
    case VK_PHYSICAL_DEVICE_TYPE_CPU:
      return "cpu";
    default:
      return "other";
  }
}

std::string version_text(uint32_t version) {
  return fmt::format("{}.{}.{}", VK_API_VERSION_MAJOR(version), VK_API_VERSION_MINOR(version),
                     VK_API_VERSION_PATCH(version));
}

std::string uuid_text(std::span<const uint8_t> bytes) {
  std::string text;
  for (size_t i = 0; i < bytes.size(); ++i) {
    if (i == 4 || i == 6 || i == 8 || i == 10) text += '-';
    text += fmt::format("{:02x}", bytes[i]);
  }
  return text;
}

/// What one physical device has, as far as it goes without opening it.
class Inspector {
 public:
  Inspector(const InstanceApi& api, VkPhysicalDevice device) : api_(api), device_(device) {}

  /// Fills both; the candidate says why the device is unusable, if it is.
  void inspect(PhysicalDevice& physical, Candidate& candidate) {
    physical.handle = device_;
    api_.get_physical_device_properties(device_, &basic_);
    DeviceInfo& info = candidate.info;
    info.name = basic_.deviceName;
    info.type = type_name(basic_.deviceType);
    info.api_version = version_text(basic_.apiVersion);
    if (basic_.apiVersion < VK_API_VERSION_1_1) {
      candidate.unusable = fmt::format("Vulkan {}, 1.1 is needed", info.api_version);
      return;
    }
    extensions_ = enumerate<VkExtensionProperties>(
        "list the extensions of a Vulkan device", [&](uint32_t* count, VkExtensionProperties* out) {
          return api_.enumerate_device_extension_properties(device_, nullptr, count, out);
        });
    fill_identity(info);
    fill_limits(info);
    candidate.unusable = choose_queue(physical, info);
    if (candidate.unusable.empty()) candidate.unusable = missing_limit();
    if (candidate.unusable.empty()) choose_clock(physical, info);
    if (candidate.unusable.empty()) info.no_counters_reason = find_counters(physical, info);
  }

 private:
  [[nodiscard]] bool has(std::string_view extension) const {
    return std::any_of(extensions_.begin(), extensions_.end(), [&](const auto& item) {
      return std::string_view(item.extensionName) == extension;
    });
  }

  void fill_identity(DeviceInfo& info) {
    VkPhysicalDeviceProperties2 all{};
    all.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
    const auto chain = [&](auto& properties, VkStructureType type) {
      properties.sType = type;
      properties.pNext = all.pNext;
      all.pNext = &properties;
    };
    VkPhysicalDeviceIDProperties id{};
    chain(id, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES);
    VkPhysicalDeviceSubgroupProperties subgroup{};
    chain(subgroup, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES);
    VkPhysicalDeviceDriverProperties driver{};
    const bool has_driver = has(VK_KHR_DRIVER_PROPERTIES_EXTENSION_NAME);
    if (has_driver) chain(driver, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES);
    VkPhysicalDevicePCIBusInfoPropertiesEXT pci{};
    const bool has_pci = has(VK_EXT_PCI_BUS_INFO_EXTENSION_NAME);
    if (has_pci) chain(pci, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PCI_BUS_INFO_PROPERTIES_EXT);
    VkPhysicalDeviceDrmPropertiesEXT drm{};
    const bool has_drm = has(VK_EXT_PHYSICAL_DEVICE_DRM_EXTENSION_NAME);
    if (has_drm) chain(drm, VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRM_PROPERTIES_EXT);
    api_.get_physical_device_properties2(device_, &all);

    info.vendor_id = basic_.vendorID;
    info.device_id = basic_.deviceID;
    info.uuid = uuid_text(id.deviceUUID);
    info.subgroup_size = subgroup.subgroupSize;
    info.driver_name = has_driver ? driver.driverName : "";
    info.driver_info = has_driver ? driver.driverInfo : fmt::format("{:#x}", basic_.driverVersion);
    if (has_pci) {
      info.pci_address = fmt::format("{:04x}:{:02x}:{:02x}.{:x}", pci.pciDomain, pci.pciBus,
                                     pci.pciDevice, pci.pciFunction);
    }
    if (has_drm && drm.hasPrimary) info.drm_primary = DrmNode{drm.primaryMajor, drm.primaryMinor};
    if (has_drm && drm.hasRender) info.drm_render = DrmNode{drm.renderMajor, drm.renderMinor};
  }

  void fill_limits(DeviceInfo& info) const {
    const VkPhysicalDeviceLimits& limits = basic_.limits;
    info.max_storage_buffer_bytes = limits.maxStorageBufferRange;
    info.max_workgroup_invocations = limits.maxComputeWorkGroupInvocations;
    info.max_workgroup_size_x = limits.maxComputeWorkGroupSize[0];
    info.max_workgroup_size_y = limits.maxComputeWorkGroupSize[1];
    info.max_workgroup_count_x = limits.maxComputeWorkGroupCount[0];
    info.max_workgroup_count_y = limits.maxComputeWorkGroupCount[1];
    info.timestamp_period_ns = static_cast<double>(limits.timestampPeriod);
  }

  /// Takes the first queue family that computes and has timestamps; else returns what is missing.
  std::string choose_queue(PhysicalDevice& physical, DeviceInfo& info) const {
    uint32_t count = 0;
    api_.get_physical_device_queue_family_properties(device_, &count, nullptr);
    std::vector<VkQueueFamilyProperties> families(count);
    api_.get_physical_device_queue_family_properties(device_, &count, families.data());
    bool computes = false;
    for (uint32_t i = 0; i < count; ++i) {
      if ((families[i].queueFlags & VK_QUEUE_COMPUTE_BIT) == 0) continue;
      computes = true;
      if (families[i].timestampValidBits == 0) continue;
      physical.queue_family = i;
      info.timestamp_valid_bits = families[i].timestampValidBits;
      return {};
    }
    return computes ? "timestampValidBits is 0 on its compute queue" : "it has no compute queue";
  }

  [[nodiscard]] std::string missing_limit() const {
    const uint32_t buffers = basic_.limits.maxPerStageDescriptorStorageBuffers;
    if (buffers >= binding_count) return {};
    return fmt::format("maxPerStageDescriptorStorageBuffers is {}, {} are needed", buffers,
                       binding_count);
  }

  void choose_clock(PhysicalDevice& physical, DeviceInfo& info) const {
    constexpr std::string_view fallback =
        "each frame is placed midway between its submission and the end of waiting for it, with "
        "half "
        "of the slack as error";
    for (const char* name :
         {"VK_KHR_calibrated_timestamps", VK_EXT_CALIBRATED_TIMESTAMPS_EXTENSION_NAME}) {
      if (!has(name) || api_.get_calibrateable_time_domains == nullptr) continue;
      const auto domains = enumerate<VkTimeDomainEXT>(
          "list the clocks of a Vulkan device", [&](uint32_t* count, VkTimeDomainEXT* out) {
            return api_.get_calibrateable_time_domains(device_, count, out);
          });
      const auto offers = [&](VkTimeDomainEXT domain) {
        return std::find(domains.begin(), domains.end(), domain) != domains.end();
      };
      if (!offers(VK_TIME_DOMAIN_DEVICE_EXT) || !offers(VK_TIME_DOMAIN_CLOCK_MONOTONIC_EXT)) {
        info.clock_note = fmt::format("{} does not offer CLOCK_MONOTONIC: {}", name, fallback);
        return;
      }
      physical.calibration_extension = name;
      info.calibrated_timestamps = true;
      info.clock_note = fmt::format(
          "{}: GPU ticks are read together with CLOCK_MONOTONIC before each frame, with the "
          "driver's "
          "bound as error",
          name);
      return;
    }
    info.clock_note =
        fmt::format("{} is missing: {}", VK_EXT_CALIBRATED_TIMESTAMPS_EXTENSION_NAME, fallback);
  }

  /// Fills in the performance counters; else returns why there are none.
  std::string find_counters(PhysicalDevice& physical, DeviceInfo& info) const {
    if (!has(VK_KHR_PERFORMANCE_QUERY_EXTENSION_NAME) ||
        api_.enumerate_performance_counters == nullptr ||
        api_.get_performance_query_passes == nullptr) {
      return fmt::format("the driver offers no {}", VK_KHR_PERFORMANCE_QUERY_EXTENSION_NAME);
    }
    VkPhysicalDevicePerformanceQueryFeaturesKHR queries{};
    queries.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PERFORMANCE_QUERY_FEATURES_KHR;
    VkPhysicalDeviceFeatures2 features{};
    features.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
    features.pNext = &queries;
    api_.get_physical_device_features2(device_, &features);
    if (queries.performanceCounterQueryPools == VK_FALSE) {
      return "the driver does not allow performanceCounterQueryPools";
    }
    std::vector<VkPerformanceCounterDescriptionKHR> texts;
    const auto counters = enumerate<VkPerformanceCounterKHR>(
        "list the performance counters of a Vulkan device",
        [&](uint32_t* count, VkPerformanceCounterKHR* out) {
          VkPerformanceCounterKHR empty{};
          empty.sType = VK_STRUCTURE_TYPE_PERFORMANCE_COUNTER_KHR;
          VkPerformanceCounterDescriptionKHR empty_text{};
          empty_text.sType = VK_STRUCTURE_TYPE_PERFORMANCE_COUNTER_DESCRIPTION_KHR;
          if (out != nullptr) std::fill_n(out, *count, empty);
          texts.assign(out == nullptr ? 0 : *count, empty_text);
          return api_.enumerate_performance_counters(device_, physical.queue_family, count, out,
                                                     out == nullptr ? nullptr : texts.data());
        });
    if (counters.empty()) return "the driver has no performance counters for compute";
    for (size_t i = 0; i < counters.size(); ++i) {
      info.performance_counters.push_back(describe_counter(counters[i], texts[i]));
    }
    const PassCount pass_count = [&](std::span<const uint32_t> indices) {
      VkQueryPoolPerformanceCreateInfoKHR query{};
      query.sType = VK_STRUCTURE_TYPE_QUERY_POOL_PERFORMANCE_CREATE_INFO_KHR;
      query.queueFamilyIndex = physical.queue_family;
      query.counterIndexCount = static_cast<uint32_t>(indices.size());
      query.pCounterIndices = indices.data();
      uint32_t passes = 0;
      api_.get_performance_query_passes(device_, &query, &passes);
      return passes;
    };
    physical.counter_indices = choose_counters(info.performance_counters, pass_count);
    for (const uint32_t i : physical.counter_indices) {
      info.performance_counters[i].is_chosen = true;
      physical.counters.push_back(counters[i]);
    }
    if (!physical.counter_indices.empty()) {
      physical.counter_pass_count = pass_count(physical.counter_indices);
    }
    return {};
  }

  const InstanceApi& api_;
  VkPhysicalDevice device_;
  VkPhysicalDeviceProperties basic_{};
  std::vector<VkExtensionProperties> extensions_;
};

}  // namespace

void MessageLog::add(std::string message) {
  const std::lock_guard lock(mutex_);
  messages_.push_back(std::move(message));
}

std::vector<std::string> MessageLog::messages() const {
  const std::lock_guard lock(mutex_);
  return messages_;
}

Instance::Instance(bool validation, bool gpu_assisted) {
  const LoaderApi loader = load_vulkan();
  if (loader.enumerate_instance_version == nullptr) {
    throw std::runtime_error(
        "cannot use this Vulkan loader: it is of version 1.0, 1.1 is needed. Update libvulkan1.");
  }
  VkApplicationInfo application{};
  application.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO;
  application.pApplicationName = "energyprof";
  application.apiVersion = VK_API_VERSION_1_1;
  VkInstanceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO;
  info.pApplicationInfo = &application;

  constexpr std::array extensions{VK_EXT_DEBUG_UTILS_EXTENSION_NAME,
                                  VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME};
  constexpr std::array checks{VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT,
                              VK_VALIDATION_FEATURE_ENABLE_GPU_ASSISTED_EXT};
  VkValidationFeaturesEXT features{};
  features.sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT;
  features.enabledValidationFeatureCount = gpu_assisted ? 2 : 1;
  features.pEnabledValidationFeatures = checks.data();
  VkDebugUtilsMessengerCreateInfoEXT messenger = messenger_info(*log_);
  if (validation) {
    require_validation_layer(loader);
    info.enabledLayerCount = 1;
    info.ppEnabledLayerNames = &validation_layer;
    info.enabledExtensionCount = static_cast<uint32_t>(extensions.size());
    info.ppEnabledExtensionNames = extensions.data();
    // Chained here too, so that creating and destroying the instance is covered.
    features.pNext = &messenger;
    info.pNext = &features;
  }

  const VkResult result = loader.create_instance(&info, nullptr, &handle_);
  if (result == VK_ERROR_INCOMPATIBLE_DRIVER) {
    handle_ = VK_NULL_HANDLE;
    throw std::runtime_error(fmt::format("cannot use Vulkan: no driver was found ({}). {}",
                                         result_name(result), no_driver_advice));
  }
  check(result, "create a Vulkan instance");
  api_ = load_instance_api(loader, handle_);
  if (validation) {
    messenger.pNext = nullptr;
    check(api_.create_debug_utils_messenger(handle_, &messenger, nullptr, &messenger_),
          "listen to the validation layer");
  }
}

Instance::~Instance() {
  if (handle_ == VK_NULL_HANDLE) return;
  if (messenger_ != VK_NULL_HANDLE) {
    api_.destroy_debug_utils_messenger(handle_, messenger_, nullptr);
  }
  api_.destroy_instance(handle_, nullptr);
}

Instance::Survey Instance::survey() const {
  const auto handles = enumerate<VkPhysicalDevice>(
      "list the Vulkan devices", [&](uint32_t* count, VkPhysicalDevice* out) {
        return api_.enumerate_physical_devices(handle_, count, out);
      });
  if (handles.empty()) {
    throw std::runtime_error(fmt::format(
        "cannot use Vulkan: its drivers found no device on this machine. {}", no_driver_advice));
  }
  Survey survey;
  survey.devices.resize(handles.size());
  survey.candidates.resize(handles.size());
  for (size_t i = 0; i < handles.size(); ++i) {
    Inspector(api_, handles[i]).inspect(survey.devices[i], survey.candidates[i]);
  }
  return survey;
}

}  // namespace energyprof::kernels
