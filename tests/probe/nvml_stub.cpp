// A library that looks like NVML. Variants lack some of its functions, as other drivers do:
//
//   NVML_STUB_OLD     a driver of 2016: no fields, no energy, the older names for the reasons
//   NVML_STUB_NEW     a driver to come: without what NVML 13 calls deprecated
//   NVML_STUB_BARE    nothing that reads a sensor, and no words for errors
#include "nvml_stub.h"

#include <chrono>
#include <cstdio>
#include <cstring>
#include <thread>

#include "probe/nvml_abi.h"

namespace {

using namespace energyprof::probe;

NvmlStub stub;

// Handles are the addresses of these.
char gpus[8];
unsigned number_of(const void* device) {
  return static_cast<unsigned>(static_cast<const char*>(device) - gpus);
}

// What happens in every reading.
int reading() {
  ++stub.reading_count;
  if (stub.delay_ms > 0) std::this_thread::sleep_for(std::chrono::milliseconds(stub.delay_ms));
  if (stub.calls_until_lost == 0) return nvml::gpu_lost;
  if (stub.calls_until_lost > 0) --stub.calls_until_lost;
  return stub.is_jetson ? int{nvml::not_supported} : int{nvml::success};
}

template <typename T, typename Value>
int give(T* out, Value value, int result = nvml::success) {
  if (const int failure = reading(); failure != nvml::success) return failure;
  if (result == nvml::success) *out = static_cast<T>(value);
  return result;
}

}  // namespace

#define STUB_EXPORT extern "C" __attribute__((visibility("default")))

STUB_EXPORT NvmlStub* nvml_stub();
STUB_EXPORT NvmlStub* nvml_stub() { return &stub; }

#define STUB(name, ...)              \
  STUB_EXPORT int name(__VA_ARGS__); \
  STUB_EXPORT int name(__VA_ARGS__)

STUB(nvmlInit_v2) {
  ++stub.init_count;
  return stub.init_result;
}
STUB(nvmlShutdown) {
  ++stub.shutdown_count;
  return nvml::success;
}
STUB(nvmlDeviceGetCount_v2, uint32_t* count) {
  *count = stub.gpu_count;
  return stub.count_result;
}
STUB(nvmlDeviceGetHandleByIndex_v2, uint32_t index, void** device) {
  if (index == 1 && stub.handle_result != nvml::success) return stub.handle_result;
  *device = gpus + index;
  return nvml::success;
}
STUB(nvmlDeviceGetName, void* device, char* name, uint32_t length) {
  std::snprintf(name, length, "Stub %u", number_of(device));
  return nvml::success;
}

#ifndef NVML_STUB_BARE

