// Expects:
//
//   sys/class/hwmon/hwmon5/name                     coretemp
//   sys/class/hwmon/hwmon5/device                   link to the device: ../../../coretemp.0
//   sys/class/hwmon/hwmon5/temp1_label              Package id 0
//   sys/class/hwmon/hwmon5/temp1_input              28000
//   sys/class/hwmon/hwmon5/temp1_{crit,crit_alarm}  100000, 0
//
// and of a board with supply rails
//
//   sys/class/hwmon/hwmon1/{name,in1_label}         ina3221, VDD_IN
//   sys/class/hwmon/hwmon1/{in1_input,curr1_input}  4976, 1240
//
//   sys/class/hwmon/hwmon3/{name,oc3_event_cnt}     soctherm_oc, 27390
//
// at the device where the driver puts them there (applesmc; power_meter before Linux 6.15)
//
//   sys/class/hwmon/hwmon2/device/{name,power1_average}   power_meter, 412000000
//
// or, as JetPack up to 4 has it,
//
//   sys/bus/i2c/drivers/ina3221x/1-0040/iio:device0/{rail_name_0,in_power0_input}  VDD_IN, 6170
#include "probe/hwmon.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/hwmon";
constexpr std::string_view supply_dir = "sys/class/power_supply";
constexpr std::string_view iio_rails_dir = "sys/bus/i2c/drivers/ina3221x";

// What "<prefix><number>_<item>" means.
struct Item {
  std::string_view prefix;
  std::string_view item;
  std::string_view suffix;
  Quantity quantity;
  Unit unit;
  Kind kind;
};
constexpr std::array items{
    Item{"temp", "input", "temp", Quantity::temperature, Unit::millicelsius, Kind::gauge},
    Item{"power", "input", "power", Quantity::power, Unit::microwatt, Kind::gauge},
    Item{"power", "average", "power_average", Quantity::power, Unit::microwatt, Kind::average},
    Item{"energy", "input", "energy", Quantity::energy, Unit::microjoule, Kind::cumulative},
    Item{"freq", "input", "freq", Quantity::frequency, Unit::hertz, Kind::gauge},
    Item{"oc", "event_cnt", "events", Quantity::throttle, Unit::count, Kind::cumulative},
};

// What a temperature should stay below: the first of these that is set.
constexpr std::array<std::string_view, 3> temperature_limits{"crit", "max", "emergency"};
// What is enforced on power in the long run is the lower of cap and max (xe: cap is for bursts).
// Without either crit, a peak that no average ever comes near.
constexpr std::array<std::string_view, 2> power_limits{"cap", "max"};
constexpr std::string_view power_peak = "crit";

// Chips whose every read costs a firmware call, a disk command or a transfer.
constexpr std::array<std::string_view, 12> slow_chips{
    "nvme",     "drivetemp", "acpitz",   "iwlwifi", "BAT",  "dell_smm",
    "thinkpad", "spd5118",   "applesmc", "scmi",    "scpi", "power_meter"};

// Counts how often a Jetson's hardware throttled for its supply, and asks the firmware for it.
constexpr std::string_view supply_chip = "soctherm_oc";

// Drives, memory modules, radios and batteries: their alarms slow neither processor nor GPU down.
constexpr std::array<std::string_view, 6> bystanders{"nvme", "drivetemp", "iwlwifi",
                                                     "BAT",  "spd5118",   "jc42"};

// Drivers of GPUs: what their chips say belongs to the GPU. A read may ask the GPU's firmware.
constexpr std::array<std::string_view, 9> gpu_chips{
    "amdgpu", "i915", "xe", "nouveau", "radeon", "panfrost", "panthor", "lima", "msm"};

template <size_t N>
bool is_one_of(std::string_view chip, const std::array<std::string_view, N>& names) {
  return std::any_of(names.begin(), names.end(),
                     [&](std::string_view name) { return chip.starts_with(name); });
}

// coretemp answers from memory, anew once a second.
int64_t period_of(std::string_view chip) {
  if (chip == "acpitz") return 5 * ns_per_s;  // the thermal zone again: firmware code at every read
  return is_one_of(chip, slow_chips) || chip == "coretemp" ? ns_per_s : 100 * ns_per_ms;
}

