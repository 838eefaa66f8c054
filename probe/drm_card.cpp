// Expects:
//
//   sys/class/drm/card1/device            link to the PCI or platform device
//   sys/class/drm/card1/device/driver     link to ../../../bus/pci/drivers/i915
//   sys/class/drm/card1/device/uevent     DRIVER=i915, PCI_SLOT_NAME=0000:00:02.0
//   sys/dev/char/226:1/device             the same device, by the number of its node
#include "probe/drm_card.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/drm";

// The value after "<key>=" at the start of a line; empty if there is none.
std::string uevent_value(const Root& root, const std::string& device, std::string_view key) {
  const std::string text = root.read(device + "/uevent").text.value_or("");
  for (size_t at = 0; at < text.size();) {
    const size_t end = std::min(text.find('\n', at), text.size());
    const std::string_view line = std::string_view(text).substr(at, end - at);
    if (line.starts_with(key) && line.size() > key.size() && line[key.size()] == '=')
      return std::string(line.substr(key.size() + 1));
    at = end + 1;
  }
  return {};
}

std::string driver_of(const Root& root, const std::string& card) {
  const std::string device = card + "/device";
  std::string driver = uevent_value(root, device, "DRIVER");
  if (driver.empty()) driver = root.link_name(device + "/driver");
  if (!driver.empty()) return driver;
  // Copies of sysfs may have neither; then by a file that no other driver has.
  constexpr std::array<std::pair<std::string_view, std::string_view>, 5> signs{
      {{"gt/gt0", "i915"},
       {"gt_cur_freq_mhz", "i915"},
       {"device/tile0", "xe"},
       {"device/gpu_metrics", "amdgpu"},
       {"device/pp_dpm_sclk", "amdgpu"}}};
  for (const auto& [file, sign_of] : signs)
    if (root.exists(fmt::format("{}/{}", card, file))) return std::string(sign_of);
  return {};
}

}  // namespace

std::string gpu_of_device(const Root& root, std::string_view device_path) {
  const std::string device(device_path);
  std::string slot = uevent_value(root, device, "PCI_SLOT_NAME");
  if (!slot.empty()) return slot;
  const Root::Resolved resolved = root.resolve(device);
  if (resolved.error != 0) return {};
  std::string_view path = resolved.path;
  // In copies where "device" is no link, it is called by what it belongs to: "card1".
  constexpr std::string_view own_directory = "/device";
  if (path.ends_with(own_directory)) path.remove_suffix(own_directory.size());
  return std::string(path.substr(path.rfind('/') + 1));
}

bool may_sleep(const Root& root, std::string_view device_path) {
  return root.read_line(fmt::format("{}/power/control", device_path)) != "on";
}

std::vector<DrmCard> list_drm_cards(const Root& root) {
  std::vector<DrmCard> cards;
  for (const std::string& entry : root.list(class_dir)) {
    if (!is_numbered(entry, "card")) continue;
    DrmCard card{fmt::format("{}/{}", class_dir, entry), {}, {}};
    const std::string device = card.path + "/device";
    card.driver = driver_of(root, card.path);
    card.gpu = gpu_of_device(root, device);
    if (card.gpu.empty()) card.gpu = entry;  // a copy without its device
    cards.push_back(std::move(card));
  }
  return cards;
}

std::vector<NamedCard> drm_cards_of(const Root& root, std::string_view driver) {
  std::vector<NamedCard> named;
  for (DrmCard& card : list_drm_cards(root))
    if (card.driver == driver) named.push_back({std::move(card), std::string(driver)});
  if (named.size() > 1)
    for (NamedCard& one : named) one.prefix += '@' + slug(one.card.gpu);
  return named;
}

void report_absent_chip(const Root& root, const DrmCard& card, Discovery& discovery) {
  const std::string chips = card.path + "/device/hwmon";
  if (root.exists(chips)) return;
  const std::string_view why =
      card.gpu == integrated_intel_gpu
          ? "as usual for an integrated GPU; its energy is RAPL's uncore, its temperature the "
            "package's"
          : "which a card of its own has from Linux 6.2 on, with CONFIG_HWMON";
  discovery.missing.push_back({card.driver,
                               fmt::format("no '{}': {} has no power or temperature of its own, {}",
                                           root.display(chips), card.gpu, why),
                               ""});
}

std::optional<std::string> gpu_of_drm_node(const Root& root, int64_t major, int64_t minor) {
  std::string gpu = gpu_of_device(root, fmt::format("sys/dev/char/{}:{}/device", major, minor));
  if (gpu.empty()) return std::nullopt;
  return gpu;
}

}  // namespace energyprof::probe
