// KD_STACK: the kd-tree with a stack of the far children still to be visited.
// "Heuristic Ray Shooting Algorithms", V. Havran, PhD thesis, Czech Technical University, 2000.
#ifndef ENERGYPROF_TRAVERSAL_KD_STACK_H
#define ENERGYPROF_TRAVERSAL_KD_STACK_H

EP_FN Hit trace_kd_stack(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = ray.inv_d;
  count_box_test();
  vec2 scene = box_span(xyz(constants.bounds_min), xyz(constants.bounds_max), ray.origin, inv_d,
                        ray.t_min, ray.t_max);
  float t_min = scene.x;
  float t_max = scene.y;
  uint stack[stack_size];
  float stack_t[stack_size];  // where the ray leaves the node of that entry
  uint entry_count = 0u;
  uint node_id = 0u;
  bool running = scene.x <= scene.y;
  while (running) {
    count_step();
    count_node_visit();
    KdNode node = load_kd_node(node_id);
    if ((node.word & 3u) != kd_leaf) {
      KdSplit split = kd_split(ray, inv_d, node_id, node);
      bool far_only = split.t > 0.0f && split.t <= t_min;
      if (split.t > t_min && split.t <= t_max) {
        stack[entry_count] = split.far_id;
        stack_t[entry_count] = t_max;
        entry_count++;
        t_max = split.t;
      }
      node_id = far_only ? split.far_id : split.near_id;
    } else {
      best = test_leaf(best, ray, node.plane_or_first, node.word >> 2u);
      running = entry_count != 0u && widened(best.t) >= t_max;
      if (running) {
        entry_count--;
        t_min = t_max;
        t_max = stack_t[entry_count];
        node_id = stack[entry_count];
      }
    }
  }
  return best;
}

#endif
