/// The one exception that means exit code 2: wrong usage or a wrong config.
#pragma once

#include <stdexcept>

namespace energyprof::app {

struct UsageError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

}  // namespace energyprof::app