struct Chip {
  std::string path;        // of its files
  std::string name;        // as the driver says
  std::string id;          // as in channel names
  std::string device;      // last part of the device's path: "coretemp.0", "1-0040"
  bool is_supply = false;  // a battery's or charger's bridge to hwmon
  SourceTraits traits;     // of its sources
};

// Whether a device's name is an address on an I2C bus: "1-0040". A read is a transfer.
bool is_i2c_address(std::string_view device) {
  const size_t dash = device.find('-');
  return dash != std::string_view::npos && dash > 0 && device.size() == dash + 5 &&
         device.find_first_not_of("0123456789") == dash &&
         device.find_first_not_of("0123456789abcdef", dash + 1) == std::string_view::npos;
}

// N of "<prefix>N_<item>".
std::optional<int> item_number(std::string_view file, std::string_view prefix,
                               std::string_view item) {
  if (!file.starts_with(prefix)) return std::nullopt;
  file.remove_prefix(prefix.size());
  if (file.starts_with('-')) return std::nullopt;
  int number = 0;
  const auto [stop, error] = std::from_chars(file.data(), file.data() + file.size(), number);
  if (error != std::errc{}) return std::nullopt;
  file.remove_prefix(static_cast<size_t>(stop - file.data()));
  if (!file.starts_with('_') || file.substr(1) != item) return std::nullopt;
  return number;
}

// Whether the file's number is one of the kinds of values that are read here.
bool is_input(std::string_view file) {
  return std::any_of(items.begin(), items.end(), [&](const Item& item) {
    return item_number(file, item.prefix, item.item).has_value();
  });
}

// Where the chip's files lie: at its entry in the class or, of some drivers, at its device.
std::string files_of(const Root& root, const std::string& chip) {
  if (root.exists(chip + "/name")) return chip;
  const auto has_inputs = [&](const std::string& directory) {
    const std::vector<std::string> files = root.list(directory);
    return std::any_of(files.begin(), files.end(), is_input);
  };
  std::string device = chip + "/device";
  return !has_inputs(chip) && has_inputs(device) ? device : chip;
}

// The last part of the path of the chip's device; its entry in the class if that is not known.
std::string device_of(const Root& root, const std::string& chip, const std::string& entry) {
  const std::string link = root.link_name(chip + "/device");
  if (!link.empty() && link != "..") return link;
  // Copies of sysfs may lack the link: <device>/hwmon/hwmon5 is where the chip lies.
  std::string path = root.resolve(chip).path;
  for (const std::string& below : {'/' + entry, std::string("/hwmon")}) {
    if (!path.ends_with(below)) return entry;
    path.resize(path.size() - below.size());
  }
  std::string name = path.substr(path.rfind('/') + 1);
  return name == "class" ? entry : name;
}

// Where a chip is listed.
struct Entry {
  std::string path;
  std::string gpu;  // whose it is, where only the card's own directory has it
};

// Entries of the class; and of cards' own directories, which copies may have alone.
std::vector<Entry> list_entries(const Root& root) {
  std::vector<Entry> entries;
  const std::vector<std::string> in_class = root.list(class_dir);
  for (const std::string& name : in_class)
    entries.push_back({fmt::format("{}/{}", class_dir, name), {}});
  for (const DrmCard& card : list_drm_cards(root)) {
    const std::string parent = card.path + "/device/hwmon";
    for (const std::string& name : root.list(parent))
      if (std::find(in_class.begin(), in_class.end(), name) == in_class.end())
        entries.push_back({fmt::format("{}/{}", parent, name), card.gpu});
  }
  return entries;
}

