// GRID: uniform grid, cell by cell along the ray (3D-DDA).
// "ARTS: Accelerated Ray-Tracing System", A. Fujimoto, T. Tanaka, K. Iwata, IEEE CG&A 6(4), 1986.
// The planes are computed from the cell's number at every step, not by adding up: no drift.
#ifndef ENERGYPROF_TRAVERSAL_GRID_H
#define ENERGYPROF_TRAVERSAL_GRID_H

EP_FN Hit trace_grid(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = ray.inv_d;
  vec3 low = xyz(constants.bounds_min);
  vec3 high = xyz(constants.bounds_max);
  count_box_test();
  vec2 scene = box_span(low, high, ray.origin, inv_d, ray.t_min, ray.t_max);

  vec3 size = vec3(constants.up.w, constants.forward.w, constants.bounds_min.w);
  vec3 extent = (high - low) / size;  // of a cell
  vec3 place = (ray.origin + scene.x * ray.direction - low) / extent;
  vec3 last = size - 1.0f;
  vec3 cell = vec3(min(max(floor(place.x), 0.0f), last.x), min(max(floor(place.y), 0.0f), last.y),
                   min(max(floor(place.z), 0.0f), last.z));
  vec3 forth = vec3(inv_d.x < 0.0f ? -1.0f : 1.0f, inv_d.y < 0.0f ? -1.0f : 1.0f,
                    inv_d.z < 0.0f ? -1.0f : 1.0f);
  // The plane through which the ray leaves cell number c: low + (c + ahead) extent.
  vec3 ahead = 0.5f * forth + 0.5f;
  vec3 base = low - ray.origin;
  bool inside = scene.x <= scene.y;
  while (inside) {
    // On to the next cell that holds something: lanes of a subgroup test their triangles together.
    uint first = 0u;
    uint count = 0u;
    float leave = 0.0f;
    while (inside && count == 0u) {
      count_step();
      count_node_visit();
      GridCell content = load_grid_cell(
          uint(cell.x) + uint(size.x) * (uint(cell.y) + uint(size.y) * uint(cell.z)));
      first = content.first;
      count = content.count;
      vec3 t = (base + (cell + ahead) * extent) * inv_d;
      leave = min(t.x, min(t.y, t.z));
      bool through_x = t.x <= leave;
      bool through_y = !through_x && t.y <= leave;
      bool through_z = !through_x && !through_y;
      cell.x += through_x ? forth.x : 0.0f;
      cell.y += through_y ? forth.y : 0.0f;
      cell.z += through_z ? forth.z : 0.0f;
      inside = widened(best.t) >= leave && cell.x >= 0.0f && cell.x <= last.x && cell.y >= 0.0f &&
               cell.y <= last.y && cell.z >= 0.0f && cell.z <= last.z;
    }
    best = test_leaf(best, ray, first, count);
    inside = inside && widened(best.t) >= leave;
  }
  return best;
}

#endif
