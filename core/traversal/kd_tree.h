// KD_TREE: kd-restart. Without a stack: after each leaf the search starts at the root again, for
// the leaf behind it. "KD-Tree Acceleration Structures for a GPU Raytracer", T. Foley and J.
// Sugerman, Graphics Hardware 2005.
#ifndef ENERGYPROF_TRAVERSAL_KD_TREE_H
#define ENERGYPROF_TRAVERSAL_KD_TREE_H

EP_FN Hit trace_kd_tree(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = ray.inv_d;
  count_box_test();
  vec2 scene = box_span(xyz(constants.bounds_min), xyz(constants.bounds_max), ray.origin, inv_d,
                        ray.t_min, ray.t_max);
  float t_min = scene.x;
  bool running = scene.x <= scene.y;
  while (running) {
    // Down to the leaf at t_min; t_max is where the ray leaves it.
    float t_max = scene.y;
    uint node_id = 0u;
    count_node_visit();
    KdNode node = load_kd_node(0u);
    while ((node.word & 3u) != kd_leaf) {
      count_step();
      KdSplit split = kd_split(ray, inv_d, node_id, node);
      bool far_only = split.t > 0.0f && split.t <= t_min;
      if (split.t > t_min) t_max = min(t_max, split.t);
      node_id = far_only ? split.far_id : split.near_id;
      count_node_visit();
      node = load_kd_node(node_id);
    }
    count_step();
    best = test_leaf(best, ray, node.plane_or_first, node.word >> 2u);
    running = widened(best.t) >= t_max && t_max < scene.y;
    t_min = t_max;
  }
  return best;
}

#endif
