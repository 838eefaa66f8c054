// Expects, its columns separated by tabs:
//
//   sys/devices/platform/v3dbus/fec00000.v3d/gpu_stats
//     queue   timestamp       jobs    runtime
//     render  239043069420    22619   27284814161
#include "probe/v3d.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/names.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view platform_dir = "sys/devices/platform";
constexpr int64_t poll_period_ns = 20 * ns_per_ms;

// Directories that may be the GPU's: on the platform bus or one level below it.
std::vector<std::string> list_devices(const Root& root) {
  std::vector<std::string> devices;
  const auto add = [&](const std::string& parent) {
    for (const std::string& entry : root.list(parent))
      if (entry.find(".v3d") != std::string::npos)
        devices.push_back(fmt::format("{}/{}", parent, entry));
  };
  add(std::string(platform_dir));
  for (const std::string& entry : root.list(platform_dir))
    add(fmt::format("{}/{}", platform_dir, entry));
  return devices;
}

struct Row {
  std::string_view queue;
  std::optional<int64_t> runtime_ns;
};

// The next row of `text`, which loses it.
Row take_row(std::string_view& text) {
  const size_t end = std::min(text.find('\n'), text.size());
  const std::string_view line = text.substr(0, end);
  text.remove_prefix(std::min(end + 1, text.size()));
  const size_t queue_end = line.find_first_of("\t ");
  const size_t last = line.find_last_of("\t ");
  if (queue_end == std::string_view::npos) return {};
  return {line.substr(0, queue_end), parse_int(line.substr(last + 1))};
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
