// `energyprof probe`: what can be sensed here, what cannot, why, and the fix.

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <tuple>
#include <utility>

#include "analysis/format.h"
#include "app/commands.h"
#include "app/gpu_counters.h"
#include "app/sensors.h"
#include "app/terminal.h"
#include "core/run_db.h"
#include "kernels/device.h"
#include "probe/characterize.h"
#include "probe/discover.h"

namespace energyprof::app {
namespace {

using nlohmann::json;

/// A channel and its value now, if it gave one.
struct ProbedChannel {
  const Channel* channel;
  bool is_slow;
  std::optional<int64_t> value;
};

std::vector<ProbedChannel> poll_once(const probe::Discovery& discovery) {
  std::vector<ProbedChannel> probed;
  for (const auto& source : discovery.sources) {
    const std::span<const Channel> channels = std::as_const(*source).channels();
    std::vector<probe::Reading> readings(channels.size());
    source->poll(readings);
    for (size_t i = 0; i < channels.size(); ++i) {
      const bool ok = readings[i].status == probe::PollStatus::ok;
      probed.push_back({&channels[i], source->traits().slow,
                        ok ? std::optional(readings[i].value) : std::nullopt});
    }
  }
  std::stable_sort(probed.begin(), probed.end(), [](const auto& a, const auto& b) {
    return a.channel->quantity < b.channel->quantity;
  });
  return probed;
}

template <class T>
json or_null(const std::optional<T>& value) {
  return value ? json(*value) : json(nullptr);
}

json counters_json(const kernels::DeviceInfo& info) {
  json counters = json::array();
  for (const kernels::PerformanceCounter& counter : info.performance_counters)
    counters.push_back({{"name", counter.name},
                        {"unit", counter.unit},
                        {"scope", counter.scope},
                        {"description", counter.description},
                        {"counted", counter.is_chosen}});
  return counters;
}

/// The Vulkan devices, or why there are none.
json devices_json(const probe::Root& root) {
  json devices = json::array();
  try {
    const kernels::DeviceList list = kernels::list_devices();
    for (const kernels::DeviceInfo& info : list.usable) {
      const std::string fix = counters_fix(root, info);
      devices.push_back(
          {{"name", info.name},
           {"type", info.type},
           {"driver", info.driver_name + " " + info.driver_info},
           {"performance_counters", counters_json(info)},
           {"no_counters_reason",
            info.no_counters_reason.empty() ? json(nullptr) : json(info.no_counters_reason)},
           {"no_counters_fix", fix.empty() ? json(nullptr) : json(fix)},
           {"refused", nullptr}});
    }
    for (const kernels::DeviceRefusal& refusal : list.unusable)
      devices.push_back({{"name", refusal.name}, {"refused", refusal.reason}});
  } catch (const std::runtime_error& error) {
    devices.push_back({{"name", nullptr}, {"refused", error.what()}});
  }
  return devices;
}

json channel_json(const ProbedChannel& probed) {
  const Channel& channel = *probed.channel;
  json j{{"name", channel.name},
         {"source", channel.source},
         {"quantity", to_string(channel.quantity)},
         {"unit", unit_info(channel.unit).name},
         {"kind", to_string(channel.kind)},
         {"value", or_null(probed.value)},
         {"period_ns", channel.period_ns},
         {"read_cost_ns", or_null(channel.read_cost_ns)},
         {"read_cost_p99_ns", or_null(channel.read_cost_p99_ns)},
         {"update_period_ns", or_null(channel.update_period_ns)},
         {"quantum", or_null(channel.quantum)},
         {"stands_still", channel.stands_still},
         {"slow", probed.is_slow},
         {"wakes_device", channel.wakes_device},
         {"gpu", channel.gpu.empty() ? json(nullptr) : json(channel.gpu)},
         {"origin", channel.origin}};
  if (channel.limit) j["limit"] = *channel.limit;
  if (channel.wrap_at) j["wrap_at"] = *channel.wrap_at;
  return j;
}

/// Why no device is listed: those of this machine are not the other one's.
constexpr const char* no_devices_reason =
    "not under --root: Vulkan knows the devices of this machine only";

void print_json(const probe::Root& root, const probe::Discovery& discovery,
                const std::vector<ProbedChannel>& probed) {
  json channels = json::array();
  for (const ProbedChannel& channel : probed) channels.push_back(channel_json(channel));
  json output{{"schema_version", schema_version},
              {"simulated", !root.is_host()},
              {"verdict", probe::verdict(discovery)},
              {"channels", channels},
              {"missing", missing_json(discovery.missing)}};
  if (root.is_host()) {
    output["devices"] = devices_json(root);
  } else {
    output["root"] = root.directory();
    output["devices"] = json::array();
    output["no_devices_reason"] = no_devices_reason;
  }
  fmt::print("{}\n", output.dump(2, ' ', false, json::error_handler_t::replace));
}

// ------------------------------------------------------------------ text

constexpr size_t page_width = 120;
constexpr size_t name_width = 39;
constexpr size_t origin_width = 24;
constexpr size_t unit_width = 8;
// Channels that differ in their numbers only, as those of cores do, are one line from this many on.
constexpr size_t fewest_to_fold = 4;

/// The end of a long path says more than its beginning.
std::string shortened(const std::string& text, size_t width) {
  return text.size() <= width ? text : "..." + text.substr(text.size() - (width - 3));
}

/// `text` in lines of the page, each after the first behind `indent` spaces.
std::string on_page(std::string_view text, size_t indent) {
  return wrapped(text, indent, page_width);
}

/// "coretemp.core_12.temp" -> "coretemp.core_*.temp"; behind an @ stands which device it is.
std::string without_numbers(std::string_view name) {
  std::string pattern;
  bool is_device = false;
  for (size_t i = 0; i < name.size(); ++i) {
    is_device = name[i] == '@' || (is_device && name[i] != '.');
    if (is_device || std::isdigit(static_cast<unsigned char>(name[i])) == 0)
      pattern += name[i];
    else if (pattern.empty() || pattern.back() != '*')
      pattern += '*';
  }
  return pattern;
}

/// One line of the table: a channel, or several that differ in their numbers only.
using Line = std::vector<const ProbedChannel*>;

std::vector<Line> fold(const std::vector<ProbedChannel>& probed, bool all) {
  std::map<std::tuple<std::string, std::string, Unit, Kind>, Line> groups;
  const auto key = [](const ProbedChannel& one) {
    const Channel& c = *one.channel;
    return std::tuple(c.source, without_numbers(c.name), c.unit, c.kind);
  };
  if (!all)
    for (const ProbedChannel& one : probed) groups[key(one)].push_back(&one);
  std::vector<Line> lines;
  for (const ProbedChannel& one : probed) {
    const auto group = groups.find(key(one));
    if (group == groups.end() || group->second.size() < fewest_to_fold)
      lines.push_back({&one});
    else if (group->second.front() == &one)
      lines.push_back(group->second);
  }
  return lines;
}

/// "1.20 GHz", or "1.20 to 3.40 GHz" of several.
template <class Value>
std::string range_text(const Line& line, Value value_of) {
  std::optional<int64_t> low;
  std::optional<int64_t> high;
  for (const ProbedChannel* one : line)
    if (const std::optional<int64_t> value = value_of(*one)) {
      low = std::min(low.value_or(*value), *value);
      high = std::max(high.value_or(*value), *value);
    }
  if (!low) return "-";
  const std::string_view unit = unit_info(line.front()->channel->unit).name;
  const auto shown = [&](int64_t value) {
    return analysis::scaled_stored(static_cast<double>(value), unit);
  };
  if (*low == *high) return shown(*low);
  std::string from = shown(*low);
  const std::string to = shown(*high);
  if (from == to) return to;
  const size_t unit_at = from.find(' ');
  if (unit_at != std::string::npos && to.ends_with(from.substr(unit_at))) from.resize(unit_at);
  return fmt::format("{} to {}", from, to);
}

void print_line(const Line& line, bool all) {
  const Channel& channel = *line.front()->channel;
  const std::string name = line.size() == 1
                               ? channel.name
                               : fmt::format("{} ({})", without_numbers(channel.name), line.size());
  const std::string now = range_text(line, [](const ProbedChannel& one) { return one.value; });
  const std::string limit =
      range_text(line, [](const ProbedChannel& one) { return one.channel->limit; });
  const std::string rate =
      channel.period_ns > 0 ? analysis::scaled(1e9 / static_cast<double>(channel.period_ns), "Hz")
                            : "-";
  const std::string cost =
      channel.read_cost_ns
          ? fmt::format("{:.2f}", static_cast<double>(*channel.read_cost_ns) * 1e-3)
          : "-";
  const std::string value = limit == "-" ? now : fmt::format("{} / {}", now, limit);
  fmt::print("  {} {} {} {} {}  {}\n", padded(name, name_width),
             padded(all ? channel.origin : shortened(channel.origin, origin_width), origin_width),
             padded(std::string(unit_info(channel.unit).name), unit_width), padded(rate, 8, true),
             padded(cost, 7, true), value);
}

void print_table(const std::vector<ProbedChannel>& probed, bool all) {
  std::optional<Quantity> quantity;
  for (const Line& line : fold(probed, all)) {
    if (line.front()->channel->quantity != quantity) {
      quantity = line.front()->channel->quantity;
      fmt::print("{}{} {} {} {} {}  {}\n", padded(std::string(to_string(*quantity)), 0),
                 padded("", name_width + 1 - to_string(*quantity).size()),
                 padded("where", origin_width), padded("unit", unit_width), padded("rate", 8, true),
                 padded("cost us", 7, true), "now / limit");
    }
    print_line(line, all);
  }
  if (probed.empty()) fmt::print("Nothing can be sensed here.\n");
}

/// Whose reads wake a sleeping GPU, and may just have.
void print_wakers(const std::vector<ProbedChannel>& probed) {
  std::map<std::pair<std::string, std::string>, std::size_t> wakers;  // source, GPU -> channels
  for (const ProbedChannel& one : probed)
    if (one.channel->wakes_device) ++wakers[{one.channel->source, one.channel->gpu}];
  if (wakers.empty()) return;
  std::string text;
  for (const auto& [who, channel_count] : wakers)
    text += fmt::format("{}{} channels of {} of {}", text.empty() ? "" : ", ", channel_count,
                        who.first, who.second);
  fmt::print("\n{}\n",
             on_page(text + ": to read them may wake that GPU, also now; they are left alone while "
                            "a run idles",
                     0));
}

void print_devices(const probe::Root& root) {
  fmt::print("\nVulkan devices\n");
  if (!root.is_host()) return fmt::print("  {}\n", no_devices_reason);
  for (const json& device : devices_json(root)) {
    const std::string name = device["name"].is_null() ? "none" : device["name"].get<std::string>();
    if (!device["refused"].is_null()) {
      fmt::print("  {}\n",
                 on_page(fmt::format("{}: {}", name, device["refused"].get<std::string>()), 2));
      continue;
    }
    fmt::print("  {} ({}, {})\n", name, device["type"].get<std::string>(),
               device["driver"].get<std::string>());
    const json& counters = device["performance_counters"];
    if (counters.empty()) {
      fmt::print(
          "    {}\n",
          on_page("no counters of its own: " + device["no_counters_reason"].get<std::string>(), 4));
      if (!device["no_counters_fix"].is_null())
        fmt::print("    fix: {}\n", device["no_counters_fix"].get<std::string>());
      continue;
    }
    std::string names;
    for (const json& counter : counters)
      if (counter["counted"].get<bool>())
        names += (names.empty() ? "" : ", ") + counter["name"].get<std::string>();
    fmt::print("    {}\n",
               on_page(fmt::format("{} counters of its own; counted after each trial: {}",
                                   counters.size(), names.empty() ? "none" : names),
                       4));
  }
}

void print_text(const probe::Root& root, const probe::Discovery& discovery,
                const std::vector<ProbedChannel>& probed, bool all) {
  if (!root.is_host())
    fmt::print("Simulated: what '{}' tells, not this machine.\n\n", root.directory());
  print_table(probed, all);
  print_wakers(probed);
  if (!discovery.missing.empty()) fmt::print("\nnot seen\n");
  for (const probe::Missing& m : discovery.missing) {
    fmt::print("  {} {}\n", padded(m.source, 16), on_page(m.reason, 19));
    // On one line, however long: it is there to be copied.
    if (!m.fix.empty()) fmt::print("  {} fix: {}\n", padded("", 16), m.fix);
  }
  print_devices(root);
  fmt::print("\n{}\n", on_page(probe::verdict(discovery), 0));
}

}  // namespace

int probe_command(const ProbeOptions& options) {
  const probe::Root root(options.root);
  probe::Selection selection;
  selection.allow_msr = options.allow_msr;
  probe::Discovery discovery = probe::discover(root, selection);
  probe::characterize(discovery, root);
  const std::vector<ProbedChannel> probed = poll_once(discovery);
  if (options.json)
    print_json(root, discovery, probed);
  else
    print_text(root, discovery, probed, options.all);
  return 0;
}

}  // namespace energyprof::app
