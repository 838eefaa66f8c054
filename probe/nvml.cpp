// Expects, beside the library:
//
//   sys/bus/pci/devices/0000:01:00.0/vendor                  0x10de
//   sys/bus/pci/devices/0000:01:00.0/class                   0x030000
//   sys/bus/pci/devices/0000:01:00.0/driver                  link to ../../bus/pci/drivers/nvidia
//   sys/bus/pci/devices/0000:01:00.0/power/control           auto: may be suspended; on: never is
//   sys/bus/pci/devices/0000:01:00.0/power/runtime_status    active, suspended
#include "probe/nvml.h"

#include <dlfcn.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "core/clock.h"
#include "probe/nvml_abi.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr int64_t state_period_ns = 100 * ns_per_ms;
constexpr int64_t limit_period_ns = ns_per_s;

// ---------------------------------------------------------------- the library

// A function of the library; one that it does not have says "not supported".
template <typename... Args>
class Function {
 public:
  Function(void* library, const char* name)
      : pointer_(reinterpret_cast<int (*)(Args...)>(dlsym(library, name))) {}
  Function(void* library, const char* name, const char* older_name) : Function(library, name) {
    if (pointer_ == nullptr) *this = Function(library, older_name);
  }

  [[nodiscard]] bool exists() const { return pointer_ != nullptr; }
  int operator()(Args... args) const {
    return pointer_ == nullptr ? int{nvml::not_supported} : pointer_(args...);
  }

 private:
  int (*pointer_)(Args...);
};

// The library while it is loaded; all sources share one.
struct Library {
  // Takes what dlopen() gave.
  explicit Library(void* handle) : loaded(handle, &dlclose) {}
  ~Library() {
    if (is_up) shutdown();
  }
  Library(const Library&) = delete;
  Library& operator=(const Library&) = delete;

  [[nodiscard]] std::string error_text(int result) const {
    const auto words =
        reinterpret_cast<const char* (*)(int)>(dlsym(loaded.get(), "nvmlErrorString"));
    const char* text = words == nullptr ? nullptr : words(result);
    return fmt::format("{} (NVML error {})", text == nullptr ? "no words for it" : text, result);
  }

  std::unique_ptr<void, int (*)(void*)> loaded;
  bool is_up = false;
  using D = nvml::Device;
  void* const l = loaded.get();
  // clang-format off
  Function<> init{l, "nvmlInit_v2", "nvmlInit"};
  Function<> shutdown{l, "nvmlShutdown"};
  Function<uint32_t*> count{l, "nvmlDeviceGetCount_v2", "nvmlDeviceGetCount"};
  Function<uint32_t, D*> handle_by_index{l, "nvmlDeviceGetHandleByIndex_v2", "nvmlDeviceGetHandleByIndex"};
  Function<D, nvml::PciInfo*> pci_info{l, "nvmlDeviceGetPciInfo_v3"};
  Function<D, char*, uint32_t> name{l, "nvmlDeviceGetName"};
  Function<D, char*, uint32_t> uuid{l, "nvmlDeviceGetUUID"};
  Function<D, unsigned long long*> total_energy{l, "nvmlDeviceGetTotalEnergyConsumption"};
  Function<D, uint32_t*> power_usage{l, "nvmlDeviceGetPowerUsage"};
  Function<D, uint32_t*> enforced_limit{l, "nvmlDeviceGetEnforcedPowerLimit"};
  Function<D, uint32_t*> management_limit{l, "nvmlDeviceGetPowerManagementLimit"};
  Function<D, int, uint32_t*> clock{l, "nvmlDeviceGetClockInfo"};
  Function<D, int, uint32_t*> max_clock{l, "nvmlDeviceGetMaxClockInfo"};
  Function<D, int, uint32_t*> temperature{l, "nvmlDeviceGetTemperature"};
  Function<D, nvml::TemperatureV1*> temperature_v{l, "nvmlDeviceGetTemperatureV"};
  Function<D, int, uint32_t*> temperature_threshold{l, "nvmlDeviceGetTemperatureThreshold"};
  Function<D, unsigned long long*> reasons{l, "nvmlDeviceGetCurrentClocksEventReasons", "nvmlDeviceGetCurrentClocksThrottleReasons"};
  Function<D, unsigned long long*> supported_reasons{l, "nvmlDeviceGetSupportedClocksEventReasons", "nvmlDeviceGetSupportedClocksThrottleReasons"};
  Function<D, nvml::Utilization*> utilization{l, "nvmlDeviceGetUtilizationRates"};
  Function<D, int*> performance_state{l, "nvmlDeviceGetPerformanceState"};
  Function<D, int, nvml::ViolationTime*> violation{l, "nvmlDeviceGetViolationStatus"};
  Function<D, int, nvml::FieldValue*> fields{l, "nvmlDeviceGetFieldValues"};
  // clang-format on
};

