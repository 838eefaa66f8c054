// Nodes of a BVH.
#ifndef ENERGYPROF_BVH_NODES_GLSL
#define ENERGYPROF_BVH_NODES_GLSL

layout(std430, binding = 0) readonly buffer Nodes { BvhNode nodes[]; };

BvhNode load_bvh_node(uint i) { return BvhNode(nodes[i].min_link, nodes[i].max_link); }
uvec2 load_bvh_links(uint i) {
  return uvec2(floatBitsToUint(nodes[i].min_link.w), floatBitsToUint(nodes[i].max_link.w));
}

#endif
