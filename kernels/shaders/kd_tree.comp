// KD_TREE: core/traversal/kd_tree.h on the device.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require

#include "kernels/shaders/scene.glsl"
#include "kernels/shaders/kd_nodes.glsl"
#include "core/traversal/kd_tree.h"
#define TRACE trace_kd_tree
#include "kernels/shaders/main.glsl"
