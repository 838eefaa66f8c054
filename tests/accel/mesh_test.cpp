// Reading PLY and OBJ, what is refused and in which words, and the exact weld.
#include "accel/mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>

#include "accel/bytes.h"
#include "accel/models.h"
#include "mesh_samples.h"

namespace energyprof::accel {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  if (at == std::string::npos) throw std::logic_error("nothing to replace: " + from);
  return text.replace(at, from.size(), to);
}

/// The message with which a file is refused; empty if it is read.
std::string refusal(const std::string& name, const std::string& contents) {
  try {
    parse_mesh(name, contents);
    return {};
  } catch (const std::runtime_error& error) {
    return error.what();
  }
}

void expect_sample(const Mesh& mesh) {
  EXPECT_THAT(mesh.positions,
              ElementsAre(glm::vec3(0, 0, 0), glm::vec3(1, 0, 0.25f), glm::vec3(1, 1, -0.5f),
                          glm::vec3(0, 1, 1e-3f), glm::vec3(2, 0.5f, 0)));
  EXPECT_THAT(mesh.triangles,
              ElementsAre(glm::uvec3(0, 1, 2), glm::uvec3(0, 2, 3), glm::uvec3(1, 4, 2)));
}

class TempDir {
 public:
  TempDir() {
    std::string name = (std::filesystem::temp_directory_path() / "mesh-test-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("mkdtemp failed");
    path_ = name;
  }
  ~TempDir() { std::filesystem::remove_all(path_); }
  TempDir(const TempDir&) = delete;
  TempDir& operator=(const TempDir&) = delete;
  std::filesystem::path write(const std::string& name, const std::string& contents) const {
    std::ofstream(path_ / name, std::ios::binary) << contents;
    return path_ / name;
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

// ---- what is read ----

TEST(Mesh, ReadsTheSameFromEveryFormat) {
  expect_sample(parse_mesh("a.ply", ascii_ply));
  expect_sample(parse_mesh("a.ply", binary_ply(false)));
  expect_sample(parse_mesh("a.ply", binary_ply(true)));
  expect_sample(parse_mesh("a.obj", obj));
}

TEST(Mesh, ReadsFilesPackedByGzipWhateverTheyAreCalled) {
  const TempDir dir;
  expect_sample(read_mesh(dir.write("a.ply", ascii_ply)));
  expect_sample(read_mesh(dir.write("a.ply.gz", gzip(ascii_ply))));
  expect_sample(read_mesh(dir.write("b.PLY", gzip(binary_ply(true)))));
  expect_sample(read_mesh(dir.write("c.obj.gz", gzip(obj))));
  expect_sample(read_mesh(dir.write("d.obj.gz", obj)));
}

TEST(Mesh, ReadsSeveralGzipMembersOneAfterAnother) {
  expect_sample(parse_mesh("a.ply.gz",
                           gzip(ascii_ply.substr(0, 70)) + gzip(ascii_ply.substr(70)) + gzip("")));
}

TEST(Mesh, ReadsAsciiWithAnyLineEndsAndSpacing) {
  std::string crlf;
  for (const char c : ascii_ply) crlf += c == '\n' ? std::string("\r\n") : std::string(1, c);
  expect_sample(parse_mesh("a.ply", crlf));
  expect_sample(parse_mesh("a.ply", replaced(ascii_ply, "0 0 0\n1 0", "\n 0  0\t0\n\n1 0")));
  expect_sample(parse_mesh("a.ply", ascii_ply.substr(0, ascii_ply.size() - 1)));
}

TEST(Mesh, SkipsOtherPropertiesInAscii) {
  std::string text =
      replaced(ascii_ply, "property float y\n",
               "property uchar red\nproperty list uchar float w\nproperty double y\n");
  for (const char* line : {"0 0 0\n", "1 0 0.25\n", "1 1 -0.5\n", "0 1 1e-3\n", "2 0.5 0\n"}) {
    const std::string whole = line;
    text = replaced(text, "\n" + whole,
                    "\n" + whole.substr(0, 2) + "200 2 0.5 nan " + whole.substr(2));
  }
  expect_sample(parse_mesh("a.ply", text));
}

TEST(Mesh, ReadsFacesThatStandBeforeTheirVertices) {
  const Mesh mesh = parse_mesh("a.ply",
                               "ply\nformat ascii 1.0\nelement face 1\n"
                               "property list uchar int vertex_indices\nelement vertex 3\n"
                               "property int z\nproperty int y\nproperty int x\nend_header\n"
                               "3 0 1 2\n3 2 1\n6 5 4\n9 8 0\n");
  EXPECT_THAT(mesh.positions,
              ElementsAre(glm::vec3(1, 2, 3), glm::vec3(4, 5, 6), glm::vec3(0, 8, 9)));
}

TEST(Mesh, ReadsEveryScalarTypeInBinary) {
  struct Case {
    std::string type;
    std::string bytes;
  };
  const auto of = [](auto value) { return ByteWriter(false).put(value).bytes(); };
  for (const auto& [type, bytes] :
       {Case{"char", of(int8_t{-3})}, Case{"int8", of(int8_t{-3})}, Case{"short", of(int16_t{-3})},
        Case{"int16", of(int16_t{-3})}, Case{"int", of(int32_t{-3})},
        Case{"int32", of(int32_t{-3})}, Case{"float", of(-3.0f)}, Case{"float32", of(-3.0f)},
        Case{"double", of(-3.0)}, Case{"float64", of(-3.0)}}) {
    const std::string one = of(1.0f);
    const std::string zero = of(0.0f);
    const Mesh mesh = parse_mesh(
        "a.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty " + type +
                     " x\nproperty float y\nproperty float z\nelement face 1\n"
                     "property list uint ushort vertex_indices\nend_header\n" +
                     bytes + zero + zero + bytes + one + zero + bytes + one + one +
                     of(uint32_t{3}) + of(uint16_t{0}) + of(uint16_t{1}) + of(uint16_t{2}));
    ASSERT_EQ(mesh.positions.size(), 3u) << type;
    for (const glm::vec3 p : mesh.positions) EXPECT_EQ(p.x, -3.0f) << type;
  }
}

TEST(Mesh, ReadsAFileWithoutVertices) {
  const Mesh mesh = parse_mesh("a.ply",
                               "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\n"
                               "property float y\nproperty float z\nelement face 0\n"
                               "property list uchar int vertex_indices\nend_header\n");
  EXPECT_TRUE(mesh.positions.empty());
  EXPECT_TRUE(mesh.triangles.empty());
  EXPECT_EQ(bounds(mesh).min, glm::vec3(0.0f));
  EXPECT_EQ(bounds(mesh).max, glm::vec3(0.0f));
}

TEST(Mesh, KnowsTheNamesItReads) {
  for (const char* name : {"a.ply", "a.ply.gz", "a.obj", "a.obj.gz", "A.PLY", "b/c.OBJ.GZ"}) {
    EXPECT_TRUE(is_mesh_name(name)) << name;
  }
  for (const char* name : {"a.stl", "ply", "a.gz", "a.ply.bz2", ""})
    EXPECT_FALSE(is_mesh_name(name));
}

// ---- what is refused ----

struct Refused {
  const char* from;
  const char* to;
  const char* words;  ///< in the message
};

TEST(Mesh, RefusesAsciiPlyAndSaysWhereAndWhy) {
  for (const auto& [from, to, words] : {
           Refused{"ply\n", "plx\n", "line 1: a PLY file begins with 'ply', not with 'plx'"},
           Refused{"ascii 1.0", "ascii 2.0",
                   "line 2: 'format ascii 2.0' is not a single 'format' line"},
           Refused{"ascii 1.0", "latin 1.0",
                   "line 2: format 'latin' is not ascii, binary_little_endian"},
           Refused{"format ascii 1.0\n", "", "has no 'format' line"},
           Refused{"comment", "remark", "line 3: 'remark' is not a keyword of a PLY header"},
           Refused{"vertex 5", "vertex five", "line 4: 'five' is not a count of elements"},
           Refused{"vertex 5", "vertex -5", "line 4: '-5' is not a count of elements"},
           Refused{"vertex 5", "vertex", "line 4: 'element vertex' is not 'element NAME COUNT'"},
           Refused{"element vertex", "element point", "its header has no element 'vertex'"},
           Refused{"element face", "element strip", "its header has no element 'face'"},
           Refused{"element face", "element vertex", "line 8: a second element 'vertex'"},
           Refused{"element vertex 5\n", "", "line 4: a 'property' before any 'element'"},
           Refused{"float x", "float w", "its header has no properties x, y and z of 'vertex'"},
           Refused{"float y", "float x", "line 6: a second property 'x'"},
           Refused{"float x", "real x", "line 5: 'real' is not a type"},
           Refused{"property float x", "property x", "line 5: 'property x' is neither"},
           Refused{"list uchar int", "list float int",
                   "line 9: the count of a list must be of an integer type"},
           Refused{"list uchar int", "list uchar float",
                   "no single list of integers 'vertex_indices'"},
           Refused{"vertex_indices", "corners", "no single list of integers 'vertex_indices'"},
           Refused{"end_header\n", "", "line 10: '0' is not a keyword"},
           Refused{"1 0 0.25", "1 0 nan",
                   "line 12: element 'vertex', 1 of 5: 'nan' is not a coordinate"},
           Refused{"1 0 0.25", "1 0 -inf",
                   "line 12: element 'vertex', 1 of 5: '-inf' is not a coordinate"},
           Refused{"1 0 0.25", "1 0 1e39",
                   "'1e39' is not a coordinate: it must be finite and no larger"},
           Refused{"1 0 0.25", "1 0 1e999", "'1e999' is not a coordinate"},
           Refused{"1 0 0.25", "1 0 0.25x", "'0.25x' is not a number"},
           Refused{"1 0 0.25", "1 0", "line 16: element 'face', 0 of 2: 0 corners are too few"},
           Refused{"3 1 4 2", "3 1 5 2",
                   "line 17: element 'face', 1 of 2: there is no vertex 5; the file has 5"},
           Refused{"3 1 4 2", "3 1 -4 2",
                   "'-4' is not the index of a vertex, a whole number from 0 up"},
           Refused{"3 1 4 2", "3 1 4.5 2", "'4.5' is not the index of a vertex"},
           Refused{"3 1 4 2", "3 1 18446744073709551617 2",
                   "'18446744073709551617' is not the index"},
           Refused{"3 1 4 2", "2 1 4",
                   "element 'face', 1 of 2: 2 corners are too few; a face has 3 or more"},
           Refused{"3 1 4 2", "-3 1 4 2", "'-3' is not the number of corners"},
           Refused{"3 1 4 2\n", "3 1 4",
                   "element 'face', 1 of 2: the file ends where the index of a vertex"},
           Refused{"3 1 4 2\n", "", "the file ends where the number of corners should stand"},
           Refused{"3 1 4 2", "3 1 4 2 0", "line 17: '0' follows where the file should end"},
           Refused{"vertex 5", "vertex 4000", "its header promises 4000 'vertex' elements"},
           Refused{"face 2", "face 2147483646",
                   "promises 2147483646 'face' elements, of 2 bytes or more each"},
           Refused{"face 2", "face 2147483647",
                   "line 8: 2147483647 face elements are too many; at most 2147483646 fit"},
           Refused{"face 2", "face 99999999999999999999", "is not a count of elements"},
           Refused{"vertex 5", "vertex 18446744073709551615",
                   "18446744073709551615 vertex elements are too many"},
       }) {
    const std::string message = refusal("dir/a.ply", replaced(ascii_ply, from, to));
    EXPECT_THAT(message, AllOf(HasSubstr("'dir/a.ply'"), HasSubstr(words), Not(HasSubstr("\n"))))
        << from << " -> " << to;
  }
}

TEST(Mesh, RefusesBinaryPlyAndSaysWhereAndWhy) {
  const std::string good = binary_ply(false);
  const size_t body = good.find("end_header\r\n") + 12;
  // The first vertex begins after the camera's two bytes: z is a double, two shorts, x, y, alpha.
  const auto patched = [&](size_t at, auto value) {
    std::string bytes = good;
    std::memcpy(bytes.data() + body + at, &value, sizeof(value));
    return bytes;
  };
  const size_t faces = 2 + 5 * 22;
  EXPECT_THAT(refusal("a.ply", patched(2, std::numeric_limits<double>::quiet_NaN())),
              HasSubstr("element 'vertex', 0 of 5: nan is not a coordinate"));
  EXPECT_THAT(refusal("a.ply", patched(2, 1e300)), HasSubstr("1e+300 is not a coordinate"));
  EXPECT_THAT(refusal("a.ply", patched(2 + 13, std::numeric_limits<float>::infinity())),
              HasSubstr("inf is not a coordinate: it must be finite"));
  EXPECT_THAT(refusal("a.ply", patched(faces + 1, uint16_t{2})),
              HasSubstr("2 corners are too few"));
  EXPECT_THAT(refusal("a.ply", patched(faces + 1, uint16_t{40000})),
              HasSubstr("element 'face', 0 of 2"));
  EXPECT_THAT(refusal("a.ply", patched(faces + 3, uint32_t{5})),
              AllOf(HasSubstr("byte " + std::to_string(body + faces + 7)),
                    HasSubstr("there is no vertex 5")));
  EXPECT_THAT(refusal("a.ply", patched(good.size() - body - 4, int32_t{-2})),
              HasSubstr("-2 is not the count of a list"));
  EXPECT_THAT(refusal("a.ply", patched(good.size() - body - 4, int32_t{2000000000})),
              HasSubstr("2000000000 more bytes are needed and 0 are left"));
  EXPECT_THAT(refusal("a.ply", good + "abc"),
              HasSubstr("3 bytes follow where the file should end"));
  EXPECT_EQ(refusal("a.ply", good + "\n"), "");
}

TEST(Mesh, RefusesEveryTruncation) {
  for (const std::string& whole : {binary_ply(false), binary_ply(true), ascii_ply}) {
    // The last byte of ASCII is a line end, which may be missing, and the last digit before it
    // would be, too, were the index longer.
    const size_t longest = whole == ascii_ply ? whole.size() - 2 : whole.size() - 1;
    for (size_t length = 0; length <= longest; ++length) {
      EXPECT_NE(refusal("a.ply", whole.substr(0, length)), "") << length;
    }
  }
  const std::string packed = gzip(ascii_ply);
  for (size_t length = 0; length < packed.size(); ++length) {
    EXPECT_NE(refusal("a.ply.gz", packed.substr(0, length)), "") << length;
  }
}

TEST(Mesh, RefusesObjAndSaysWhereAndWhy) {
  for (const auto& [from, to, words] : {
           Refused{"v 0 0 0", "v 0 0", "line 4: a number is missing"},
           Refused{"v 0 0 0", "v 0 0 nan", "line 4: 'nan' is not a coordinate"},
           Refused{"v 0 0 0", "v 0 zero 0", "line 4: 'zero' is not a number"},
           Refused{"v 0 0 0", "v 0 1e40 0",
                   "line 4: '1e40' is not a coordinate: it must be finite"},
           Refused{"f 1/1/1", "f 9/1/1",
                   "line 11: there is no vertex 9; the file has 5, counted from 1"},
           Refused{"f 1/1/1", "f 0/1/1", "line 11: '0/1/1' is not a vertex"},
           Refused{"f 1/1/1", "f 99999999999999999999",
                   "line 11: '99999999999999999999' is not a corner"},
           Refused{"f 1/1/1", "f -5/1/1", "line 11: '-5/1/1' is not a vertex; 4 have come before"},
           Refused{"f 1/1/1", "f 1/1/1/1", "'1/1/1/1' is not a corner: i, i/j, i//k or i/j/k"},
           Refused{"f 1/1/1", "f 1.5", "'1.5' is not a corner"},
           Refused{"f 1/1/1", "f one", "'one' is not a corner"},
           Refused{"f 1/1/1 2//1 3/1 4", "f 1 2",
                   "line 11: 2 corners are too few; a face has 3 or more"},
           Refused{"f 1/1/1 2//1 3/1 4", "f", "line 11: 0 corners are too few"},
       }) {
    EXPECT_THAT(refusal("a.obj", replaced(obj, from, to)),
                AllOf(HasSubstr("'a.obj'"), HasSubstr(words), Not(HasSubstr("\n"))))
        << from << " -> " << to;
  }
  EXPECT_THAT(refusal("a.obj", "hello\n"), HasSubstr("it has no 'v' line"));
  EXPECT_THAT(refusal("a.obj", std::string("v 0 0 0\n\0", 9)), HasSubstr("byte 8: a byte 0"));
}

TEST(Mesh, AnObjFaceMayNameVerticesThatFollow) {
  EXPECT_EQ(parse_mesh("a.obj", "f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\n").triangles.size(), 1u);
}

TEST(Mesh, RefusesFilesThatAreNone) {
  const TempDir dir;
  const auto reason = [](const std::filesystem::path& file) {
    try {
      read_mesh(file);
      return std::string();
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
  };
  EXPECT_THAT(reason(dir.path() / "none.ply"), HasSubstr("none.ply': No such file or directory."));
  EXPECT_THAT(reason(dir.path()), HasSubstr("it is a directory, not a file"));
  EXPECT_THAT(reason(dir.write("empty.ply", "")), HasSubstr("it is empty"));
  EXPECT_THAT(reason(dir.write("a.stl", ascii_ply)),
              HasSubstr(".ply, .ply.gz, .obj and .obj.gz are read"));
  EXPECT_THAT(reason("/dev/null"), HasSubstr("it is not a regular file"));
  EXPECT_THAT(reason(dir.write("line\nbreak.ply", "")), HasSubstr("line\\x0abreak.ply'"));
  EXPECT_THAT(reason(dir.write("garbage.ply", "\x7f\x45\x4c\x46\x02\x01\n\x01")),
              HasSubstr("not with '\\x7fELF\\x02\\x01'"));
}

TEST(Mesh, RefusesDamagedGzip) {
  const std::string packed = gzip(ascii_ply);
  std::string damaged = packed;
  damaged[damaged.size() / 2] = static_cast<char>(damaged[damaged.size() / 2] ^ 0x10);
  EXPECT_THAT(refusal("a.ply.gz", damaged),
              HasSubstr("'a.ply.gz': byte 0: the gzip data that begins"));
  EXPECT_THAT(
      refusal("a.ply.gz", packed + "tail"),
      HasSubstr("byte " + std::to_string(packed.size()) + ": what follows is not gzip data"));
  EXPECT_THAT(refusal("a.ply.gz", gzip("")), HasSubstr("it is empty once unpacked"));
}

TEST(Gzip, TrustsNoSizeThatTheFileClaims) {
  const std::string text(300000, 'x');
  const std::string packed = gzip(text);
  EXPECT_EQ(inflate_gzip("a", packed).view(), text);
  for (const uint32_t lie : {0u, 1u, 299999u, 300001u, 0xffffffffu}) {
    std::string lying = packed;
    std::memcpy(lying.data() + lying.size() - 4, &lie, 4);
    EXPECT_THROW(inflate_gzip("a", lying), std::runtime_error) << lie;
  }
  // Two members: the last four bytes speak of the second alone.
  EXPECT_EQ(inflate_gzip("a", packed + gzip("y")).view(), text + "y");
}

TEST(Gzip, StopsAtItsLimit) {
  const std::string packed = gzip(std::string(1 << 20, '\0'));
  EXPECT_EQ(inflate_gzip("a", packed, 1 << 20).byte_count, size_t{1} << 20);
  try {
    inflate_gzip("bomb", packed, (1 << 20) - 1);
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(
        error.what(),
        HasSubstr("'bomb': byte 0: the gzip data that begins here holds more than 1048575 bytes"));
  }
}

// ---- the weld ----

TEST(Weld, MergesEqualPositionsAndTakesMinusZeroForZero) {
  const Mesh mesh{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {-0.0f, 0, -0.0f}, {1, 1, 0}, {0, 1, 0}},
                  {{0, 1, 2}, {3, 4, 5}}};
  MeshInfo info;
  const Mesh welded = weld(mesh, &info);
  EXPECT_THAT(welded.positions, ElementsAre(glm::vec3(0, 0, 0), glm::vec3(1, 0, 0),
                                            glm::vec3(0, 1, 0), glm::vec3(1, 1, 0)));
  EXPECT_THAT(welded.triangles, ElementsAre(glm::uvec3(0, 1, 2), glm::uvec3(0, 3, 2)));
  EXPECT_EQ(info.file_vertex_count, 6u);
  EXPECT_EQ(info.file_triangle_count, 2u);
  EXPECT_EQ(info.welded_vertex_count, 2u);
  EXPECT_EQ(info.unreferenced_vertex_count, 0u);
  EXPECT_EQ(info.degenerate_triangle_count, 0u);
}

TEST(Weld, KeepsPositionsThatDifferInTheLastBit) {
  const float next = std::nextafter(1.0f, 2.0f);
  const Mesh welded = weld({{{1, 0, 0}, {next, 0, 0}, {0, 1, 0}}, {{0, 1, 2}}});
  EXPECT_EQ(welded.positions.size(), 3u);
  EXPECT_EQ(welded.triangles.size(), 1u);
}

TEST(Weld, DropsDegenerateTrianglesAndWhatOnlyTheyUse) {
  MeshInfo info;
  const Mesh welded = weld({{{9, 9, 9}, {0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 0, 0}, {5, 5, 5}},
                            {{0, 0, 1}, {1, 2, 4}, {1, 2, 3}, {1, 5, 5}}},
                           &info);
  EXPECT_THAT(welded.positions,
              ElementsAre(glm::vec3(0, 0, 0), glm::vec3(1, 0, 0), glm::vec3(0, 1, 0)));
  EXPECT_THAT(welded.triangles, ElementsAre(glm::uvec3(0, 1, 2)));
  EXPECT_EQ(info.welded_vertex_count, 1u);
  EXPECT_EQ(info.unreferenced_vertex_count, 2u);
  EXPECT_EQ(info.degenerate_triangle_count, 3u);
}

TEST(Weld, EndsWithoutNumbersThatEqualThemselves) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(weld({{{nan, 0, 0}, {nan, 0, 0}, {0, 0, nan}}, {{0, 1, 2}}}).positions.size(), 3u);
  EXPECT_TRUE(weld({}).positions.empty());
}

TEST(Weld, GivesTheDragonOfTheStudy) {
  const ModelInfo& dragon = *find_model("dragon");
  if (!is_available(dragon)) GTEST_SKIP() << "not in the cache: " << model_file(dragon);
  MeshInfo info;
  const Mesh mesh = read_mesh(model_file(dragon), &info);
  EXPECT_EQ(info.file_vertex_count, 437645u);
  EXPECT_EQ(info.file_triangle_count, 871414u);
  EXPECT_EQ(info.degenerate_triangle_count, 108u);
  EXPECT_EQ(mesh.positions.size(), 435545u);
  EXPECT_EQ(mesh.triangles.size(), 871306u);
}

TEST(Weld, GivesTheDragonTheCoordinatesThatStrtofReads) {
  const ModelInfo& dragon = *find_model("dragon");
  if (!is_available(dragon)) GTEST_SKIP() << "not in the cache: " << model_file(dragon);
  const Bytes text = inflate_gzip("dragon", read_file(model_file(dragon)).view());
  std::string copy(text.view());
  const char* p = copy.c_str() + copy.find("end_header\n") + 11;
  Mesh expected;
  for (size_t v = 0; v < 437645; ++v) {
    glm::vec3 position{0.0f};
    for (int axis = 0; axis < 3; ++axis) {
      char* stop = nullptr;
      position[axis] = std::strtof(p, &stop);
      p = stop;
    }
    expected.positions.push_back(position);
  }
  for (size_t t = 0; t < 871414; ++t) {
    glm::uvec3 triangle{0};
    char* stop = nullptr;
    ASSERT_EQ(std::strtoul(p, &stop, 10), 3u);
    for (int k = 0; k < 3; ++k) {
      triangle[k] = static_cast<uint32_t>(std::strtoul(stop, &stop, 10));
    }
    p = stop;
    expected.triangles.push_back(triangle);
  }
  const Mesh mesh = parse_mesh("dragon.ply", text.view());
  expected = weld(std::move(expected));
  EXPECT_TRUE(mesh.positions == expected.positions);
  EXPECT_TRUE(mesh.triangles == expected.triangles);
}

}  // namespace
}  // namespace energyprof::accel
