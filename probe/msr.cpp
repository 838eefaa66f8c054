// Expects dev/cpu/0/msr, where an 8-byte read at offset N gives register N; below a --root
//
//   dev/cpu/0/msr.tsv          0x606 <tab> 0x00000000000a0e03
#include "probe/msr.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <tuple>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/perf_pmu.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr int64_t energy_period_ns = ns_per_ms;
constexpr int64_t flag_period_ns = 20 * ns_per_ms;
constexpr int64_t limit_period_ns = ns_per_s;
constexpr std::string_view device = "dev/cpu/0/msr";
constexpr std::string_view table = "dev/cpu/0/msr.tsv";

// The value of `wanted` in lines "0x606<tab>0x00000000000a0e03<tab>note".
std::optional<uint64_t> find_register(std::string_view text, uint32_t wanted) {
  const auto take_hex = [](std::string_view& line) -> std::optional<uint64_t> {
    line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size()));
    if (!line.starts_with("0x")) return std::nullopt;
    line.remove_prefix(2);
    uint64_t value = 0;
    const auto [stop, error] = std::from_chars(line.data(), line.data() + line.size(), value, 16);
    if (error != std::errc{}) return std::nullopt;
    line.remove_prefix(static_cast<size_t>(stop - line.data()));
    return value;
  };
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (take_hex(line) == wanted) return take_hex(line);
  }
  return std::nullopt;
}

// The registers of the first CPU.
class Registers {
 public:
  explicit Registers(const Root& root) : is_host_(root.is_host()), file_(root, table) {
    if (!is_host_) return;
    fd_ = open(root.resolve(device).path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd_ < 0) open_error_ = errno;
  }
  ~Registers() {
    if (fd_ >= 0) close(fd_);
  }
  Registers(const Registers&) = delete;
  Registers& operator=(const Registers&) = delete;

  struct Value {
    std::optional<uint64_t> bits;
    int64_t t_ns = 0;
    int64_t width_ns = 0;
    int error = 0;
  };
  Value read(uint32_t number) noexcept {
    if (!is_host_) {
      std::array<char, 4096> buffer;
      const TextFile::Read read = file_.read(buffer);
      const std::optional<uint64_t> bits = find_register(read.text, number);
      // As the device answers for a register that is not there.
      const int error = read.error == 0 && !bits ? EIO : read.error;
      return {bits, read.t_ns, read.width_ns, error};
    }
    uint64_t bits = 0;
    const int64_t before_ns = now_ns();
    const ssize_t got = fd_ < 0 ? -1 : pread(fd_, &bits, sizeof bits, number);
    const int error = fd_ < 0 ? open_error_ : got == sizeof bits ? 0 : errno;
    const int64_t width_ns = now_ns() - before_ns;
    Value value{std::nullopt, before_ns + width_ns / 2, width_ns, error};
    if (error == 0) value.bits = bits;
    return value;
  }

 private:
  bool is_host_;
  TextFile file_;
  int fd_ = -1;
  int open_error_ = 0;
};

// What a channel takes from its register.
struct Field {
  uint32_t number = 0;
  int first_bit = 0;
  uint64_t mask = 0;
  uint64_t factor = 1;  // value = (bits & mask) * factor >> shift
  int shift = 0;
  uint64_t enable = 0;  // bits of the register without which the value means nothing
};

bool is_enabled(const Field& field, uint64_t bits) { return (bits & field.enable) == field.enable; }

class MsrSource final : public SensorSource {
 public:
  MsrSource(int64_t period_ns, std::vector<Channel> channels, std::vector<Field> fields,
            std::shared_ptr<Registers> registers, SourceTraits traits)
      : SensorSource("msr", period_ns, std::move(channels), std::move(traits)),
        fields_(std::move(fields)),
        registers_(std::move(registers)) {}

