// The library's types are declared here as far as they are used, so that no build needs its header.
#include "probe/nvml.h"

#include <dlfcn.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <functional>
#include <memory>
#include <utility>

#include "core/clock.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr int64_t poll_period_ns = 100 * ns_per_ms;

using Device = void*;

// nvmlReturn_t
constexpr int nvml_success = 0;
constexpr int nvml_not_supported = 3;
constexpr int nvml_no_permission = 4;
constexpr int nvml_gpu_is_lost = 15;

// nvmlClockType_t, nvmlTemperatureSensors_t, nvmlTemperatureThresholds_t
constexpr int clock_graphics = 0;
constexpr int clock_sm = 1;
constexpr int clock_memory = 2;
constexpr int sensor_gpu = 0;
constexpr int threshold_slowdown = 1;

// Ids for nvmlDeviceGetFieldValues
constexpr uint32_t field_violation_power = 74;
constexpr uint32_t field_violation_thermal = 75;
constexpr uint32_t field_memory_temp = 82;
constexpr uint32_t field_power_instant = 186;

struct PciInfo {
  char bus_id_legacy[16];
  uint32_t domain, bus, device, pci_device_id, pci_subsystem_id;
  char bus_id[32];
};
static_assert(sizeof(PciInfo) == 68);

struct Utilization {
  uint32_t gpu, memory;
};

struct Temperature {
  uint32_t version;
  int sensor;
  int temperature;
};

struct FieldValue {
  uint32_t id;
  uint32_t scope;
  int64_t timestamp_us;
  int64_t latency_us;
  uint32_t type;
  int result;
  union {
    double as_double;
    uint32_t as_u32;
    uint64_t as_u64;
    int64_t as_i64;
    int32_t as_i32;
    uint16_t as_u16;
  } value;
};
static_assert(sizeof(FieldValue) == 40);

// The library while it is in use.
class Library {
 public:
  // `problem` says why there is none.
  static std::shared_ptr<Library> load(const std::string& name, std::string& problem) {
    void* const handle = dlopen(name.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (handle == nullptr) {
      problem = fmt::format("'{}' cannot be loaded: no NVIDIA driver here", name);
      return nullptr;
    }
    auto library = std::shared_ptr<Library>(new Library(handle));
    const auto init = library->symbol<int()>("nvmlInit_v2");
    const int result = init == nullptr ? nvml_not_supported : init();
    if (result != nvml_success) {
      problem = fmt::format("'{}' does not start: {}", name, library->error_text(result));
      return nullptr;
    }
    library->started_ = true;
    return library;
  }
  ~Library() {
    if (started_)
      if (const auto shutdown = symbol<int()>("nvmlShutdown")) shutdown();
    dlclose(handle_);
  }
  Library(const Library&) = delete;
  Library& operator=(const Library&) = delete;

  // nullptr where this version of the driver has no such function.
  template <class Signature>
  [[nodiscard]] Signature* symbol(const char* name) const {
    return reinterpret_cast<Signature*>(dlsym(handle_, name));
  }

  [[nodiscard]] std::string error_text(int result) const {
    const auto text = symbol<const char*(int)>("nvmlErrorString");
    return fmt::format("{} (NVML error {})", text == nullptr ? "unknown error" : text(result),
                       result);
  }

 private:
  explicit Library(void* handle) : handle_(handle) {}

  void* handle_;
  bool started_ = false;
};

// One call of the library; it fills one value for each of its channels. Returns nvmlReturn_t.
struct Query {
  std::vector<Channel> channels;
  std::function<int(std::span<int64_t>)> call;
};

Channel make_channel(std::string name, Quantity quantity, Unit unit, Kind kind,
                     std::string origin) {
  Channel channel;
  channel.name = std::move(name);
  channel.quantity = quantity;
  channel.unit = unit;
  channel.kind = kind;
  channel.origin = std::move(origin);
  return channel;
}

struct ReasonBit {
  uint64_t mask;
  std::string_view name;
  bool is_throttle;
};
constexpr std::array reason_bits{ReasonBit{0x4, "throttle.sw_power_cap", true},
                                 ReasonBit{0x8, "throttle.hw_slowdown", true},
                                 ReasonBit{0x20, "throttle.sw_thermal", true},
                                 ReasonBit{0x40, "throttle.hw_thermal", true},
                                 ReasonBit{0x80, "throttle.hw_power_brake", true},
                                 ReasonBit{0x1, "status.idle", false},
                                 ReasonBit{0x2, "status.app_clocks", false},
                                 ReasonBit{0x10, "status.sync_boost", false},
                                 ReasonBit{0x100, "status.display", false},
                                 ReasonBit{~uint64_t{0x1ff}, "status.other", false}};

// Gathers what one GPU answers.
class GpuQueries {
 public:
  GpuQueries(const Library& library, Device device, std::string prefix)
      : library_(library), device_(device), prefix_(std::move(prefix)) {}

