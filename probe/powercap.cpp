// Expects, with links into /sys/devices/virtual/powercap:
//
//   sys/class/powercap/intel-rapl:0        name = package-0, energy_uj, max_energy_range_uj,
//   enabled,
//                                          constraint_0_name = long_term,
//                                          constraint_0_power_limit_uw
//   sys/class/powercap/intel-rapl:0:1      name = uncore; a part of intel-rapl:0. Numbers are hex.
//   sys/class/powercap/intel-rapl-mmio:0   name = package-0: the same counter, limits of its own
#include "probe/powercap.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <set>
#include <utility>

#include "core/clock.h"
#include "probe/file_source.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view class_dir = "sys/class/powercap";
constexpr int64_t energy_period_ns = ns_per_ms;  // RAPL counters move about every 0.976 ms
constexpr int64_t limit_period_ns = ns_per_s;

struct Limit {
  std::string_view constraint;
  std::string_view suffix;
};
constexpr std::array limits{Limit{"long_term", "pl1"}, Limit{"short_term", "pl2"},
                            Limit{"peak_power", "pl4"}};

struct Zone {
  std::string path;     // below the root
  std::string control;  // "intel-rapl", "intel-rapl-tpmi", "intel-rapl-mmio"
  std::string id;       // "0", or "0:1" for a part of zone 0
  std::string name;     // "package-0", "uncore"

  [[nodiscard]] bool is_part() const { return id.find(':') != std::string::npos; }
  [[nodiscard]] std::string parent_id() const { return id.substr(0, id.find(':')); }
};

// Zones that are the same counter, the most direct way to it first.
struct Domain {
  std::string name;  // "package-0", "core" or "package-1.core"
  bool is_part = false;
  std::vector<Zone> zones;
};

bool is_zone_id(std::string_view id) {
  return !id.empty() && id.find_first_not_of("0123456789abcdef:") == std::string_view::npos &&
         std::count(id.begin(), id.end(), ':') <= 1 && id.front() != ':' && id.back() != ':';
}

int rank(std::string_view control) {
  if (control == "intel-rapl") return 0;
  return control == "intel-rapl-tpmi" ? 1 : 2;
}

struct Listing {
  std::vector<Zone> zones;
  std::string hidden;               // a zone that is listed but whose directory cannot be reached
  std::set<std::string> forbidden;  // those that may not be entered
};

// Adds the zones in `directory` and below it. The class has links to all of them; copies may have
// only where they lie, parts inside their zone and zones inside their control.
void list_zones_in(const Root& root, const std::string& directory, int depth, Listing& listing) {
  for (const std::string& entry : root.list(directory)) {
    if (!entry.starts_with("intel-rapl")) continue;
    const std::string path = fmt::format("{}/{}", directory, entry);
    const size_t colon = std::min(entry.find(':'), entry.size());
    Zone zone{path, entry.substr(0, colon), entry.substr(std::min(colon + 1, entry.size())), {}};
    const bool is_known = std::any_of(
        listing.zones.begin(), listing.zones.end(),
        [&](const Zone& known) { return known.control == zone.control && known.id == zone.id; });
    if (is_zone_id(zone.id) && !is_known) {
      if (const auto name = root.read_line(path + "/name")) {
        zone.name = slug(*name);
        listing.zones.push_back(std::move(zone));
      } else if (root.read(path + "/name").error == EACCES) {
        listing.forbidden.insert(root.display(path));
      } else {
        listing.hidden = path;
      }
    }
    if (depth > 0) list_zones_in(root, path, depth - 1, listing);
  }
}

// Limits that several zones set for one thing, of which the lowest rules. A file that went away
// counts no more; the channel is gone with the last of them.
class LimitSource final : public SensorSource {
 public:
  using FileGroups = std::vector<std::vector<TextFile>>;
  LimitSource(std::vector<Channel> channels, FileGroups groups)
      : SensorSource("powercap", limit_period_ns, std::move(channels)),
        groups_(std::move(groups)) {}

