// Data layouts that C++ and GLSL share: compiled by both. 4-byte scalars and vec4 only, so that
// std430 and the C++ ABI agree. trace_math.h, beside it, shares the arithmetic.
#ifndef ENERGYPROF_GPU_LAYOUT_H
#define ENERGYPROF_GPU_LAYOUT_H

#ifdef __cplusplus
#include <cstdint>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/gtc/type_precision.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
namespace energyprof::gpu {
using glm::uint;
using glm::uvec2;
using glm::uvec4;
using glm::vec2;
using glm::vec3;
using glm::vec4;
#endif

// 32 bytes. The words in .w are integers stored as float bits.
//   min_link.w: inner node: -(split axis + 1); leaf: its first entry in refs, or its only
//   triangle's
//               id where there are no refs (>= 0)
//   max_link.w: inner node: the link, see AccelKind; leaf: its number of triangles
struct BvhNode {
  vec4 min_link;
  vec4 max_link;
};

const uint kd_leaf = 3u;

// 8 bytes. Low two bits of `word`: split axis of an inner node, or kd_leaf.
//   inner node: split plane as float bits; word >> 2: the child above the plane
//   leaf: its first entry in refs;         word >> 2: its number of triangles
struct KdNode {
  uint plane_or_first;
  uint word;
};

// 8 bytes. The triangles of a cell: refs[first .. first + count).
struct GridCell {
  uint count;
  uint first;
};

// 48 bytes. Corner and edges of a triangle; .w of the three hold its normal cross(e1, e2).
struct Triangle {
  vec4 v0_nx;
  vec4 e1_ny;
  vec4 e2_nz;
};

// One frame's constants, a uniform/storage block of vec4 and uint only.
//   A primary ray through pixel (x, y), jitter (jx, jy) in [0, 1):
//   direction = forward + (2 (x + jx) / width - 1) right + (1 - 2 (y + jy) / height) up,
//   normalized, where right and up already carry tan(fov / 2) and the aspect ratio.
struct FrameConstants {
  vec4 origin_tmin;  // camera position, t_min of every ray
  vec4 right_tmax;   // t_max of every ray in .w
  vec4 up;           // cells of the grid along x, y and z in .w of this and the next two
  vec4 forward;
  vec4 bounds_min;  // of the structure
  vec4 bounds_max;
  uint width;
  uint height;
  uint frame;  // jitter and bounce directions differ from frame to frame
  uint seed;
  uint bounce_count;  // 0 or 1 bounces after a hit
  uint first_row;     // this dispatch traces rows [first_row, first_row + row_count)
  uint row_count;
  uint node_count;  // 0: there is nothing to hit
};

// What one pixel saw in one frame: primitive id + 1 of the primary and the bounce ray; 0 is a miss.
// t as float bits. A ray that was not traced (no bounce) has id ray_absent.
struct PixelHits {
  uint primary_id;
  uint primary_t;
  uint bounce_id;
  uint bounce_t;
};

// What one pixel cost in a counted frame, both rays together. A node visit is a node (a cell, in a
// grid) that was looked at; a box test is a ray against a box, a primitive test against a triangle.
struct PixelCounts {
  uint node_visits;
  uint box_tests;
  uint prim_tests;
  uint loop_steps;  // iterations of the traversal's loops
};

// For SIMD efficiency: with whom a pixel's thread ran. A buffer of its own, because 24 bytes a
// pixel in one would not fit small devices at 3840x2160.
struct PixelLanes {
  uint bounce_loop_steps;  // of PixelCounts::loop_steps, the bounce ray's
  uint subgroup;           // the thread's subgroup in its workgroup
};

#ifdef __cplusplus
static_assert(sizeof(BvhNode) == 32);
static_assert(sizeof(KdNode) == 8);
static_assert(sizeof(GridCell) == 8);
static_assert(sizeof(Triangle) == 48);
static_assert(sizeof(FrameConstants) == 128);
static_assert(sizeof(PixelHits) == 16);
static_assert(sizeof(PixelCounts) == 16);
static_assert(sizeof(PixelLanes) == 8);
}  // namespace energyprof::gpu
#endif

#endif
