// `energyprof probe`: what can be sensed here, what cannot, why, and the fix.

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
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

void print_json(const probe::Discovery& discovery, const std::vector<ProbedChannel>& probed) {
  json channels = json::array();
  for (const auto& [channel, value] : probed)
    channels.push_back({{"name", channel->name},
                        {"source", channel->source},
                        {"quantity", to_string(channel->quantity)},
                        {"unit", unit_info(channel->unit).name},
                        {"kind", to_string(channel->kind)},
                        {"value", or_null(value)},
                        {"period_ns", channel->period_ns},
                        {"read_cost_ns", or_null(channel->read_cost_ns)},
                        {"origin", channel->origin}});
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

void print_text(const probe::Discovery& discovery, const std::vector<ProbedChannel>& probed) {
  fmt::print("{:<13} {:<40} {:>16} {:<8} {:>9} {:>9}\n", "quantity", "channel", "now", "unit",
             "every ms", "cost us");
  for (const auto& [channel, value] : probed)
    fmt::print("{:<13} {:<40} {:>16} {:<8} {:>9.1f} {:>9}\n", to_string(channel->quantity),
               channel->name, value ? fmt::format("{}", *value) : "no value",
               unit_info(channel->unit).name, static_cast<double>(channel->period_ns) * 1e-6,
               channel->read_cost_ns
                   ? fmt::format("{:.2f}", static_cast<double>(*channel->read_cost_ns) * 1e-3)
                   : "-");
  if (!discovery.missing.empty()) fmt::print("\nnot seen\n");
  for (const probe::Missing& m : discovery.missing) {
    fmt::print("  {:<12} {}\n", m.source, m.reason);
    if (!m.fix.empty()) fmt::print("  {:<12} fix: {}\n", "", m.fix);
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
  probe::Discovery discovery = probe::discover(root);
  probe::characterize(discovery, root);
  const std::vector<ProbedChannel> probed = poll_once(discovery);
  if (options.json)
    print_json(discovery, probed);
  else
    print_text(discovery, probed);
  return 0;
}

}  // namespace energyprof::app
