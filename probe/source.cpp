#include "probe/source.h"

#include <utility>

namespace energyprof::probe {

SensorSource::SensorSource(std::string name, int64_t period_ns, std::vector<Channel> channels)
    : name_(std::move(name)), period_ns_(period_ns), channels_(std::move(channels)) {
  for (Channel& channel : channels_) {
    channel.source = name_;
    channel.period_ns = period_ns_;
  }
}

}  // namespace energyprof::probe
