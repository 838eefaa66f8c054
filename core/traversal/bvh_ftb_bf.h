// BVH_FTB_BF: breadth-first BVH, front to back with a stack. Both children, which lie side by side,
// are tested together; the nearer one is visited first and the other one is pushed.
// "Fast Construction of SAH BVHs on the Intel Many Integrated Core (MIC) Architecture", I. Wald,
// IEEE TVCG 18(1), 2012, and Embree: "A Kernel Framework for Efficient CPU Ray Tracing", I. Wald et
// al., ACM TOG 33(4), 2014.
#ifndef ENERGYPROF_TRAVERSAL_BVH_FTB_BF_H
#define ENERGYPROF_TRAVERSAL_BVH_FTB_BF_H

EP_FN Hit trace_bvh_ftb_bf(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = ray.inv_d;
  // Both words of a node are pushed, so that it need not be loaded again.
  uint stack_word[stack_size];
  uint stack_link[stack_size];
  uint entry_count = 0u;
  count_step();
  count_node_visit();
  count_box_test();
  BvhNode root = load_bvh_node(0u);
  int word = floatBitsToInt(root.min_link.w);
  uint link = floatBitsToUint(root.max_link.w);
  bool running = enter_box(xyz(root.min_link), xyz(root.max_link), ray.origin, inv_d, ray.t_min,
                           best.t) >= 0.0f;
  while (running) {
    count_step();
    bool finished = true;  // with this node and what is below it
    if (word < 0) {
      count_node_visit();
      count_box_test();
      BvhNode a = load_bvh_node(link);
      float enter_a =
          enter_box(xyz(a.min_link), xyz(a.max_link), ray.origin, inv_d, ray.t_min, best.t);
      count_node_visit();
      count_box_test();
      BvhNode b = load_bvh_node(link + 1u);
      float enter_b =
          enter_box(xyz(b.min_link), xyz(b.max_link), ray.origin, inv_d, ray.t_min, best.t);
      bool b_is_next = enter_a < 0.0f || (enter_b >= 0.0f && enter_b < enter_a);
      if (enter_a >= 0.0f && enter_b >= 0.0f) {
        stack_word[entry_count] = floatBitsToUint(b_is_next ? a.min_link.w : b.min_link.w);
        stack_link[entry_count] = floatBitsToUint(b_is_next ? a.max_link.w : b.max_link.w);
        entry_count++;
      }
      finished = enter_a < 0.0f && enter_b < 0.0f;
      word = floatBitsToInt(b_is_next ? b.min_link.w : a.min_link.w);
      link = floatBitsToUint(b_is_next ? b.max_link.w : a.max_link.w);
    } else {
      best = test_leaf(best, ray, uint(word), link);
    }
    if (finished) {
      running = entry_count != 0u;
      if (running) {
        entry_count--;
        word = int(stack_word[entry_count]);
        link = stack_link[entry_count];
      }
    }
  }
  return best;
}

#endif
