// The arithmetic of a ray, shared by the kernels (GLSL) and the CPU oracle (C++): random numbers,
// camera and bounce rays, box and triangle tests. One text, so that the two cannot drift apart;
// what must round alike on both sides is `precise` (no fused multiply-add) and uses only + - * /
// sqrt.
#ifndef ENERGYPROF_TRACE_MATH_H
#define ENERGYPROF_TRACE_MATH_H

#ifdef __cplusplus
#include <cmath>
#include <cstring>

#include "core/gpu_layout.h"
#define EP_FN inline
#define precise
namespace energyprof::gpu {
inline float sqrt(float x) { return std::sqrt(x); }
inline float abs(float x) { return std::fabs(x); }
inline float min(float a, float b) { return b < a ? b : a; }
inline float max(float a, float b) { return a < b ? b : a; }
inline float floor(float x) { return std::floor(x); }
inline float uintBitsToFloat(uint bits) {
  float x;
  std::memcpy(&x, &bits, sizeof x);
  return x;
}
inline uint floatBitsToUint(float x) {
  uint bits;
  std::memcpy(&bits, &x, sizeof bits);
  return bits;
}
inline int floatBitsToInt(float x) {
  int bits;
  std::memcpy(&bits, &x, sizeof bits);
  return bits;
}
#else
#define EP_FN
#endif

const uint ray_absent = 0xFFFFFFFFu;

struct Ray {
  vec3 origin;
  vec3 direction;  // unit length
  float t_min;
  float t_max;
  vec3 inv_d;  // inverse_direction(direction)
};

struct Hit {
  float t;       // of the closest hit so far; t_max before any
  uint prim_id;  // primitive id + 1; 0 is a miss
};

EP_FN Hit no_hit(Ray ray) {
  Hit hit;
  hit.t = ray.t_max;
  hit.prim_id = 0u;
  return hit;
}

EP_FN vec3 xyz(vec4 v) { return vec3(v.x, v.y, v.z); }

// PCG hash. "Hash Functions for GPU Rendering", M. Jarzynski and M. Olano, JCGT 9(3), 2020.
EP_FN uint hash_u32(uint x) {
  uint state = x * 747796405u + 2891336453u;
  uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return (word >> 22u) ^ word;
}

// Random bits that depend on pixel, frame, seed and dimension only: every kernel draws the same.
EP_FN uint random_bits(uint pixel, uint frame, uint seed, uint dimension) {
  return hash_u32(pixel + hash_u32(frame + hash_u32(seed + hash_u32(dimension))));
}

// [0, 1): 24 random bits, exact in float.
EP_FN float unit_float(uint bits) { return float(bits >> 8u) * 5.9604644775390625e-8f; }

EP_FN float dot3(vec3 a, vec3 b) {
  precise float xy = a.x * b.x + a.y * b.y;
  precise float xyz = xy + a.z * b.z;
  return xyz;
}

EP_FN vec3 cross3(vec3 a, vec3 b) {
  precise float x = a.y * b.z - a.z * b.y;
  precise float y = a.z * b.x - a.x * b.z;
  precise float z = a.x * b.y - a.y * b.x;
  return vec3(x, y, z);
}

// 1 / direction with zeros replaced by +-1e-20: no infinity, so no 0 * inf when a ray lies in a
// slab.
EP_FN float safe_inverse(float d) {
  if (abs(d) >= 1e-20f) return 1.0f / d;
  return (floatBitsToUint(d) >> 31u) != 0u ? -1e20f : 1e20f;
}

EP_FN vec3 inverse_direction(vec3 d) {
  return vec3(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
}

// The primary ray of a pixel, jittered inside it.
EP_FN Ray primary_ray(FrameConstants c, uint x, uint y) {
  uint pixel = y * c.width + x;
  precise float px = float(x) + unit_float(random_bits(pixel, c.frame, c.seed, 0u));
  precise float py = float(y) + unit_float(random_bits(pixel, c.frame, c.seed, 1u));
  precise float sx = 2.0f * px / float(c.width) - 1.0f;
  precise float sy = 1.0f - 2.0f * py / float(c.height);
  precise float dx = c.forward.x + sx * c.right_tmax.x + sy * c.up.x;
  precise float dy = c.forward.y + sx * c.right_tmax.y + sy * c.up.y;
  precise float dz = c.forward.z + sx * c.right_tmax.z + sy * c.up.z;
  vec3 d = vec3(dx, dy, dz);
  precise float length_d = sqrt(dot3(d, d));
  Ray ray;
  ray.origin = vec3(c.origin_tmin.x, c.origin_tmin.y, c.origin_tmin.z);
  ray.direction = vec3(dx / length_d, dy / length_d, dz / length_d);
  ray.t_min = c.origin_tmin.w;
  ray.t_max = c.right_tmax.w;
  ray.inv_d = inverse_direction(ray.direction);
  return ray;
}

// The bounce ray: from the hit point, uniform over the hemisphere on the side the ray came from.
// Direction on the sphere by rejection: "Choosing a Point from the Surface of a Sphere",
// G. Marsaglia, Annals of Mathematical Statistics 43(2), 1972.
EP_FN Ray bounce_ray(FrameConstants c, Ray incoming, float t, vec3 normal, uint pixel) {
  float a = 0.0f;
  float b = 0.0f;
  precise float s = 0.0f;
  for (uint i = 0u; i < 16u; ++i) {
    a = 2.0f * unit_float(random_bits(pixel, c.frame, c.seed, 2u + 2u * i)) - 1.0f;
    b = 2.0f * unit_float(random_bits(pixel, c.frame, c.seed, 3u + 2u * i)) - 1.0f;
    precise float candidate = a * a + b * b;
    s = candidate;
    if (s < 1.0f) break;
  }
  if (s >= 1.0f) {  // 16 rejections in a row: 2e-11 of all rays
    a = 0.0f;
    b = 0.0f;
    s = 0.0f;
  }
  precise float root = sqrt(1.0f - s);
  precise float dx = 2.0f * a * root;
  precise float dy = 2.0f * b * root;
  precise float dz = 1.0f - 2.0f * s;
  vec3 d = vec3(dx, dy, dz);
  // Same side of the surface as the origin of the incoming ray.
  if ((dot3(d, normal) < 0.0f) == (dot3(incoming.direction, normal) < 0.0f))
    d = vec3(-dx, -dy, -dz);
  precise float ox = incoming.origin.x + t * incoming.direction.x;
  precise float oy = incoming.origin.y + t * incoming.direction.y;
  precise float oz = incoming.origin.z + t * incoming.direction.z;
  Ray ray;
  ray.origin = vec3(ox, oy, oz);
  ray.direction = d;
  ray.t_min = incoming.t_min;
  ray.t_max = incoming.t_max;
  ray.inv_d = inverse_direction(d);
  return ray;
}

// The far end of a ray's stay in a box or cell, widened by 1e-6 so that no ray slips between two
// touching boxes (2 ulp would do: "Robust BVH Ray Traversal", T. Ize, JCGT 2(2), 2013) and so that
// a triangle at the same t as the best hit, but another rounding, is still looked at: ties then end
// alike in every order of traversal.
EP_FN float widened(float t) { return t * 1.000001f; }

// Where the ray enters and leaves the box, within [t_min, t_max]: entered only if x <= y.
EP_FN vec2 box_span(vec3 box_min, vec3 box_max, vec3 origin, vec3 inv_d, float t_min, float t_max) {
  float x0 = (box_min.x - origin.x) * inv_d.x;
  float x1 = (box_max.x - origin.x) * inv_d.x;
  float y0 = (box_min.y - origin.y) * inv_d.y;
  float y1 = (box_max.y - origin.y) * inv_d.y;
  float z0 = (box_min.z - origin.z) * inv_d.z;
  float z1 = (box_max.z - origin.z) * inv_d.z;
  float enter = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), t_min));
  float leave = min(min(max(x0, x1), max(y0, y1)), max(z0, z1));
  return vec2(enter, widened(min(leave, t_max)));
}

