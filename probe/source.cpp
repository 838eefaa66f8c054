#include "probe/source.h"

#include <algorithm>
#include <utility>

namespace energyprof::probe {

Channel make_channel(std::string name, Quantity quantity, Unit unit, Kind kind,
                     std::string origin) {
  Channel channel;
  channel.name = std::move(name);
  channel.quantity = quantity;
  channel.unit = unit;
  channel.kind = kind;
  channel.origin = std::move(origin);
  return channel;
}

SensorSource::SensorSource(std::string name, int64_t period_ns, std::vector<Channel> channels,
                           SourceTraits traits)
    : name_(std::move(name)),
      period_ns_(period_ns),
      channels_(std::move(channels)),
      traits_(std::move(traits)) {
  for (Channel& channel : channels_) {
    channel.source = name_;
    channel.period_ns = period_ns_;
    channel.wakes_device = traits_.wakes_device;
    channel.gpu = traits_.gpu;
  }
}

void SensorSource::set_period_ns(int64_t period_ns) {
  period_ns_ = period_ns;
  for (Channel& channel : channels_) channel.period_ns = period_ns;
}

bool Discovery::has_channel(std::string_view name) const {
  return std::any_of(sources.begin(), sources.end(), [&](const auto& source) {
    const std::span<const Channel> channels = std::as_const(*source).channels();
    return std::any_of(channels.begin(), channels.end(),
                       [&](const Channel& channel) { return channel.name == name; });
  });
}

}  // namespace energyprof::probe