  std::vector<Query> gather() {
    add_energy_and_power();
    add_clocks();
    add_temperatures();
    add_reasons();
    add_violations();
    number<uint32_t>("nvmlDeviceGetEnforcedPowerLimit", "power_limit", Quantity::limit,
                     Unit::milliwatt, Kind::gauge);
    add_utilization();
    return std::move(queries_);
  }
  // Why nothing was gathered: the library's last refusal.
  [[nodiscard]] int last_error() const { return last_error_; }

 private:
  // Keeps the query if it works now. Returns whether it does.
  bool keep(Query query) {
    std::array<int64_t, reason_bits.size()> values{};
    const int result = query.call(std::span(values).first(query.channels.size()));
    if (result != nvml_success) {
      last_error_ = result;
      return false;
    }
    queries_.push_back(std::move(query));
    return true;
  }

  Channel channel(std::string_view name, Quantity quantity, Unit unit, Kind kind,
                  std::string origin) const {
    return make_channel(fmt::format("{}.{}", prefix_, name), quantity, unit, kind,
                        std::move(origin));
  }

  // A function that gives one number.
  template <class Number>
  bool number(const char* function, std::string_view name, Quantity quantity, Unit unit,
              Kind kind) {
    const auto get = library_.symbol<int(Device, Number*)>(function);
    if (get == nullptr) return false;
    return keep({{channel(name, quantity, unit, kind, function)},
                 [get, device = device_](std::span<int64_t> out) {
                   Number value{};
                   const int result = get(device, &value);
                   out[0] = static_cast<int64_t>(value);
                   return result;
                 }});
  }

  // A value of nvmlDeviceGetFieldValues.
  bool field(uint32_t id, std::string_view name, Quantity quantity, Unit unit, Kind kind) {
    const auto get = library_.symbol<int(Device, int, FieldValue*)>("nvmlDeviceGetFieldValues");
    if (get == nullptr) return false;
    return keep({{channel(name, quantity, unit, kind,
                          fmt::format("nvmlDeviceGetFieldValues: field {}", id))},
                 [get, id, device = device_](std::span<int64_t> out) {
                   FieldValue field{};
                   field.id = id;
                   const int result = get(device, 1, &field);
                   if (result != nvml_success) return result;
                   out[0] = integer_of(field);
                   return field.result;
                 }});
  }

  static int64_t integer_of(const FieldValue& field) {
    switch (field.type) {
      case 0:
        return static_cast<int64_t>(field.value.as_double);
      case 1:
        return field.value.as_u32;
      case 5:
        return field.value.as_i32;
      case 6:
        return field.value.as_u16;
      default:
        return field.value.as_i64;
    }
  }

  void add_energy_and_power() {
    number<unsigned long long>("nvmlDeviceGetTotalEnergyConsumption", "energy", Quantity::energy,
                               Unit::millijoule, Kind::cumulative);
    if (!field(field_power_instant, "power_instant", Quantity::power, Unit::milliwatt, Kind::gauge))
      number<uint32_t>("nvmlDeviceGetPowerUsage", "power", Quantity::power, Unit::milliwatt,
                       Kind::average);
  }

  void add_clocks() {
    using GetClock = int(Device, int, uint32_t*);
    const auto get = library_.symbol<GetClock>("nvmlDeviceGetClockInfo");
    const auto get_max = library_.symbol<GetClock>("nvmlDeviceGetMaxClockInfo");
    if (get == nullptr) return;
    for (const auto& [type, name] :
         {std::pair{clock_graphics, "graphics_freq"}, std::pair{clock_sm, "sm_freq"},
          std::pair{clock_memory, "mem_freq"}}) {
      Channel clock = channel(name, Quantity::frequency, Unit::megahertz, Kind::gauge,
                              fmt::format("nvmlDeviceGetClockInfo: type {}", type));
      uint32_t highest = 0;
      if (get_max != nullptr && get_max(device_, type, &highest) == nvml_success)
        clock.limit = highest;
      keep({{std::move(clock)}, [get, clock_type = type, device = device_](std::span<int64_t> out) {
              uint32_t mhz = 0;
              const int result = get(device, clock_type, &mhz);
              out[0] = mhz;
              return result;
            }});
    }
  }

