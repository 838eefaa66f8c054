// What the traversals of core/traversal/ need on the device: buffers, constants, counters, loads.
// Each kernel includes this, its nodes, its traversal, and last main.glsl.
#ifndef ENERGYPROF_SCENE_GLSL
#define ENERGYPROF_SCENE_GLSL

#include "core/gpu_layout.h"
#include "core/trace_math.h"

layout(local_size_x = 8, local_size_y = 8, local_size_z = 1) in;
layout(local_size_x_id = 0, local_size_y_id = 1) in;
layout(constant_id = 2) const bool count_work = false;  // counted frames only, never timed ones
layout(constant_id = 3) const uint stack_size = 64u;    // entries; the host makes it deep enough
layout(constant_id = 4) const bool has_refs = false;    // leaves are lists in refs
// Workgroup rows are handed out in the order 0, n, 2 n, ..., 1, n + 1, ...: Mesa's CPU driver gives
// each of its threads one run of workgroups, and so each a part of every region of the image.
layout(constant_id = 5) const uint row_interleave = 1u;

layout(std430, binding = 1) readonly buffer Refs { uint refs[]; };
layout(std430, binding = 2) readonly buffer Triangles { Triangle triangles[]; };
layout(std430, binding = 3) writeonly buffer Hits { PixelHits hits[]; };
layout(std430, binding = 4) writeonly buffer Counts { PixelCounts counts[]; };
layout(std430, binding = 6) writeonly buffer Lanes { PixelLanes lanes[]; };
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

// Members are loaded one by one here and in all loads: GPU-assisted validation does not look at loads
// of a whole struct.
uint load_ref(uint i) { return refs[i]; }

// The closer of `best` and the hit of triangle `prim`.
Hit test_triangle(Hit best, Ray ray, uint prim) {
  if (count_work) work.prim_tests++;
  return closer_hit(best, ray, triangles[prim].v0_nx.xyz, triangles[prim].e1_ny.xyz,
                    triangles[prim].e2_nz.xyz, prim);
}

#include "core/traversal/leaf.h"

#endif