STUB_EXPORT const char* nvmlErrorString(int result);
STUB_EXPORT const char* nvmlErrorString(int result) {
  switch (result) {
    case nvml::not_supported:
      return "Not Supported";
    case nvml::no_permission:
      return "Insufficient Permissions";
    case nvml::driver_not_loaded:
      return "Driver Not Loaded";
    case nvml::gpu_lost:
      return "GPU is lost";
    default:
      return "Unknown Error";
  }
}
STUB(nvmlDeviceGetUUID, void* device, char* uuid, uint32_t length) {
  std::snprintf(uuid, length, "GPU-8F1B0000-0000-0000-0000-00000000000%u", number_of(device));
  return nvml::success;
}
STUB(nvmlDeviceGetPciInfo_v3, void* device, nvml::PciInfo* info) {
  if (stub.is_jetson) return nvml::not_supported;
  info->domain = stub.pci_domain;
  info->bus = number_of(device) == 0 ? 0x01 : 0x2D;
  info->device = 0;
  std::snprintf(info->bus_id, sizeof info->bus_id, "%08X:%02X:00.0", info->domain, info->bus);
  return nvml::success;
}
STUB(nvmlDeviceGetPowerUsage, void*, uint32_t* power_mw) { return give(power_mw, 45'000); }
STUB(nvmlDeviceGetEnforcedPowerLimit, void*, uint32_t* power_mw) { return give(power_mw, 115'000); }
STUB(nvmlDeviceGetClockInfo, void*, int type, uint32_t* clock_mhz) {
  return give(clock_mhz, 1000 + type);
}
STUB(nvmlDeviceGetMaxClockInfo, void*, int type, uint32_t* clock_mhz) {
  return give(clock_mhz, 2000 + type);
}
STUB(nvmlDeviceGetTemperatureThreshold, void*, int type, uint32_t* celsius) {
  return give(celsius, type == nvml::slowdown_threshold ? 97 : 105);
}
STUB(nvmlDeviceGetUtilizationRates, void*, nvml::Utilization* utilization) {
  return give(utilization, nvml::Utilization{83, 41});
}
STUB(nvmlDeviceGetPerformanceState, void*, int* state) {
  return give(state, stub.performance_state.load());
}

#ifndef NVML_STUB_NEW
STUB(nvmlDeviceGetTemperature, void*, int, uint32_t* celsius) { return give(celsius, 61); }
STUB(nvmlDeviceGetViolationStatus, void*, int policy, nvml::ViolationTime* time) {
  return give(time, nvml::ViolationTime{1, 900u + static_cast<unsigned>(policy)},
              stub.violation_result);
}
#endif

#ifdef NVML_STUB_OLD

STUB(nvmlDeviceGetCurrentClocksThrottleReasons, void*, unsigned long long* reasons) {
  return give(reasons, stub.reasons.load());
}

#else

STUB(nvmlDeviceGetCurrentClocksEventReasons, void*, unsigned long long* reasons) {
  return give(reasons, stub.reasons.load());
}
STUB(nvmlDeviceGetSupportedClocksEventReasons, void*, unsigned long long* reasons) {
  return give(reasons, stub.supported_reasons.load());
}
STUB(nvmlDeviceGetTemperatureV, void*, nvml::TemperatureV1* temperature) {
  if (temperature->version != 0x0100000c) return 25;  // NVML_ERROR_ARGUMENT_VERSION_MISMATCH
  return give(&temperature->celsius, 62);
}
#ifndef NVML_STUB_NEW
STUB(nvmlDeviceGetTotalEnergyConsumption, void* device, unsigned long long* energy_mj) {
  return give(energy_mj, stub.energy_mj + 7 * number_of(device), stub.energy_result);
}
#endif
STUB(nvmlDeviceGetFieldValues, void* device, int count, nvml::FieldValue* fields) {
  if (const int failure = reading(); failure != nvml::success) return failure;
  for (int i = 0; i < count; ++i) {
    nvml::FieldValue& field = fields[i];
    field.result = stub.field_result;
    switch (field.field_id) {
      case nvml::field_total_energy:
        field.value_type = nvml::type_u64;
        field.as_u64 = stub.energy_mj + 7 * number_of(device);
        break;
      case nvml::field_power_instant:
        field.value_type = nvml::type_u32;
        field.as_u32 = 51'000;
        break;
      case nvml::field_memory_temperature:
        field.value_type = nvml::type_u32;
        field.as_u32 = stub.memory_celsius;
        break;
      case nvml::field_violation_power:
        field.value_type = nvml::type_ulong;
        field.as_u64 = 5'000'000'000;
        break;
      case nvml::field_violation_thermal:
        field.value_type = nvml::type_i64;
        field.as_i64 = 7'000'000'000;
        break;
      case nvml::field_time_sw_thermal:
        field.value_type = nvml::type_double;
        field.as_double = 2.5e9;
        break;
      case nvml::field_time_hw_thermal:
        field.value_type = nvml::type_i32;
        field.as_i32 = 12;
        break;
      case nvml::field_time_hw_power_brake:
        field.value_type = 17;  // a type to come
        break;
      default:
        field.result = nvml::not_supported;
    }
  }
  return nvml::success;
}

#endif  // NVML_STUB_OLD
#endif  // NVML_STUB_BARE
