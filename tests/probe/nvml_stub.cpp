// A management library for tests: two GPUs with known answers, which fail on demand. Compiled a
// second time with NVML_STUB_OLD it lacks what old drivers lack. Signatures: NVML API reference.
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstring>

namespace {

// Set through nvml_stub_set().
std::atomic<int> result_of_all{0};      // what every query returns
std::atomic<int> calls_until_lost{-1};  // then every query returns "GPU is lost"
std::atomic<int> call_us{0};            // how long every query takes
std::atomic<int> init_result{0};
std::atomic<unsigned long long> reasons{0x1};
std::atomic<int> open_count{0};
std::atomic<long long> energy_mj{1'000'000};

int devices[2] = {0, 1};

int index_of(void* device) { return *static_cast<int*>(device); }

int answer() {
  if (const int us = call_us) usleep(static_cast<useconds_t>(us));
  if (calls_until_lost >= 0 && calls_until_lost.fetch_sub(1) <= 0) {
    calls_until_lost = 0;
    return 15;
  }
  return result_of_all;
}

struct PciInfo {
  char legacy[16];
  uint32_t domain, bus, device, id, subsystem;
  char bus_id[32];
};
struct FieldValue {
  uint32_t id, scope;
  int64_t timestamp, latency;
  uint32_t type;
  int result;
  uint64_t value;
};

}  // namespace

extern "C" {

void nvml_stub_set(const char* what, long long value) {
  if (std::strcmp(what, "result") == 0) result_of_all = static_cast<int>(value);
  if (std::strcmp(what, "calls_until_lost") == 0) calls_until_lost = static_cast<int>(value);
  if (std::strcmp(what, "call_us") == 0) call_us = static_cast<int>(value);
  if (std::strcmp(what, "init") == 0) init_result = static_cast<int>(value);
  if (std::strcmp(what, "reasons") == 0) reasons = static_cast<unsigned long long>(value);
  if (std::strcmp(what, "energy_mj") == 0) energy_mj = value;
}
int nvml_stub_open_count() { return open_count; }

int nvmlInit_v2() {
  if (init_result == 0) ++open_count;
  return init_result;
}
int nvmlShutdown() {
  --open_count;
  return 0;
}
const char* nvmlErrorString(int result) { return result == 15 ? "GPU is lost" : "Stub error"; }
int nvmlDeviceGetCount_v2(unsigned* count) {
  *count = 2;
  return 0;
}
int nvmlDeviceGetHandleByIndex_v2(unsigned index, void** device) {
  *device = &devices[index];
  return 0;
}
int nvmlDeviceGetPciInfo_v3(void* device, PciInfo* info) {
  info->domain = 0;
  info->bus = static_cast<uint32_t>(1 + 0x2c * index_of(device));
  info->device = 0;
  return 0;
}
int nvmlDeviceGetPowerUsage(void*, unsigned* mw) {
  *mw = 33'000;
  return answer();
}
int nvmlDeviceGetEnforcedPowerLimit(void*, unsigned* mw) {
  *mw = 450'000;
  return answer();
}
int nvmlDeviceGetClockInfo(void*, int type, unsigned* mhz) {
  *mhz = type == 2 ? 10'501 : 1'980;
  return answer();
}
int nvmlDeviceGetMaxClockInfo(void*, int type, unsigned* mhz) {
  *mhz = type == 2 ? 10'501 : 2'520;
  return 0;
}
int nvmlDeviceGetTemperatureThreshold(void*, int, unsigned* celsius) {
  *celsius = 93;
  return 0;
}
int nvmlDeviceGetUtilizationRates(void*, unsigned rates[2]) {
  rates[0] = 97;
  rates[1] = 41;
  return answer();
}
int nvmlDeviceGetTemperature(void*, int, unsigned* celsius) {
  *celsius = 61;
  return answer();
}

#ifdef NVML_STUB_OLD
int nvmlDeviceGetCurrentClocksThrottleReasons(void*, unsigned long long* bits) {
  *bits = reasons;
  return answer();
}
#else
int nvmlDeviceGetCurrentClocksEventReasons(void*, unsigned long long* bits) {
  *bits = reasons;
  return answer();
}
int nvmlDeviceGetTotalEnergyConsumption(void* device, unsigned long long* mj) {
  *mj = static_cast<unsigned long long>(energy_mj + index_of(device));
  return answer();
}
int nvmlDeviceGetFieldValues(void*, int count, FieldValue* fields) {
  for (int i = 0; i < count; ++i) {
    fields[i].result = fields[i].id == 82 ? 3 : 0;  // no memory temperature
    fields[i].type = fields[i].id == 186 ? 1 : 3;
    fields[i].value = fields[i].id == 186 ? 42'000 : 5'000'000'000;
  }
  return answer();
}
#endif
}
