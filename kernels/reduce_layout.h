// What reduce.comp and the runner share: compiled by both C++ and GLSL, like core/gpu_layout.h.
#ifndef ENERGYPROF_REDUCE_LAYOUT_H
#define ENERGYPROF_REDUCE_LAYOUT_H

#include "core/gpu_layout.h"

#ifdef __cplusplus
namespace energyprof::gpu {
#endif

// Threads of a workgroup, and pixels that one thread sums up.
const uint reduce_workgroup_size = 64u;
const uint reduce_pixels_per_thread = 256u;

struct ReduceConstants {
  uint pixel_count;
  uint thread_count;
};

// Sums over the pixels of one thread; the host adds them up.
struct ReducePartial {
  uint hit_count;
  uint ray_count;
  uint checksum_x;  // modulo 2^32
  uint checksum_y;
};

#ifdef __cplusplus
static_assert(sizeof(ReduceConstants) == 8);
static_assert(sizeof(ReducePartial) == 16);
}  // namespace energyprof::gpu
#endif

#endif
