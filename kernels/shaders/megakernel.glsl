// The part that all traversal kernels share: one thread traces one pixel, primary ray and bounce.
// A kernel includes this file, declares its nodes at binding 0 and defines trace().
#ifndef ENERGYPROF_MEGAKERNEL_GLSL
#define ENERGYPROF_MEGAKERNEL_GLSL

#include "core/gpu_layout.h"
#include "core/trace_math.h"

layout(local_size_x = 8, local_size_y = 8, local_size_z = 1) in;
layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool count_work = false;  // counted frames only, never timed ones
layout(constant_id = 3) const uint stack_size = 64u;    // entries; the host makes it deep enough

layout(std430, binding = 1) readonly buffer Refs { uint refs[]; };
layout(std430, binding = 2) readonly buffer Triangles { Triangle triangles[]; };
layout(std430, binding = 3) writeonly buffer Hits { PixelHits hits[]; };
layout(std430, binding = 4) writeonly buffer Counts { PixelCounts counts[]; };
layout(push_constant) uniform Constants { FrameConstants constants; };

// The work of this thread so far.
PixelCounts work = PixelCounts(0u, 0u, 0u, 0u);

void count_step() {
  if (count_work) work.loop_steps++;
}
void count_node_visit() {
  if (count_work) work.node_visits++;
}
void count_box_test() {
  if (count_work) work.box_tests++;
}

// The closer of `best` and the hit of triangle `prim`.
Hit test_triangle(Hit best, Ray ray, uint prim) {
  if (count_work) work.prim_tests++;
  Triangle triangle = triangles[prim];
  return closer_hit(best, ray, triangle.v0_nx.xyz, triangle.e1_ny.xyz, triangle.e2_nz.xyz, prim);
}

// The closest hit of the ray; given by the kernel.
Hit trace(Ray ray);

void main() {
  uint x = gl_GlobalInvocationID.x;
  uint y = constants.first_row + gl_GlobalInvocationID.y;
  if (x >= constants.width || gl_GlobalInvocationID.y >= constants.row_count) return;
  uint pixel = y * constants.width + x;

  PixelHits seen = PixelHits(0u, 0u, ray_absent, 0u);
  Ray ray = primary_ray(constants, x, y);
  // One loop, so that trace() is compiled once and not once per bounce.
  for (uint bounce = 0u; bounce <= constants.bounce_count; ++bounce) {
    Hit hit = trace(ray);
    if (bounce == 0u) {
      seen.primary_id = hit.prim_id;
      seen.primary_t = floatBitsToUint(hit.t);
    } else {
      seen.bounce_id = hit.prim_id;
      seen.bounce_t = floatBitsToUint(hit.t);
    }
    if (hit.prim_id == 0u || bounce == constants.bounce_count) break;
    Triangle triangle = triangles[hit.prim_id - 1u];
    vec3 normal = vec3(triangle.v0_nx.w, triangle.e1_ny.w, triangle.e2_nz.w);
    ray = bounce_ray(constants, ray, hit.t, normal, pixel);
  }
  hits[pixel] = seen;
  if (count_work) counts[pixel] = work;
}

#endif
