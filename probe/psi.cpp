// Expects in proc/pressure/{cpu,memory,io} and in cpu.pressure of the own control group:
//
//   some avg10=0.00 avg60=0.00 avg300=0.00 total=15
//   full avg10=0.00 avg60=0.00 avg300=0.00 total=25
#include "probe/psi.h"

#include <fmt/format.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <utility>

#include "core/clock.h"
#include "probe/cgroup.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

// total= of the line that starts with `kind`.
std::optional<int64_t> stall_us(std::string_view text, std::string_view kind) {
  const size_t line = text.starts_with(kind) ? 0 : text.find('\n') + 1;
  if (!text.substr(std::min(line, text.size())).starts_with(kind)) return std::nullopt;
  constexpr std::string_view key = "total=";
  const size_t at = text.find(key, line);
  if (at == std::string_view::npos) return std::nullopt;
  int64_t value = 0;
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data() + at + key.size(), end, value);
  if (error != std::errc{}) return std::nullopt;
  return value;
}

struct Resource {
  TextFile file;
  std::vector<std::string> kinds;  // "some", "full"
};

class PsiSource final : public SensorSource {
 public:
  PsiSource(std::vector<Channel> channels, std::vector<Resource> resources)
      : SensorSource("psi", 10 * ns_per_ms, std::move(channels)),
        resources_(std::move(resources)) {}

  void poll(std::span<Reading> out) noexcept override {
    size_t next = 0;
    for (Resource& resource : resources_) {
      std::array<char, 256> buffer;
      const TextFile::Read read = resource.file.read(buffer);
      for (const std::string& kind : resource.kinds)
        out[next++] = read.reading(stall_us(read.text, kind));
    }
  }

 private:
  std::vector<Resource> resources_;
};

}  // namespace

void discover_psi(const Root& root, Discovery& discovery) {
  struct Place {
    std::string path;
    std::string prefix;  // of channel names
    std::vector<std::string> kinds{"some", "full"};
    bool optional = false;  // no news where it is not
  };
  std::vector<Place> places{
      // All tasks of a whole machine never wait for CPU at once: its cpu.full is always 0.
      {"proc/pressure/cpu", "psi.cpu", {"some"}},
      {"proc/pressure/memory", "psi.memory"},
      {"proc/pressure/io", "psi.io"}};
  if (const auto group = own_group_v2(root))
    places.push_back(
        {.path = *group + "/cpu.pressure", .prefix = "psi.cgroup.cpu", .optional = true});
  std::vector<Channel> channels;
  std::vector<Resource> resources;
  for (const Place& place : places) {
    const Root::Text text = root.read(place.path);
    if (!text.text) {
      if (place.optional && text.error == ENOENT) continue;
      // EOPNOTSUPP: compiled in, but off.
      discovery.missing.push_back(
          {"psi",
           fmt::format("cannot read '{}': {}", root.display(place.path), errno_text(text.error)),
           text.error == EOPNOTSUPP ? "boot with psi=1 on the kernel command line" : ""});
      continue;
    }
    Resource resource{TextFile(root, place.path), {}};
    for (const std::string& kind : place.kinds) {
      if (!stall_us(*text.text, kind)) continue;
      Channel channel;
      channel.name = fmt::format("{}.{}", place.prefix, kind);
      channel.quantity = Quantity::interference;
      channel.unit = Unit::microsecond;
      channel.kind = Kind::cumulative;
      channel.origin = fmt::format("{}: {} total", resource.file.path(), kind);
      channels.push_back(std::move(channel));
      resource.kinds.push_back(kind);
    }
    if (resource.kinds.empty())
      discovery.missing.push_back(
          {"psi", fmt::format("'{}' has no line with 'total='", resource.file.path()), ""});
    else
      resources.push_back(std::move(resource));
  }
  if (!channels.empty())
    discovery.sources.push_back(
        std::make_unique<PsiSource>(std::move(channels), std::move(resources)));
}

}  // namespace energyprof::probe
