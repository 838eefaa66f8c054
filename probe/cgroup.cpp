// Expects in proc/self/cgroup "0::/a/b" (v2) or "2:cpu,cpuacct:/a/b" (v1), and in
//
//   sys/fs/cgroup/a/b/cpu.stat                 v2: nr_throttled 2, throttled_usec 156161
//   sys/fs/cgroup/cpu,cpuacct/a/b/cpu.stat     v1: nr_throttled 2, throttled_time 156161000
//
// and beside it cpu.max "50000 100000" (v2) or cpu.cfs_quota_us "50000" (v1), where "max" and -1
// are no quota.
#include "probe/cgroup.h"

#include <fmt/format.h>

#include <array>
#include <utility>

#include "core/clock.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

struct Membership {
  std::string mount;  // where the hierarchy is mounted, below the root
  std::string group;  // "/a/b"
  bool is_v1 = false;
};

bool has_cpu(std::string_view controllers) {
  while (!controllers.empty()) {
    const size_t end = std::min(controllers.find(','), controllers.size());
    if (controllers.substr(0, end) == "cpu") return true;
    controllers.remove_prefix(std::min(end + 1, controllers.size()));
  }
  return false;
}

std::string first_existing(const Root& root, std::initializer_list<std::string> paths) {
  for (const std::string& path : paths)
    if (root.exists(path)) return path;
  return {};
}

// The own groups in the v1 hierarchy with the cpu controller and in v2. On hybrid systems there are
// both, and the controller is in one of them.
struct Memberships {
  std::optional<Membership> v1;
  std::optional<Membership> v2;
};

Memberships parse_memberships(const Root& root, std::string_view lines) {
  Memberships found;
  while (!lines.empty()) {
    const size_t end = std::min(lines.find('\n'), lines.size());
    const std::string_view line = lines.substr(0, end);
    lines.remove_prefix(std::min(end + 1, lines.size()));
    const size_t first = line.find(':');
    const size_t second = line.find(':', first + 1);
    if (first == std::string_view::npos || second == std::string_view::npos) continue;
    const std::string controllers(line.substr(first + 1, second - first - 1));
    const std::string group(line.substr(second + 1));
    if (has_cpu(controllers)) {
      const std::string mount =
          first_existing(root, {"sys/fs/cgroup/" + controllers, "sys/fs/cgroup/cpu,cpuacct",
                                "sys/fs/cgroup/cpuacct,cpu", "sys/fs/cgroup/cpu"});
      if (!mount.empty()) found.v1 = Membership{mount, group, true};
    } else if (controllers.empty()) {
      const std::string mount = first_existing(root, {"sys/fs/cgroup/unified", "sys/fs/cgroup"});
      if (!mount.empty()) found.v2 = Membership{mount, group, false};
    }
  }
  return found;
}

// Directories of the own group and those above it, innermost first. A container sees its own group
// mounted as the top: what the host calls it does not exist there.
std::vector<std::string> levels_of(const Root& root, const Membership& member) {
  std::vector<std::string> levels;
  std::string group = member.group;
  while (group.size() > 1 && group.ends_with('/')) group.pop_back();
  if (group.starts_with('/') && group.find("..") == std::string::npos &&
      root.exists(member.mount + group))
    for (; group.size() > 1; group.resize(group.rfind('/'))) levels.push_back(member.mount + group);
  levels.push_back(member.mount);
  return levels;
}

// A quota's stops are told from each other; where there is none, one that is set later is noticed.
constexpr int64_t with_quota_period_ns = ns_per_ms;
constexpr int64_t without_quota_period_ns = 10 * ns_per_ms;

// Whether the group says that it has no quota.
bool is_unlimited(const Root& root, const std::string& group, bool is_v1) {
  const auto line = root.read_line(group + (is_v1 ? "/cpu.cfs_quota_us" : "/cpu.max"));
  return line && (is_v1 ? *line == "-1" : line->starts_with("max"));
}

class CgroupSource final : public SensorSource {
 public:
  CgroupSource(int64_t period_ns, std::vector<Channel> channels, std::vector<TextFile> files,
               std::string_view time_key)
      : SensorSource("cgroup", period_ns, std::move(channels)),
        files_(std::move(files)),
        time_key_(time_key) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < files_.size(); ++i) {
      std::array<char, 1024> buffer;
      const TextFile::Read read = files_[i].read(buffer);
      out[2 * i] = reading(read, time_key_);
      out[2 * i + 1] = reading(read, "nr_throttled");
    }
  }

 private:
  static Reading reading(const TextFile::Read& read, std::string_view key) noexcept {
    return read.reading(find_int(read.text, key));
  }

  std::vector<TextFile> files_;
  std::string_view time_key_;
};

Channel quota_channel(std::string name, Unit unit, std::string origin) {
  return make_channel(std::move(name), Quantity::interference, unit, Kind::cumulative,
                      std::move(origin));
}

}  // namespace

std::optional<std::string> own_group_v2(const Root& root) {
  const std::string lines = root.read("proc/self/cgroup").text.value_or("");
  const Memberships memberships = parse_memberships(root, lines);
  if (!memberships.v2) return std::nullopt;
  return levels_of(root, *memberships.v2).front();
}

void discover_cgroup(const Root& root, Discovery& discovery) {
  const Root::Text self = root.read("proc/self/cgroup");
  if (!self.text) {
    discovery.missing.push_back(
        {"cgroup",
         fmt::format("cannot read '{}': {}", root.display("proc/self/cgroup"),
                     errno_text(self.error)),
         ""});
    return;
  }
  const Memberships memberships = parse_memberships(root, *self.text);
  const std::optional<Membership>& member = memberships.v1 ? memberships.v1 : memberships.v2;
  if (!member) {
    discovery.missing.push_back({"cgroup",
                                 fmt::format("no control group hierarchy for CPU time in '{}'",
                                             root.display("sys/fs/cgroup")),
                                 ""});
    return;
  }
  const std::string_view time_key = member->is_v1 ? "throttled_time" : "throttled_usec";
  const Unit time_unit = member->is_v1 ? Unit::nanosecond : Unit::microsecond;
  std::vector<Channel> channels;
  std::vector<TextFile> files;
  const std::vector<std::string> levels = levels_of(root, *member);
  bool can_be_stopped = false;
  for (size_t up = 0; up < levels.size(); ++up) {
    const std::string path = levels[up] + "/cpu.stat";
    const std::string text = root.read(path).text.value_or("");
    if (!find_int(text, time_key) || !find_int(text, "nr_throttled")) continue;
    const std::string suffix = up == 0 ? "" : fmt::format(".parent{}", up);
    const std::string where = root.display(path);
    channels.push_back(quota_channel("cgroup.cpu.throttled" + suffix, time_unit,
                                     fmt::format("{}: {}", where, time_key)));
    channels.push_back(quota_channel("cgroup.cpu.throttled_periods" + suffix, Unit::count,
                                     where + ": nr_throttled"));
    files.emplace_back(root, path);
    can_be_stopped = can_be_stopped || !is_unlimited(root, levels[up], member->is_v1);
  }
  if (files.empty())
    discovery.missing.push_back(
        {"cgroup",
         fmt::format("no group from '{}' upwards has a CPU quota: none can stop this process",
                     root.display(levels.front())),
         ""});
  else
    discovery.sources.push_back(std::make_unique<CgroupSource>(
        can_be_stopped ? with_quota_period_ns : without_quota_period_ns, std::move(channels),
        std::move(files), time_key));
}

}  // namespace energyprof::probe