std::vector<Chip> list_chips(const Root& root, Discovery& discovery) {
  std::vector<Chip> chips;
  std::map<std::string, int> name_count;
  std::set<std::string> known;  // resolved paths
  for (const auto& [path, gpu] : list_entries(root)) {
    const std::string entry = path.substr(path.rfind('/') + 1);
    const std::string device = path + "/device";
    std::optional<std::string> name = root.read_line(path + "/name");
    if (!name) name = root.read_line(device + "/name");
    if (!name && root.list(path).empty()) {
      if (const int error = root.list_error(path); error == EACCES)
        discovery.missing.push_back(
            {"hwmon", fmt::format("cannot enter '{}': {}", root.display(path), errno_text(error)),
             ""});
      continue;
    }
    if (!known.insert(root.resolve(path).path).second) continue;
    Chip chip;
    chip.path = files_of(root, path);
    chip.device = device_of(root, path, entry);
    chip.name = name.value_or(chip.device);
    chip.id = slug(chip.name);
    chip.is_supply = root.exists(fmt::format("{}/{}", supply_dir, chip.device));
    // A card of the kernel's has its chips at the same device, whatever they are called: i915_gt0.
    const bool is_gpu =
        std::find(gpu_chips.begin(), gpu_chips.end(), chip.name) != gpu_chips.end() ||
        root.exists(device + "/drm") || !gpu.empty();
    if (is_gpu) chip.traits.gpu = gpu.empty() ? gpu_of_device(root, device) : gpu;
    chip.traits.wakes_device = is_gpu && may_sleep(root, device);
    if (is_gpu && chip.traits.gpu.empty() && chip.device != entry) chip.traits.gpu = chip.device;
    chip.traits.slow = is_gpu || is_i2c_address(chip.device) || is_one_of(chip.name, slow_chips) ||
                       chip.name == supply_chip;
    ++name_count[chip.id];
    chips.push_back(std::move(chip));
  }
  for (Chip& chip : chips) {
    if (name_count[chip.id] > 1) chip.id += '@' + slug(chip.device);
    chip.traits.chip = chip.id;
  }
  return chips;
}

std::optional<int64_t> temperature_limit(const Root& root, const Chip& chip,
                                         const std::string& sensor) {
  for (const std::string_view item : temperature_limits) {
    const auto limit = check_int_file(root, fmt::format("{}/{}_{}", chip.path, sensor, item)).value;
    if (limit && *limit > 0 && *limit <= highest_temp_mc) return limit;
  }
  return std::nullopt;
}

// Why a file is no use as a channel; empty: it is. An amdgpu that sleeps or is being reset refuses
// reads (Linux 6.13), and answers when it is awake.
std::string problem_of(const Chip& chip, const CheckedFile& checked) {
  const bool is_asleep = chip.name == "amdgpu" && checked.error == EPERM;
  return is_asleep ? std::string() : checked.problem;
}

// The file of a power's limit that rules: of those set, the lowest.
std::optional<CheckedFile> power_limit(const Root& root, const Chip& chip,
                                       const std::string& sensor) {
  const auto read = [&](std::string_view item) -> std::optional<CheckedFile> {
    CheckedFile limit = check_int_file(root, fmt::format("{}/{}_{}", chip.path, sensor, item));
    if (!problem_of(chip, limit).empty() || limit.value.value_or(1) <= 0) return std::nullopt;
    return limit;
  };
  std::optional<CheckedFile> lowest;
  for (const std::string_view item : power_limits) {
    std::optional<CheckedFile> limit = read(item);
    constexpr int64_t unknown = std::numeric_limits<int64_t>::max();  // of a GPU that sleeps
    if (limit && (!lowest || limit->value.value_or(unknown) < lowest->value.value_or(unknown)))
      lowest.emplace(std::move(*limit));
  }
  if (!lowest) return read(power_peak);
  return lowest;
}

bool is_switched_off(const Root& root, const Chip& chip, const std::string& sensor) {
  return root.read_line(fmt::format("{}/{}_enable", chip.path, sensor)) == "0";
}

std::string label_of(const Root& root, const Chip& chip, const std::string& sensor) {
  // As NVIDIA's manual calls them; they have no labels.
  if (chip.name == supply_chip && sensor == "oc1") return "undervoltage";
  if (chip.name == supply_chip && sensor == "oc2") return "overcurrent_average";
  if (chip.name == supply_chip && sensor == "oc3") return "overcurrent_peak";
  const auto label = root.read_line(fmt::format("{}/{}_label", chip.path, sensor));
  return has_name(label.value_or("")) ? slug(*label) : sensor;
}

// The label of current N, which some drivers give to voltage N only; else `otherwise`.
std::string current_label(const Root& root, const Chip& chip, int number, std::string otherwise) {
  for (const char* prefix : {"curr", "in"})
    if (const auto label = root.read_line(fmt::format("{}/{}{}_label", chip.path, prefix, number)))
      if (has_name(*label)) return slug(*label);
  return otherwise;
}

