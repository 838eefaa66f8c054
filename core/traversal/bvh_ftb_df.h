// BVH_FTB_DF: depth-first BVH, front to back with a stack. Of two children, both tested together,
// the one on the side that the ray comes from, along the split axis, is visited first. "Shallow
// Bounding Volume Hierarchies for Fast SIMD Ray Tracing of Incoherent Rays", H. Dammertz, J.
// Hanika, A. Keller, Computer Graphics Forum 27(4), 2008.
#ifndef ENERGYPROF_TRAVERSAL_BVH_FTB_DF_H
#define ENERGYPROF_TRAVERSAL_BVH_FTB_DF_H

EP_FN Hit trace_bvh_ftb_df(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = ray.inv_d;
  // Number and words of a node are pushed, so that it need not be loaded again.
  uint stack_id[stack_size];
  uint stack_word[stack_size];
  uint stack_link[stack_size];
  uint entry_count = 0u;
  count_step();
  count_node_visit();
  count_box_test();
  BvhNode root = load_bvh_node(0u);
  uint node_id = 0u;
  int word = floatBitsToInt(root.min_link.w);
  uint link = floatBitsToUint(root.max_link.w);
  bool running = enter_box(xyz(root.min_link), xyz(root.max_link), ray.origin, inv_d, ray.t_min,
                           best.t) >= 0.0f;
  while (running) {
    count_step();
    bool finished = true;  // with this node and what is below it
    if (word < 0) {
      bool left_is_near = ray.direction[-word - 1] >= 0.0f;
      uint near_id = left_is_near ? node_id + 1u : link;
      uint far_id = left_is_near ? link : node_id + 1u;
      count_node_visit();
      count_box_test();
      BvhNode a = load_bvh_node(near_id);
      bool hit_a =
          enter_box(xyz(a.min_link), xyz(a.max_link), ray.origin, inv_d, ray.t_min, best.t) >= 0.0f;
      count_node_visit();
      count_box_test();
      BvhNode b = load_bvh_node(far_id);
      bool hit_b =
          enter_box(xyz(b.min_link), xyz(b.max_link), ray.origin, inv_d, ray.t_min, best.t) >= 0.0f;
      if (hit_a && hit_b) {
        stack_id[entry_count] = far_id;
        stack_word[entry_count] = floatBitsToUint(b.min_link.w);
        stack_link[entry_count] = floatBitsToUint(b.max_link.w);
        entry_count++;
      }
      finished = !hit_a && !hit_b;
      node_id = hit_a ? near_id : far_id;
      word = floatBitsToInt(hit_a ? a.min_link.w : b.min_link.w);
      link = floatBitsToUint(hit_a ? a.max_link.w : b.max_link.w);
    } else {
      best = test_leaf(best, ray, uint(word), link);
    }
    if (finished) {
      running = entry_count != 0u;
      if (running) {
        entry_count--;
        node_id = stack_id[entry_count];
        word = int(stack_word[entry_count]);
        link = stack_link[entry_count];
      }
    }
  }
  return best;
}

#endif
