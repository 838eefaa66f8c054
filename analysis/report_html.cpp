#include "analysis/report_html.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <iterator>
#include <map>
#include <numeric>
#include <set>
#include <string_view>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "analysis/format.h"
#include "analysis/frame_table.h"
#include "analysis/join_spans.h"
#include "analysis/relations.h"
#include "analysis/report_json.h"
#include "analysis/report_text.h"
#include "analysis/series.h"
#include "analysis/shrink_png.h"
#include "embedded/echarts_script.h"
#include "embedded/report_licences.h"
#include "embedded/report_page.h"
#include "embedded/report_script.h"
#include "embedded/report_style.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;

// What keeps the page below 3 MB; images take what the rest leaves.
constexpr std::size_t max_page_bytes = 3'000'000;
constexpr std::size_t max_points_per_channel = 2'000;
constexpr std::size_t max_sensor_points = 40'000;
constexpr std::size_t max_frame_points = 16'000;
constexpr std::size_t max_outliers = 100'000;
constexpr std::size_t max_evidence_outliers = 3'000;
constexpr std::size_t max_evidence_per_outlier = 3;
constexpr std::size_t max_bands = 2'000;
constexpr std::size_t max_scatter_frames = 4'000;
constexpr std::size_t max_scatter_values = 40'000;
constexpr std::size_t max_event_rows = 200;
constexpr std::size_t max_regime_rows = 20;

/// What is left of `most` points where many outliers need room; at least a quarter.
std::size_t room_beside_outliers(const Analysis& analysis, std::size_t most) {
  const std::size_t taken = std::min(max_outliers, analysis.outliers.size());
  return std::max(most - most * taken / max_outliers, most / 4);
}

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

/// Seconds since the begin of the run, to a hundredth of a millisecond: finer than a pixel, and
/// short as text.
double drawn_seconds(const Analysis& analysis, int64_t t_ns) {
  return std::round(static_cast<double>(t_ns - analysis.run.begin_ns) * 1e-4) / 1e5;
}

/// A number that names each different text once.
class TextTable {
 public:
  std::size_t index(const std::string& text) {
    const auto [found, is_new] = indices_.emplace(text, texts_.size());
    if (is_new) texts_.push_back(text);
    return found->second;
  }
  json take() { return std::move(texts_); }

 private:
  std::unordered_map<std::string, std::size_t> indices_;
  json texts_ = json::array();
};

/// The outliers that lost most time first, as indices into Analysis::outliers.
std::vector<std::size_t> worst_outliers(const Analysis& analysis) {
  std::vector<std::size_t> order(analysis.outliers.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return analysis.outliers[a].excess_ms > analysis.outliers[b].excess_ms;
  });
  return order;
}

/// The outliers that the page holds, numbered by cell and then by time, as it numbers them.
class DrawnOutliers {
 public:
  DrawnOutliers(const Analysis& analysis, const std::vector<std::size_t>& worst)
      : order_(worst.begin(),
               worst.begin() + static_cast<std::ptrdiff_t>(std::min(worst.size(), max_outliers))) {
    std::sort(order_.begin(), order_.end(), [&](std::size_t a, std::size_t b) {
      return std::pair(analysis.outliers[a].cell, a) < std::pair(analysis.outliers[b].cell, b);
    });
    for (std::size_t number = 0; number < order_.size(); ++number)
      number_of_.emplace(analysis.outliers[order_[number]].frame_index, number);
  }
  /// Indices into Analysis::outliers.
  [[nodiscard]] const std::vector<std::size_t>& order() const { return order_; }
  /// The number of the outlier that the frame is.
  [[nodiscard]] std::optional<std::size_t> number_of(std::size_t frame_index) const {
    const auto found = number_of_.find(frame_index);
    return found == number_of_.end() ? std::nullopt : std::optional(found->second);
  }

 private:
  std::vector<std::size_t> order_;
  std::unordered_map<std::size_t, std::size_t> number_of_;
};

