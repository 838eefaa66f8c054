#include "page_data.h"

#include <stdexcept>
#include <string_view>

namespace energyprof::analysis {

using nlohmann::json;

json data_of(const std::string& page) {
  const std::string open = R"(<script type="application/json" id="data">)";
  const std::size_t begin = page.find(open) + open.size();
  return json::parse(page.substr(begin, page.find("</script>", begin) - begin));
}

std::string base64_decoded(const std::string& text) {
  constexpr std::string_view digits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string bytes;
  uint32_t group = 0;
  int bits = 0;
  for (const char c : text) {
    const std::size_t digit = digits.find(c);
    if (digit == digits.npos) break;
    group = group << 6 | static_cast<uint32_t>(digit);
    bits += 6;
    if (bits < 8) continue;
    bits -= 8;
    bytes += static_cast<char>(group >> bits & 0xFFu);
  }
  return bytes;
}

std::vector<DrawnFrame> drawn_frames(const json& data, std::size_t cell) {
  const json& packed = data.at("frames").at(cell);
  const std::string bytes = base64_decoded(packed.at("points"));
  const double unit_ms = packed.at("unit_ms");
  std::size_t at = 0;
  const auto next = [&] {
    uint64_t bits = 0;
    for (int shift = 0;; shift += 7) {
      if (at == bytes.size()) throw std::runtime_error("the packed points are cut short");
      const auto byte = static_cast<unsigned char>(bytes[at++]);
      bits |= static_cast<uint64_t>(byte & 127u) << shift;
      if (byte < 128) break;
    }
    const auto half = static_cast<int64_t>(bits >> 1);
    return (bits & 1) != 0 ? -half - 1 : half;
  };
  std::vector<DrawnFrame> frames;
  int64_t t = 0;
  int64_t number = 0;
  int64_t level = 0;
  while (at < bytes.size()) {
    DrawnFrame frame;
    const int64_t head = next();
    t += next();
    number += next();
    level += next();
    frame.t_s = static_cast<double>(t) * 1e-5;
    frame.ms = static_cast<double>(level) * unit_ms;
    frame.frame = number;
    frame.begins_trial = head % 2 == 1;
    frame.is_outlier = head / 2 > 0;
    if (frame.is_outlier) {
      frame.cause = (head / 2 - 1) / 2;
      frame.is_stretch = (head / 2 - 1) % 2 == 1;
      frame.excess_ms = static_cast<double>(next()) * unit_ms;
      frame.ms += frame.excess_ms;
      frame.confidence_percent = next();
    }
    frames.push_back(frame);
  }
  if (frames.size() != packed.at("count")) throw std::runtime_error("the count is wrong");
  return frames;
}

std::size_t drawn_outlier_count(const json& data) {
  std::size_t count = 0;
  for (std::size_t cell = 0; cell < data.at("frames").size(); ++cell)
    for (const DrawnFrame& frame : drawn_frames(data, cell)) count += frame.is_outlier ? 1 : 0;
  return count;
}

}  // namespace energyprof::analysis
