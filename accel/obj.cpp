// The OBJ reader: positions ("v") and faces ("f"); every other line is ignored.
// See "Appendix B1: Object Files (.obj)", Advanced Visualizer manual, Wavefront Technologies, 1992.
#include <fmt/format.h>

#include <cstring>
#include <vector>

#include "accel/mesh_reader.h"

namespace energyprof::accel {
namespace {

class ObjParser {
 public:
  explicit ObjParser(const MeshText& file)
      : file_(file), next_(file.text.data()), end_(file.text.data() + file.text.size()) {}

  Mesh parse() {
    if (const void* const nul = std::memchr(next_, '\0', file_.text.size())) {
      file_.fail_at_byte(static_cast<const char*>(nul), "a byte 0; an OBJ file is text");
    }
    while (next_ != end_) read_line();
    if (mesh_.positions.empty()) file_.fail("it has no 'v' line; an OBJ mesh has vertices");
    if (!mesh_.triangles.empty() && largest_index_ >= mesh_.positions.size()) {
      file_.fail_at_line(largest_index_at_,
                         fmt::format("there is no vertex {}; the file has {}, counted from 1",
                                     largest_index_ + 1, mesh_.positions.size()));
    }
    return std::move(mesh_);
  }

 private:
  [[noreturn]] void fail(std::string_view why) const { file_.fail_at_line(next_, why); }

  void read_line() {
    skip_space();
    const std::string_view keyword = token();
    next_ += keyword.size();
    if (keyword == "v") {
      read_position();
    } else if (keyword == "f") {
      read_face();
    }
    skip_line();
  }

  void read_position() {
    glm::vec3 position{0.0f};
    for (int axis = 0; axis < 3; ++axis) {
      skip_space();
      const std::string_view word = token();
      const char* const stop = scan_float(word.data(), word.data() + word.size(), position[axis]);
      if (stop != word.data() + word.size() || word.empty()) fail(why_not_a_float(word));
      next_ = stop;
    }
    if (mesh_.positions.size() == max_triangle_count) {
      fail(fmt::format("more than {} vertices", max_triangle_count));
    }
    mesh_.positions.push_back(position);
  }

  void read_face() {
    glm::uvec3 triangle{0};
    size_t corner = 0;
    for (;; ++corner) {
      skip_space();
      if (next_ == end_ || *next_ == '\n' || *next_ == '#') break;
      triangle[corner == 0 ? 0 : 2] = read_corner();
      if (corner >= 2) mesh_.triangles.push_back(triangle);
      if (corner >= 1) triangle.y = triangle.z;
    }
    if (corner < 3) fail(fmt::format("{} corners are too few; a face has 3 or more", corner));
    if (mesh_.triangles.size() > max_triangle_count) {
      fail(fmt::format("more than {} triangles", max_triangle_count));
    }
  }

  /// The position of one corner, "i", "i/j", "i//k" or "i/j/k", counted from 0.
  uint32_t read_corner() {
    const std::string_view word = token();
    size_t at = word.starts_with('-') ? 1 : 0;
    const bool from_end = at == 1;
    uint64_t index = 0;
    const size_t digits = at;
    for (; at < word.size() && is_digit(word[at]) && index < (uint64_t{1} << 40); ++at) {
      index = index * 10 + static_cast<uint64_t>(word[at] - '0');
    }
    const bool well_formed =
        at > digits && (at == word.size() || (word[at] == '/' && is_reference(word.substr(at))));
    if (!well_formed) {
      fail(fmt::format("{} is not a corner: i, i/j, i//k or i/j/k, whole numbers", quoted(word)));
    }
    if (index == 0 || index > max_triangle_count || (from_end && index > mesh_.positions.size())) {
      fail(fmt::format("{} is not a vertex; {} have come before, counted from 1 or back from -1",
                       quoted(word), mesh_.positions.size()));
    }
    const uint64_t from_zero = from_end ? mesh_.positions.size() - index : index - 1;
    if (from_zero > largest_index_ || largest_index_at_ == nullptr) {
      largest_index_ = from_zero;
      largest_index_at_ = next_;
    }
    next_ += word.size();
    return static_cast<uint32_t>(from_zero);
  }

  /// True for "/j", "//k" and "/j/k".
  static bool is_reference(std::string_view text) {
    size_t slash_count = 0;
    for (const char c : text) {
      slash_count += c == '/';
      if (!is_digit(c) && c != '/' && c != '-') return false;
    }
    return slash_count <= 2 && text.back() != '-';
  }

  /// Blanks, and a line end that a backslash joins to the next line.
  void skip_space() {
    while (next_ != end_) {
      if (*next_ == ' ' || *next_ == '\t' || *next_ == '\r') {
        ++next_;
      } else if (const size_t length = continuation_at(next_); length > 0) {
        next_ += length;
      } else {
        return;
      }
    }
  }

  /// Length of the "\" and line end at `p`, 0 if there is none.
  [[nodiscard]] size_t continuation_at(const char* p) const {
    if (p == end_ || *p != '\\') return 0;
    const std::string_view rest(p, static_cast<size_t>(end_ - p));
    if (rest.starts_with("\\\n")) return 2;
    return rest.starts_with("\\\r\n") ? 3 : 0;
  }

  [[nodiscard]] std::string_view token() const {
    const char* p = next_;
    while (p != end_ && *p != ' ' && *p != '\t' && *p != '\r' && *p != '\n' &&
           continuation_at(p) == 0) {
      ++p;
    }
    return {next_, static_cast<size_t>(p - next_)};
  }

  void skip_line() {
    while (next_ != end_ && *next_ != '\n') {
      const size_t length = continuation_at(next_);
      next_ += length > 0 ? length : 1;
    }
    if (next_ != end_) ++next_;
  }

  const MeshText& file_;
  const char* next_;
  const char* end_;
  Mesh mesh_;
  uint64_t largest_index_ = 0;
  const char* largest_index_at_ = nullptr;
};

}  // namespace

Mesh parse_obj(const MeshText& file) { return ObjParser(file).parse(); }

}  // namespace energyprof::accel