// Whether current N is no supply rail's: not connected, switched off, or one of ina3221's sums.
// Its in4 .. in7 are voltages over the shunts of channels 1 to 3 and their sum; curr4 is a sum.
bool is_no_rail(const Root& root, const Chip& chip, int number, const std::string& label) {
  constexpr int ina3221_channels = 3;
  return label == "nc" || (chip.name == "ina3221" && number > ina3221_channels) ||
         is_switched_off(root, chip, fmt::format("in{}", number)) ||
         is_switched_off(root, chip, fmt::format("curr{}", number));
}

// hwmon.<chip>.<label>.<suffix>, with the sensor's own name added where a chip repeats a label.
std::string channel_name(const Chip& chip, const std::string& label, const std::string& sensor,
                         std::string_view suffix, std::set<std::string>& taken) {
  std::string name = fmt::format("hwmon.{}.{}.{}", chip.id, label, suffix);
  if (!taken.insert(name).second) {
    name = fmt::format("hwmon.{}.{}_{}.{}", chip.id, label, slug(sensor), suffix);
    taken.insert(name);
  }
  return name;
}

// Power of supply rails as voltage times current, the two read one right after the other.
class RailSource final : public SensorSource {
 public:
  struct Rail {
    TextFile voltage_mv;
    TextFile current_ma;
  };
  RailSource(int64_t period_ns, std::vector<Channel> channels, std::vector<Rail> rails,
             SourceTraits traits)
      : SensorSource("hwmon", period_ns, std::move(channels), std::move(traits)),
        rails_(std::move(rails)) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < rails_.size(); ++i) {
      const Reading voltage = rails_[i].voltage_mv.read_int();
      const Reading current = rails_[i].current_ma.read_int();
      Reading& power = out[i];
      power.status = std::max(voltage.status, current.status);  // ok < retry < gone
      power.t_ns = voltage.t_ns + (current.t_ns - voltage.t_ns) / 2;
      power.width_ns = current.t_ns - voltage.t_ns + (voltage.width_ns + current.width_ns) / 2;
      power.error = voltage.error != 0 ? voltage.error : current.error;
      if (power.status == PollStatus::ok &&
          __builtin_mul_overflow(voltage.value, current.value, &power.value))
        power.status = PollStatus::retry;
    }
  }

 private:
  std::vector<Rail> rails_;
};

// Rails of a chip: inN with currN. Returns how many were usable.
size_t discover_rails(const Root& root, const Chip& chip, const std::vector<std::string>& files,
                      std::set<std::string>& taken, Discovery& discovery) {
  std::vector<Channel> channels;
  std::vector<RailSource::Rail> rails;
  for (const std::string& file : files) {
    const std::optional<int> number = item_number(file, "curr", "input");
    if (!number) continue;
    const std::string sensor = fmt::format("in{}", *number);
    const std::string label = current_label(root, chip, *number, sensor);
    if (is_no_rail(root, chip, *number, label)) continue;
    CheckedFile voltage = check_int_file(root, fmt::format("{}/{}_input", chip.path, sensor));
    CheckedFile current = check_int_file(root, fmt::format("{}/{}", chip.path, file));
    if (voltage.error == ENOENT) continue;  // of a chip that tells no voltage beside its current
    const std::string& problem = voltage.problem.empty() ? current.problem : voltage.problem;
    if (!problem.empty()) {
      discovery.missing.push_back({"hwmon", problem, ""});
      continue;
    }
    Channel channel;
    channel.name = channel_name(chip, label, sensor, "power", taken);
    channel.quantity = Quantity::power;
    channel.unit = Unit::microwatt;
    channel.origin = fmt::format("{} (mV) x {} (mA)", voltage.file.path(), file);
    channels.push_back(std::move(channel));
    rails.push_back({std::move(voltage.file), std::move(current.file)});
  }
  const size_t rail_count = rails.size();
  if (rail_count > 0)
    discovery.sources.push_back(std::make_unique<RailSource>(
        period_of(chip.name), std::move(channels), std::move(rails), chip.traits));
  return rail_count;
}

