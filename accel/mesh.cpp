// Reading a mesh file of any kind, and the exact weld.
#include "accel/mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <stdexcept>

#include "accel/bytes.h"
#include "accel/mesh_reader.h"

namespace energyprof::accel {
namespace {

constexpr std::string_view read_formats = ".ply, .ply.gz, .obj and .obj.gz are read";

enum class MeshFormat { ply, obj, unknown };

MeshFormat format_of(std::string_view name) {
  std::string lower(name);
  for (char& c : lower) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  if (lower.ends_with(".ply") || lower.ends_with(".ply.gz")) return MeshFormat::ply;
  if (lower.ends_with(".obj") || lower.ends_with(".obj.gz")) return MeshFormat::obj;
  return MeshFormat::unknown;
}

std::string in_quotes(std::string_view text, bool ascii_only) {
  std::string result = "'";
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    const bool printable = byte >= 0x20 && byte != 0x7f && (byte < 0x80 || !ascii_only);
    result += printable ? std::string(1, c) : fmt::format("\\x{:02x}", byte);
  }
  return result + "'";
}

uint64_t hash_of(glm::vec3 p) {
  p += 0.0f;  // -0 becomes 0, so that equal coordinates have equal bits
  const uint64_t xy = std::bit_cast<uint32_t>(p.x) | uint64_t{std::bit_cast<uint32_t>(p.y)} << 32;
  uint64_t h = xy * 0x9e3779b97f4a7c15u;
  h = (h ^ (h >> 32) ^ std::bit_cast<uint32_t>(p.z)) * 0xd6e8feb86659fd93u;
  return h ^ (h >> 32);
}

/// For each position, the index of the first that equals it.
///
/// Open addressing. What costs time is waiting for memory: slots are asked for a few positions
/// ahead, and the half of the hash that they keep spares a look at almost every position that
/// differs.
std::vector<uint32_t> first_equals(const std::vector<glm::vec3>& positions) {
  struct Slot {
    uint32_t hash_high = 0;
    uint32_t index_plus_one = 0;  // 0: free
  };
  constexpr size_t ahead = 12;
  const size_t slot_count = std::bit_ceil(2 * positions.size() + 1);
  std::vector<Slot> slots;
  slots.reserve(slot_count);
  prefer_large_pages(slots.data(), slot_count * sizeof(Slot));
  slots.resize(slot_count);
  std::vector<uint32_t> first(positions.size());
  for (uint32_t v = 0; v < positions.size(); ++v) {
    const size_t soon = std::min<size_t>(v + ahead, positions.size() - 1);
    __builtin_prefetch(&slots[hash_of(positions[soon]) & (slot_count - 1)], 1);
    const uint64_t hash = hash_of(positions[v]);
    const auto hash_high = static_cast<uint32_t>(hash >> 32);
    for (size_t s = hash & (slot_count - 1);; s = (s + 1) & (slot_count - 1)) {
      Slot& slot = slots[s];
      const bool is_new = slot.index_plus_one == 0;
      if (is_new) slot = {hash_high, v + 1};
      first[v] = slot.index_plus_one - 1;
      if (is_new || (slot.hash_high == hash_high && positions[first[v]] == positions[v])) break;
    }
  }
  return first;
}

bool is_degenerate(glm::uvec3 t) { return t.x == t.y || t.y == t.z || t.z == t.x; }

}  // namespace

std::string quoted(std::string_view text) {
  constexpr size_t longest = 40;
  if (text.size() <= longest) return in_quotes(text, true);
  return in_quotes(text.substr(0, longest), true) + "...";
}

std::string quoted_name(std::string_view name) { return in_quotes(name, false); }

void MeshText::fail(std::string_view why) const {
  throw std::runtime_error(fmt::format("cannot read mesh {}: {}.", quoted_name(name), why));
}

void MeshText::fail_at_line(const char* at, std::string_view why) const {
  fail(fmt::format("line {}: {}", 1 + std::count(text.data(), at, '\n'), why));
}

void MeshText::fail_at_byte(const char* at, std::string_view why) const {
  fail(fmt::format("byte {}: {}", at - text.data(), why));
}

