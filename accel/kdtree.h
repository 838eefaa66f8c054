/// Builder of SAH kd-trees with 8-byte nodes.
#pragma once

#include "accel/built.h"
#include "accel/mesh.h"

namespace energyprof::accel {

/// Parameters of build_kdtree(); the defaults are the paper's.
struct KdTreeConfig {
  /// Cost of visiting an inner node, of testing a triangle: SAH units.
  float traverse_cost = 1.0f;
  float intersect_cost = 80.0f;
  /// A split with one empty side costs this share less: 0 to 1.
  float empty_bonus = 0.2f;
  /// A node with this many triangles or fewer is a leaf, 1 to 64.
  int max_leaf_size = 8;
  /// A path ends in a leaf at the split of this number that is no cheaper than its leaf; at 0 and
  /// 1: at the first. Under 16 triangles, one more than four times as dear is enough.
  int bad_refinement_count = 3;
  /// Inner nodes on a path, 1 to 120; 0: 8 + 1.3 log2(triangles).
  int max_depth = 0;
  /// Cut triangles to the cell before their bounds are taken ("perfect splits"), and try all three
  /// axes. Otherwise: the bounds of whole triangles, and the longest axis that allows a split.
  bool clip = false;
  /// List a triangle also in cells that it only touches, as every corner in a split plane does.
  /// Without, trees are a third as large, built in a third of the time and some 7 % cheaper; but a
  /// ray that meets a corner or an edge just where a plane goes through it may miss the triangles
  /// on the plane's other side. For comparison with builders that do without.
  bool keep_touching = true;

  bool operator==(const KdTreeConfig&) const = default;
};

/// The best trees for the time: clipped triangles, equal costs.
KdTreeConfig tuned_kdtree();

/// A kd-tree (AccelKind::kd_tree). Planes go through bounds of triangles, where SAH finds the least
/// cost of all such planes. A leaf lists, by rising id, the triangles that come within a millionth
/// of the scene's extent (or what box_padding() says, if that is more) of its cell: KD_TREE relies
/// on that, because rounding may make it pass by a cell where the ray just cuts a corner of it.
///
/// BuildStats::sah_cost = (traverse_cost * sum of inner areas + intersect_cost * sum over leaves of
/// area * triangles) / root area, areas of cells. Uses all threads that TBB allows; the result does
/// not depend on their number. Throws std::runtime_error for more triangles, references or nodes
/// than 2^30, or parameters outside their ranges.
///
/// The tree of the default parameters: "Physically Based Rendering", M. Pharr, W. Jakob and
/// G. Humphreys, 3rd edition, 2016, section 4.4. Clipping, and the cost of empty sides: "On
/// building fast kd-Trees for Ray Tracing, and on doing that in O(N log N)", I. Wald and V. Havran,
/// IEEE Symposium on Interactive Ray Tracing, 2006.
Built build_kdtree(const Mesh& mesh, const KdTreeConfig& config = {});

}  // namespace energyprof::accel
