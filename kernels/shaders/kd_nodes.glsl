// Nodes of a kd-tree.
#ifndef ENERGYPROF_KD_NODES_GLSL
#define ENERGYPROF_KD_NODES_GLSL

layout(std430, binding = 0) readonly buffer Nodes { KdNode nodes[]; };

KdNode load_kd_node(uint i) { return KdNode(nodes[i].plane_or_first, nodes[i].word); }

#include "core/traversal/kd.h"

#endif