  void poll(std::span<Reading> out) noexcept override {
    Registers::Value value;
    for (size_t i = 0; i < fields_.size(); ++i) {
      const Field& field = fields_[i];
      // Flags of one register lie side by side.
      if (i == 0 || field.number != fields_[i - 1].number) value = registers_->read(field.number);
      out[i] = {status_of(value.error), value.t_ns, 0, value.width_ns, value.error};
      if (!value.bits) continue;
      const uint64_t raw = (*value.bits >> field.first_bit) & field.mask;
      out[i].value = static_cast<int64_t>((raw * field.factor) >> field.shift);
      if (!is_enabled(field, *value.bits)) out[i].status = PollStatus::retry;
    }
  }

 private:
  std::vector<Field> fields_;
  std::shared_ptr<Registers> registers_;
};

// Whether another source gives what is called `name` here. Where there are several packages, or
// dies in one, others call a part of the first one "rapl.package-0.dram.energy" or
// "rapl.package-0-die-0.dram.energy", and the package itself "rapl.package-0-die-0.energy".
bool is_known(const Discovery& discovery, const std::string& name) {
  constexpr std::string_view package = "rapl.package-0";
  constexpr std::string_view all = "rapl";
  if (discovery.has_channel(name)) return true;
  if (!name.starts_with(all)) return false;
  const std::string what = name.substr(name.starts_with(package) ? package.size() : all.size());
  return discovery.has_channel(fmt::format("{}{}", package, what)) ||
         discovery.has_channel(fmt::format("{}-die-0{}", package, what));
}

// Channels of one period that are being gathered.
class Gathering {
 public:
  Gathering(std::shared_ptr<Registers> registers, Discovery& discovery)
      : registers_(std::move(registers)), discovery_(discovery) {}

  // Adds the channel if its register is there, the field enabled, and no other source gives it.
  Channel* add(std::string name, Quantity quantity, Unit unit, Kind kind, const Field& field) {
    if (is_known(discovery_, name)) return nullptr;
    const std::optional<uint64_t> bits = registers_->read(field.number).bits;
    if (!bits) return nullptr;
    if (!is_enabled(field, *bits)) {
      discovery_.missing.push_back(
          {"msr", fmt::format("{} is not enabled in MSR {:#x}", name, field.number), ""});
      return nullptr;
    }
    Channel channel;
    channel.name = std::move(name);
    channel.quantity = quantity;
    channel.unit = unit;
    channel.kind = kind;
    channel.origin = fmt::format("MSR {:#x}, bits from {}", field.number, field.first_bit);
    channels_.push_back(std::move(channel));
    fields_.push_back(field);
    return &channels_.back();
  }

  void finish(int64_t period_ns, SourceTraits traits = {}) {
    if (!channels_.empty())
      discovery_.sources.push_back(
          std::make_unique<MsrSource>(period_ns, std::exchange(channels_, {}),
                                      std::exchange(fields_, {}), registers_, std::move(traits)));
  }

 private:
  std::shared_ptr<Registers> registers_;
  Discovery& discovery_;
  std::vector<Channel> channels_;
  std::vector<Field> fields_;
};

struct Domain {
  std::string_view name;
  uint32_t number;
  int unit;  // one count is 2^-unit J
};

// Energy is low 32 bits x 2^-unit J. In nJ, rounded down, a value is right to 1 nJ, and the
// register's 2^32 are 10^9 x 2^(32 - unit) nJ, a whole number: the channel wraps exactly.
void add_energy(Gathering& gathering, std::span<const Domain> domains) {
  constexpr uint64_t nj_per_j = 1'000'000'000;
  for (const Domain& domain : domains) {
    Channel* const channel =
        gathering.add(fmt::format("rapl.{}.energy", domain.name), Quantity::energy, Unit::nanojoule,
                      Kind::cumulative, {domain.number, 0, 0xffffffff, nj_per_j, domain.unit});
    if (channel != nullptr)
      channel->wrap_at = static_cast<int64_t>(((uint64_t{1} << 32) * nj_per_j) >> domain.unit) - 1;
  }
  gathering.finish(energy_period_ns);
}

