// Expects, its columns separated by tabs:
//
//   sys/devices/platform/v3dbus/fec00000.v3d/gpu_stats
//     queue   timestamp       jobs    runtime
//     render  239043069420    22619   27284814161
#include "probe/v3d.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view platform_dir = "sys/devices/platform";
constexpr int64_t poll_period_ns = 20 * ns_per_ms;

// Directories that may be the GPU's: the devices of cards of this driver, then, since the driver
// may have no card yet, those on the platform bus or one level below it which have the file or the
// name. Each once.
std::vector<std::string> list_devices(const Root& root) {
  std::vector<std::string> devices;
  std::set<std::string> known;
  const auto add = [&](std::string device) {
    if (known.insert(root.resolve(device).path).second) devices.push_back(std::move(device));
  };
  const auto add_children = [&](const std::string& parent) {
    for (const std::string& entry : root.list(parent)) {
      std::string device = fmt::format("{}/{}", parent, entry);
      if (entry.ends_with(".v3d") || root.exists(device + "/gpu_stats")) add(std::move(device));
    }
  };
  for (const NamedCard& named : drm_cards_of(root, "v3d")) add(named.card.path + "/device");
  add_children(std::string(platform_dir));
  for (const std::string& entry : root.list(platform_dir))
    add_children(fmt::format("{}/{}", platform_dir, entry));
  return devices;
}

struct Row {
  std::string_view queue;
  std::optional<int64_t> runtime_ns;
};

// The next row of `text`, which loses it: queue, timestamp, jobs, runtime.
Row take_row(std::string_view& text) {
  constexpr std::string_view gaps = "\t \r";
  std::string_view line = text.substr(0, text.find('\n'));
  text.remove_prefix(std::min(line.size() + 1, text.size()));
  std::array<std::string_view, 4> fields;
  for (std::string_view& field : fields) {
    line.remove_prefix(std::min(line.find_first_not_of(gaps), line.size()));
    field = line.substr(0, line.find_first_of(gaps));
    line.remove_prefix(field.size());
  }
  return {fields[0], parse_int(fields[3])};
}

class StatsSource final : public SensorSource {
 public:
  StatsSource(std::vector<Channel> channels, std::vector<std::string> queues, TextFile file,
              SourceTraits traits)
      : SensorSource("v3d", poll_period_ns, std::move(channels), std::move(traits)),
        queues_(std::move(queues)),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    std::array<char, 2048> buffer;
    const TextFile::Read read = file_.read(buffer);
    for (Reading& reading : out) reading = read.reading(std::nullopt);
    for (std::string_view text = read.text; !text.empty();) {
      const Row row = take_row(text);
      const auto known = std::find(queues_.begin(), queues_.end(), row.queue);
      if (known != queues_.end())
        out[static_cast<size_t>(known - queues_.begin())] = read.reading(row.runtime_ns);
    }
  }

 private:
  std::vector<std::string> queues_;
  TextFile file_;
};

}  // namespace

void discover_v3d(const Root& root, Discovery& discovery) {
  const std::vector<std::string> devices = list_devices(root);
  if (devices.empty()) {
    discovery.missing.push_back({"v3d", "no VideoCore GPU", ""});
    return;
  }
  for (const std::string& device : devices) {
    const std::string path = device + "/gpu_stats";
    const Root::Text stats = root.read(path);
    std::vector<Channel> channels;
    std::vector<std::string> queues;
    TextFile file(root, path);
    for (std::string_view text = stats.text ? *stats.text : std::string_view(); !text.empty();) {
      const Row row = take_row(text);
      if (!row.runtime_ns) continue;
      Channel channel;
      channel.name = fmt::format("v3d.{}.busy", slug(row.queue));
      channel.quantity = Quantity::utilization;
      channel.unit = Unit::nanosecond;
      channel.kind = Kind::cumulative;
      channel.origin = file.path();
      channels.push_back(std::move(channel));
      queues.emplace_back(row.queue);
    }
    if (channels.empty())
      discovery.missing.push_back(
          {"v3d",
           stats.text ? fmt::format("'{}' lists no queue", file.path())
                      : fmt::format("cannot read '{}': {}; it is there from Linux 6.8 on",
                                    file.path(), errno_text(stats.error)),
           ""});
    else
      discovery.sources.push_back(
          std::make_unique<StatsSource>(std::move(channels), std::move(queues), std::move(file),
                                        SourceTraits{.gpu = gpu_of_device(root, device)}));
  }
}

}  // namespace energyprof::probe
