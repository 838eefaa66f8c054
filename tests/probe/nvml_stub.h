/// How the stub of NVML behaves; the tests get hold of it with dlsym("nvml_stub").
#pragma once

#include <atomic>
#include <cstdint>

namespace energyprof::probe {

struct NvmlStub {
  // What it does:
  std::atomic<int> init_result{0};
  std::atomic<uint32_t> gpu_count{2};
  std::atomic<int> count_result{0};
  std::atomic<int> handle_result{0};      ///< of the second GPU
  std::atomic<bool> is_jetson{false};     ///< starts, and supports nothing
  std::atomic<int> field_result{0};       ///< of every single field
  std::atomic<int> violation_result{0};   ///< of nvmlDeviceGetViolationStatus
  std::atomic<int> energy_result{0};      ///< of nvmlDeviceGetTotalEnergyConsumption
  std::atomic<int> calls_until_lost{-1};  ///< readings of any GPU; then all are lost; -1: never
  std::atomic<int> delay_ms{0};           ///< of each reading
  std::atomic<uint32_t> pci_domain{0};
  std::atomic<uint64_t> energy_mj{1'000'000};  ///< of the first GPU; the second has 7 more
  std::atomic<uint64_t> reasons{0x1};
  std::atomic<uint64_t> supported_reasons{0x1ff};
  std::atomic<uint32_t> memory_celsius{70};
  std::atomic<int> performance_state{2};
  // What was done to it:
  std::atomic<int> init_count{0};
  std::atomic<int> shutdown_count{0};
  std::atomic<int> reading_count{0};
};

}  // namespace energyprof::probe
