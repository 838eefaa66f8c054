// BVH_STACKLESS_DF: depth-first BVH without a stack. The order is fixed: on a hit the next node, on
// a miss the one behind the subtree.
// "Efficiency Issues for Ray Tracing", B. Smits, Journal of Graphics Tools 3(2), 1998.
#ifndef ENERGYPROF_TRAVERSAL_BVH_STACKLESS_DF_H
#define ENERGYPROF_TRAVERSAL_BVH_STACKLESS_DF_H

EP_FN Hit trace_bvh_stackless_df(Ray ray) {
  Hit best = no_hit(ray);
  vec3 inv_d = ray.inv_d;
  uint node_id = 0u;
  while (node_id < constants.node_count) {
    // On to the next leaf whose box is hit: lanes of a subgroup test their triangles together.
    bool is_leaf = false;
    uint first = 0u;
    uint count = 0u;
    while (node_id < constants.node_count && !is_leaf) {
      count_step();
      count_node_visit();
      count_box_test();
      BvhNode node = load_bvh_node(node_id);
      int word = floatBitsToInt(node.min_link.w);
      uint link = floatBitsToUint(node.max_link.w);
      bool hit = enter_box(xyz(node.min_link), xyz(node.max_link), ray.origin, inv_d, ray.t_min,
                           best.t) >= 0.0f;
      node_id = hit || word >= 0 ? node_id + 1u : link;
      is_leaf = hit && word >= 0;
      first = uint(word);
      count = link;
    }
    if (is_leaf) best = test_leaf(best, ray, first, count);
  }
  return best;
}

#endif
