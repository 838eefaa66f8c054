/// Triangle meshes: the readers of PLY and OBJ, the exact weld, and Newell's teapot.
#pragma once

#include <cstddef>
#include <filesystem>
#include <glm/vec3.hpp>
#include <string_view>
#include <vector>

namespace energyprof::accel {

/// Triangles that index into shared positions, counter-clockwise seen from outside.
struct Mesh {
  std::vector<glm::vec3> positions;
  std::vector<glm::uvec3> triangles;
};

/// An axis-aligned box, both corners included.
struct Bounds {
  glm::vec3 min{0.0f};
  glm::vec3 max{0.0f};
};

/// What a file held and what the weld made of it.
struct MeshInfo {
  size_t file_vertex_count = 0;
  size_t file_triangle_count = 0;        ///< polygons already split
  size_t welded_vertex_count = 0;        ///< vertices at the position of an earlier one
  size_t unreferenced_vertex_count = 0;  ///< distinct positions that no triangle kept uses
  size_t degenerate_triangle_count = 0;  ///< triangles with two corners at the same position
};

/// The most triangles a mesh may have: ids of triangles, plus one, are int32 on the device.
inline constexpr size_t max_triangle_count = 0x7ffffffe;

/// The welded mesh in a file: .ply or .obj, either of them packed by gzip (content decides, not the
/// name). Coordinates are the decimal numbers of the file, correctly rounded to float.
///
/// PLY: ascii and both binary formats, any scalar types, polygons split into fans; elements and
/// properties beside x, y, z and vertex_indices are skipped. OBJ: `v` and `f`, the rest is ignored.
/// Throws std::runtime_error, one line with file, place and value, for anything it cannot take.
Mesh read_mesh(const std::filesystem::path& file, MeshInfo* info = nullptr);

/// read_mesh() of a file's contents; `name` stands in messages and its extension tells the format.
Mesh parse_mesh(std::string_view name, std::string_view contents, MeshInfo* info = nullptr);

/// True if read_mesh() knows the extension of `name`.
bool is_mesh_name(std::string_view name);

/// Merges vertices whose positions are equal (exactly; -0 is 0), drops the triangles that then have
/// two equal corners, and the vertices that no triangle uses. Order is kept. Where `info` is given,
/// it is filled in.
Mesh weld(Mesh mesh, MeshInfo* info = nullptr);

/// The box around all positions; both corners at the origin if there are none.
Bounds bounds(const Mesh& mesh);

/// Newell's teapot, welded: 32 bicubic patches on a grid of n x n quads each, in Newell's units, y
/// up and standing on y = 0. 64 n^2 - 8 n triangles. Throws std::runtime_error unless 1 <= n <=
/// 256.
///
/// Patches that share a border share its vertices bit for bit, at every n.
Mesh make_teapot(int n = 6);

}  // namespace energyprof::accel