  void add_temperatures() {
    Channel temp = channel("temp", Quantity::temperature, Unit::celsius, Kind::gauge,
                           "nvmlDeviceGetTemperature");
    using GetThreshold = int(Device, int, uint32_t*);
    uint32_t slowdown = 0;
    if (const auto get = library_.symbol<GetThreshold>("nvmlDeviceGetTemperatureThreshold"))
      if (get(device_, threshold_slowdown, &slowdown) == nvml_success && slowdown > 0)
        temp.limit = slowdown;
    const auto get = library_.symbol<int(Device, int, uint32_t*)>("nvmlDeviceGetTemperature");
    const auto get_v = library_.symbol<int(Device, Temperature*)>("nvmlDeviceGetTemperatureV");
    const bool kept =
        get != nullptr && keep({{temp}, [get, device = device_](std::span<int64_t> out) {
                                  uint32_t celsius = 0;
                                  const int result = get(device, sensor_gpu, &celsius);
                                  out[0] = celsius;
                                  return result;
                                }});
    if (!kept && get_v != nullptr) {
      temp.origin = "nvmlDeviceGetTemperatureV";
      keep({{std::move(temp)}, [get_v, device = device_](std::span<int64_t> out) {
              Temperature value{sizeof(Temperature) | (1u << 24), sensor_gpu, 0};
              const int result = get_v(device, &value);
              out[0] = value.temperature;
              return result;
            }});
    }
    field(field_memory_temp, "mem_temp", Quantity::temperature, Unit::celsius, Kind::gauge);
  }

  void add_reasons() {
    using GetReasons = int(Device, unsigned long long*);
    const char* function = "nvmlDeviceGetCurrentClocksEventReasons";
    auto get = library_.symbol<GetReasons>(function);
    if (get == nullptr) {
      function = "nvmlDeviceGetCurrentClocksThrottleReasons";  // its name before driver 535
      get = library_.symbol<GetReasons>(function);
    }
    if (get == nullptr) return;
    Query query;
    for (const ReasonBit& bit : reason_bits)
      query.channels.push_back(
          channel(bit.name, bit.is_throttle ? Quantity::throttle : Quantity::utilization,
                  Unit::count, Kind::flag, fmt::format("{}: {:#x}", function, bit.mask)));
    query.call = [get, device = device_](std::span<int64_t> out) {
      unsigned long long reasons = 0;
      const int result = get(device, &reasons);
      for (size_t i = 0; i < out.size(); ++i) out[i] = (reasons & reason_bits[i].mask) != 0 ? 1 : 0;
      return result;
    };
    keep(std::move(query));
  }

  void add_violations() {
    field(field_violation_power, "violation.power", Quantity::throttle, Unit::nanosecond,
          Kind::cumulative);
    field(field_violation_thermal, "violation.thermal", Quantity::throttle, Unit::nanosecond,
          Kind::cumulative);
  }

  void add_utilization() {
    const auto get = library_.symbol<int(Device, Utilization*)>("nvmlDeviceGetUtilizationRates");
    if (get == nullptr) return;
    const char* const origin = "nvmlDeviceGetUtilizationRates";
    keep({{channel("utilization", Quantity::utilization, Unit::percent, Kind::average, origin),
           channel("mem_utilization", Quantity::utilization, Unit::percent, Kind::average, origin)},
          [get, device = device_](std::span<int64_t> out) {
            Utilization rates{};
            const int result = get(device, &rates);
            out[0] = rates.gpu;
            out[1] = rates.memory;
            return result;
          }});
  }

