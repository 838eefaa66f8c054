// What the two kd-tree traversals share: the plane of a node, seen from a ray.
#ifndef ENERGYPROF_TRAVERSAL_KD_H
#define ENERGYPROF_TRAVERSAL_KD_H

struct KdSplit {
  float t;  // where the ray meets the plane; <= 0 if it never does
  uint near_id;
  uint far_id;
};

EP_FN KdSplit kd_split(Ray ray, vec3 inv_d, uint node_id, KdNode node) {
  uint axis = node.word & 3u;
  float origin = axis == 0u ? ray.origin.x : axis == 1u ? ray.origin.y : ray.origin.z;
  float inverse = axis == 0u ? inv_d.x : axis == 1u ? inv_d.y : inv_d.z;
  float distance = uintBitsToFloat(node.plane_or_first) - origin;
  // An origin in the plane belongs to the side that the ray goes to.
  bool below_is_near = distance > 0.0f || (distance == 0.0f && inverse < 0.0f);
  uint below = node_id + 1u;
  uint above = node.word >> 2u;
  KdSplit split;
  split.t = distance * inverse;
  split.near_id = below_is_near ? below : above;
  split.far_id = below_is_near ? above : below;
  return split;
}

#endif
