/// Builder of the paper's bounding volume hierarchy: binned SAH, one triangle a leaf, 32-byte
/// nodes.
#pragma once

#include "accel/mesh.h"
#include "core/accel_blob.h"

namespace energyprof::accel {

struct Built {
  AccelBlob blob;
  BuildStats stats;
};

/// Parameters of build_bvh(); the defaults are the paper's.
struct BvhConfig {
  /// Buckets along the longest axis of the centroids' bounds. More find better splits, slower.
  int bucket_count = 12;
  /// Cost of visiting an inner node, of testing a triangle: SAH units.
  float traverse_cost = 1.0f;
  float intersect_cost = 2.0f;
  /// Up to this many triangles are split in the middle instead of by cost.
  int middle_split_count = 4;
};

/// A BVH in depth-first layout (AccelKind::bvh_depth_first): left child at i + 1, a subtree of n
/// triangles in 2 n - 1 consecutive nodes.
///
/// BuildStats::sah_cost = (traverse_cost * sum of inner areas + intersect_cost * sum of leaf areas)
/// / root area. Uses all threads that TBB allows. Throws std::runtime_error for more than 2^30
/// triangles.
///
/// "Automatic Creation of Object Hierarchies for Ray Tracing", J. Goldsmith and J. Salmon, IEEE
/// CG&A 7(5), 1987; binning: "On fast Construction of SAH-based Bounding Volume Hierarchies",
/// I. Wald, IEEE Symposium on Interactive Ray Tracing, 2007.
Built build_bvh(const Mesh& mesh, const BvhConfig& config = {});

}  // namespace energyprof::accel
