// The PLY reader: a header that describes elements, then their values as text or as bytes.
// See "The PLY Polygon File Format", by G. Turk, Stanford University, 1994.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <vector>

#include "accel/bytes.h"
#include "accel/mesh_reader.h"

namespace energyprof::accel {
namespace {

static_assert(std::endian::native == std::endian::little);

enum class Scalar : uint8_t { int8, uint8, int16, uint16, int32, uint32, float32, float64 };

struct ScalarName {
  std::string_view name;
  Scalar type;
};
constexpr std::array<ScalarName, 16> scalar_names{{{"char", Scalar::int8},
                                                   {"uchar", Scalar::uint8},
                                                   {"short", Scalar::int16},
                                                   {"ushort", Scalar::uint16},
                                                   {"int", Scalar::int32},
                                                   {"uint", Scalar::uint32},
                                                   {"float", Scalar::float32},
                                                   {"double", Scalar::float64},
                                                   {"int8", Scalar::int8},
                                                   {"uint8", Scalar::uint8},
                                                   {"int16", Scalar::int16},
                                                   {"uint16", Scalar::uint16},
                                                   {"int32", Scalar::int32},
                                                   {"uint32", Scalar::uint32},
                                                   {"float32", Scalar::float32},
                                                   {"float64", Scalar::float64}}};

constexpr size_t byte_count(Scalar type) {
  constexpr std::array<size_t, 8> counts{1, 1, 2, 2, 4, 4, 4, 8};
  return counts[static_cast<size_t>(type)];
}

constexpr bool is_integer(Scalar type) { return type < Scalar::float32; }

struct Property {
  std::string_view name;
  Scalar type = Scalar::int8;          // of the value, or of each value of a list
  std::optional<Scalar> count_type{};  // lists only
};

struct Element {
  std::string_view name;
  uint64_t count = 0;
  std::vector<Property> properties;
};

enum class Encoding { ascii, little_endian, big_endian };

struct Header {
  Encoding encoding = Encoding::ascii;
  std::vector<Element> elements;
  const char* body = nullptr;
};

// ---- the header ----

bool is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

std::vector<std::string_view> words_of(std::string_view line) {
  std::vector<std::string_view> words;
  size_t i = 0;
  while (i < line.size()) {
    while (i < line.size() && is_space(line[i])) ++i;
    const size_t begin = i;
    while (i < line.size() && !is_space(line[i])) ++i;
    if (i > begin) words.push_back(line.substr(begin, i - begin));
  }
  return words;
}

class HeaderParser {
 public:
  explicit HeaderParser(const MeshText& file) : file_(file), next_(file.text.data()) {}

  Header parse() {
    next_line();
    if (words_.size() != 1 || words_[0] != "ply") {
      fail(fmt::format("a PLY file begins with 'ply', not with {}", quoted(line_)));
    }
    do {
      next_line();
      read_line();
    } while (!at_end_);
    if (!seen_format_) fail("the header has no 'format' line");
    header_.body = next_;
    return std::move(header_);
  }

 private:
  [[noreturn]] void fail(std::string_view why) const { file_.fail_at_line(line_.data(), why); }

  void next_line() {
    const char* const end = file_.text.data() + file_.text.size();
    const auto rest = static_cast<size_t>(end - next_);
    const void* const stop = std::memchr(next_, '\n', rest);
    if (stop == nullptr) {
      line_ = {next_, rest};
      if (next_ == file_.text.data())
        fail(fmt::format("a PLY file begins with 'ply', not with {}", quoted(line_)));
      fail("the header has no 'end_header' line");
    }
    line_ = {next_, static_cast<size_t>(static_cast<const char*>(stop) - next_)};
    words_ = words_of(line_);
    next_ = static_cast<const char*>(stop) + 1;
  }

  void read_line() {
    if (words_.empty()) return;
    const std::string_view keyword = words_[0];
    if (keyword == "comment" || keyword == "obj_info") return;
    if (keyword == "format") {
      read_format();
    } else if (keyword == "element") {
      read_element();
    } else if (keyword == "property") {
      read_property();
    } else if (keyword == "end_header") {
      at_end_ = true;
    } else {
      fail(
          fmt::format("{} is not a keyword of a PLY header: format, comment, obj_info, element, "
                      "property or end_header",
                      quoted(keyword)));
    }
  }

  void read_format() {
    if (words_.size() != 3 || words_[2] != "1.0" || seen_format_) {
      fail(fmt::format("{} is not a single 'format' line of version 1.0", quoted(line_)));
    }
    seen_format_ = true;
    if (words_[1] == "ascii") {
      header_.encoding = Encoding::ascii;
    } else if (words_[1] == "binary_little_endian") {
      header_.encoding = Encoding::little_endian;
    } else if (words_[1] == "binary_big_endian") {
      header_.encoding = Encoding::big_endian;
    } else {
      fail(fmt::format("format {} is not ascii, binary_little_endian or binary_big_endian",
                       quoted(words_[1])));
    }
  }

