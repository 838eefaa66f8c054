// `energyprof probe`: what can be sensed here, what cannot, why, and the fix.

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>

#include "app/commands.h"
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
      probed.push_back({&channels[i], ok ? std::optional(readings[i].value) : std::nullopt});
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

/// The Vulkan devices, or why there are none.
json devices_json() {
  json devices = json::array();
  try {
    const kernels::DeviceList list = kernels::list_devices();
    for (const kernels::DeviceInfo& info : list.usable)
      devices.push_back({{"name", info.name},
                         {"type", info.type},
                         {"driver", info.driver_name + " " + info.driver_info},
                         {"refused", nullptr}});
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
         {"wakes_device", channel.wakes_device},
         {"gpu", channel.gpu.empty() ? json(nullptr) : json(channel.gpu)},
         {"origin", channel.origin}};
  if (channel.limit) j["limit"] = *channel.limit;
  return j;
}

void print_json(const probe::Discovery& discovery, const std::vector<ProbedChannel>& probed) {
  json channels = json::array();
  for (const ProbedChannel& channel : probed) channels.push_back(channel_json(channel));
  json missing = json::array();
  for (const probe::Missing& m : discovery.missing)
    missing.push_back({{"source", m.source},
                       {"reason", m.reason},
                       {"fix", m.fix.empty() ? json(nullptr) : json(m.fix)}});
  const json output{{"schema_version", schema_version},
                    {"verdict", probe::verdict(discovery)},
                    {"channels", channels},
                    {"missing", missing},
                    {"devices", devices_json()}};
  fmt::print("{}\n", output.dump(2, ' ', false, json::error_handler_t::replace));
}

/// A channel's name with every number replaced: channels of the same pattern differ only by core,
/// CPU or zone.
std::string pattern_of(const std::string& name) {
  std::string pattern;
  for (const char c : name) {
    const bool is_digit = c >= '0' && c <= '9';
    if (!is_digit)
      pattern += c;
    else if (!pattern.ends_with('#'))
      pattern += '#';
  }
  return pattern;
}

/// Lines of the table: channels that differ only by numbers, and in nothing else that is shown.
std::vector<std::vector<ProbedChannel>> fold(const std::vector<ProbedChannel>& probed, bool all) {
  constexpr size_t fewest_folded = 4;
  std::map<std::pair<Quantity, std::string>, std::vector<ProbedChannel>> groups;
  for (const ProbedChannel& channel : probed)
    groups[{channel.channel->quantity, pattern_of(channel.channel->name)}].push_back(channel);
  std::vector<std::vector<ProbedChannel>> lines;
  for (const ProbedChannel& channel : probed) {
    auto& group = groups[{channel.channel->quantity, pattern_of(channel.channel->name)}];
    if (all || group.size() < fewest_folded)
      lines.push_back({channel});
    else if (group.front().channel == channel.channel)
      lines.push_back(group);
  }
  return lines;
}

std::string range_text(const std::vector<ProbedChannel>& line) {
  std::optional<int64_t> low;
  std::optional<int64_t> high;
  for (const ProbedChannel& channel : line) {
    if (!channel.value) continue;
    low = std::min(low.value_or(*channel.value), *channel.value);
    high = std::max(high.value_or(*channel.value), *channel.value);
  }
  if (!low) return "no value";
  return *low == *high ? fmt::format("{}", *low) : fmt::format("{} .. {}", *low, *high);
}

void print_line(const std::vector<ProbedChannel>& line) {
  const Channel& first = *line.front().channel;
  const std::string name =
      line.size() == 1 ? first.name
                       : fmt::format("{} ({} of them)", pattern_of(first.name), line.size());
  const auto microseconds = [](const std::optional<int64_t>& ns) {
    return ns ? fmt::format("{:.2f}", static_cast<double>(*ns) * 1e-3) : std::string("-");
  };
  fmt::print("  {:<44} {:>22} {:<8} {:>12} {:>9.1f} {:>8}  {}\n", name, range_text(line),
             unit_info(first.unit).name, first.limit ? fmt::format("{}", *first.limit) : "-",
             static_cast<double>(first.period_ns) * 1e-6, microseconds(first.read_cost_ns),
             line.size() == 1 ? first.origin : fmt::format("{} ...", first.origin));
}

void print_text(const probe::Discovery& discovery, const std::vector<ProbedChannel>& probed,
                bool all) {
  std::optional<Quantity> quantity;
  for (const std::vector<ProbedChannel>& line : fold(probed, all)) {
    const Quantity of_line = line.front().channel->quantity;
    if (quantity != of_line)
      fmt::print("{}{:<46} {:>22} {:<8} {:>12} {:>9} {:>8}  where\n", quantity ? "\n" : "",
                 to_string(of_line), "now", "unit", "limit", "every ms", "cost us");
    quantity = of_line;
    print_line(line);
  }
  if (!discovery.missing.empty()) fmt::print("\nnot seen\n");
  for (const probe::Missing& m : discovery.missing) {
    fmt::print("  {:<17} {}\n", m.source, m.reason);
    if (!m.fix.empty()) fmt::print("  {:<17} fix: {}\n", "", m.fix);
  }
  fmt::print("\nVulkan devices\n");
  for (const json& device : devices_json()) {
    const std::string name = device["name"].is_null() ? "none" : device["name"].get<std::string>();
    if (device["refused"].is_null())
      fmt::print("  {} ({}, {})\n", name, device["type"].get<std::string>(),
                 device["driver"].get<std::string>());
    else
      fmt::print("  {}: {}\n", name, device["refused"].get<std::string>());
  }
  fmt::print("\n{}\n", probe::verdict(discovery));
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
    print_json(discovery, probed);
  else
    print_text(discovery, probed, options.all);
  return 0;
}

}  // namespace energyprof::app