/// By number of the outlier, [channel, unit, value, expected or null] of each piece of evidence;
/// only for those that lost most time.
json evidence(const Analysis& analysis, const std::vector<std::size_t>& worst,
              const DrawnOutliers& drawn) {
  TextTable channels;
  TextTable units;
  json of = json::object();
  for (std::size_t i = 0; i < std::min(worst.size(), max_evidence_outliers); ++i) {
    const Outlier& outlier = analysis.outliers[worst[i]];
    json list = json::array();
    for (const Evidence& seen : outlier.attribution.evidence) {
      if (list.size() == max_evidence_per_outlier) break;
      list.push_back({channels.index(seen.channel), units.index(seen.unit),
                      short_number(seen.value),
                      seen.expected ? json(short_number(*seen.expected)) : json(nullptr)});
    }
    of[std::to_string(*drawn.number_of(outlier.frame_index))] = std::move(list);
  }
  return {{"channels", channels.take()}, {"units", units.take()}, {"of", std::move(of)}};
}

/// Whole numbers, each in as many bytes as it needs, seven bits a byte, the lowest first.
class Packed {
 public:
  void put(int64_t number) {
    // 0, -1, 1, -2, ... become 0, 1, 2, 3, ...
    uint64_t bits = static_cast<uint64_t>(number) << 1 ^ static_cast<uint64_t>(number >> 63);
    for (; bits > 127; bits >>= 7) bytes_ += static_cast<char>((bits & 127u) | 128u);
    bytes_ += static_cast<char>(bits);
  }
  [[nodiscard]] const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

/// What times of a cell are counted in: at most a ten-thousandth of its median.
double packed_unit_ms(const Cell& cell) {
  return cell.median_ms > 0 ? std::pow(10, std::floor(std::log10(cell.median_ms)) - 4) : 1;
}

/// The points of one cell in time order, `kept` of them, for unpack() of report.js. Of each: what
/// it is (0 a normal frame, else 1 + 2 cause + (part of a stretch)) twice, plus 1 at the begin of a
/// trial; how much later than the point before, in 10 us; how many frames further; its time, or
/// that of an outlier's fast regime, less that of the point before; and of an outlier its excess
/// and its confidence in percent.
std::string packed_points(const RunRecord& run, const Analysis& analysis, const Cell& cell,
                          const std::vector<std::size_t>& kept, const DrawnOutliers& drawn) {
  Packed packed;
  std::optional<int64_t> trial_id;
  int64_t t = 0;
  int64_t number = 0;
  int64_t level = 0;
  const double unit_ms = packed_unit_ms(cell);
  const auto put_change = [&](int64_t& last, int64_t now) {
    packed.put(now - last);
    last = now;
  };
  for (const std::size_t i : kept) {
    const FrameRecord& frame = run.frames[cell.frame_index[i]];
    const auto slow = drawn.number_of(cell.frame_index[i]);
    const Outlier* outlier = slow ? &analysis.outliers[drawn.order()[*slow]] : nullptr;
    int64_t what = 0;
    if (outlier != nullptr)
      what = 1 + 2 * static_cast<int64_t>(outlier->attribution.cause) +
             (outlier->shape == OutlierShape::spike ? 0 : 1);
    packed.put(2 * what + (trial_id == frame.trial_id ? 0 : 1));
    trial_id = frame.trial_id;
    put_change(t, (frame.begin_ns - analysis.run.begin_ns) / 10'000);
    put_change(number, frame.frame);
    put_change(level, std::llround((outlier ? outlier->baseline_ms : cell.frame_ms[i]) / unit_ms));
    if (outlier == nullptr) continue;
    packed.put(std::llround(outlier->excess_ms / unit_ms));
    packed.put(std::lround(outlier->attribution.confidence * 100));
  }
  return base64(packed.bytes());
}

/// Per cell its points, thinned but for the outliers.
json frame_points(const RunRecord& run, const Analysis& analysis, const DrawnOutliers& drawn) {
  json cells = json::array();
  const std::size_t limit =
      std::max<std::size_t>(100, room_beside_outliers(analysis, max_frame_points) /
                                     std::max<std::size_t>(1, analysis.cells.size()));
  for (const Cell& cell : analysis.cells) {
    std::vector<int64_t> begin_ns;
    std::vector<std::size_t> slow;
    for (std::size_t i = 0; i < cell.frame_index.size(); ++i) {
      begin_ns.push_back(run.frames[cell.frame_index[i]].begin_ns);
      if (drawn.number_of(cell.frame_index[i])) slow.push_back(i);
    }
    const std::vector<std::size_t> kept = thin_beside(begin_ns, cell.frame_ms, slow, limit);
    cells.push_back({{"unit_ms", packed_unit_ms(cell)},
                     {"count", kept.size()},
                     {"points", packed_points(run, analysis, cell, kept, drawn)}});
  }
  return cells;
}

/// How often each cause was named and what it cost, over all outliers.
json cause_rows(const Analysis& analysis) {
  struct Sum {
    std::size_t count = 0;
    double excess_ms = 0;
    double confidence = 0;
  };
  std::array<Sum, cause_count> sums{};
  for (const Outlier& outlier : analysis.outliers) {
    Sum& sum = sums[static_cast<std::size_t>(outlier.attribution.cause)];
    ++sum.count;
    sum.excess_ms += outlier.excess_ms;
    sum.confidence += outlier.attribution.confidence;
  }
  json rows = json::array();
  for (std::size_t k = 0; k < cause_count; ++k)
    if (sums[k].count > 0)
      rows.push_back({{"cause", k},
                      {"count", sums[k].count},
                      {"excess", sums[k].excess_ms},
                      {"confidence", sums[k].confidence}});
  return rows;
}

/// When frames were held back, by class: [begin, end] in seconds, all sources of a class together.
json throttle_bands(const RunRecord& run, const Analysis& analysis) {
  struct Band {
    std::vector<Span> spans;
    json channels = json::array();
  };
  std::map<std::pair<std::string_view, bool>, Band> classes;
  for (const ThrottleSource& source : analysis.throttling.sources) {
    if (source.active.spans().empty()) continue;
    Band& band = classes[{to_string(source.reason), source.inferred}];
    band.spans.insert(band.spans.end(), source.active.spans().begin(), source.active.spans().end());
    band.channels.push_back(run.channels[source.channel].name);
  }
  json bands = json::array();
  for (auto& [key, band] : classes) {
    const auto [joined, closed_ns] =
        join_spans(SpanSet(std::move(band.spans)).spans(), max_bands / classes.size());
    json spans = json::array();
    for (const Span& span : joined)
      spans.push_back(
          {drawn_seconds(analysis, span.begin_ns), drawn_seconds(analysis, span.end_ns)});
    bands.push_back({{"channels", std::move(band.channels)},
                     {"class", key.first},
                     {"inferred", key.second},
                     {"closed", closed_ns > 0 ? json(duration_text(closed_ns)) : json(nullptr)},
                     {"spans", std::move(spans)}});
  }
  return bands;
}

/// What channel_signals() gives for the channel, on its axis.
AxisUnit signal_axis(const Channel& channel) {
  if (channel.kind == Kind::flag) return {"share of the frame", 1};
  std::string si(unit_info(channel.unit).si);
  if (channel.unit == Unit::none) si = stored_unit(channel);
  if (channel.kind == Kind::cumulative) return axis_unit(si == "J" ? "W" : si + "/s");
  return axis_unit(si);
}

/// Which frames stand for all: at most `limit`, half of them outliers, those that lost most time.
std::vector<std::size_t> scatter_frames(const Analysis& analysis,
                                        const std::vector<TimedFrame>& frames,
                                        const std::vector<std::size_t>& worst,
                                        const std::set<std::size_t>& slow, std::size_t limit) {
  std::set<std::size_t> chosen;
  const std::size_t slow_count = std::min(worst.size(), limit / 2);
  for (std::size_t i = 0; i < slow_count; ++i)
    chosen.insert(analysis.outliers[worst[i]].frame_index);
  const std::size_t normal_count = frames.size() - std::min(frames.size(), worst.size());
  const std::size_t stride = normal_count / std::max<std::size_t>(1, limit - slow_count) + 1;
  std::vector<std::size_t> kept;
  std::size_t normal = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const bool is_slow = slow.contains(frames[i].frame_index);
    if (is_slow ? chosen.contains(frames[i].frame_index) : normal++ % stride == 0)
      kept.push_back(i);
  }
  return kept;
}

/// Frame time beside what each channel said meanwhile, as columns.
json scatter(const RunRecord& run, const Analysis& analysis, const std::vector<std::size_t>& worst,
             const DrawnOutliers& drawn) {
  const std::vector<TimedFrame> frames = timed_frames(run, analysis.cells);
  const std::vector<ChannelSignal> signals = channel_signals(run, frames);
  std::set<std::size_t> slow;
  for (const Outlier& outlier : analysis.outliers) slow.insert(outlier.frame_index);
  const auto usable = [](const ChannelSignal& signal) {
    return signal.unusable.empty() &&
           std::any_of(signal.value.begin(), signal.value.end(),
                       [](const std::optional<double>& value) { return value.has_value(); });
  };
  const auto usable_count =
      static_cast<std::size_t>(std::count_if(signals.begin(), signals.end(), usable));
  const std::size_t limit = std::clamp<std::size_t>(
      room_beside_outliers(analysis, max_scatter_values) / std::max<std::size_t>(1, usable_count),
      200, max_scatter_frames);
  const std::vector<std::size_t> kept = scatter_frames(analysis, frames, worst, slow, limit);
  json result{{"cell", json::array()},
              {"ms", json::array()},
              {"outlier", json::array()},
              {"channels", json::array()},
              {"frames", frames.size()}};
  for (const std::size_t i : kept) {
    const auto outlier = drawn.number_of(frames[i].frame_index);
    result["cell"].push_back(frames[i].cell);
    result["ms"].push_back(short_number(frames[i].ms));
    result["outlier"].push_back(outlier ? json(*outlier) : json(nullptr));
  }
  for (std::size_t c = 0; c < signals.size(); ++c) {
    if (!usable(signals[c])) continue;
    const AxisUnit axis = signal_axis(run.channels[c]);
    json values = json::array();
    for (const std::size_t i : kept) {
      const auto& value = signals[c].value[i];
      values.push_back(value ? json(short_number(*value * axis.factor)) : json(nullptr));
    }
    result["channels"].push_back(
        {{"name", signals[c].name}, {"unit", axis.name}, {"value", std::move(values)}});
  }
  return result;
}

/// A channel as it is drawn: counters as rates, units as on the axis.
struct Drawn {
  Curve curve;
  std::string title;  // what the axis shows
  std::string note;   // how it was derived; may be empty
};

std::optional<Drawn> draw(const Channel& channel, const SampleSeries& series,
                          std::span<const Sleep> sleeps) {
  Drawn drawn;
  drawn.title = to_string(channel.quantity);
  std::replace(drawn.title.begin(), drawn.title.end(), '_', ' ');
  std::string si(unit_info(channel.unit).si);
  if (channel.kind == Kind::cumulative) {
    auto curve = rate(channel, series, sleeps);
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
    t_s.push_back(drawn_seconds(analysis, curve.t_ns[i]));
    value.push_back(short_number(curve.value[i]));
  }
  return {{"name", channel.name}, {"t_s", std::move(t_s)}, {"value", std::move(value)}};
}

/// Sensor tracks, one per title and unit, and the names of the channels that are not drawn.
std::pair<json, json> sensor_tracks(const RunRecord& run, const Analysis& analysis) {
  const std::size_t limit =
      std::clamp<std::size_t>(room_beside_outliers(analysis, max_sensor_points) /
                                  std::max<std::size_t>(1, run.series.size()),
                              100, max_points_per_channel);
  std::map<std::tuple<Quantity, std::string, std::string>, json> tracks;
  json constant = json::array();
  json too_short = json::array();
  const std::vector<Sleep> sleeps = sleeps_of(run);
  for (const SensorSummary& sensor : analysis.sensors) {
    if (sensor.sample_count == 0) continue;
    if (sensor.update_count == 0) {
      constant.push_back(sensor.channel.name);
      continue;
    }
    const auto drawn = draw(sensor.channel, run.series.at(sensor.channel.id), sleeps);
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

/// What a picture's name says: "{model}_view{v}_reference", "{model}_view{v}_{ALGORITHM}_heat".
struct PictureName {
  std::string place;  ///< model and view; empty for other names
  std::string what;   ///< "reference", or the algorithm of a heat map
};

PictureName picture_name(const std::string& title) {
  const std::size_t view = title.rfind("_view");
  if (view == title.npos) return {};
  std::size_t end = view + 5;
  while (end < title.size() && std::isdigit(static_cast<unsigned char>(title[end])) != 0) ++end;
  if (end == view + 5 || end == title.size() || title[end] != '_') return {};
  std::string what = title.substr(end + 1);
  constexpr std::string_view heat = "_heat";
  if (what.ends_with(heat)) {
    what.resize(what.size() - heat.size());
  } else if (what != "reference") {
    return {};
  }
  return {title.substr(0, view) + ", view " + title.substr(view + 5, end - view - 5), what};
}

/// The pictures of the page as they fit into it.
struct ShownImages {
  json list = json::array();      ///< reference images first
  json left_out = json::array();  ///< files that did not fit
  uint32_t max_width = 0;
};

/// All pictures, in the largest of a few widths at which they fit into `budget_bytes` together;
/// those that fit where even the smallest is too much.
ShownImages shown_images(const std::vector<ReportImage>& images, std::size_t budget_bytes) {
  std::vector<const ReportImage*> order;
  for (const ReportImage& image : images)
    if (!image.png.empty()) order.push_back(&image);
  std::stable_partition(order.begin(), order.end(), [](const ReportImage* image) {
    return picture_name(image->title).what == "reference";
  });
  const auto page_bytes = [](const std::string& png) { return (png.size() + 2) / 3 * 4 + 300; };
  ShownImages shown;
  // The page shows them about 280 pixels wide: the first width suits screens with twice the pixels.
  constexpr std::array<uint32_t, 4> widths{640, 320, 240, 160};
  std::vector<std::string> largest(order.size());
  tbb::parallel_for(std::size_t{0}, order.size(),
                    [&](std::size_t i) { largest[i] = shrink_png(order[i]->png, widths.front()); });
  std::vector<std::string> pngs = largest;
  for (const uint32_t width : widths) {
    shown.max_width = width;
    if (width != widths.front())
      tbb::parallel_for(std::size_t{0}, order.size(),
                        [&](std::size_t i) { pngs[i] = shrink_png(largest[i], width); });
    std::size_t total_bytes = 0;
    for (const std::string& png : pngs) total_bytes += page_bytes(png);
    if (total_bytes <= budget_bytes) break;
  }
  std::size_t total_bytes = 0;
  for (std::size_t i = 0; i < order.size(); ++i) {
    if (total_bytes + page_bytes(pngs[i]) > budget_bytes) {
      shown.left_out.push_back(image_file(order[i]->title));
      continue;
    }
    total_bytes += page_bytes(pngs[i]);
    const PictureName name = picture_name(order[i]->title);
    shown.list.push_back({{"title", order[i]->title},
                          {"place", name.place},
                          {"what", name.what},
                          {"file", image_file(order[i]->title)},
                          {"src", "data:image/png;base64," + base64(pngs[i])}});
  }
  return shown;
}

/// report.json without what the page holds in a shorter form.
json page_report(const RunRecord& run, const Analysis& analysis,
                 const std::vector<std::string>& image_files) {
  json report = report_json_without_outliers(run, analysis, image_files);
  report["throttling"].erase("intervals");
  json events = json::array();
  for (json& event : report["events"])
    if (event["kind"] != "idle" && event["kind"] != "sampler-off")
      events.push_back(std::move(event));
  report["event_count"] = events.size();
  if (events.size() > max_event_rows)
    events.erase(events.begin() + static_cast<std::ptrdiff_t>(max_event_rows), events.end());
  report["events"] = std::move(events);
  // Those trials whose fast regime needs a word.
  json regimes = json::array();
  for (json& regime : report["regimes"])
    if (regime["entirely_slow"] == true ||
        std::fabs(regime["drift_ratio"].get<double>() - 1) > 0.05)
      regimes.push_back(std::move(regime));
  report["regime_count"] = regimes.size();
  if (regimes.size() > max_regime_rows)
    regimes.erase(regimes.begin() + static_cast<std::ptrdiff_t>(max_regime_rows), regimes.end());
  report["regimes"] = std::move(regimes);
  return report;
}

json cause_names() {
  json names = json::array();
  for (std::size_t k = 0; k < cause_count; ++k) names.push_back(to_string(static_cast<Cause>(k)));
  return names;
}

json ranking_energy(const Analysis& analysis) {
  json rows = json::array();
  for (const RankingRow& row : analysis.ranking)
    rows.push_back(energy_of_text(analysis, row.algorithm));
  return rows;
}

/// All but the pictures.
json page_data(const RunRecord& run, const Analysis& analysis,
               const std::vector<ReportImage>& images) {
  json data;
  std::vector<std::string> image_files;
  json named_images = json::array();
  for (const ReportImage& image : images) {
    image_files.push_back(image_file(image.title));
    if (image.png.empty()) named_images.push_back(image_files.back());
  }
  data["report"] = page_report(run, analysis, image_files);
  data["answer"] = answer_text(analysis);
  data["causes"] = cause_names();
  data["min_confidence"] = min_confidence;
  const std::vector<std::size_t> worst = worst_outliers(analysis);
  const DrawnOutliers drawn(analysis, worst);
  data["cause_rows"] = cause_rows(analysis);
  data["outlier_count"] = analysis.outliers.size();
  data["evidence"] = evidence(analysis, worst, drawn);
  data["frames"] = frame_points(run, analysis, drawn);
  data["bands"] = throttle_bands(run, analysis);
  data["throttling_text"] = throttling_text(run, analysis.throttling);
  data["scatter"] = scatter(run, analysis, worst, drawn);
  std::tie(data["tracks"], data["not_drawn"]) = sensor_tracks(run, analysis);
  data["sensor_rows"] = sensor_rows(analysis);
  data["readings"] = reading_rows(analysis);
  data["sampler"] = sampler_text(analysis.sampler);
  data["score_text"] = score_text(analysis);
  data["energy_text"] = energy_text(analysis);
  data["ranking_energy"] = ranking_energy(analysis);
  data["duration"] = duration_text(analysis.run.end_ns - analysis.run.begin_ns);
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
  const std::string licences = html_text(embedded::report_licences());
  json page = page_data(run, analysis, images);
  const std::size_t bytes_without_images =
      script_json(page).size() + licences.size() + embedded::report_page().size() +
      embedded::report_style().size() + embedded::echarts_script().size() +
      embedded::report_script().size();
  ShownImages shown =
      shown_images(images, max_page_bytes - std::min(max_page_bytes, bytes_without_images));
  page["images"] = std::move(shown.list);
  page["images_left_out"] = std::move(shown.left_out);
  page["image_width"] = shown.max_width;
  const std::string data = script_json(page);
  std::string answer;
  for (const std::string& sentence : answer_text(analysis))
    answer += fmt::format("<p>{}</p>", html_text(sentence));
  return fill(embedded::report_page(), {{"title", title},
                                        {"answer", answer},
                                        {"style", embedded::report_style()},
                                        {"data", data},
                                        {"echarts", embedded::echarts_script()},
                                        {"script", embedded::report_script()},
                                        {"licences", licences}});
}

}  // namespace energyprof::analysis
