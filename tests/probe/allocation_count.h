/// How often the calling thread has allocated: this test program replaces operator new.
#pragma once

#include <cstdint>

namespace energyprof::probe {

int64_t allocation_count();

}  // namespace energyprof::probe
