// Ranks and chooses devices.
#include "kernels/device_choice.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <stdexcept>

namespace energyprof::kernels {
namespace {

/// Integrated first: it is the class of machine the study is about, and it shares the package
/// sensors.
constexpr std::array<std::string_view, 5> preference{"integrated", "discrete", "virtual", "cpu",
                                                     "other"};

auto rank_of(const Candidate& candidate) {
  return std::find(preference.begin(), preference.end(), candidate.info.type);
}

std::string lower(std::string_view text) {
  std::string result(text);
  std::transform(result.begin(), result.end(), result.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return result;
}

bool name_fits(const Candidate& candidate, std::string_view name) {
  return name == "auto" || lower(candidate.info.name).find(lower(name)) != std::string::npos;
}

}  // namespace

std::vector<size_t> rank_devices(std::span<const Candidate> candidates) {
  std::vector<size_t> order;
  for (size_t i = 0; i < candidates.size(); ++i) {
    if (candidates[i].unusable.empty()) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return rank_of(candidates[a]) < rank_of(candidates[b]);
  });
  return order;
}

Choice choose_device(std::span<const Candidate> candidates, std::string_view name) {
  const std::vector<size_t> order = rank_devices(candidates);
  const auto chosen = std::find_if(order.begin(), order.end(),
                                   [&](size_t i) { return name_fits(candidates[i], name); });
  Choice choice;
  for (size_t i = 0; i < candidates.size(); ++i) {
    if (chosen != order.end() && i == *chosen) continue;
    const Candidate& candidate = candidates[i];
    std::string reason = candidate.unusable;
    if (reason.empty() && !name_fits(candidate, name)) {
      reason = fmt::format("name does not contain '{}'", name);
    }
    if (reason.empty()) reason = fmt::format("ranked below '{}'", candidates[*chosen].info.name);
    choice.refusals.push_back({candidate.info.name, std::move(reason)});
  }
  if (chosen == order.end()) throw std::runtime_error(no_device_fits(choice.refusals));
  choice.index = *chosen;
  return choice;
}

std::string no_device_fits(std::span<const DeviceRefusal> refusals) {
  std::string reasons;
  for (const DeviceRefusal& refusal : refusals) {
    reasons += fmt::format("{}'{}': {}", reasons.empty() ? "" : "; ", refusal.name, refusal.reason);
  }
  return fmt::format("no Vulkan device fits: {}.", reasons);
}

}  // namespace energyprof::kernels