struct Reason {
  int bit;
  std::string_view name;
};
// Not the bits for the clock limit of many active cores, and for "inefficient operation": neither
// is throttling.
constexpr std::array perf_limit_reasons{
    Reason{0, "prochot"}, Reason{1, "thermal"},       Reason{4, "residency"},
    Reason{5, "ratl"},    Reason{6, "vr_thermalert"}, Reason{7, "vr_tdc"},
    Reason{8, "edp"},     Reason{10, "pl1"},          Reason{11, "pl2"}};
// Register 0x690, before Skylake: bits 4 and 5 are others.
constexpr std::array haswell_reasons{Reason{0, "prochot"},       Reason{1, "thermal"},
                                     Reason{6, "vr_thermalert"}, Reason{8, "edp"},
                                     Reason{10, "pl1"},          Reason{11, "pl2"}};
constexpr std::array package_reasons{Reason{0, "thermal"}, Reason{2, "prochot"},
                                     Reason{4, "critical"}, Reason{10, "power_limit"}};

void add_flags(Gathering& gathering, std::string_view domain, uint32_t number,
               std::span<const Reason> reasons) {
  for (const Reason& reason : reasons)
    gathering.add(fmt::format("msr.{}.throttle.{}", domain, reason.name), Quantity::throttle,
                  Unit::count, Kind::flag, {number, reason.bit, 1});
}

// "model : 143" of the first processor; 0 if it does not say.
int64_t cpu_model(const Root& root) {
  const std::string text = root.read("proc/cpuinfo").text.value_or("");
  constexpr std::string_view key = "\nmodel\t";
  const size_t line = text.find(key);
  if (line == std::string::npos) return 0;
  const size_t colon = text.find(':', line);
  if (colon == std::string::npos) return 0;
  return parse_int(text.substr(colon + 1, text.find('\n', colon) - colon - 1)).value_or(0);
}

// Servers count dram in 2^-16 J whatever the unit register says: Haswell, Broadwell, Skylake, Ice
// Lake, Xeon Phi; and Sapphire and Emerald Rapids, which count psys in whole joules besides.
struct ServerUnits {
  bool is_dram_16 = false;
  bool is_psys_whole = false;
};
ServerUnits server_units(int64_t model) {
  constexpr std::array<int64_t, 7> dram_16{0x3f, 0x4f, 0x55, 0x6a, 0x6c, 0x57, 0x85};
  const bool is_rapids = model == 0x8f || model == 0xcf;
  const bool is_listed = std::find(dram_16.begin(), dram_16.end(), model) != dram_16.end();
  return {is_listed || is_rapids, is_rapids};
}

bool has_integrated_gpu(const Root& root) {
  const std::vector<DrmCard> cards = list_drm_cards(root);
  return std::any_of(cards.begin(), cards.end(),
                     [](const DrmCard& card) { return card.gpu == integrated_intel_gpu; });
}

void discover_intel(const Root& root, Gathering& gathering, Registers& registers, uint64_t units) {
  const int unit = static_cast<int>((units >> 8) & 0x1f);
  const ServerUnits server = server_units(cpu_model(root));
  const std::array domains{Domain{"package-0", 0x611, unit}, Domain{"core", 0x639, unit},
                           Domain{"uncore", 0x641, unit},
                           Domain{"dram", 0x619, server.is_dram_16 ? 16 : unit},
                           Domain{"psys", 0x64d, server.is_psys_whole ? 0 : unit}};
  add_energy(gathering, domains);
  const int power_unit = static_cast<int>(units & 0xf);
  for (const auto& [name, first_bit, enable_bit] :
       {std::tuple{"pl1", 0, 15}, std::tuple{"pl2", 32, 47}})
    gathering.add(fmt::format("rapl.package-0.{}", name), Quantity::limit, Unit::microwatt,
                  Kind::gauge,
                  {0x610, first_bit, 0x7fff, 1'000'000, power_unit, uint64_t{1} << enable_bit});
  gathering.finish(limit_period_ns);
  if (registers.read(0x64f).bits)
    add_flags(gathering, "core", 0x64f, perf_limit_reasons);
  else
    add_flags(gathering, "core", 0x690, haswell_reasons);
  add_flags(gathering, "ring", 0x6b1, perf_limit_reasons);
  add_flags(gathering, "package", 0x1b1, package_reasons);
  gathering.finish(flag_period_ns);
  if (!has_integrated_gpu(root)) return;
  add_flags(gathering, "gfx", 0x6b0, perf_limit_reasons);
  gathering.finish(flag_period_ns, {.gpu = std::string(integrated_intel_gpu)});
}