const char* scan_float_exactly(const char* p, const char* end, float& value) {
  const bool negative = p != end && *p == '-';
  const char* const first = p + (p != end && (*p == '-' || *p == '+') ? 1 : 0);
  if (!negative) p = first;  // from_chars knows no plus sign
  // from_chars would also take "inf" and "nan".
  if (first == end || (!is_digit(*first) && *first != '.')) return nullptr;
  const auto [stop, error] = std::from_chars(p, end, value);
  if (error == std::errc()) return stop;
  if (error != std::errc::result_out_of_range) return nullptr;

  // Too large or too small: where the first digit that counts stands decides, in powers of ten.
  ptrdiff_t place = 0;
  bool seen_point = false;
  bool seen_digit = false;
  const char* q = first;
  for (; q != stop && (is_digit(*q) || *q == '.'); ++q) {
    if (*q == '.') {
      seen_point = true;
    } else {
      seen_digit = seen_digit || *q != '0';
      if (seen_digit && !seen_point) ++place;
      if (!seen_digit && seen_point) --place;
    }
  }
  ptrdiff_t exponent = 0;
  if (q != stop) {
    const bool below_one = q[1] == '-';
    q += q[1] == '-' || q[1] == '+' ? 2 : 1;
    for (; q != stop && exponent < (1 << 30); ++q) exponent = exponent * 10 + (*q - '0');
    if (below_one) exponent = -exponent;
  }
  if (place + exponent > 0) return nullptr;
  value = negative ? -0.0f : 0.0f;
  return stop;
}

std::string why_not_a_float(std::string_view token) {
  if (token.empty()) return "a number is missing";
  double value = 0;
  const std::string_view number = token.starts_with('+') ? token.substr(1) : token;
  const char* const end = number.data() + number.size();
  const auto [stop, error] = std::from_chars(number.data(), end, value);
  if (stop != end || error == std::errc::invalid_argument) {
    return quoted(token) + " is not a number";
  }
  return quoted(token) + " is not a coordinate: it must be finite and no larger than 3.4e38";
}

bool is_mesh_name(std::string_view name) { return format_of(name) != MeshFormat::unknown; }

Mesh parse_mesh(std::string_view name, std::string_view contents, MeshInfo* info) {
  const MeshFormat format = format_of(name);
  const MeshText packed{name, contents};
  if (format == MeshFormat::unknown) {
    packed.fail(fmt::format("its format is not known by its name; {}", read_formats));
  }
  if (contents.empty()) packed.fail("it is empty");
  if (is_gzip(contents)) {
    const Bytes inflated = inflate_gzip(name, contents);
    if (inflated.byte_count == 0) packed.fail("it is empty once unpacked");
    const MeshText text{name, inflated.view()};
    return weld(format == MeshFormat::ply ? parse_ply(text) : parse_obj(text), info);
  }
  return weld(format == MeshFormat::ply ? parse_ply(packed) : parse_obj(packed), info);
}

Mesh read_mesh(const std::filesystem::path& file, MeshInfo* info) {
  const Bytes bytes = read_file(file);
  return parse_mesh(file.string(), bytes.view(), info);
}

Mesh weld(Mesh mesh, MeshInfo* info) {
  constexpr uint32_t unused = 0xffffffff;
  const size_t file_vertex_count = mesh.positions.size();
  const size_t file_triangle_count = mesh.triangles.size();
  std::vector<uint32_t> index = first_equals(mesh.positions);
  size_t distinct_count = 0;
  for (uint32_t v = 0; v < index.size(); ++v) distinct_count += index[v] == v;

  // Triangles first take the vertices that stand for theirs, then the numbers these are given.
  std::erase_if(mesh.triangles, [&](glm::uvec3& t) {
    t = {index[t.x], index[t.y], index[t.z]};
    return is_degenerate(t);
  });
  std::ranges::fill(index, unused);
  for (const glm::uvec3 t : mesh.triangles) index[t.x] = index[t.y] = index[t.z] = 0;
  uint32_t kept_count = 0;
  for (size_t v = 0; v < index.size(); ++v) {
    if (index[v] == unused) continue;
    index[v] = kept_count;
    mesh.positions[kept_count++] = mesh.positions[v] + 0.0f;
  }
  mesh.positions.resize(kept_count);
  for (glm::uvec3& t : mesh.triangles) t = {index[t.x], index[t.y], index[t.z]};

  if (info != nullptr) {
    info->file_vertex_count = file_vertex_count;
    info->file_triangle_count = file_triangle_count;
    info->welded_vertex_count = file_vertex_count - distinct_count;
    info->unreferenced_vertex_count = distinct_count - kept_count;
    info->degenerate_triangle_count = file_triangle_count - mesh.triangles.size();
  }
  return mesh;
}

Bounds bounds(const Mesh& mesh) {
  if (mesh.positions.empty()) return {};
  Bounds box{mesh.positions.front(), mesh.positions.front()};
  for (const glm::vec3 p : mesh.positions) {
    box.min =
        glm::vec3(std::min(box.min.x, p.x), std::min(box.min.y, p.y), std::min(box.min.z, p.z));
    box.max =
        glm::vec3(std::max(box.max.x, p.x), std::max(box.max.y, p.y), std::max(box.max.z, p.z));
  }
  return box;
}

}  // namespace energyprof::accel
