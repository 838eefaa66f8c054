/// What every builder returns.
#pragma once

#include "core/accel_blob.h"

namespace energyprof::accel {

struct Built {
  AccelBlob blob;
  BuildStats stats;
};

}  // namespace energyprof::accel
