#include "app/algorithms.h"

#include <array>

namespace energyprof::app {
namespace {

constexpr std::array algorithms{
    Algorithm{"BVH_FTB_DF", "BVH_FTB_DF",
              [](const accel::Mesh& mesh) { return accel::build_bvh(mesh); }},
};

}  // namespace

const Algorithm* find_algorithm(std::string_view name) {
  for (const Algorithm& algorithm : algorithms)
    if (algorithm.name == name) return &algorithm;
  return nullptr;
}

std::string algorithm_names() {
  std::string names;
  for (const Algorithm& algorithm : algorithms) {
    if (!names.empty()) names += ", ";
    names += algorithm.name;
  }
  return names;
}

}  // namespace energyprof::app
