/// Builder of SAH bounding volume hierarchies in three layouts.
#pragma once

#include "accel/built.h"
#include "accel/mesh.h"

namespace energyprof::accel {

/// Parameters of build_bvh(); the defaults are the paper's.
struct BvhConfig {
  enum class Method : uint8_t {
    binned,  ///< splits between buckets of equal width
    sweep,   ///< the best of all splits between sorted triangles: better trees, slower
  };
  Method method = Method::binned;
  /// Buckets along an axis, 2 to 64. More find better splits, slower. Unused by `sweep`.
  int bucket_count = 12;
  /// Try all three axes instead of only the longest one of the centroids' bounds. `binned` then
  /// gives nodes of few triangles fewer buckets, and sweeps the smallest ones.
  bool all_axes = false;
  /// Triangles in a leaf, 1 to 16. Above 1 a leaf is made where testing all of a node's triangles
  /// costs no more than the best tree found over them.
  int max_leaf_size = 1;
  /// Cost of visiting an inner node, of testing a triangle: SAH units, 0 to 1e6.
  float traverse_cost = 1.0f;
  float intersect_cost = 2.0f;
  /// Up to this many triangles are split in the middle instead of by cost, 0 to 2^30; 0: all by
  /// cost.
  int middle_split_count = 4;

  bool operator==(const BvhConfig&) const = default;
};

/// The best trees for the time: binned along all axes, leaves of up to 4, equal costs. On the
/// dragon within 1 % of the cost that `sweep` reaches with the same leaves, in less than half its
/// time.
BvhConfig tuned_bvh();

/// The most inner nodes on a path of any tree that build_bvh() makes: a path that gets long is
/// split in the middle from there on.
inline constexpr uint32_t max_bvh_depth = 120;

/// A BVH in one of the BVH layouts of AccelKind. The tree is the same in all three, and with any
/// number of threads.
///
/// BuildStats::sah_cost = (traverse_cost * sum of inner areas + intersect_cost * sum over leaves of
/// area * triangles) / root area. Uses all threads that TBB allows. Throws std::runtime_error for
/// more than 2^30 triangles, for a mesh so large (about 1e19) that areas are more than a float can
/// hold, for parameters outside their ranges, and for an AccelKind that is no BVH.
///
/// "Automatic Creation of Object Hierarchies for Ray Tracing", J. Goldsmith and J. Salmon, IEEE
/// CG&A 7(5), 1987; binning: "On fast Construction of SAH-based Bounding Volume Hierarchies",
/// I. Wald, IEEE Symposium on Interactive Ray Tracing, 2007.
Built build_bvh(const Mesh& mesh, const BvhConfig& config = {},
                AccelKind layout = AccelKind::bvh_depth_first);

}  // namespace energyprof::accel