// Reads the registers, of the same tree; the device as root.
std::string command_that_reads(const Root& root) {
  const std::string command = running_program() + " probe --allow-msr";
  if (root.is_host()) return "sudo " + command;
  return fmt::format("{} --root '{}'", command, root.directory());
}

// Processors of other architectures have no such registers. Only those of x86 name their vendor.
bool is_other_architecture(const Root& root) {
  const std::string text = root.read("proc/cpuinfo").text.value_or("");
  return !text.empty() && text.find("vendor_id") == std::string::npos;
}

// Of "none [integrity] confidentiality" the word in brackets is in force.
bool is_locked_down(const Root& root) {
  const std::string state = root.read_line("sys/kernel/security/lockdown").value_or("");
  return state.find('[') != std::string::npos && state.find("[none]") == std::string::npos;
}

Missing explain(const Root& root, int error) {
  const std::string path = root.display(root.is_host() ? device : table);
  const std::string reason = fmt::format("cannot read '{}': {}", path, errno_text(error));
  if (error == ENOENT) return {"msr", reason, root.is_host() ? "sudo modprobe msr" : ""};
  if (error == EPERM && is_locked_down(root))
    return {"msr", reason + "; the kernel's lockdown (Secure Boot) refuses it to everybody", ""};
  // Root without the capability is root of a container.
  if (error == EPERM)
    return {"msr", reason + "; it needs CAP_SYS_RAWIO",
            geteuid() == 0 ? "docker run --cap-add SYS_RAWIO --device /dev/cpu/0/msr ..."
                           : command_that_reads(root)};
  if (error == EACCES)
    return {"msr", reason, root.is_host() ? command_that_reads(root) : "sudo chmod a+r " + path};
  return {"msr", reason + "; neither Intel's nor AMD's energy registers are there", ""};
}

}  // namespace

void discover_msr(const Root& root, const Selection& selection, Discovery& discovery) {
  if (!root.exists(root.is_host() ? device : table)) {
    if (is_other_architecture(root)) {
      discovery.missing.push_back({"msr", "no x86 processor: there are no such registers", ""});
      return;
    }
    if (!root.is_host()) {
      discovery.missing.push_back(explain(root, ENOENT));
      return;
    }
  }
  if (!selection.allow_msr) {
    discovery.missing.push_back({"msr", "not read unless allowed", command_that_reads(root)});
    return;
  }
  constexpr uint32_t intel_unit = 0x606;
  constexpr uint32_t amd_unit = 0xc0010299;
  const auto registers = std::make_shared<Registers>(root);
  const size_t source_count = discovery.sources.size();
  Gathering gathering(registers, discovery);
  const Registers::Value intel = registers->read(intel_unit);
  if (intel.bits) {
    discover_intel(root, gathering, *registers, *intel.bits);
  } else if (const auto amd = registers->read(amd_unit); amd.bits) {
    const int unit = static_cast<int>((*amd.bits >> 8) & 0x1f);
    const std::array domains{Domain{"package-0", 0xc001029b, unit},
                             Domain{"core", 0xc001029a, unit}};
    add_energy(gathering, domains);
  } else {
    discovery.missing.push_back(explain(root, intel.error));
    return;
  }
  if (discovery.sources.size() == source_count)
    discovery.missing.push_back(
        {"msr", "its registers tell nothing that is not read elsewhere", ""});
}

}  // namespace energyprof::probe
