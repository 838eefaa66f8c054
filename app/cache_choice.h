/// Which caches are modelled, and where their sizes come from.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "accel/cache_model.h"
#include "app/config.h"
#include "app/host.h"
#include "kernels/device.h"

namespace energyprof::app {

struct CacheChoice {
  accel::CacheModelConfig model;
  /// "config": at least one number of it is in the config; "host": this CPU's, which is the device;
  /// "assumed": neither.
  std::string l1_source;
  std::string llc_source;
};

/// What the config says, else the host's caches where the device is its CPU, else the model's
/// defaults. More ways than a cache has lines: as many as it has lines.
CacheChoice choose_caches(const CacheSettings& settings, const kernels::DeviceInfo& device,
                          const HostCaches& host);

/// What was modelled, for the record: caches, order, pixels.
nlohmann::json describe(const CacheChoice& choice, const accel::CacheModelResult& result);

}  // namespace energyprof::app
