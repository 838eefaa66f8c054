#include "analysis/report_html.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <string_view>
#include <tuple>
#include <unordered_set>
#include <utility>

#include "analysis/format.h"
#include "analysis/report_json.h"
#include "analysis/report_text.h"
#include "analysis/series.h"
#include "embedded/echarts_script.h"
#include "embedded/report_licences.h"
#include "embedded/report_page.h"
#include "embedded/report_script.h"
#include "embedded/report_style.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;

constexpr std::size_t max_points_per_channel = 2'000;
constexpr std::size_t max_sensor_points = 120'000;
constexpr std::size_t max_frame_points = 40'000;
constexpr std::size_t max_image_bytes = 3 * 1024 * 1024;

std::string base64(std::string_view bytes) {
  constexpr std::string_view digits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t count = std::min<std::size_t>(3, bytes.size() - i);
    uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k)
      group = group << 8 | (k < count ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k)
      text += k <= count ? digits[group >> (18 - 6 * k) & 63u] : '=';
  }
  return text;
}

/// Six significant digits: enough to draw, and short as text.
double short_number(double value) {
  if (value == 0 || !std::isfinite(value)) return 0;
  const double scale = std::pow(10, 5 - std::floor(std::log10(std::fabs(value))));
  return std::isfinite(scale) ? std::round(value * scale) / scale : value;
}

/// Seconds since the begin of the run, to the microsecond.
double seconds(const Analysis& analysis, int64_t t_ns) {
  return std::round(static_cast<double>(t_ns - analysis.run.begin_ns) * 1e-3) * 1e-6;
}

/// Per cell the points [seconds, ms, frame, is outlier], null between two trials.
json frame_points(const RunRecord& run, const Analysis& analysis) {
  json cells = json::array();
  std::unordered_set<std::size_t> outliers;
  for (const Outlier& outlier : analysis.outliers) outliers.insert(outlier.frame_index);
  const std::size_t limit = std::max<std::size_t>(
      200, max_frame_points / std::max<std::size_t>(1, analysis.cells.size()));
  for (const Cell& cell : analysis.cells) {
    std::vector<int64_t> begin_ns;
    for (std::size_t i : cell.frame_index) begin_ns.push_back(run.frames[i].begin_ns);
    json points = json::array();
    std::optional<int64_t> trial_id;
    for (std::size_t i : thin_points(begin_ns, cell.frame_ms, limit)) {
      const FrameRecord& frame = run.frames[cell.frame_index[i]];
      if (trial_id && *trial_id != frame.trial_id) points.push_back(nullptr);
      trial_id = frame.trial_id;
      const bool outlier = outliers.contains(cell.frame_index[i]);
      points.push_back({seconds(analysis, frame.begin_ns), short_number(cell.frame_ms[i]),
                        frame.frame, outlier ? 1 : 0});
    }
    cells.push_back(std::move(points));
  }
  return cells;
}

/// A channel as it is drawn: counters as rates, units as on the axis.
struct Drawn {
  Curve curve;
  std::string title;  // what the axis shows
  std::string note;   // how it was derived; may be empty
};

std::optional<Drawn> draw(const Channel& channel, const SampleSeries& series) {
  Drawn drawn;
  drawn.title = to_string(channel.quantity);
  std::replace(drawn.title.begin(), drawn.title.end(), '_', ' ');
  std::string si(unit_info(channel.unit).si);
  if (channel.kind == Kind::cumulative) {
    auto curve = rate(channel, series);
    if (!curve) return std::nullopt;
    drawn.curve = std::move(*curve);
    si = drawn.curve.unit;
    drawn.title = si == "W" ? "power, from energy counters" : drawn.title + ", rate of counters";
    drawn.note =
        "Counters are shown as their mean rate over windows of at least 20 polls and 20 updates "
        "of the sensor.";
  } else {
    const double factor = unit_info(channel.unit).to_si;
    drawn.curve = changes_only({series.t_ns, series.value, ""});
    for (double& value : drawn.curve.value) value *= factor;
    if (channel.unit == Unit::none) si = stored_unit(channel);
    if (channel.kind == Kind::flag) si = "0 or 1";
  }
  const AxisUnit axis = axis_unit(si);
  for (double& value : drawn.curve.value) value *= axis.factor;
  drawn.curve.unit = axis.name;
  return drawn;
}

json curve_json(const Analysis& analysis, const Channel& channel, const Curve& curve) {
  json t_s = json::array();
  json value = json::array();
  for (std::size_t i = 0; i < curve.t_ns.size(); ++i) {
    t_s.push_back(seconds(analysis, curve.t_ns[i]));
    value.push_back(short_number(curve.value[i]));
  }
  return {{"name", channel.name}, {"t_s", std::move(t_s)}, {"value", std::move(value)}};
}

