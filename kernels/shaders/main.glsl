// The part that all traversal kernels share: one thread traces one pixel, primary ray and bounce.
// Included last, with TRACE naming the kernel's traversal.
#ifndef ENERGYPROF_MAIN_GLSL
#define ENERGYPROF_MAIN_GLSL

// The row of workgroups that this one traces: see row_interleave.
uint workgroup_row() {
  uint begin = gl_WorkGroupID.y;
  uint per_residue = gl_NumWorkGroups.y / row_interleave;
  uint longer = gl_NumWorkGroups.y % row_interleave;  // residues with one row more
  if (begin < longer * (per_residue + 1u))
    return begin % (per_residue + 1u) * row_interleave + begin / (per_residue + 1u);
  begin -= longer * (per_residue + 1u);
  return begin % per_residue * row_interleave + longer + begin / per_residue;
}

void main() {
  uint x = gl_GlobalInvocationID.x;
  uint tile_y = workgroup_row() * gl_WorkGroupSize.y + gl_LocalInvocationID.y;
  uint y = constants.first_row + tile_y;
  if (x >= constants.width || tile_y >= constants.row_count) return;
  uint pixel = y * constants.width + x;

  PixelHits seen = PixelHits(0u, 0u, ray_absent, 0u);
  uint bounce_steps = 0u;
  Ray ray = primary_ray(constants, x, y);
  // One loop, so that the traversal is compiled once and not once per bounce.
  for (uint bounce = 0u; bounce <= constants.bounce_count; ++bounce) {
    uint steps_before = work.loop_steps;
    Hit hit = no_hit(ray);
    if (constants.node_count != 0u) hit = TRACE(ray);
    if (bounce == 0u) {
      seen.primary_id = hit.prim_id;
      seen.primary_t = floatBitsToUint(hit.t);
    } else {
      seen.bounce_id = hit.prim_id;
      seen.bounce_t = floatBitsToUint(hit.t);
      bounce_steps = work.loop_steps - steps_before;
    }
    if (hit.prim_id == 0u || bounce == constants.bounce_count) break;
    uint prim = hit.prim_id - 1u;
    vec3 normal = vec3(triangles[prim].v0_nx.w, triangles[prim].e1_ny.w, triangles[prim].e2_nz.w);
    ray = bounce_ray(constants, ray, hit.t, normal, pixel);
  }
  hits[pixel] = seen;
  if (count_work) {
    counts[pixel] = work;
    lanes[pixel] = PixelLanes(bounce_steps, gl_SubgroupID);
  }
}

#endif