  void read_element() {
    Element element;
    if (words_.size() != 3) fail(fmt::format("{} is not 'element NAME COUNT'", quoted(line_)));
    element.name = words_[1];
    const std::string_view count = words_[2];
    const auto [stop, error] =
        std::from_chars(count.data(), count.data() + count.size(), element.count);
    if (error != std::errc() || stop != count.data() + count.size()) {
      fail(fmt::format("{} is not a count of elements", quoted(count)));
    }
    for (const Element& other : header_.elements) {
      if (other.name == element.name) {
        fail(fmt::format("a second element {}", quoted(element.name)));
      }
    }
    const bool is_limited = element.name == "vertex" || element.name == "face";
    if (is_limited && element.count > max_triangle_count) {
      fail(fmt::format("{} {} elements are too many; at most {} fit", element.count, element.name,
                       max_triangle_count));
    }
    header_.elements.push_back(std::move(element));
  }

  void read_property() {
    if (header_.elements.empty()) fail("a 'property' before any 'element'");
    Property property;
    if (words_.size() == 5 && words_[1] == "list") {
      property = {words_[4], scalar_of(words_[3]), scalar_of(words_[2])};
      if (!is_integer(*property.count_type)) {
        fail(fmt::format("the count of a list must be of an integer type, not {}",
                         quoted(words_[2])));
      }
    } else if (words_.size() == 3) {
      property = {words_[2], scalar_of(words_[1])};
    } else {
      fail(fmt::format("{} is neither 'property TYPE NAME' nor 'property list TYPE TYPE NAME'",
                       quoted(line_)));
    }
    for (const Property& other : header_.elements.back().properties) {
      if (other.name == property.name) {
        fail(fmt::format("a second property {}", quoted(property.name)));
      }
    }
    header_.elements.back().properties.push_back(property);
  }

  [[nodiscard]] Scalar scalar_of(std::string_view name) const {
    for (const ScalarName& known : scalar_names) {
      if (known.name == name) return known.type;
    }
    fail(
        fmt::format("{} is not a type: char, uchar, short, ushort, int, uint, float, double, or "
                    "int8 to float64",
                    quoted(name)));
  }

  const MeshText& file_;
  const char* next_;
  std::string_view line_;
  std::vector<std::string_view> words_;
  Header header_;
  bool seen_format_ = false;
  bool at_end_ = false;
};

// ---- the body: two readers of values with the same members, and one walk over the elements ----

/// Where a reader stands, for messages.
struct Position {
  const Element* element = nullptr;
  uint64_t item = 0;
};

std::string of_element(const Position& at) {
  return fmt::format("element {}, {} of {}", quoted(at.element->name), at.item, at.element->count);
}

class AsciiReader {
 public:
  Position at;

  AsciiReader(const MeshText& file, const char* body)
      : file_(file), next_(body), end_(file.text.data() + file.text.size()) {}

  float coordinate(Scalar) {
    skip_space();
    float value = 0;
    const char* const stop = scan_float(next_, end_, value);
    if (stop == nullptr || !is_delimited(stop)) fail(why_not_a_float(token()));
    next_ = stop;
    return value;
  }

  uint64_t integer(Scalar, std::string_view what) {
    skip_space();
    uint64_t value = 0;
    const char* const p = scan_digits(next_, end_, value);
    if (p == next_ || p - next_ > longest_integer || !is_delimited(p)) {
      fail(next_ == end_
               ? fmt::format("the file ends where {} should stand", what)
               : fmt::format("{} is not {}, a whole number from 0 up", quoted(token()), what));
    }
    next_ = p;
    return value;
  }

  void skip(Scalar, uint64_t count) {
    for (uint64_t i = 0; i < count; ++i) {
      skip_space();
      if (next_ == end_) fail("the file ends where a value should stand");
      while (next_ != end_ && !is_space(*next_)) ++next_;
    }
  }

  void expect_end() {
    skip_space();
    if (next_ != end_) {
      file_.fail_at_line(next_,
                         fmt::format("{} follows where the file should end; the counts of the "
                                     "header do not match",
                                     quoted(token())));
    }
  }

  [[noreturn]] void fail(std::string_view why) const {
    file_.fail_at_line(next_, fmt::format("{}: {}", of_element(at), why));
  }

  /// The fewest bytes that an element can take: a character and a space per value.
  static uint64_t least_bytes(const Element& element) { return 2 * element.properties.size(); }
  [[nodiscard]] uint64_t bytes_left() const { return static_cast<uint64_t>(end_ - next_) + 1; }

