// BVH_FTB_BF: core/traversal/bvh_ftb_bf.h on the device.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require

#include "kernels/shaders/scene.glsl"
#include "kernels/shaders/bvh_nodes.glsl"
#include "core/traversal/bvh_ftb_bf.h"
#define TRACE trace_bvh_ftb_bf
#include "kernels/shaders/main.glsl"
