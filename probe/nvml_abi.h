/// The part of NVML's binary interface that is used here, declared anew so that no build needs
/// NVIDIA's header. Facts: nvml.h as published with NVIDIA/go-nvml,
/// docs.nvidia.com/deploy/nvml-api.
#pragma once

#include <cstdint>

namespace energyprof::probe::nvml {

using Device = void*;

/// nvmlReturn_t.
enum Result : int {
  success = 0,
  not_supported = 3,
  no_permission = 4,
  driver_not_loaded = 9,
  timed_out = 10,
  gpu_lost = 15,
  operating_system = 17,
  version_mismatch = 18,
  in_use = 19,
};

/// nvmlClockType_t.
enum ClockType : int { graphics_clock = 0, sm_clock = 1, memory_clock = 2, video_clock = 3 };
/// nvmlTemperatureSensors_t has this one only.
inline constexpr int gpu_temperature = 0;
/// nvmlTemperatureThresholds_t.
enum TemperatureThreshold : int { slowdown_threshold = 1, memory_max_threshold = 2 };
/// nvmlPstates_t: 0 (fastest) to 15.
inline constexpr int unknown_performance_state = 32;

/// nvmlClocksEventReasons: why the clocks are what they are.
enum ClockReason : uint64_t {
  gpu_idle = 0x1,
  application_clocks = 0x2,
  sw_power_cap = 0x4,
  hw_slowdown = 0x8,
  sync_boost = 0x10,
  sw_thermal = 0x20,
  hw_thermal = 0x40,
  hw_power_brake = 0x80,
  display_clock = 0x100,
};

/// NVML_FI_DEV_*.
enum FieldId : uint32_t {
  field_violation_power = 74,  // 74 to 79: ns spent below the wanted clock, by policy
  field_violation_thermal = 75,
  field_violation_sync_boost = 76,
  field_violation_board_limit = 77,
  field_violation_low_utilization = 78,
  field_violation_reliability = 79,
  field_memory_temperature = 82,    // C
  field_total_energy = 83,          // mJ
  field_power_average = 185,        // mW
  field_power_instant = 186,        // mW
  field_energy = 191,               // mJ
  field_time_sw_thermal = 269,      // ns
  field_time_hw_thermal = 270,      // ns
  field_time_hw_power_brake = 271,  // ns
};

/// nvmlValueType_t.
enum ValueType : uint32_t {
  type_double = 0,
  type_u32 = 1,
  type_ulong = 2,
  type_u64 = 3,
  type_i64 = 4,
  type_i32 = 5,
  type_u16 = 6,
};

/// nvmlFieldValue_t.
struct FieldValue {
  uint32_t field_id = 0;
  uint32_t scope_id = 0;
  int64_t timestamp_us = 0;
  int64_t latency_us = 0;
  uint32_t value_type = 0;
  int32_t result = 0;
  union {
    double as_double;
    uint64_t as_u64 = 0;
    int64_t as_i64;
    uint32_t as_u32;
    int32_t as_i32;
    uint16_t as_u16;
  };
};
static_assert(sizeof(FieldValue) == 40);

/// nvmlUtilization_t, in percent.
struct Utilization {
  uint32_t gpu = 0;
  uint32_t memory = 0;
};

/// nvmlViolationTime_t.
struct ViolationTime {
  uint64_t reference_us = 0;
  uint64_t violation_ns = 0;
};

/// nvmlTemperature_v1_t.
struct TemperatureV1 {
  uint32_t version = uint32_t{12} | (uint32_t{1} << 24U);  // size and version
  int32_t sensor = gpu_temperature;
  int32_t celsius = 0;
};
static_assert(sizeof(TemperatureV1) == 12);

/// nvmlPciInfo_t as of nvmlDeviceGetPciInfo_v3.
struct PciInfo {
  char legacy_bus_id[16]{};
  uint32_t domain = 0;
  uint32_t bus = 0;
  uint32_t device = 0;
  uint32_t device_id = 0;
  uint32_t subsystem_id = 0;
  char bus_id[32]{};
};
static_assert(sizeof(PciInfo) == 68);

}  // namespace energyprof::probe::nvml
