// Sums up a traced frame: rays, hits, checksum. Runs after the frame's end timestamp, untimed.
#version 460
#extension GL_GOOGLE_include_directive : require

#include "core/gpu_layout.h"
#include "core/trace_math.h"
#include "kernels/reduce_layout.h"

layout(local_size_x = 64, local_size_y = 1, local_size_z = 1) in;  // reduce_workgroup_size

layout(std430, binding = 3) readonly buffer Hits { PixelHits hits[]; };
layout(std430, binding = 5) writeonly buffer Partials { ReducePartial partials[]; };
layout(push_constant) uniform Constants { ReduceConstants constants; };

void main() {
  uint thread = gl_GlobalInvocationID.x;
  if (thread >= constants.thread_count) return;

  ReducePartial sum = ReducePartial(0u, 0u, 0u, 0u);
  // Neighbouring threads read neighbouring pixels.
  for (uint pixel = thread; pixel < constants.pixel_count; pixel += constants.thread_count) {
    PixelHits seen = hits[pixel];
    bool bounced = seen.bounce_id != ray_absent;
    sum.ray_count += bounced ? 2u : 1u;
    sum.hit_count += seen.primary_id != 0u ? 1u : 0u;
    sum.hit_count += bounced && seen.bounce_id != 0u ? 1u : 0u;
    uvec2 terms = checksum_terms(pixel, seen);
    sum.checksum_x += terms.x;
    sum.checksum_y += terms.y;
  }
  partials[thread] = sum;
}
