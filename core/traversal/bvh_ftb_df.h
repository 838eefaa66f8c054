// BVH_FTB_DF: depth-first BVH, front to back with a stack. Of two children the one on the side that
// the ray comes from, along the split axis, is visited first and the other one is pushed.
// "Shallow Bounding Volume Hierarchies for Fast SIMD Ray Tracing of Incoherent Rays", H. Dammertz,
// J. Hanika, A. Keller, Computer Graphics Forum 27(4), 2008.
#ifndef ENERGYPROF_TRAVERSAL_BVH_FTB_DF_H
#define ENERGYPROF_TRAVERSAL_BVH_FTB_DF_H

EP_FN Hit trace_bvh_ftb_df(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = inverse_direction(ray.direction);
  uint stack[stack_size];
  stack[0] = no_node;
  uint entry_count = 1u;
  uint node_id = 0u;
  while (node_id != no_node) {
    count_step();
    count_node_visit();
    count_box_test();
    BvhNode node = load_bvh_node(node_id);
    int word = floatBitsToInt(node.min_link.w);
    uint link = floatBitsToUint(node.max_link.w);
    bool hit = enter_box(xyz(node.min_link), xyz(node.max_link), ray.origin, inv_d, ray.t_min,
                         best.t) >= 0.0f;
    if (hit && word >= 0) best = test_leaf(best, ray, uint(word), link);
    if (hit && word < 0) {
      uint left = node_id + 1u;
      bool left_is_near = ray.direction[-word - 1] >= 0.0f;
      stack[entry_count++] = left_is_near ? link : left;
      node_id = left_is_near ? left : link;
    } else {
      node_id = stack[--entry_count];
    }
  }
  return best;
}

#endif
