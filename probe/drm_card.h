/// The GPUs that the kernel's DRM layer knows, and the driver of each.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Where an integrated Intel GPU is.
inline constexpr std::string_view integrated_intel_gpu = "0000:00:02.0";

/// One card of sys/class/drm.
struct DrmCard {
  std::string path;    ///< below the root: "sys/class/drm/card1"
  std::string driver;  ///< "i915"; empty if it cannot be told
  std::string gpu;     ///< as SourceTraits::gpu: "0000:00:02.0", "fec00000.v3d"
};

/// All cards, in the kernel's order. Connectors ("card1-DP-1") and render nodes are none.
std::vector<DrmCard> list_drm_cards(const Root& root);

/// The cards of one driver, and how the channels of each begin: "i915", or "i915@0000:03:00_0"
/// where the driver has several cards.
struct NamedCard {
  DrmCard card;
  std::string prefix;
};
std::vector<NamedCard> drm_cards_of(const Root& root, std::string_view driver);

/// Says that the card has no hwmon chip, if so: integrated Intel GPUs have none, and what they use
/// is counted elsewhere.
void report_absent_chip(const Root& root, const DrmCard& card, Discovery& discovery);

/// The GPU behind a directory of sysfs that is, or is a link to, its device: its PCI address, else
/// the last part of the device's path. Empty if the directory is not there.
std::string gpu_of_device(const Root& root, std::string_view device_path);

/// Whether the kernel may put a device to sleep while nothing uses it, so that a read wakes it,
/// which takes milliseconds and watts: unless its power/control says "on".
bool may_sleep(const Root& root, std::string_view device_path);

/// The GPU behind a DRM node (VK_EXT_physical_device_drm); nullopt if the kernel lists none.
std::optional<std::string> gpu_of_drm_node(const Root& root, int64_t major, int64_t minor);

}  // namespace energyprof::probe