// Alarms that mean a limit of heat, power or current was reached: evidence of throttling. Returns
// how many were usable. A chip that has no values to go with them is left to the voltage alarm of
// the Raspberry Pi's own source.
size_t discover_alarms(const Root& root, const Chip& chip, const std::vector<std::string>& files,
                       std::set<std::string>& taken, Discovery& discovery) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 7> alarms{{
      {"temp", "crit_alarm"},
      {"temp", "emergency_alarm"},
      {"power", "alarm"},
      {"power", "cap_alarm"},
      {"power", "crit_alarm"},
      {"curr", "max_alarm"},
      {"curr", "crit_alarm"},
  }};
  std::vector<FileChannel> rows;
  for (const std::string& file : files)
    for (const auto& [prefix, item] : alarms) {
      const std::optional<int> number = item_number(file, prefix, item);
      if (!number) continue;
      const std::string sensor = fmt::format("{}{}", prefix, *number);
      const bool is_current = prefix == "curr";
      const std::string label =
          is_current ? current_label(root, chip, *number, sensor) : label_of(root, chip, sensor);
      if (is_switched_off(root, chip, sensor)) continue;
      // A sum's alarm is an alarm; a rail's that is not there is none.
      if (is_current &&
          (label == "nc" || is_switched_off(root, chip, fmt::format("in{}", *number))))
        continue;
      CheckedFile checked = check_int_file(root, fmt::format("{}/{}", chip.path, file));
      if (std::string problem = problem_of(chip, checked); !problem.empty()) {
        discovery.missing.push_back({"hwmon", std::move(problem), ""});
        continue;
      }
      Channel channel;
      channel.name = channel_name(chip, label, sensor, item, taken);
      channel.quantity =
          is_one_of(chip.name, bystanders) ? Quantity::utilization : Quantity::throttle;
      channel.unit = Unit::count;
      channel.kind = Kind::flag;
      rows.push_back({std::move(channel), std::move(checked.file)});
    }
  const size_t count = rows.size();
  add_file_source(discovery, "hwmon", period_of(chip.name), std::move(rows), chip.traits);
  return count;
}

// The power that a GPU's firmware holds it to, which may be set and changed while it runs; the
// power itself may be told as energy only. Returns how many were usable.
size_t discover_power_limits(const Root& root, const Chip& chip,
                             const std::vector<std::string>& files, std::set<std::string>& taken,
                             Discovery& discovery) {
  std::set<int> numbers;
  for (const std::string& file : files)
    for (const std::string_view item : {power_limits[0], power_limits[1], power_peak})
      if (const auto number = item_number(file, "power", item)) numbers.insert(*number);
  std::vector<FileChannel> rows;
  for (const int number : numbers) {
    const std::string sensor = fmt::format("power{}", number);
    std::optional<CheckedFile> limit = power_limit(root, chip, sensor);
    if (!limit) continue;
    Channel channel;
    channel.name = channel_name(chip, label_of(root, chip, sensor), sensor, "power_limit", taken);
    channel.quantity = Quantity::limit;
    channel.unit = Unit::microwatt;
    rows.push_back({std::move(channel), std::move(limit->file)});
  }
  const size_t count = rows.size();
  add_file_source(discovery, "hwmon", ns_per_s, std::move(rows), chip.traits);
  return count;
}

// Rails as JetPack up to 4 shows them. Returns how many were usable.
size_t discover_iio_rails(const Root& root, Discovery& discovery) {
  std::vector<std::string> chips;  // entries of the driver's directory: "1-0040"
  for (const std::string& entry : root.list(iio_rails_dir))
    if (is_i2c_address(entry)) chips.push_back(entry);
  size_t rail_count = 0;
  for (const std::string& entry : chips) {
    const Chip chip{{},    "ina3221x", chips.size() > 1 ? "ina3221x@" + entry : "ina3221x",
                    entry, false,      {}};
    std::set<std::string> taken;
    std::vector<FileChannel> rows;
    const std::string device = fmt::format("{}/{}", iio_rails_dir, entry);
    for (const std::string& below : root.list(device)) {
      if (!below.starts_with("iio:device")) continue;
      const std::string iio = fmt::format("{}/{}", device, below);
      for (const std::string& file : root.list(iio)) {
        const std::optional<int> number = item_number(file, "in_power", "input");
        if (!number) continue;
        const std::string sensor = fmt::format("power{}", *number);
        const std::string label =
            slug(root.read_line(fmt::format("{}/rail_name_{}", iio, *number)).value_or(sensor));
        if (label == "nc") continue;
        CheckedFile checked = check_int_file(root, fmt::format("{}/{}", iio, file));
        if (!checked.problem.empty()) {
          discovery.missing.push_back({"hwmon", checked.problem, ""});
          continue;
        }
        Channel channel;
        channel.name = channel_name(chip, label, sensor, "power", taken);
        channel.quantity = Quantity::power;
        channel.unit = Unit::milliwatt;
        rows.push_back({std::move(channel), std::move(checked.file)});
      }
    }
    rail_count += rows.size();
    add_file_source(discovery, "hwmon", period_of(chip.name), std::move(rows),
                    {.slow = true, .chip = chip.id});
  }
  return rail_count;
}