  void poll(std::span<Reading> out) noexcept override {
    for (size_t i = 0; i < groups_.size(); ++i) {
      Reading best{.status = PollStatus::gone};
      for (TextFile& file : groups_[i]) {
        Reading reading = file.read_int();
        // 0 is a limit that was never set.
        if (reading.status == PollStatus::ok && reading.value <= 0)
          reading.status = PollStatus::retry;
        const bool better = reading.status == PollStatus::ok
                                ? best.status != PollStatus::ok || reading.value < best.value
                                : reading.status < best.status;  // ok < retry < gone
        if (better) best = reading;
      }
      out[i] = best;
    }
  }

 private:
  FileGroups groups_;
};

Listing list_zones(const Root& root) {
  Listing listing;
  for (const int depth : {0, 2})  // the class's own links first
    list_zones_in(root, std::string(class_dir), depth, listing);
  std::stable_sort(listing.zones.begin(), listing.zones.end(),
                   [](const Zone& a, const Zone& b) { return rank(a.control) < rank(b.control); });
  return listing;
}

std::vector<Domain> group_zones(const std::vector<Zone>& zones) {
  const auto parent_name = [&](const Zone& part) -> std::string {
    for (const Zone& zone : zones)
      if (!zone.is_part() && zone.control == part.control && zone.id == part.parent_id())
        return zone.name;
    return part.parent_id();
  };
  std::vector<std::string> packages;
  for (const Zone& zone : zones)
    if (!zone.is_part() && zone.name.starts_with("package") &&
        std::find(packages.begin(), packages.end(), zone.name) == packages.end())
      packages.push_back(zone.name);

  std::vector<Domain> domains;
  for (const Zone& zone : zones) {
    std::string name = zone.name;
    if (zone.is_part() && packages.size() > 1) name = parent_name(zone) + '.' + name;
    auto domain = std::find_if(domains.begin(), domains.end(),
                               [&](const Domain& known) { return known.name == name; });
    if (domain == domains.end())
      domain = domains.insert(domain, Domain{std::move(name), zone.is_part(), {}});
    domain->zones.push_back(zone);
  }
  return domains;
}

void discover_energy(const Root& root, const std::vector<Domain>& domains, Discovery& discovery) {
  std::vector<FileChannel> rows;
  std::vector<std::string> forbidden;
  for (const Domain& domain : domains) {
    const std::string name = fmt::format("rapl.{}.energy", domain.name);
    if (discovery.has_channel(name)) continue;  // perf gives it already
    std::vector<CheckedFile> refused;
    bool found = false;
    for (const Zone& zone : domain.zones) {
      CheckedFile energy = check_int_file(root, zone.path + "/energy_uj");
      if (!energy.problem.empty()) {
        refused.push_back(std::move(energy));
        continue;
      }
      Channel channel;
      channel.name = name;
      channel.quantity = Quantity::energy;
      channel.unit = Unit::microjoule;
      channel.kind = Kind::cumulative;
      const CheckedFile range = check_int_file(root, zone.path + "/max_energy_range_uj");
      if (range.value && *range.value > 0) channel.wrap_at = range.value;
      rows.push_back({std::move(channel), std::move(energy.file)});
      found = true;
      break;
    }
    if (found) continue;
    for (const CheckedFile& energy : refused) {
      if (energy.error == EACCES || energy.error == EPERM)
        forbidden.push_back(energy.file.path());
      else
        discovery.missing.push_back({"powercap", energy.problem, ""});
    }
  }
  add_file_source(discovery, "powercap", energy_period_ns, std::move(rows));
  if (forbidden.empty()) return;
  // Since Linux 5.10 the counters are for root only: CVE-2020-8694 (PLATYPUS).
  std::string fix = "sudo chmod a+r";
  for (const std::string& path : forbidden) fix += ' ' + path;
  discovery.missing.push_back(
      {"powercap",
       fmt::format("cannot read '{}'{}: Permission denied; the kernel lets only root read energy",
                   forbidden.front(),
                   forbidden.size() > 1 ? fmt::format(" and {} more", forbidden.size() - 1) : ""),
       std::move(fix)});
}

