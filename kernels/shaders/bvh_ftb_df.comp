// BVH_FTB_DF: depth-first BVH, front to back with a stack. Of two children the one on the side that
// the ray comes from, along the split axis, is visited first and the other one is pushed.
// "Shallow Bounding Volume Hierarchies for Fast SIMD Ray Tracing of Incoherent Rays", H. Dammertz,
// J. Hanika, A. Keller, Computer Graphics Forum 27(4), 2008.
#version 460
#extension GL_GOOGLE_include_directive : require

#include "kernels/shaders/megakernel.glsl"

layout(std430, binding = 0) readonly buffer Nodes { BvhNode nodes[]; };

Hit trace(Ray ray) {
  Hit best = Hit(ray.t_max, 0u);
  if (constants.node_count == 0u) return best;

  vec3 inv_d = inverse_direction(ray.direction);
  uint stack[stack_size];
  uint entry_count = 0u;
  uint node_id = 0u;
  while (true) {
    count_step();
    count_node_visit();
    count_box_test();
    BvhNode node = nodes[node_id];
    if (enter_box(node.min_link.xyz, node.max_link.xyz, ray.origin, inv_d, ray.t_min, best.t) >= 0.0f) {
      int link = floatBitsToInt(node.min_link.w);
      if (link < 0) {
        uint left = node_id + 1u;
        uint right = floatBitsToUint(node.max_link.w);
        bool left_is_near = ray.direction[-link - 1] >= 0.0f;
        stack[entry_count++] = left_is_near ? right : left;
        node_id = left_is_near ? left : right;
        continue;
      }
      best = test_triangle(best, ray, uint(link));
    }
    if (entry_count == 0u) break;
    node_id = stack[--entry_count];
  }
  return best;
}