// Distance at which the ray enters the box, or a negative number if it does not within
// [t_min, t_max].
EP_FN float enter_box(vec3 box_min, vec3 box_max, vec3 origin, vec3 inv_d, float t_min,
                      float t_max) {
  vec2 span = box_span(box_min, box_max, origin, inv_d, t_min, t_max);
  return span.x <= span.y ? span.x : -1.0f;
}

// The closer of `best` and the triangle's hit. Two hits at the same t: the lower id wins, so that
// the answer does not depend on the order of traversal. No fixed epsilon: a test of the determinant
// against one would depend on the scene's scale and lose small triangles. But a determinant that is
// nothing but rounding is a ray in the triangle's plane, and a miss: `bound` is what its terms add
// up to without their signs, and its rounding error is below 3e-7 of that. "Fast, Minimum Storage
// Ray/Triangle Intersection", T. Moeller and B. Trumbore, JGT 2(1), 1997.
EP_FN Hit closer_hit(Hit best, Ray ray, vec3 v0, vec3 e1, vec3 e2, uint prim) {
  vec3 d = ray.direction;
  vec3 p = cross3(d, e2);
  precise float det = dot3(e1, p);
  float bound = abs(e1.x) * (abs(d.y * e2.z) + abs(d.z * e2.y)) +
                abs(e1.y) * (abs(d.z * e2.x) + abs(d.x * e2.z)) +
                abs(e1.z) * (abs(d.x * e2.y) + abs(d.y * e2.x));
  if (abs(det) <= 1e-6f * bound) return best;
  precise float inv_det = 1.0f / det;
  precise vec3 s = ray.origin - v0;
  precise float u = dot3(s, p) * inv_det;
  if (!(u >= 0.0f && u <= 1.0f)) return best;
  vec3 q = cross3(s, e1);
  precise float v = dot3(ray.direction, q) * inv_det;
  precise float uv = u + v;
  if (!(v >= 0.0f && uv <= 1.0f)) return best;
  precise float t_plane = dot3(e2, q) * inv_det;
  // Where the ray is in the triangle's box. For a sliver rounding can make t_plane a hit beside it,
  // which no structure would visit; this way all agree on what is hit, and where. The box is padded
  // for its own rounding, by less than the structures' boxes are.
  vec3 v1 = v0 + e1;
  vec3 v2 = v0 + e2;
  vec3 low =
      vec3(min(v0.x, min(v1.x, v2.x)), min(v0.y, min(v1.y, v2.y)), min(v0.z, min(v1.z, v2.z)));
  vec3 high =
      vec3(max(v0.x, max(v1.x, v2.x)), max(v0.y, max(v1.y, v2.y)), max(v0.z, max(v1.z, v2.z)));
  vec3 padding = 1.1920929e-7f * vec3(max(abs(low.x), abs(high.x)), max(abs(low.y), abs(high.y)),
                                      max(abs(low.z), abs(high.z)));
  vec2 span = box_span(low - padding, high + padding, ray.origin, ray.inv_d, ray.t_min, ray.t_max);
  if (span.x > span.y) return best;
  float t = min(max(t_plane, span.x), span.y);
  if (!(t_plane >= ray.t_min && t <= best.t)) return best;
  if (t == best.t && best.prim_id != 0u && best.prim_id <= prim + 1u) return best;
  Hit hit;
  hit.t = t;
  hit.prim_id = prim + 1u;
  return hit;
}

// One pixel's part of a frame's hit_checksum (docs/method.md): two hashes of who was hit; the
// frame's checksum is their sums modulo 2^32 over all pixels, so that the order does not matter.
EP_FN uvec2 checksum_terms(uint pixel, PixelHits hits) {
  uint primary = hash_u32(hits.primary_id + hash_u32(2u * pixel));
  uint bounce = hash_u32(hits.bounce_id + hash_u32(2u * pixel + 1u));
  return uvec2(primary + bounce, hash_u32(primary ^ 0x9E3779B9u) + hash_u32(bounce ^ 0x85EBCA6Bu));
}

#ifdef __cplusplus
#undef precise
}  // namespace energyprof::gpu
#endif

#endif