 private:
  static constexpr ptrdiff_t longest_integer = 19;  // digits that fit into 64 bits

  void skip_space() {
    while (next_ != end_ && is_space(*next_)) ++next_;
  }
  [[nodiscard]] bool is_delimited(const char* p) const { return p == end_ || is_space(*p); }
  [[nodiscard]] std::string_view token() const {
    const char* stop = next_;
    while (!is_delimited(stop)) ++stop;
    return {next_, static_cast<size_t>(stop - next_)};
  }

  const MeshText& file_;
  const char* next_;
  const char* end_;
};

class BinaryReader {
 public:
  Position at;

  BinaryReader(const MeshText& file, const char* body, bool swap_bytes)
      : file_(file), next_(body), end_(file.text.data() + file.text.size()), swap_(swap_bytes) {}

  float coordinate(Scalar type) {
    const char* const begin = next_;
    double value = 0;
    switch (type) {
      case Scalar::float32:
        value = double{take<float>()};
        break;
      case Scalar::float64:
        value = take<double>();
        break;
      default:
        value = static_cast<double>(take_integer(type));
        break;
    }
    const float rounded = static_cast<float>(value);
    if (!std::isfinite(rounded)) {
      next_ = begin;
      fail(fmt::format("{} is not a coordinate: it must be finite and no larger than 3.4e38",
                       value));
    }
    return rounded;
  }

  uint64_t integer(Scalar type, std::string_view what) {
    const char* const begin = next_;
    const int64_t value = take_integer(type);
    if (value < 0) {
      next_ = begin;
      fail(fmt::format("{} is not {}, a whole number from 0 up", value, what));
    }
    return static_cast<uint64_t>(value);
  }

  void skip(Scalar type, uint64_t count) {
    need(count * byte_count(type));  // count is below 2^32
    next_ += count * byte_count(type);
  }

  void expect_end() {
    if (!std::all_of(next_, end_, is_space)) {
      file_.fail_at_byte(next_,
                         fmt::format("{} bytes follow where the file should end; the counts of "
                                     "the header do not match",
                                     end_ - next_));
    }
  }

  [[noreturn]] void fail(std::string_view why) const {
    file_.fail_at_byte(next_, fmt::format("{}: {}", of_element(at), why));
  }

  static uint64_t least_bytes(const Element& element) {
    uint64_t sum = 0;
    for (const Property& property : element.properties) {
      sum += byte_count(property.count_type.value_or(property.type));
    }
    return sum;
  }
  [[nodiscard]] uint64_t bytes_left() const { return static_cast<uint64_t>(end_ - next_); }

 private:
  void need(uint64_t count) const {
    if (count > bytes_left()) {
      fail(
          fmt::format("{} more bytes are needed and {} are left; the file is cut off or its header "
                      "is wrong",
                      count, bytes_left()));
    }
  }

  template <class T>
  T take() {
    need(sizeof(T));
    std::array<char, sizeof(T)> bytes{};
    std::memcpy(bytes.data(), next_, sizeof(T));
    if (swap_) std::reverse(bytes.begin(), bytes.end());
    next_ += sizeof(T);
    return std::bit_cast<T>(bytes);
  }

  int64_t take_integer(Scalar type) {
    switch (type) {
      case Scalar::int8:
        return take<int8_t>();
      case Scalar::uint8:
        return take<uint8_t>();
      case Scalar::int16:
        return take<int16_t>();
      case Scalar::uint16:
        return take<uint16_t>();
      case Scalar::int32:
        return take<int32_t>();
      default:
        return take<uint32_t>();
    }
  }

