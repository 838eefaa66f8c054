// Damaged files of every kind: each is either read or refused in one line. Nothing else may happen;
// the sanitizers of a Debug build see to that.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "accel/mesh.h"
#include "mesh_samples.h"

namespace energyprof::accel {
namespace {

struct Seedling {
  const char* name;
  std::string contents;
};

std::vector<Seedling> valid_files() {
  return {{"a.ply", ascii_ply},          {"le.ply", binary_ply(false)},
          {"be.ply", binary_ply(true)},  {"a.obj", obj},
          {"a.ply.gz", gzip(ascii_ply)}, {"le.ply.gz", gzip(binary_ply(false))},
          {"a.obj.gz", gzip(obj)}};
}

/// One to eight changes: a byte set, a bit flipped, bytes removed, repeated or put in from a list
/// of what readers trip over, or the end cut off.
std::string damaged(std::string bytes, std::mt19937& random) {
  static const std::vector<std::string> words{"-1",
                                              "0",
                                              "99999999999",
                                              "4294967295",
                                              "4294967296",
                                              "18446744073709551615",
                                              "nan",
                                              "1e999",
                                              "-",
                                              ".",
                                              "/",
                                              "\\\n",
                                              "\n",
                                              "\r",
                                              " ",
                                              "list uchar int ",
                                              "property float x\n",
                                              "element face 4294967295\n",
                                              std::string(1, '\0'),
                                              "\xff\xff\xff\xff"};
  const auto below = [&](size_t n) { return n == 0 ? 0 : random() % n; };
  const size_t change_count = 1 + below(8);
  for (size_t i = 0; i < change_count && !bytes.empty(); ++i) {
    const size_t at = below(bytes.size());
    switch (below(6)) {
      case 0:
        bytes[at] = static_cast<char>(random());
        break;
      case 1:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << below(8)));
        break;
      case 2:
        bytes.erase(at, 1 + below(8));
        break;
      case 3:
        bytes.insert(at, bytes.substr(at, 1 + below(32)));
        break;
      case 4:
        bytes.insert(at, words[below(words.size())]);
        break;
      case 5:
        if (below(4) == 0) bytes.resize(at);
        break;
    }
  }
  return bytes;
}

void expect_consistent(const Mesh& mesh) {
  for (const glm::uvec3 t : mesh.triangles) {
    for (int k = 0; k < 3; ++k) ASSERT_LT(t[k], mesh.positions.size());
  }
  for (const glm::vec3 p : mesh.positions) {
    ASSERT_TRUE(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z));
  }
}

TEST(MeshFuzz, DamagedFilesAreReadOrRefusedInOneLine) {
  constexpr unsigned rounds = 4000;
  for (const Seedling& file : valid_files()) {
    SCOPED_TRACE(file.name);
    ASSERT_NO_THROW(parse_mesh(file.name, file.contents));
    unsigned refused_count = 0;
    for (unsigned seed = 0; seed < rounds; ++seed) {
      SCOPED_TRACE(seed);
      std::mt19937 random(seed);
      const std::string bytes = damaged(file.contents, random);
      try {
        expect_consistent(parse_mesh(file.name, bytes));
      } catch (const std::runtime_error& error) {
        const std::string message = error.what();
        ++refused_count;
        ASSERT_EQ(message.find_first_of("\n\r"), std::string::npos) << message;
        ASSERT_NE(message.find(file.name), std::string::npos) << message;
        ASSERT_TRUE(message.ends_with('.')) << message;
        ASSERT_LT(message.size(), 400u) << message;
      }
      if (HasFatalFailure()) return;
    }
    EXPECT_GT(refused_count, rounds / 4);
    RecordProperty(file.name, static_cast<int>(refused_count));
  }
}

}  // namespace
}  // namespace energyprof::accel