// constraint_N_power_limit_uw of the constraint called `name`, if it limits anything.
std::optional<CheckedFile> limit_file(const Root& root, const Zone& zone, std::string_view name) {
  if (root.read_line(zone.path + "/enabled") == "0") return std::nullopt;
  for (int i = 0;; ++i) {
    const auto constraint = root.read_line(fmt::format("{}/constraint_{}_name", zone.path, i));
    if (!constraint) return std::nullopt;
    if (*constraint != name) continue;
    CheckedFile file =
        check_int_file(root, fmt::format("{}/constraint_{}_power_limit_uw", zone.path, i));
    if (!file.value || *file.value <= 0) return std::nullopt;
    return file;
  }
}

void discover_limits(const Root& root, const std::vector<Domain>& domains, Discovery& discovery) {
  std::vector<Channel> channels;
  LimitSource::FileGroups groups;
  for (const Domain& domain : domains) {
    if (domain.is_part) continue;
    for (const Limit& limit : limits) {
      std::vector<TextFile> files;
      std::string origin;
      for (const Zone& zone : domain.zones) {
        std::optional<CheckedFile> file = limit_file(root, zone, limit.constraint);
        if (!file) continue;
        origin += fmt::format("{}{} ({} uW)", origin.empty() ? "" : ", ", file->file.path(),
                              *file->value);
        files.push_back(std::move(file->file));
      }
      if (files.empty()) continue;
      Channel channel;
      channel.name = fmt::format("rapl.{}.{}", domain.name, limit.suffix);
      channel.quantity = Quantity::limit;
      channel.unit = Unit::microwatt;
      channel.origin = files.size() > 1 ? "lowest of " + origin : origin;
      channels.push_back(std::move(channel));
      groups.push_back(std::move(files));
    }
  }
  if (!channels.empty())
    discovery.sources.push_back(
        std::make_unique<LimitSource>(std::move(channels), std::move(groups)));
}

Missing explain_absence(const Root& root, const std::string& hidden_zone) {
  if (!hidden_zone.empty())
    return {"powercap",
            fmt::format("'{}' is listed but cannot be entered: container runtimes mask it",
                        root.display(hidden_zone)),
            "docker run --security-opt systempaths=unconfined ..."};
  const std::string where = root.display(class_dir);
  const std::string cpu = root.read("proc/cpuinfo").text.value_or("");
  if (cpu.find("hypervisor") != std::string::npos)
    return {"powercap",
            fmt::format("no RAPL zone in '{}': a virtual machine's host keeps its energy counters "
                        "to itself",
                        where),
            ""};
  const bool has_rapl = cpu.find("GenuineIntel") != std::string::npos ||
                        cpu.find("AuthenticAMD") != std::string::npos;
  return {"powercap", fmt::format("no RAPL zone in '{}'", where),
          has_rapl ? "sudo modprobe intel_rapl_msr" : ""};
}

}  // namespace

void discover_powercap(const Root& root, Discovery& discovery) {
  const Listing listing = list_zones(root);
  for (const std::string& path : listing.forbidden)
    discovery.missing.push_back(
        {"powercap", fmt::format("cannot enter '{}': {}", path, errno_text(EACCES)), ""});
  if (listing.zones.empty()) {
    if (!listing.forbidden.empty()) return;
    discovery.missing.push_back(explain_absence(root, listing.hidden));
    return;
  }
  const std::vector<Domain> domains = group_zones(listing.zones);
  discover_energy(root, domains, discovery);
  discover_limits(root, domains, discovery);
}

}  // namespace energyprof::probe