void discover_chip(const Root& root, const Chip& chip, Discovery& discovery) {
  const std::vector<std::string> files = root.list(chip.path);
  const size_t missing_before = discovery.missing.size();
  std::set<std::string> taken;
  std::vector<FileChannel> rows;
  bool has_power = false;
  for (const std::string& file : files) {
    for (const Item& item : items) {
      const std::optional<int> number = item_number(file, item.prefix, item.item);
      if (!number) continue;
      const std::string sensor = fmt::format("{}{}", item.prefix, *number);
      if (is_switched_off(root, chip, sensor)) continue;
      if (chip.is_supply && item.quantity == Quantity::power) {
        discovery.missing.push_back(
            {"hwmon",
             fmt::format("'{}/{}' repeats what the source battery reads, and does not say whether "
                         "it charges or discharges",
                         root.display(chip.path), file),
             ""});
        continue;
      }
      CheckedFile checked = check_int_file(root, fmt::format("{}/{}", chip.path, file));
      if (std::string problem = problem_of(chip, checked); !problem.empty()) {
        discovery.missing.push_back({"hwmon", std::move(problem), ""});
        continue;
      }
      // B580: energy1 of the card. A GPU that was on has used energy.
      if (item.quantity == Quantity::energy && !chip.traits.gpu.empty() && checked.value == 0) {
        discovery.missing.push_back(
            {"hwmon", fmt::format("'{}' is 0: unsupported, not 0 J", checked.file.path()), ""});
        continue;
      }
      const bool is_temp = item.quantity == Quantity::temperature;
      if (is_temp && root.read_line(fmt::format("{}/{}_fault", chip.path, sensor)) == "1") {
        discovery.missing.push_back(
            {"hwmon",
             fmt::format("'{}' is of a sensor that says it is faulty", checked.file.path()), ""});
        continue;
      }
      Channel channel;
      channel.name = channel_name(chip, label_of(root, chip, sensor), sensor, item.suffix, taken);
      channel.quantity = item.quantity;
      channel.unit = item.unit;
      channel.kind = item.kind;
      if (is_temp) channel.limit = temperature_limit(root, chip, sensor);
      if (item.quantity == Quantity::power)
        if (const auto limit = power_limit(root, chip, sensor)) channel.limit = limit->value;
      has_power = has_power || item.quantity == Quantity::power;
      rows.push_back({std::move(channel), std::move(checked.file)});
    }
  }
  size_t channel_count = rows.size();
  add_file_source(discovery, "hwmon", period_of(chip.name), std::move(rows), chip.traits);
  channel_count += discover_alarms(root, chip, files, taken, discovery);
  if (!chip.traits.gpu.empty())
    channel_count += discover_power_limits(root, chip, files, taken, discovery);
  if (!has_power && !chip.is_supply)
    channel_count += discover_rails(root, chip, files, taken, discovery);
  if (channel_count == 0 && discovery.missing.size() == missing_before)
    discovery.missing.push_back(
        {"hwmon",
         fmt::format("'{}' ({}) has no temperature, power, energy or clock to read",
                     root.display(chip.path), shown(chip.name)),
         ""});
}

}  // namespace

void discover_hwmon(const Root& root, Discovery& discovery) {
  const size_t missing_before = discovery.missing.size();
  const std::vector<Chip> chips = list_chips(root, discovery);
  const size_t iio_rail_count = discover_iio_rails(root, discovery);
  if (chips.empty() && iio_rail_count == 0 && discovery.missing.size() == missing_before)
    discovery.missing.push_back(
        {"hwmon",
         fmt::format("no hardware monitoring chip in '{}'; usual in a virtual machine",
                     root.display(class_dir)),
         ""});
  for (const Chip& chip : chips) discover_chip(root, chip, discovery);
}

}  // namespace energyprof::probe
