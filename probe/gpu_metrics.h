/// The binary table that the amdgpu driver gives as `gpu_metrics`, taken apart.
///
/// Offsets, widths and units are facts of drivers/gpu/drm/amd/include/kgd_pp_interface.h in the
/// kernel's source, the bits those of drivers/gpu/drm/amd/pm/swsmu/inc: amdgpu_smu.h and pmfw_if.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/unit.h"

namespace energyprof::probe {

/// Which layout a table has. Its size does not tell: 1.3, 2.0 and 2.1 all have 120 bytes.
struct MetricsRevision {
  uint8_t format = 0;
  uint8_t content = 0;
  bool operator==(const MetricsRevision&) const = default;
};

/// What the first bytes say; nullopt for fewer than four.
std::optional<MetricsRevision> metrics_revision(std::span<const char> table) noexcept;

/// Whether the size that the table states holds the layout of `revision` and is there.
bool is_complete(std::span<const char> table, MetricsRevision revision) noexcept;

/// Why `table` cannot be taken apart, in words; empty: it can.
std::string metrics_problem(std::span<const char> table);

/// One value of a table.
struct MetricsField {
  std::string_view name;    ///< as in channel names: "socket_power", "throttle.spl"
  std::string_view member;  ///< what the kernel calls it: "average_socket_power"
  Quantity quantity = Quantity::power;
  Unit unit = Unit::none;
  Kind kind = Kind::gauge;
  size_t offset = 0;  ///< bytes
  size_t width = 0;   ///< bytes: 2, 4 or 8, little-endian
  uint64_t mask = 0;  ///< a flag: whether any of these bits is set; 0: the number itself

  /// The value in `unit`. nullopt where the driver marks it as unsupported by setting all bits of
  /// the member, for more than 100 %, and for what `table` is too short for.
  [[nodiscard]] std::optional<int64_t> value(std::span<const char> table) const noexcept;
};

/// All that a table of this revision may hold, empty for an unknown revision. Where several fields
/// have the same name, the first one whose value is valid is to be used. `pci_device` ("163f")
/// decides where chips differ; 0: unknown.
std::vector<MetricsField> metrics_fields(MetricsRevision revision, uint32_t pci_device);

/// In what an APU's gfx_activity is counted: firmware versions differ in percent and hundredths of
/// it. Told from the value itself where it exceeds 100, else from gpu_busy_percent read beside it,
/// which is right; where both fit, percent for format 3 as documented, else hundredths.
Unit activity_unit(MetricsRevision revision, int64_t raw, std::optional<int64_t> busy_percent);

/// In what an APU's socket power is counted: milliwatts, but whole watts with some firmware of
/// Renoir. Told by the power that hwmon gives.
Unit socket_power_unit(int64_t raw, std::optional<int64_t> hwmon_power_uw);

}  // namespace energyprof::probe