  const Library& library_;
  Device device_;
  std::string prefix_;
  std::vector<Query> queries_;
  int last_error_ = nvml_not_supported;
};

std::vector<Channel> channels_of(const std::vector<Query>& queries) {
  std::vector<Channel> channels;
  for (const Query& query : queries)
    channels.insert(channels.end(), query.channels.begin(), query.channels.end());
  return channels;
}

class NvmlSource final : public SensorSource {
 public:
  NvmlSource(std::shared_ptr<Library> library, std::vector<Query> queries, TextFile runtime_status,
             std::string gpu)
      : SensorSource("nvml", poll_period_ns, channels_of(queries),
                     {.slow = true, .wakes_device = true, .gpu = std::move(gpu)}),
        library_(std::move(library)),
        queries_(std::move(queries)),
        runtime_status_(std::move(runtime_status)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 32> buffer;
    const TextFile::Read status = runtime_status_.read(buffer);
    if (status.text.starts_with("suspended")) {
      for (Reading& reading : out) reading = status.reading(std::nullopt);
      return;
    }
    size_t next = 0;
    for (Query& query : queries_) {
      std::array<int64_t, reason_bits.size()> values;
      const size_t count = query.channels.size();
      const int64_t before_ns = now_ns();
      const int result = query.call(std::span(values).first(count));
      const int64_t width_ns = now_ns() - before_ns;
      for (size_t i = 0; i < count; ++i)
        out[next++] = {status_of_result(result), before_ns + width_ns / 2, values[i], width_ns,
                       errno_of(result)};
    }
  }

 private:
  static PollStatus status_of_result(int result) {
    if (result == nvml_success) return PollStatus::ok;
    return result == nvml_gpu_is_lost ? PollStatus::gone : PollStatus::retry;
  }
  static int errno_of(int result) {
    switch (result) {
      case nvml_success:
        return 0;
      case nvml_gpu_is_lost:
        return ENODEV;
      case nvml_no_permission:
        return EACCES;
      case nvml_not_supported:
        return EOPNOTSUPP;
      default:
        return EIO;
    }
  }

  std::shared_ptr<Library> library_;  // stays loaded as long as any source
  std::vector<Query> queries_;
  TextFile runtime_status_;
};

// "0000:01:00.0": as sysfs and Vulkan write it.
std::string pci_address(const Library& library, Device device) {
  const auto get = library.symbol<int(Device, PciInfo*)>("nvmlDeviceGetPciInfo_v3");
  PciInfo info{};
  if (get == nullptr || get(device, &info) != nvml_success) return {};
  return fmt::format("{:04x}:{:02x}:{:02x}.0", info.domain, info.bus, info.device);
}

void discover_gpu(const Root& root, const std::shared_ptr<Library>& library, Device device,
                  unsigned index, Discovery& discovery) {
  std::string gpu = pci_address(*library, device);
  GpuQueries gathering(*library, device, fmt::format("nvml.gpu{}", index));
  std::vector<Query> queries = gathering.gather();
  if (queries.empty()) {
    discovery.missing.push_back(
        {"nvml",
         fmt::format("GPU {} answers nothing: {}; on Jetson boards hwmon and devfreq do", index,
                     library->error_text(gathering.last_error())),
         ""});
    return;
  }
  TextFile runtime_status(root, fmt::format("sys/bus/pci/devices/{}/power/runtime_status", gpu));
  discovery.sources.push_back(std::make_unique<NvmlSource>(
      library, std::move(queries), std::move(runtime_status), std::move(gpu)));
}

}  // namespace

void discover_nvml(const Root& root, const Selection& selection, Discovery& discovery) {
  std::string problem;
  const std::shared_ptr<Library> library = Library::load(selection.nvml_library, problem);
  if (!library) {
    discovery.missing.push_back({"nvml", std::move(problem), ""});
    return;
  }
  const auto get_count = library->symbol<int(unsigned*)>("nvmlDeviceGetCount_v2");
  const auto get_handle = library->symbol<int(unsigned, Device*)>("nvmlDeviceGetHandleByIndex_v2");
  unsigned count = 0;
  const int result =
      get_count == nullptr || get_handle == nullptr ? nvml_not_supported : get_count(&count);
  if (result != nvml_success || count == 0) {
    discovery.missing.push_back({"nvml",
                                 result == nvml_success
                                     ? "the driver sees no GPU"
                                     : "GPUs cannot be listed: " + library->error_text(result),
                                 ""});
    return;
  }
  for (unsigned index = 0; index < count; ++index) {
    Device device = nullptr;
    if (const int failed = get_handle(index, &device); failed != nvml_success)
      discovery.missing.push_back(
          {"nvml", fmt::format("GPU {}: {}", index, library->error_text(failed)), ""});
    else
      discover_gpu(root, library, device, index, discovery);
  }
}

}  // namespace energyprof::probe
