// GRID: core/traversal/grid.h on the device.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require

#include "kernels/shaders/scene.glsl"

layout(std430, binding = 0) readonly buffer Nodes { GridCell nodes[]; };
GridCell load_grid_cell(uint i) { return GridCell(nodes[i].count, nodes[i].first); }

#include "core/traversal/grid.h"
#define TRACE trace_grid
#include "kernels/shaders/main.glsl"
