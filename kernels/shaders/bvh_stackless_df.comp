// BVH_STACKLESS_DF: core/traversal/bvh_stackless_df.h on the device.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require

#include "kernels/shaders/scene.glsl"
#include "kernels/shaders/bvh_nodes.glsl"
#include "core/traversal/bvh_stackless_df.h"
#define TRACE trace_bvh_stackless_df
#include "kernels/shaders/main.glsl"
