/// What report.html holds, read back.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace energyprof::analysis {

/// The page's data.
nlohmann::json data_of(const std::string& page);

std::string base64_decoded(const std::string& text);

/// A frame that the page draws.
struct DrawnFrame {
  double t_s = 0;
  double ms = 0;
  int64_t frame = 0;
  bool begins_trial = false;
  bool is_outlier = false;
  // Of outliers:
  int64_t cause = 0;
  bool is_stretch = false;
  double excess_ms = 0;
  int64_t confidence_percent = 0;
};

/// The frames of a cell, unpacked.
std::vector<DrawnFrame> drawn_frames(const nlohmann::json& data, std::size_t cell);

/// How many of all drawn frames are outliers.
std::size_t drawn_outlier_count(const nlohmann::json& data);

}  // namespace energyprof::analysis
