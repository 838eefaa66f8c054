/// Which of the machine's devices to take: pure, so that tests can invent machines.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "kernels/device.h"

namespace energyprof::kernels {

/// A device as found on the machine.
struct Candidate {
  DeviceInfo info;
  std::string unusable;  ///< why it can never be taken; empty: it can
};

struct Choice {
  size_t index = 0;                     ///< into the candidates
  std::vector<DeviceRefusal> refusals;  ///< one for each of the others
};

/// Indices of the usable candidates, most preferred first: integrated, discrete, virtual, CPU.
std::vector<size_t> rank_devices(std::span<const Candidate> candidates);

/// The device DeviceRequest::name asks for. Throws std::runtime_error with every candidate's reason
/// if none fits.
Choice choose_device(std::span<const Candidate> candidates, std::string_view name);

/// "no Vulkan device fits: 'A': reason; 'B': reason."
std::string no_device_fits(std::span<const DeviceRefusal> refusals);

}  // namespace energyprof::kernels