// What the errno of a failed call would be.
int errno_of(int result) {
  switch (result) {
    case nvml::success:
      return 0;
    case nvml::gpu_lost:
      return ENODEV;
    case nvml::no_permission:
      return EACCES;
    case nvml::not_supported:
      return EOPNOTSUPP;
    case nvml::timed_out:
      return ETIMEDOUT;
    case nvml::in_use:
      return EBUSY;
    default:
      return EIO;
  }
}

// ---------------------------------------------------------------- what can be asked

enum class Call : uint8_t {
  total_energy,
  power_usage,
  enforced_limit,
  management_limit,
  clock,
  temperature,
  temperature_v,
  reasons,
  utilization,
  memory_utilization,
  performance_state,
  violation,
  field,
};

// One way to one value.
struct Item {
  std::string_view what;  // of several ways to the same, the first that works is taken
  std::string_view suffix;
  Quantity quantity;
  Unit unit;
  Kind kind;
  Call call;
  uint64_t argument;  // clock, policy, field or mask of reasons
  std::string_view origin;
};

// clang-format off
constexpr std::array state_items{
    Item{"energy", "energy", Quantity::energy, Unit::millijoule, Kind::cumulative, Call::total_energy, 0, "nvmlDeviceGetTotalEnergyConsumption"},
    Item{"energy", "energy", Quantity::energy, Unit::millijoule, Kind::cumulative, Call::field, nvml::field_total_energy, "nvmlDeviceGetFieldValues 83"},
    Item{"energy", "energy", Quantity::energy, Unit::millijoule, Kind::cumulative, Call::field, nvml::field_energy, "nvmlDeviceGetFieldValues 191"},
    Item{"power", "power_instant", Quantity::power, Unit::milliwatt, Kind::gauge, Call::field, nvml::field_power_instant, "nvmlDeviceGetFieldValues 186"},
    Item{"power", "power", Quantity::power, Unit::milliwatt, Kind::average, Call::power_usage, 0, "nvmlDeviceGetPowerUsage (from GA102 on the mean of 1 s)"},
    Item{"power", "power", Quantity::power, Unit::milliwatt, Kind::average, Call::field, nvml::field_power_average, "nvmlDeviceGetFieldValues 185"},
    Item{"graphics clock", "graphics_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, Call::clock, nvml::graphics_clock, "nvmlDeviceGetClockInfo"},
    Item{"SM clock", "sm_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, Call::clock, nvml::sm_clock, "nvmlDeviceGetClockInfo"},
    Item{"memory clock", "mem_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, Call::clock, nvml::memory_clock, "nvmlDeviceGetClockInfo"},
    Item{"video clock", "video_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, Call::clock, nvml::video_clock, "nvmlDeviceGetClockInfo"},
    Item{"temperature", "temp", Quantity::temperature, Unit::celsius, Kind::gauge, Call::temperature, 0, "nvmlDeviceGetTemperature"},
    Item{"temperature", "temp", Quantity::temperature, Unit::celsius, Kind::gauge, Call::temperature_v, 0, "nvmlDeviceGetTemperatureV"},
    Item{"memory temperature", "mem_temp", Quantity::temperature, Unit::celsius, Kind::gauge, Call::field, nvml::field_memory_temperature, "nvmlDeviceGetFieldValues 82"},
    Item{"utilization", "utilization", Quantity::utilization, Unit::percent, Kind::average, Call::utilization, 0, "nvmlDeviceGetUtilizationRates"},
    Item{"memory utilization", "mem_utilization", Quantity::utilization, Unit::percent, Kind::average, Call::memory_utilization, 0, "nvmlDeviceGetUtilizationRates"},
    Item{"performance state", "performance_state", Quantity::utilization, Unit::count, Kind::gauge, Call::performance_state, 0, "nvmlDeviceGetPerformanceState"},
    Item{"power violation time", "violation.power", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_violation_power, "nvmlDeviceGetFieldValues 74"},
    Item{"power violation time", "violation.power", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::violation, 0, "nvmlDeviceGetViolationStatus 0"},
    Item{"thermal violation time", "violation.thermal", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_violation_thermal, "nvmlDeviceGetFieldValues 75"},
    Item{"thermal violation time", "violation.thermal", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::violation, 1, "nvmlDeviceGetViolationStatus 1"},
    Item{"board limit violation time", "violation.board_limit", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_violation_board_limit, "nvmlDeviceGetFieldValues 77"},
    Item{"board limit violation time", "violation.board_limit", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::violation, 3, "nvmlDeviceGetViolationStatus 3"},
    Item{"reliability violation time", "violation.reliability", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_violation_reliability, "nvmlDeviceGetFieldValues 79"},
    Item{"reliability violation time", "violation.reliability", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::violation, 5, "nvmlDeviceGetViolationStatus 5"},
    Item{"software thermal slowdown time", "throttled_time.sw_thermal", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_time_sw_thermal, "nvmlDeviceGetFieldValues 269"},
    Item{"hardware thermal slowdown time", "throttled_time.hw_thermal", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_time_hw_thermal, "nvmlDeviceGetFieldValues 270"},
    Item{"power brake time", "throttled_time.hw_power_brake", Quantity::throttle, Unit::nanosecond, Kind::cumulative, Call::field, nvml::field_time_hw_power_brake, "nvmlDeviceGetFieldValues 271"},
};
constexpr std::array limit_items{
    Item{"power limit", "power_limit", Quantity::limit, Unit::milliwatt, Kind::gauge, Call::enforced_limit, 0, "nvmlDeviceGetEnforcedPowerLimit"},
    Item{"power limit", "power_limit", Quantity::limit, Unit::milliwatt, Kind::gauge, Call::management_limit, 0, "nvmlDeviceGetPowerManagementLimit"},
};
// clang-format on

constexpr Item flag(std::string_view suffix, Quantity quantity, uint64_t mask) {
  return {suffix,     suffix,        quantity, Unit::count,
          Kind::flag, Call::reasons, mask,     "nvmlDeviceGetCurrentClocksEventReasons"};
}
// Only the first five mean that the GPU is slower than it wants to be; the others say that nobody
// wants it to be faster. Bits without a name here are kept, and not taken for throttling.
constexpr uint64_t named_reasons = 0x1ff;
constexpr std::array reason_items{
    flag("throttle.sw_power_cap", Quantity::throttle, nvml::sw_power_cap),
    flag("throttle.hw_slowdown", Quantity::throttle, nvml::hw_slowdown),
    flag("throttle.sw_thermal", Quantity::throttle, nvml::sw_thermal),
    flag("throttle.hw_thermal", Quantity::throttle, nvml::hw_thermal),
    flag("throttle.hw_power_brake", Quantity::throttle, nvml::hw_power_brake),
    flag("status.idle", Quantity::utilization, nvml::gpu_idle),
    flag("status.app_clocks", Quantity::utilization, nvml::application_clocks),
    flag("status.sync_boost", Quantity::utilization, nvml::sync_boost),
    flag("status.display", Quantity::utilization, nvml::display_clock),
    flag("status.other", Quantity::utilization, ~named_reasons),
};

std::optional<int64_t> to_int(uint64_t value) {
  if (value > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) return std::nullopt;
  return static_cast<int64_t>(value);
}

std::optional<int64_t> to_int(const nvml::FieldValue& field) {
  switch (field.value_type) {
    case nvml::type_double:
      if (!(std::abs(field.as_double) < 9e18)) return std::nullopt;
      return static_cast<int64_t>(std::llround(field.as_double));
    case nvml::type_u32:
      return field.as_u32;
    case nvml::type_ulong:
    case nvml::type_u64:
      return to_int(field.as_u64);
    case nvml::type_i64:
      return field.as_i64;
    case nvml::type_i32:
      return field.as_i32;
    case nvml::type_u16:
      return field.as_u16;
    default:
      return std::nullopt;
  }
}

// ---------------------------------------------------------------- asking one GPU

// A call's result and its time.
struct Asked {
  int result = nvml::not_supported;
  int64_t t_ns = 0;
  int64_t width_ns = 0;
};

template <typename Do>
Asked ask(Do&& call) {
  const int64_t before_ns = now_ns();
  const int result = call();
  const int64_t width_ns = now_ns() - before_ns;
  return {result, before_ns + width_ns / 2, width_ns};
}

struct Answer {
  Asked asked;
  std::optional<int64_t> value;

  [[nodiscard]] bool is_value() const { return asked.result == nvml::success && value.has_value(); }
  [[nodiscard]] Reading reading() const {
    PollStatus status = is_value() ? PollStatus::ok : PollStatus::retry;
    if (asked.result == nvml::gpu_lost) status = PollStatus::gone;
    return {status, asked.t_ns, is_value() ? *value : 0, asked.width_ns, errno_of(asked.result)};
  }
};

class Gpu {
 public:
  Gpu(std::shared_ptr<const Library> library, nvml::Device device)
      : library_(std::move(library)), device_(device) {}

  [[nodiscard]] const Library& library() const { return *library_; }
  [[nodiscard]] nvml::Device device() const { return device_; }

  // What the items' fields are, for one call that fetches them all.
  void set_fields(const std::vector<Item>& items) {
    fields_.clear();
    for (const Item& item : items)
      if (item.call == Call::field) {
        nvml::FieldValue field;
        field.field_id = static_cast<uint32_t>(item.argument);
        fields_.push_back(field);
      }
  }

  // What several items share is asked for once in a round.
  void begin_round() { has_reasons_ = has_utilization_ = has_fields_ = false; }

  Answer read(const Item& item) {
    const Library& library = *library_;
    const int argument = static_cast<int>(item.argument);
    const auto number = [](auto&& call) {
      uint32_t value = 0;
      const Asked asked = ask([&] { return call(&value); });
      return Answer{asked, value};
    };
    switch (item.call) {
      case Call::total_energy: {
        unsigned long long energy_mj = 0;
        const Asked asked = ask([&] { return library.total_energy(device_, &energy_mj); });
        return {asked, to_int(energy_mj)};
      }
      case Call::power_usage:
        return number([&](uint32_t* out) { return library.power_usage(device_, out); });
      case Call::enforced_limit:
        return number([&](uint32_t* out) { return library.enforced_limit(device_, out); });
      case Call::management_limit:
        return number([&](uint32_t* out) { return library.management_limit(device_, out); });
      case Call::clock:
        return number([&](uint32_t* out) { return library.clock(device_, argument, out); });
      case Call::temperature:
        return number([&](uint32_t* out) {
          return library.temperature(device_, nvml::gpu_temperature, out);
        });
      case Call::temperature_v: {
        nvml::TemperatureV1 temperature;
        const Asked asked = ask([&] { return library.temperature_v(device_, &temperature); });
        return {asked, temperature.celsius};
      }
      case Call::reasons:
        if (!std::exchange(has_reasons_, true))
          asked_reasons_ = ask([&] { return library.reasons(device_, &reasons_); });
        return {asked_reasons_, (reasons_ & item.argument) != 0 ? 1 : 0};
      case Call::utilization:
      case Call::memory_utilization:
        if (!std::exchange(has_utilization_, true))
          asked_utilization_ = ask([&] { return library.utilization(device_, &utilization_); });
        return {asked_utilization_,
                item.call == Call::utilization ? utilization_.gpu : utilization_.memory};
      case Call::performance_state: {
        int state = nvml::unknown_performance_state;
        const Asked asked = ask([&] { return library.performance_state(device_, &state); });
        return {asked, state == nvml::unknown_performance_state ? std::nullopt
                                                                : std::optional<int64_t>(state)};
      }
      case Call::violation: {
        nvml::ViolationTime time;
        const Asked asked = ask([&] { return library.violation(device_, argument, &time); });
        return {asked, to_int(time.violation_ns)};
      }
      case Call::field:
        return read_field(static_cast<uint32_t>(item.argument));
    }
    return {};
  }

 private:
  Answer read_field(uint32_t id) {
    if (!std::exchange(has_fields_, true))
      asked_fields_ = ask([&] {
        return library_->fields(device_, static_cast<int>(fields_.size()), fields_.data());
      });
    if (asked_fields_.result != nvml::success) return {asked_fields_, std::nullopt};
    for (const nvml::FieldValue& field : fields_)
      if (field.field_id == id)
        return {{field.result, asked_fields_.t_ns, asked_fields_.width_ns}, to_int(field)};
    return {};
  }

  std::shared_ptr<const Library> library_;
  nvml::Device device_;
  bool has_reasons_ = false;
  bool has_utilization_ = false;
  bool has_fields_ = false;
  Asked asked_reasons_;
  Asked asked_utilization_;
  Asked asked_fields_;
  unsigned long long reasons_ = 0;
  nvml::Utilization utilization_;
  std::vector<nvml::FieldValue> fields_;
};

class NvmlSource final : public SensorSource {
 public:
  // `runtime_status` is the kernel's word on whether the GPU sleeps, where it ever does.
  NvmlSource(int64_t period_ns, std::vector<Channel> channels, SourceTraits traits, Gpu gpu,
             std::vector<Item> items, std::optional<TextFile> runtime_status)
      : SensorSource("nvml", period_ns, std::move(channels), std::move(traits)),
        gpu_(std::move(gpu)),
        items_(std::move(items)),
        runtime_status_(std::move(runtime_status)) {
    gpu_.set_fields(items_);
  }

  void poll(std::span<Reading> out) noexcept override {
    if (!is_lost_ && is_asleep()) {
      std::fill(out.begin(), out.end(), Reading{PollStatus::retry, now_ns(), 0, 0, EAGAIN});
      return;
    }
    gpu_.begin_round();
    for (size_t i = 0; i < items_.size(); ++i) {
      if (is_lost_) {
        out[i] = {PollStatus::gone, now_ns(), 0, 0, ENODEV};
        continue;
      }
      out[i] = gpu_.read(items_[i]).reading();
      is_lost_ = out[i].status == PollStatus::gone;
    }
  }

 private:
  bool is_asleep() {
    if (!runtime_status_) return false;
    std::array<char, 32> buffer;
    return runtime_status_->read(buffer).text.starts_with("suspended");
  }

  Gpu gpu_;
  std::vector<Item> items_;
  std::optional<TextFile> runtime_status_;
  bool is_lost_ = false;
};

// ---------------------------------------------------------------- discovery

std::string pci_path(const std::string& address) { return "sys/bus/pci/devices/" + address; }

bool is_suspended(const Root& root, const std::string& address) {
  return root.read_line(pci_path(address) + "/power/runtime_status") == "suspended";
}

Missing asleep(const std::string& address) {
  return {"nvml",
          fmt::format("the GPU {} sleeps (runtime-suspended); asking it would wake it", address),
          fmt::format("echo on | sudo tee /{}/power/control", pci_path(address))};
}

// PCI addresses of NVIDIA's display controllers, as the kernel lists them.
std::vector<std::string> nvidia_gpus(const Root& root) {
  std::vector<std::string> addresses;
  for (const std::string& address : root.list("sys/bus/pci/devices"))
    if (root.read_line(pci_path(address) + "/vendor") == "0x10de" &&
        root.read_line(pci_path(address) + "/class").value_or("").starts_with("0x03"))
      addresses.push_back(address);
  return addresses;
}

// Why there is no library, or none that can be used.
Missing explain_load(const Root& root, const std::string& library, std::string_view error) {
  Missing missing{"nvml", "", ""};
  // Anything but "not there" is worth dlerror()'s words.
  if (error.find("No such file") == std::string_view::npos) {
    missing.reason = fmt::format("cannot load '{}': {}", library, error);
    return missing;
  }
  const std::vector<std::string> gpus = nvidia_gpus(root);
  if (gpus.empty()) {
    missing.reason = fmt::format("{} not found, and no NVIDIA GPU either", library);
    return missing;
  }
  const Root::Resolved driver = root.resolve(pci_path(gpus.front()) + "/driver");
  const std::string name =
      driver.error == 0 ? driver.path.substr(driver.path.rfind('/') + 1) : "none";
  missing.reason =
      fmt::format("{} not found; the GPU {} has the kernel driver {}", library, gpus.front(), name);
  if (name != "nvidia") {
    missing.reason += ", and only NVIDIA's own can be asked";
    missing.fix = "sudo apt install nvidia-driver";
  } else {
    missing.fix = "sudo apt install libnvidia-ml1";
  }
  return missing;
}

Missing explain_init(const Library& library, int result) {
  Missing missing{"nvml", "NVML does not start: " + library.error_text(result), ""};
  if (result == nvml::driver_not_loaded) missing.fix = "sudo modprobe nvidia";
  if (result == nvml::version_mismatch) missing.fix = "sudo reboot";
  if (result == nvml::no_permission)
    missing.fix = "sudo chmod a+rw /dev/nvidiactl /dev/nvidia[0-9]*";
  if (result == nvml::operating_system)
    missing.fix = "docker run --gpus all -e NVIDIA_DRIVER_CAPABILITIES=all ...";
  return missing;
}

// The text a call writes into a buffer; empty if it fails.
std::string text_of(const Function<nvml::Device, char*, uint32_t>& call, nvml::Device device) {
  std::array<char, 97> buffer{};
  if (call(device, buffer.data(), static_cast<uint32_t>(buffer.size() - 1)) != nvml::success)
    return {};
  return buffer.data();
}

// "GPU-8F1B..." as Vulkan writes it: "8f1b...".
std::string vulkan_uuid(std::string_view uuid) {
  if (uuid.starts_with("GPU-")) uuid.remove_prefix(4);
  std::string text(uuid);
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

// As sysfs writes it; absent where the GPU is no PCI device.
std::optional<std::string> pci_address(const Gpu& gpu) {
  nvml::PciInfo info;
  if (gpu.library().pci_info(gpu.device(), &info) != nvml::success) return std::nullopt;
  return fmt::format("{:04x}:{:02x}:{:02x}.0", info.domain, info.bus, info.device);
}

// What the value of an item should stay below, or can reach.
std::optional<int64_t> limit_of(const Gpu& gpu, const Item& item) {
  const Library& library = gpu.library();
  uint32_t value = 0;
  int result = nvml::not_supported;
  if (item.call == Call::clock)
    result = library.max_clock(gpu.device(), static_cast<int>(item.argument), &value);
  else if (item.quantity == Quantity::temperature)
    result = library.temperature_threshold(
        gpu.device(), item.suffix == "temp" ? nvml::slowdown_threshold : nvml::memory_max_threshold,
        &value);
  else if (item.quantity == Quantity::power)
    result = library.enforced_limit(gpu.device(), &value);
  if (result != nvml::success || value == 0) return std::nullopt;
  return value;
}

// One GPU under discovery.
class Finding {
 public:
  Finding(const Root& root, Gpu gpu, uint32_t index, Discovery& discovery)
      : root_(root),
        gpu_(std::move(gpu)),
        prefix_(fmt::format("nvml.gpu{}", index)),
        name_(text_of(gpu_.library().name, gpu_.device())),
        uuid_(text_of(gpu_.library().uuid, gpu_.device())),
        discovery_(discovery) {
    const std::optional<std::string> address = pci_address(gpu_);
    traits_.slow = true;
    traits_.gpu_uuid = vulkan_uuid(uuid_);
    traits_.gpu = address ? *address : uuid_.empty() ? prefix_ : traits_.gpu_uuid;
    // Only where the kernel may suspend it.
    traits_.wakes_device =
        address && root.read_line(pci_path(*address) + "/power/control") == "auto";
  }

  void find() {
    if (is_suspended(root_, traits_.gpu)) {
      discovery_.missing.push_back(asleep(traits_.gpu));
      return;
    }
    std::vector<Item> state(state_items.begin(), state_items.end());
    // What the GPU never says is no channel. Drivers that do not tell are taken to say all.
    unsigned long long supported = 0;
    const int result = gpu_.library().supported_reasons(gpu_.device(), &supported);
    const bool tells = result == nvml::success && supported != 0;
    for (const Item& item : reason_items)
      if (!tells || item.argument == ~named_reasons || (supported & item.argument) != 0)
        state.push_back(item);
    size_t channel_count = add_source(state_period_ns, state);
    channel_count += add_source(limit_period_ns, {limit_items.begin(), limit_items.end()});
    explain(channel_count);
  }

 private:
  // A source of those items that give a value now. Returns how many they are.
  size_t add_source(int64_t period_ns, const std::vector<Item>& candidates) {
    gpu_.set_fields(candidates);
    gpu_.begin_round();
    std::vector<Item> items;
    std::vector<Channel> channels;
    std::map<std::string_view, int> failures;  // result by Item::what
    for (const Item& item : candidates) {
      const auto is_taken = [&](const Item& other) { return other.what == item.what; };
      if (std::any_of(items.begin(), items.end(), is_taken)) continue;
      const Answer answer = gpu_.read(item);
      // 0 C is what boards without the sensor say.
      if (!answer.is_value() || (item.quantity == Quantity::temperature && *answer.value == 0)) {
        failures.emplace(item.call == Call::reasons ? "throttle reasons" : item.what,
                         answer.asked.result);
        continue;
      }
      Channel channel;
      channel.name = fmt::format("{}.{}", prefix_, item.suffix);
      channel.quantity = item.quantity;
      channel.unit = item.unit;
      channel.kind = item.kind;
      channel.limit = limit_of(gpu_, item);
      channel.origin = fmt::format("{} of {}, {}", item.origin, name_, uuid_);
      channels.push_back(std::move(channel));
      items.push_back(item);
    }
    for (const Item& item : items) failures.erase(item.what);
    for (const auto& [what, result] : failures) failed_[result].push_back(what);
    const size_t count = items.size();
    if (count == 0) return 0;
    std::optional<TextFile> runtime_status;
    if (traits_.wakes_device)
      runtime_status.emplace(root_, pci_path(traits_.gpu) + "/power/runtime_status");
    discovery_.sources.push_back(std::make_unique<NvmlSource>(period_ns, std::move(channels),
                                                              traits_, gpu_, std::move(items),
                                                              std::move(runtime_status)));
    return count;
  }

  void explain(size_t channel_count) const {
    const std::string who = fmt::format("{} ({}, {})", prefix_, name_, traits_.gpu);
    for (const auto& [result, whats] : failed_) {
      const std::string why =
          result == nvml::success ? "no valid value" : gpu_.library().error_text(result);
      if (channel_count > 0)
        discovery_.missing.push_back(
            {"nvml", fmt::format("{} gives no {}: {}", who, fmt::join(whats, ", "), why), ""});
      else
        discovery_.missing.push_back(
            {"nvml",
             fmt::format("{} answers no question: {}. On Jetson, hwmon and devfreq do", who, why),
             ""});
    }
  }

  const Root& root_;
  Gpu gpu_;
  std::string prefix_;
  std::string name_;
  std::string uuid_;
  SourceTraits traits_;
  std::map<int, std::vector<std::string_view>> failed_;  // Item::what by result
  Discovery& discovery_;
};

}  // namespace

void discover_nvml(const Root& root, const Selection& selection, Discovery& discovery) {
  void* const handle = dlopen(selection.nvml_library.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr) {
    const char* error = dlerror();
    discovery.missing.push_back(
        explain_load(root, selection.nvml_library, error == nullptr ? "" : error));
    return;
  }
  const auto library = std::make_shared<Library>(handle);
  if (!library->init.exists()) {
    discovery.missing.push_back(
        {"nvml", fmt::format("'{}' has no nvmlInit: not NVML", selection.nvml_library), ""});
    return;
  }
  // Starting NVML opens every GPU: not where all of them sleep.
  const std::vector<std::string> gpus = nvidia_gpus(root);
  if (!gpus.empty() && std::all_of(gpus.begin(), gpus.end(), [&](const std::string& address) {
        return is_suspended(root, address);
      })) {
    for (const std::string& address : gpus) discovery.missing.push_back(asleep(address));
    return;
  }
  if (const int result = library->init(); result != nvml::success) {
    discovery.missing.push_back(explain_init(*library, result));
    return;
  }
  library->is_up = true;
  uint32_t count = 0;
  if (const int result = library->count(&count); result != nvml::success || count == 0)
    discovery.missing.push_back(
        {"nvml",
         result == nvml::success ? "NVML knows no GPU"
                                 : "NVML does not tell its GPUs: " + library->error_text(result),
         ""});
  for (uint32_t i = 0; i < count; ++i) {
    nvml::Device device = nullptr;
    if (const int result = library->handle_by_index(i, &device); result != nvml::success)
      discovery.missing.push_back(
          {"nvml", fmt::format("nvml.gpu{} cannot be opened: {}", i, library->error_text(result)),
           ""});
    else
      Finding(root, Gpu(library, device), i, discovery).find();
  }
}

}  // namespace energyprof::probe