/// Sensor tracks, one per title and unit, and the names of the channels that are not drawn.
std::pair<json, json> sensor_tracks(const RunRecord& run, const Analysis& analysis) {
  const std::size_t limit = std::clamp<std::size_t>(
      max_sensor_points / std::max<std::size_t>(1, run.series.size()), 100, max_points_per_channel);
  std::map<std::tuple<Quantity, std::string, std::string>, json> tracks;
  json constant = json::array();
  json too_short = json::array();
  for (const SensorSummary& sensor : analysis.sensors) {
    if (sensor.sample_count == 0) continue;
    if (sensor.update_count == 0) {
      constant.push_back(sensor.channel.name);
      continue;
    }
    const auto drawn = draw(sensor.channel, run.series.at(sensor.channel.id));
    if (!drawn) {
      too_short.push_back(sensor.channel.name);
      continue;
    }
    json& track = tracks[{sensor.channel.quantity, drawn->title, drawn->curve.unit}];
    if (track.is_null())
      track = {{"title", drawn->title},
               {"unit", drawn->curve.unit},
               {"note", drawn->note},
               {"is_rate", sensor.channel.kind == Kind::cumulative},
               {"is_flag", sensor.channel.kind == Kind::flag},
               {"channels", json::array()}};
    track["channels"].push_back(curve_json(analysis, sensor.channel, thin(drawn->curve, limit)));
  }
  json list = json::array();
  for (auto& [key, track] : tracks) list.push_back(std::move(track));
  return {std::move(list),
          {{"constant", std::move(constant)}, {"too_short", std::move(too_short)}}};
}

/// The sensor table's cells as words.
json sensor_rows(const Analysis& analysis) {
  json rows = json::array();
  for (const SensorSummary& sensor : analysis.sensors)
    rows.push_back({{"name", sensor.channel.name},
                    {"quantity", to_string(sensor.channel.quantity)},
                    {"samples", sensor.sample_count},
                    {"updates", sensor.update_count},
                    {"polled", duration_text(sensor.poll_ns)},
                    {"updated", duration_text(sensor.update_ns)},
                    {"read_cost", duration_text(sensor.channel.read_cost_ns)},
                    {"values", values_text(sensor)},
                    {"status", sensor.status},
                    {"origin", sensor.channel.origin}});
  return rows;
}

json reading_rows(const Analysis& analysis) {
  json rows = json::array();
  for (const Reading& row : readings(analysis))
    rows.push_back(
        {{"quantity", to_string(row.quantity)}, {"channel", row.channel}, {"text", row.text}});
  return rows;
}

json image_list(const std::vector<ReportImage>& images, std::size_t& left_out_count) {
  json list = json::array();
  std::size_t total_bytes = 0;
  for (const ReportImage& image : images) {
    if (image.png.empty()) continue;
    if (total_bytes + image.png.size() > max_image_bytes) {
      ++left_out_count;
      continue;
    }
    total_bytes += image.png.size();
    list.push_back({{"title", image.title}, {"src", "data:image/png;base64," + base64(image.png)}});
  }
  return list;
}

json page_data(const RunRecord& run, const Analysis& analysis,
               const std::vector<ReportImage>& images) {
  json data;
  std::size_t left_out_count = 0;
  std::vector<std::string> image_files;
  json named_images = json::array();
  for (const ReportImage& image : images) {
    image_files.push_back(image_file(image.title));
    if (image.png.empty()) named_images.push_back(image_files.back());
  }
  data["report"] = report_json(run, analysis, image_files);
  data["frames"] = frame_points(run, analysis);
  std::tie(data["tracks"], data["not_drawn"]) = sensor_tracks(run, analysis);
  data["sensor_rows"] = sensor_rows(analysis);
  data["readings"] = reading_rows(analysis);
  data["sampler"] = sampler_text(analysis.sampler);
  data["score_text"] = score_text(analysis);
  data["duration"] = duration_text(analysis.run.end_ns - analysis.run.begin_ns);
  data["images"] = image_list(images, left_out_count);
  data["images_left_out"] = left_out_count;
  data["named_images"] = std::move(named_images);
  data["cache_text"] = cache_text(analysis);
  data["idle_text"] = idle_text(analysis);
  return data;
}

/// JSON that cannot end the script element it stands in.
std::string script_json(const json& data) {
  const std::string text = data.dump(-1, ' ', false, json::error_handler_t::replace);
  std::string result;
  result.reserve(text.size() + text.size() / 64);
  for (char c : text) {
    if (c == '<')
      result += "\\u003c";
    else
      result += c;
  }
  return result;
}

std::string html_text(std::string_view text) {
  std::string result;
  for (char c : text) {
    switch (c) {
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '&':
        result += "&amp;";
        break;
      case '"':
        result += "&quot;";
        break;
      default:
        result += c;
    }
  }
  return result;
}

/// The template with every {{name}} it knows replaced; what is inserted is not searched again.
std::string fill(std::string_view page, const std::map<std::string_view, std::string_view>& parts) {
  std::string result;
  while (!page.empty()) {
    const std::size_t open = page.find("{{");
    const std::size_t close = open == page.npos ? page.npos : page.find("}}", open);
    if (close == page.npos) break;
    const auto part = parts.find(page.substr(open + 2, close - open - 2));
    result += page.substr(0, open);
    if (part != parts.end()) result += part->second;
    page.remove_prefix(close + 2);
  }
  result += page;
  return result;
}

}  // namespace

std::string image_file(const std::string& title) { return "images/" + title + ".png"; }

std::string report_html(const RunRecord& run, const Analysis& analysis,
                        const std::vector<ReportImage>& images) {
  const std::string title = html_text(analysis.run.name.value_or("run without a name"));
  const std::string data = script_json(page_data(run, analysis, images));
  const std::string licences = html_text(embedded::report_licences());
  return fill(embedded::report_page(), {{"title", title},
                                        {"style", embedded::report_style()},
                                        {"data", data},
                                        {"echarts", embedded::echarts_script()},
                                        {"script", embedded::report_script()},
                                        {"licences", licences}});
}

}  // namespace energyprof::analysis
