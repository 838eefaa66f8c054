/// Small mesh files as text and bytes, and gzip by another hand (zlib) than the reader's.
#pragma once

#include <zlib.h>
#include <bit>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include <algorithm>
#include <stdexcept>

namespace energyprof::accel {

inline std::string gzip(const std::string& text) {
  z_stream stream{};
  if (deflateInit2(&stream, 9, Z_DEFLATED, 15 + 16, 9, Z_DEFAULT_STRATEGY) != Z_OK) {
    throw std::runtime_error("deflateInit2 failed");
  }
  std::string out(deflateBound(&stream, text.size()) + 64, '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
  stream.avail_in = static_cast<uInt>(text.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  const int result = deflate(&stream, Z_FINISH);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  if (result != Z_STREAM_END) throw std::runtime_error("deflate failed");
  return out;
}

/// Appends values in the byte order of a binary PLY file.
class ByteWriter {
 public:
  explicit ByteWriter(bool big_endian) : big_endian_(big_endian) {}

  template <class T>
  ByteWriter& put(T value) {
    std::string bytes(sizeof(T), '\0');
    std::memcpy(bytes.data(), &value, sizeof(T));
    if (big_endian_) std::reverse(bytes.begin(), bytes.end());
    bytes_ += bytes;
    return *this;
  }
  [[nodiscard]] const std::string& bytes() const { return bytes_; }

 private:
  bool big_endian_;
  std::string bytes_;
};

/// A square of two triangles and a third beside it.
inline const std::string ascii_ply =
    "ply\n"
    "format ascii 1.0\n"
    "comment made by hand\n"
    "element vertex 5\n"
    "property float x\n"
    "property float y\n"
    "property float z\n"
    "element face 2\n"
    "property list uchar int vertex_indices\n"
    "end_header\n"
    "0 0 0\n"
    "1 0 0.25\n"
    "1 1 -0.5\n"
    "0 1 1e-3\n"
    "2 0.5 0\n"
    "4 0 1 2 3\n"
    "3 1 4 2\n";

/// The same mesh in binary, with other elements and properties around what is needed.
inline std::string binary_ply(bool big_endian) {
  ByteWriter body(big_endian);
  body.put(uint16_t{7});  // camera
  const std::vector<std::vector<double>> positions{
      {0, 0, 0}, {1, 0, 0.25}, {1, 1, -0.5}, {0, 1, 1e-3}, {2, 0.5, 0}};
  for (const auto& p : positions) {
    body.put(p[2]).put(uint8_t{2}).put(int16_t{-1}).put(int16_t{9});  // z, a list of two
    body.put(static_cast<float>(p[0])).put(static_cast<float>(p[1])).put(uint8_t{255});
  }
  body.put(uint8_t{1}).put(uint16_t{4});
  for (const uint32_t i : {0, 1, 2, 3}) body.put(i);
  body.put(uint8_t{2}).put(uint16_t{3});
  for (const uint32_t i : {1, 4, 2}) body.put(i);
  body.put(uint32_t{0});  // one empty strip
  return std::string("ply\r\nformat ") +
         (big_endian ? "binary_big_endian" : "binary_little_endian") +
         " 1.0\r\n"
         "obj_info with carriage returns\r\n"
         "element camera 1\r\n"
         "property ushort id\r\n"
         "element vertex 5\r\n"
         "property double z\r\n"
         "property list uchar short extra\r\n"
         "property float32 x\r\n"
         "property float y\r\n"
         "property uint8 alpha\r\n"
         "element face 2\r\n"
         "property uchar flags\r\n"
         "property list ushort uint32 vertex_index\r\n"
         "element strip 1\r\n"
         "property list int int8 indices\r\n"
         "end_header\r\n" +
         body.bytes();
}

/// The same mesh as OBJ, in every way a corner can be written.
inline const std::string obj =
    "# made by hand\n"
    "mtllib none.mtl\n"
    "o thing\n"
    "v 0 0 0\n"
    "v 1 0 0.25 1.0\n"
    "v 1 1 -0.5 0.1 0.2 0.3\n"
    "\tv  0 \\\n"
    "   1 1e-3\r\n"
    "vt 0 0\n"
    "vn 0 0 1\n"
    "f 1/1/1 2//1 3/1 4 # a comment\n"
    "v 2 0.5 0\n"
    "s off\n"
    "f -4 -1 \\\n"
    "  -3\n";

}  // namespace energyprof::accel