  const MeshText& file_;
  const char* next_;
  const char* end_;
  bool swap_;
};

template <class Reader>
void skip_property(Reader& reader, const Property& property) {
  const uint64_t count =
      property.count_type ? reader.integer(*property.count_type, "the count of a list") : 1;
  reader.skip(property.type, count);
}

template <class Reader>
void skip_element(Reader& reader, const Element& element) {
  if (element.properties.empty()) return;
  for (uint64_t i = 0; i < element.count; ++i) {
    reader.at.item = i;
    for (const Property& property : element.properties) skip_property(reader, property);
  }
}

/// The axis a vertex property gives: 0, 1 or 2; 3 for all others.
int axis_of(const Property& property) {
  if (property.count_type || property.name.size() != 1) return 3;
  return property.name[0] >= 'x' && property.name[0] <= 'z' ? property.name[0] - 'x' : 3;
}

template <class Reader>
void read_vertices(Reader& reader, const Element& element, std::vector<glm::vec3>& positions) {
  std::vector<int> axes;
  for (const Property& property : element.properties) axes.push_back(axis_of(property));
  positions.reserve(element.count);
  prefer_large_pages(positions.data(), element.count * sizeof(glm::vec3));
  positions.resize(element.count);
  for (uint64_t i = 0; i < element.count; ++i) {
    reader.at.item = i;
    for (size_t k = 0; k < axes.size(); ++k) {
      const Property& property = element.properties[k];
      if (axes[k] == 3) {
        skip_property(reader, property);
      } else {
        positions[i][axes[k]] = reader.coordinate(property.type);
      }
    }
  }
}

bool is_corner_list(const Property& property) {
  return property.count_type && is_integer(property.type) &&
         (property.name == "vertex_indices" || property.name == "vertex_index");
}

/// One polygon, split into a fan around its first corner.
template <class Reader>
void read_polygon(Reader& reader, const Property& property, uint64_t vertex_count,
                  std::vector<glm::uvec3>& triangles) {
  const uint64_t corner_count = reader.integer(*property.count_type, "the number of corners");
  if (corner_count < 3) {
    reader.fail(fmt::format("{} corners are too few; a face has 3 or more", corner_count));
  }
  glm::uvec3 triangle{0};
  for (uint64_t corner = 0; corner < corner_count; ++corner) {
    const uint64_t index = reader.integer(property.type, "the index of a vertex");
    if (index >= vertex_count) {
      reader.fail(fmt::format("there is no vertex {}; the file has {}, counted from 0", index,
                              vertex_count));
    }
    triangle[corner == 0 ? 0 : 2] = static_cast<uint32_t>(index);
    if (corner >= 2) triangles.push_back(triangle);
    if (corner >= 1) triangle.y = triangle.z;
  }
  if (triangles.size() > max_triangle_count) {
    reader.fail(fmt::format("more than {} triangles", max_triangle_count));
  }
}

template <class Reader>
void read_faces(Reader& reader, const Element& element, uint64_t vertex_count,
                std::vector<glm::uvec3>& triangles) {
  const auto corners = std::ranges::find_if(element.properties, is_corner_list);
  triangles.reserve(element.count);
  prefer_large_pages(triangles.data(), element.count * sizeof(glm::uvec3));
  for (uint64_t i = 0; i < element.count; ++i) {
    reader.at.item = i;
    for (const Property& property : element.properties) {
      if (&property == &*corners) {
        read_polygon(reader, property, vertex_count, triangles);
      } else {
        skip_property(reader, property);
      }
    }
  }
}

template <class Reader>
Mesh read_body(const MeshText& file, const Header& header, uint64_t vertex_count, Reader reader) {
  Mesh mesh;
  for (const Element& element : header.elements) {
    // Before anything is allocated: the header may promise more than the file can hold.
    const uint64_t least = Reader::least_bytes(element);
    if (least > 0 && element.count > reader.bytes_left() / least) {
      file.fail(
          fmt::format("its header promises {} {} elements, of {} bytes or more each, and {} bytes "
                      "are left; the file is cut off or its header is wrong",
                      element.count, quoted(element.name), least, reader.bytes_left()));
    }
    reader.at = {&element, 0};
    if (element.name == "vertex") {
      read_vertices(reader, element, mesh.positions);
    } else if (element.name == "face") {
      read_faces(reader, element, vertex_count, mesh.triangles);
    } else {
      skip_element(reader, element);
    }
  }
  reader.expect_end();
  return mesh;
}

const Element& find_element(const MeshText& file, const Header& header, std::string_view name) {
  for (const Element& element : header.elements) {
    if (element.name == name) return element;
  }
  file.fail(fmt::format("its header has no element '{}'", name));
}

void check_has(const MeshText& file, bool present, std::string_view what) {
  if (!present) file.fail(fmt::format("its header has no {}", what));
}

}  // namespace

Mesh parse_ply(const MeshText& file) {
  const Header header = HeaderParser(file).parse();
  const Element& vertex = find_element(file, header, "vertex");
  const Element& face = find_element(file, header, "face");
  std::array<bool, 4> has_axis{};
  for (const Property& property : vertex.properties) {
    has_axis[static_cast<size_t>(axis_of(property))] = true;
  }
  check_has(file, has_axis[0] && has_axis[1] && has_axis[2], "properties x, y and z of 'vertex'");
  const auto corner_lists =
      std::count_if(face.properties.begin(), face.properties.end(), is_corner_list);
  check_has(file, corner_lists == 1, "single list of integers 'vertex_indices' of 'face'");

  if (header.encoding == Encoding::ascii) {
    return read_body(file, header, vertex.count, AsciiReader(file, header.body));
  }
  const bool swap_bytes = header.encoding == Encoding::big_endian;
  return read_body(file, header, vertex.count, BinaryReader(file, header.body, swap_bytes));
}

}  // namespace energyprof::accel
