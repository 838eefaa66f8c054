// Expects the bytes of sys/class/drm/cardN/device/gpu_metrics, little-endian:
//
//   0  u16  structure_size
//   2  u8   format_revision
//   3  u8   content_revision
//   4  ...  as the tables below say
#include "probe/gpu_metrics.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdlib>

namespace energyprof::probe {
namespace {

constexpr size_t header_size = 4;

struct Size {
  MetricsRevision revision;
  size_t bytes;
};
constexpr std::array sizes{
    Size{{1, 0}, 80},  Size{{1, 1}, 96},  Size{{1, 2}, 104}, Size{{1, 3}, 120},
    Size{{1, 4}, 288}, Size{{1, 5}, 360}, Size{{2, 0}, 120}, Size{{2, 1}, 120},
    Size{{2, 2}, 128}, Size{{2, 3}, 152}, Size{{2, 4}, 168}, Size{{3, 0}, 264},
};

// nullopt for an unknown revision.
std::optional<size_t> size_of(MetricsRevision revision) {
  for (const Size& size : sizes)
    if (size.revision == revision) return size.bytes;
  return std::nullopt;
}

// Revisions of one format, content first to last.
struct Range {
  uint8_t format;
  uint8_t first;
  uint8_t last;
  [[nodiscard]] bool has(MetricsRevision revision) const {
    return revision.format == format && revision.content >= first && revision.content <= last;
  }
};

struct Row {
  Range revisions;
  MetricsField field;
};

constexpr Range v1_0{1, 0, 0};
constexpr Range v1_1{1, 1, 3};  // and 1.2, 1.3, which add members at the end
constexpr Range v1_4{1, 4, 4};
constexpr Range v1_5{1, 5, 5};
constexpr Range v2_0{2, 0, 0};
constexpr Range v2_1{2, 1, 4};  // and 2.2, 2.3, 2.4, which add members at the end
constexpr Range v3_0{3, 0, 0};

constexpr auto temperature = Quantity::temperature;
constexpr auto power = Quantity::power;
constexpr auto frequency = Quantity::frequency;
constexpr auto utilization = Quantity::utilization;
constexpr auto traffic = Quantity::memory_traffic;
constexpr auto throttle = Quantity::throttle;
constexpr auto limit = Quantity::limit;
constexpr auto gauge = Kind::gauge;
constexpr auto average = Kind::average;
constexpr auto counter = Kind::cumulative;
constexpr auto C = Unit::celsius;
constexpr auto cC = Unit::centicelsius;
constexpr auto W = Unit::watt;
constexpr auto mW = Unit::milliwatt;
constexpr auto MHz = Unit::megahertz;
constexpr auto MBps = Unit::megabyte_per_second;
constexpr auto percent = Unit::percent;
constexpr auto centi = Unit::centipercent;
constexpr auto count = Unit::count;

// Columns: revisions {name, member, quantity, unit, kind, offset, width}. A member is unsupported
// where all its bits are set. Clocks: the current one stands before the average. Activity in c% and
// power in mW are what most firmware gives; activity_unit() and socket_power_unit() settle it.
constexpr std::array rows{
    Row{v1_0, {"temp_edge", "temperature_edge", temperature, C, gauge, 16, 2}},
    Row{v1_0, {"temp_hotspot", "temperature_hotspot", temperature, C, gauge, 18, 2}},
    Row{v1_0, {"temp_mem", "temperature_mem", temperature, C, gauge, 20, 2}},
    Row{v1_0, {"temp_vrgfx", "temperature_vrgfx", temperature, C, gauge, 22, 2}},
    Row{v1_0, {"temp_vrsoc", "temperature_vrsoc", temperature, C, gauge, 24, 2}},
    Row{v1_0, {"temp_vrmem", "temperature_vrmem", temperature, C, gauge, 26, 2}},
    Row{v1_0, {"activity", "average_gfx_activity", utilization, percent, average, 28, 2}},
    Row{v1_0, {"mem_activity", "average_umc_activity", utilization, percent, average, 30, 2}},
    Row{v1_0, {"socket_power", "average_socket_power", power, W, average, 34, 2}},
    Row{v1_0, {"gfx_freq", "current_gfxclk", frequency, MHz, gauge, 54, 2}},
    Row{v1_0, {"gfx_freq", "average_gfxclk_frequency", frequency, MHz, average, 40, 2}},
    Row{v1_0, {"soc_freq", "current_socclk", frequency, MHz, gauge, 56, 2}},
    Row{v1_0, {"soc_freq", "average_socclk_frequency", frequency, MHz, average, 42, 2}},
    Row{v1_0, {"mem_freq", "current_uclk", frequency, MHz, gauge, 58, 2}},
    Row{v1_0, {"mem_freq", "average_uclk_frequency", frequency, MHz, average, 44, 2}},

    Row{v1_1, {"temp_edge", "temperature_edge", temperature, C, gauge, 4, 2}},
    Row{v1_1, {"temp_hotspot", "temperature_hotspot", temperature, C, gauge, 6, 2}},
    Row{v1_1, {"temp_mem", "temperature_mem", temperature, C, gauge, 8, 2}},
    Row{v1_1, {"temp_vrgfx", "temperature_vrgfx", temperature, C, gauge, 10, 2}},
    Row{v1_1, {"temp_vrsoc", "temperature_vrsoc", temperature, C, gauge, 12, 2}},
    Row{v1_1, {"temp_vrmem", "temperature_vrmem", temperature, C, gauge, 14, 2}},
    Row{v1_1, {"activity", "average_gfx_activity", utilization, percent, average, 16, 2}},
    Row{v1_1, {"mem_activity", "average_umc_activity", utilization, percent, average, 18, 2}},
    Row{v1_1, {"socket_power", "average_socket_power", power, W, average, 22, 2}},
    Row{v1_1, {"gfx_freq", "current_gfxclk", frequency, MHz, gauge, 54, 2}},
    Row{v1_1, {"gfx_freq", "average_gfxclk_frequency", frequency, MHz, average, 40, 2}},
    Row{v1_1, {"soc_freq", "current_socclk", frequency, MHz, gauge, 56, 2}},
    Row{v1_1, {"soc_freq", "average_socclk_frequency", frequency, MHz, average, 42, 2}},
    Row{v1_1, {"mem_freq", "current_uclk", frequency, MHz, gauge, 58, 2}},
    Row{v1_1, {"mem_freq", "average_uclk_frequency", frequency, MHz, average, 44, 2}},

    Row{v1_4, {"temp_hotspot", "temperature_hotspot", temperature, C, gauge, 4, 2}},
    Row{v1_4, {"temp_mem", "temperature_mem", temperature, C, gauge, 6, 2}},
    Row{v1_4, {"temp_vrsoc", "temperature_vrsoc", temperature, C, gauge, 8, 2}},
    Row{v1_4, {"socket_power", "curr_socket_power", power, W, gauge, 10, 2}},
    Row{v1_4, {"activity", "average_gfx_activity", utilization, percent, average, 12, 2}},
    Row{v1_4, {"mem_activity", "average_umc_activity", utilization, percent, average, 14, 2}},
    Row{v1_4, {"gfx_freq", "current_gfxclk[0]", frequency, MHz, gauge, 240, 2}},
    Row{v1_4, {"soc_freq", "current_socclk[0]", frequency, MHz, gauge, 256, 2}},
    Row{v1_4, {"mem_freq", "current_uclk", frequency, MHz, gauge, 280, 2}},

    Row{v1_5, {"temp_hotspot", "temperature_hotspot", temperature, C, gauge, 4, 2}},
    Row{v1_5, {"temp_mem", "temperature_mem", temperature, C, gauge, 6, 2}},
    Row{v1_5, {"temp_vrsoc", "temperature_vrsoc", temperature, C, gauge, 8, 2}},
    Row{v1_5, {"socket_power", "curr_socket_power", power, W, gauge, 10, 2}},
    Row{v1_5, {"activity", "average_gfx_activity", utilization, percent, average, 12, 2}},
    Row{v1_5, {"mem_activity", "average_umc_activity", utilization, percent, average, 14, 2}},
    Row{v1_5, {"gfx_freq", "current_gfxclk[0]", frequency, MHz, gauge, 312, 2}},
    Row{v1_5, {"soc_freq", "current_socclk[0]", frequency, MHz, gauge, 328, 2}},
    Row{v1_5, {"mem_freq", "current_uclk", frequency, MHz, gauge, 352, 2}},

    Row{v2_0, {"temp_gfx", "temperature_gfx", temperature, cC, gauge, 16, 2}},
    Row{v2_0, {"temp_soc", "temperature_soc", temperature, cC, gauge, 18, 2}},
    Row{v2_0, {"activity", "average_gfx_activity", utilization, centi, average, 40, 2}},
    Row{v2_0, {"socket_power", "average_socket_power", power, mW, average, 44, 2}},
    Row{v2_0, {"cpu_power", "average_cpu_power", power, mW, average, 46, 2}},
    Row{v2_0, {"soc_power", "average_soc_power", power, mW, average, 48, 2}},
    Row{v2_0, {"gfx_power", "average_gfx_power", power, mW, average, 50, 2}},
    Row{v2_0, {"gfx_freq", "current_gfxclk", frequency, MHz, gauge, 80, 2}},
    Row{v2_0, {"gfx_freq", "average_gfxclk_frequency", frequency, MHz, average, 68, 2}},
    Row{v2_0, {"soc_freq", "current_socclk", frequency, MHz, gauge, 82, 2}},
    Row{v2_0, {"soc_freq", "average_socclk_frequency", frequency, MHz, average, 70, 2}},
    Row{v2_0, {"mem_freq", "current_uclk", frequency, MHz, gauge, 84, 2}},
    Row{v2_0, {"mem_freq", "average_uclk_frequency", frequency, MHz, average, 72, 2}},
    Row{v2_0, {"fclk_freq", "current_fclk", frequency, MHz, gauge, 86, 2}},
    Row{v2_0, {"fclk_freq", "average_fclk_frequency", frequency, MHz, average, 74, 2}},

    Row{v2_1, {"temp_gfx", "temperature_gfx", temperature, cC, gauge, 4, 2}},
    Row{v2_1, {"temp_soc", "temperature_soc", temperature, cC, gauge, 6, 2}},
    Row{v2_1, {"activity", "average_gfx_activity", utilization, centi, average, 28, 2}},
    Row{v2_1, {"socket_power", "average_socket_power", power, mW, average, 40, 2}},
    Row{v2_1, {"cpu_power", "average_cpu_power", power, mW, average, 42, 2}},
    Row{v2_1, {"soc_power", "average_soc_power", power, mW, average, 44, 2}},
    Row{v2_1, {"gfx_power", "average_gfx_power", power, mW, average, 46, 2}},
    Row{v2_1, {"gfx_freq", "current_gfxclk", frequency, MHz, gauge, 76, 2}},
    Row{v2_1, {"gfx_freq", "average_gfxclk_frequency", frequency, MHz, average, 64, 2}},
    Row{v2_1, {"soc_freq", "current_socclk", frequency, MHz, gauge, 78, 2}},
    Row{v2_1, {"soc_freq", "average_socclk_frequency", frequency, MHz, average, 66, 2}},
    Row{v2_1, {"mem_freq", "current_uclk", frequency, MHz, gauge, 80, 2}},
    Row{v2_1, {"mem_freq", "average_uclk_frequency", frequency, MHz, average, 68, 2}},
    Row{v2_1, {"fclk_freq", "current_fclk", frequency, MHz, gauge, 82, 2}},
    Row{v2_1, {"fclk_freq", "average_fclk_frequency", frequency, MHz, average, 70, 2}},

    Row{v3_0, {"temp_gfx", "temperature_gfx", temperature, cC, gauge, 4, 2}},
    Row{v3_0, {"temp_soc", "temperature_soc", temperature, cC, gauge, 6, 2}},
    Row{v3_0, {"temp_skin", "temperature_skin", temperature, cC, gauge, 40, 2}},
    Row{v3_0, {"activity", "average_gfx_activity", utilization, centi, average, 42, 2}},
    Row{v3_0, {"dram_read", "average_dram_reads", traffic, MBps, average, 94, 2}},
    Row{v3_0, {"dram_write", "average_dram_writes", traffic, MBps, average, 96, 2}},
    Row{v3_0, {"socket_power", "average_socket_power", power, mW, average, 112, 4}},
    Row{v3_0, {"apu_power", "average_apu_power", power, mW, average, 120, 4}},
    Row{v3_0, {"gfx_power", "average_gfx_power", power, mW, average, 124, 4}},
    Row{v3_0, {"cpu_power", "average_all_core_power", power, mW, average, 132, 4}},
    Row{v3_0, {"gfx_freq", "average_gfxclk_frequency", frequency, MHz, average, 174, 2}},
    Row{v3_0, {"soc_freq", "average_socclk_frequency", frequency, MHz, average, 176, 2}},
    Row{v3_0, {"mem_freq", "average_uclk_frequency", frequency, MHz, average, 186, 2}},
    Row{v3_0, {"fclk_freq", "average_fclk_frequency", frequency, MHz, average, 182, 2}},
    Row{v3_0, {"gfx_max_freq", "current_gfx_maxfreq", limit, MHz, gauge, 224, 2}},
    Row{v3_0,
        {"throttle.prochot_residency", "throttle_residency_prochot", throttle, count, counter, 228,
         4}},
    Row{v3_0,
        {"throttle.spl_residency", "throttle_residency_spl", throttle, count, counter, 232, 4}},
    Row{v3_0,
        {"throttle.fppt_residency", "throttle_residency_fppt", throttle, count, counter, 236, 4}},
    Row{v3_0,
        {"throttle.sppt_residency", "throttle_residency_sppt", throttle, count, counter, 240, 4}},
    Row{v3_0,
        {"throttle.thm_core_residency", "throttle_residency_thm_core", throttle, count, counter,
         244, 4}},
    Row{v3_0,
        {"throttle.thm_gfx_residency", "throttle_residency_thm_gfx", throttle, count, counter, 248,
         4}},
    Row{v3_0,
        {"throttle.thm_soc_residency", "throttle_residency_thm_soc", throttle, count, counter, 252,
         4}},
};

struct Bit {
  int position;
  std::string_view name;
};

// RDNA3 sets this bit almost always, on an idle and cool GPU too, so that it does not show
// throttling. It is recorded as what it is, a limiter that watches, and not as a throttle channel.
constexpr std::string_view hotspot = "status.hotspot";

// indep_throttle_status: the same for all chips.
constexpr std::array independent_bits{
    Bit{0, "throttle.ppt0"},
    Bit{1, "throttle.ppt1"},
    Bit{2, "throttle.ppt2"},
    Bit{3, "throttle.ppt3"},
    Bit{4, "throttle.spl"},
    Bit{5, "throttle.fppt"},
    Bit{6, "throttle.sppt"},
    Bit{7, "throttle.sppt_apu"},
    Bit{16, "throttle.tdc_gfx"},
    Bit{17, "throttle.tdc_soc"},
    Bit{18, "throttle.tdc_mem"},
    Bit{19, "throttle.tdc_vdd"},
    Bit{20, "throttle.tdc_cvip"},
    Bit{21, "throttle.edc_cpu"},
    Bit{22, "throttle.edc_gfx"},
    Bit{23, "throttle.apcc"},
    Bit{32, "throttle.temp_gpu"},
    Bit{33, "throttle.temp_core"},
    Bit{34, "throttle.temp_mem"},
    Bit{35, "throttle.temp_edge"},
    Bit{36, hotspot},
    Bit{37, "throttle.temp_soc"},
    Bit{38, "throttle.temp_vr_gfx"},
    Bit{39, "throttle.temp_vr_soc"},
    Bit{40, "throttle.temp_vr_mem0"},
    Bit{41, "throttle.temp_vr_mem1"},
    Bit{42, "throttle.temp_liquid0"},
    Bit{43, "throttle.temp_liquid1"},
    Bit{44, "throttle.vrhot0"},
    Bit{45, "throttle.vrhot1"},
    Bit{46, "throttle.prochot_cpu"},
    Bit{47, "throttle.prochot_gfx"},
    Bit{56, "throttle.ppm"},
    Bit{57, "throttle.fit"},
};

// throttle_status of APUs, under the names above: Renoir and its successors up to Phoenix ...
constexpr std::array apu_bits{
    Bit{0, "throttle.spl"},         Bit{1, "throttle.fppt"},         Bit{2, "throttle.sppt"},
    Bit{3, "throttle.sppt_apu"},    Bit{4, "throttle.temp_core"},    Bit{5, "throttle.temp_gpu"},
    Bit{6, "throttle.temp_soc"},    Bit{7, "throttle.tdc_vdd"},      Bit{8, "throttle.tdc_soc"},
    Bit{9, "throttle.prochot_cpu"}, Bit{10, "throttle.prochot_gfx"}, Bit{11, "throttle.edc_cpu"},
    Bit{12, "throttle.edc_gfx"},
};
// ... and Van Gogh, the Steam Deck's.
constexpr std::array vangogh_bits{
    Bit{0, "throttle.spl"},      Bit{1, "throttle.fppt"},      Bit{2, "throttle.sppt"},
    Bit{3, "throttle.sppt_apu"}, Bit{4, "throttle.temp_core"}, Bit{5, "throttle.temp_gpu"},
    Bit{6, "throttle.temp_soc"}, Bit{7, "throttle.tdc_vdd"},   Bit{8, "throttle.tdc_soc"},
    Bit{9, "throttle.tdc_gfx"},  Bit{10, "throttle.tdc_cvip"},
};

bool is_vangogh(uint32_t pci_device) { return pci_device == 0x163f || pci_device == 0x1435; }

// Accelerators whose counter of energy is known to count 2^-16 J.
bool is_aldebaran(uint32_t pci_device) {
  return pci_device == 0x7408 || pci_device == 0x740c || pci_device == 0x740f ||
         pci_device == 0x7410;
}

constexpr uint64_t all_bits(size_t width) {
  return width >= sizeof(uint64_t) ? ~uint64_t{0} : (uint64_t{1} << (8 * width)) - 1;
}

// One flag per named bit, and one for all that have no name.
void add_flags(std::string_view member, size_t offset, size_t width, std::span<const Bit> bits,
               std::vector<MetricsField>& fields) {
  uint64_t unnamed = all_bits(width);
  const auto add = [&](std::string_view name, Quantity quantity, uint64_t mask) {
    fields.push_back({name, member, quantity, count, Kind::flag, offset, width, mask});
    unnamed &= ~mask;
  };
  for (const Bit& bit : bits)
    add(bit.name, bit.name == hotspot ? utilization : throttle, uint64_t{1} << bit.position);
  add("status.unnamed", utilization, unnamed);
}

uint64_t load(std::span<const char> table, size_t offset, size_t width) {
  uint64_t value = 0;
  for (size_t i = width; i-- > 0;)
    value = value << 8 | static_cast<unsigned char>(table[offset + i]);
  return value;
}

}  // namespace

std::optional<MetricsRevision> metrics_revision(std::span<const char> table) noexcept {
  if (table.size() < header_size) return std::nullopt;
  return MetricsRevision{static_cast<uint8_t>(table[2]), static_cast<uint8_t>(table[3])};
}

bool is_complete(std::span<const char> table, MetricsRevision revision) noexcept {
  const std::optional<size_t> needed = size_of(revision);
  if (!needed || table.size() < header_size) return false;
  const uint64_t stated = load(table, 0, 2);
  return stated >= *needed && stated <= table.size();
}

std::string metrics_problem(std::span<const char> table) {
  const std::optional<MetricsRevision> revision = metrics_revision(table);
  if (!revision) return fmt::format("has {} bytes, fewer than its header", table.size());
  const std::optional<size_t> needed = size_of(*revision);
  if (!needed)
    return fmt::format("has the unknown revision {}.{}: what it says cannot be observed",
                       revision->format, revision->content);
  if (is_complete(table, *revision)) return {};
  return fmt::format(
      "of revision {}.{} says that it has {} bytes; expected {} or more, of the {} "
      "that can be read",
      revision->format, revision->content, load(table, 0, 2), *needed, table.size());
}

std::optional<int64_t> MetricsField::value(std::span<const char> table) const noexcept {
  if (offset + width > table.size()) return std::nullopt;
  const uint64_t raw = load(table, offset, width);
  if (raw == all_bits(width)) return std::nullopt;
  if (mask != 0) return (raw & mask) != 0 ? 1 : 0;
  if ((unit == percent && raw > 100) || (unit == centi && raw > 100 * 100)) return std::nullopt;
  if (quantity == Quantity::energy) {
    // 2^-16 J = 15625/1024 uJ. Beyond 2^48 of them, which is 4 GJ, it is no energy.
    if (raw >> 48 != 0) return std::nullopt;
    return static_cast<int64_t>(raw * 15'625 / 1'024);
  }
  return static_cast<int64_t>(raw);
}

std::vector<MetricsField> metrics_fields(MetricsRevision revision, uint32_t pci_device) {
  std::vector<MetricsField> fields;
  for (const Row& row : rows)
    if (row.revisions.has(revision)) fields.push_back(row.field);
  const auto add_energy = [&](size_t offset) {
    fields.push_back(
        {"energy", "energy_accumulator", Quantity::energy, Unit::microjoule, counter, offset, 8});
  };
  if (v1_4.has(revision)) add_energy(24);
  if (v1_5.has(revision)) add_energy(88);
  if (v1_1.has(revision) && is_aldebaran(pci_device)) add_energy(24);

  if (revision == MetricsRevision{1, 3})
    add_flags("indep_throttle_status", 112, 8, independent_bits, fields);
  if (v2_1.has(revision) && revision.content >= 2)
    add_flags("indep_throttle_status", 120, 8, independent_bits, fields);
  const std::span<const Bit> bits =
      is_vangogh(pci_device) ? std::span<const Bit>(vangogh_bits) : std::span<const Bit>(apu_bits);
  if (v2_0.has(revision)) add_flags("throttle_status", 112, 4, bits, fields);
  if (v2_1.has(revision)) add_flags("throttle_status", 108, 4, bits, fields);
  return fields;
}

Unit activity_unit(MetricsRevision revision, int64_t raw, std::optional<int64_t> busy_percent) {
  constexpr int64_t tolerance_percent = 5;  // the two are read one after the other
  if (raw > 100) return centi;
  if (busy_percent) {
    const bool fits_percent = std::abs(raw - *busy_percent) <= tolerance_percent;
    const bool fits_centi = std::abs(raw / 100 - *busy_percent) <= tolerance_percent;
    if (fits_percent != fits_centi) return fits_percent ? percent : centi;
  }
  return revision.format >= 3 ? percent : centi;
}

Unit socket_power_unit(int64_t raw, std::optional<int64_t> hwmon_power_uw) {
  // The nearer one by ratio: 31.6 is the geometric mean of 1 and 1000.
  constexpr int64_t between_uw = 31'623;
  return hwmon_power_uw && raw > 0 && *hwmon_power_uw / between_uw >= raw ? W : mW;
}

}  // namespace energyprof::probe
