/// The algorithms that can be traced: one row each, which is all that wires a builder to a kernel.
#pragma once

#include <string>
#include <string_view>

#include "accel/bvh.h"

namespace energyprof::app {

struct Algorithm {
  std::string_view name;    ///< as in configs and reports
  std::string_view kernel;  ///< as in kernels/: the compute shader
  accel::Built (*build)(const accel::Mesh& mesh);
};

/// nullptr for an algorithm that this version does not have.
const Algorithm* find_algorithm(std::string_view name);
/// All names, comma-separated.
std::string algorithm_names();

}  // namespace energyprof::app
