// Newell's teapot: counts, borders that meet, and which side is out.
#include <gtest/gtest.h>

#include <glm/geometric.hpp>
#include <map>
#include <utility>

#include "accel/mesh.h"

namespace energyprof::accel {
namespace {

using Edge = std::pair<uint32_t, uint32_t>;

/// How many triangles run along each edge in each direction.
std::map<Edge, int> directed_edges(const Mesh& mesh) {
  std::map<Edge, int> edges;
  for (const glm::uvec3 t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) ++edges[{t[k], t[(k + 1) % 3]}];
  }
  return edges;
}

TEST(Teapot, IsTheOneOfTheStudy) {
  const Mesh teapot = make_teapot();
  EXPECT_EQ(teapot.triangles.size(), 2256u);
  EXPECT_EQ(teapot.positions.size(), 1177u);
}

TEST(Teapot, StandsOnTheFloorWithItsSpoutTowardsX) {
  const Bounds box = bounds(make_teapot(12));
  EXPECT_EQ(box.min.y, 0.0f);
  EXPECT_EQ(box.max.y, 3.15f);
  EXPECT_EQ(box.min.x, -3.0f);
  EXPECT_NEAR(box.max.x, 3.434f, 1e-3f);
  EXPECT_EQ(box.max.z, 2.0f);
  EXPECT_EQ(box.min.z, -2.0f);
}

// Of the 2 n^2 triangles of each of 32 patches, n degenerate in each of the 8 patches that run into
// a point at the lid's knob or the middle of the base.
TEST(Teapot, HasTheTrianglesOfItsPatches) {
  for (const int n : {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 17, 32, 100, 256}) {
    const auto m = static_cast<size_t>(n);
    EXPECT_EQ(make_teapot(n).triangles.size(), 64 * m * m - 8 * m) << n;
  }
}

// If patches did not meet bit for bit, there would be more vertices, and borders where there is
// surface. The open borders are: rim, lid, the wide ends of spout and handle, the spout's mouth: 16
// curves in all.
TEST(Teapot, PatchesMeetAtEverySize) {
  for (int n = 2; n <= 24; ++n) {
    SCOPED_TRACE(n);
    const Mesh teapot = make_teapot(n);
    const auto m = static_cast<size_t>(n);
    EXPECT_EQ(teapot.positions.size(), 32 * m * m + 4 * m + 1);
    size_t open_count = 0;
    for (const auto& [edge, count] : directed_edges(teapot)) {
      EXPECT_EQ(count, 1) << "two triangles run along an edge in the same direction";
    }
    const std::map<Edge, int> edges = directed_edges(teapot);
    for (const auto& [edge, count] : edges)
      open_count += !edges.contains({edge.second, edge.first});
    EXPECT_EQ(open_count, 16 * m);
  }
}

// Half of the body's and half of the lid's volume each: a sum over all triangles of the signed
// volume to the origin is positive if they are counter-clockwise from outside.
TEST(Teapot, TrianglesAreCounterClockwiseFromOutside) {
  const Mesh teapot = make_teapot(8);
  double volume = 0;
  for (const glm::uvec3 t : teapot.triangles) {
    const glm::dvec3 a(teapot.positions[t.x]);
    const glm::dvec3 b(teapot.positions[t.y]);
    const glm::dvec3 c(teapot.positions[t.z]);
    volume += glm::dot(a, glm::cross(b, c)) / 6;
  }
  EXPECT_NEAR(volume, 25.68, 0.01);
}

TEST(Teapot, RefusesSizesItCannotMake) {
  for (const int n : {-1, 0, 257, 1 << 30}) EXPECT_THROW(make_teapot(n), std::runtime_error) << n;
}

}  // namespace
}  // namespace energyprof::accel
