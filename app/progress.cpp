#include "app/progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "app/terminal.h"
#include "core/clock.h"

namespace energyprof::app {
namespace {

constexpr int64_t draw_period_ns = 100 * ns_per_ms;

std::string duration_text(double seconds) {
  const auto whole = std::llround(seconds);
  if (whole < 60) return fmt::format("{} s", whole);
  return fmt::format("{}:{:02} min", whole / 60, whole % 60);
}

/// Of the first `width` bytes, what are whole characters.
std::string cut(std::string text, size_t width) {
  if (text.size() <= width) return text;
  while (width > 0 && (text[width] & 0xC0) == 0x80) --width;
  text.resize(width);
  return text;
}

}  // namespace

Progress::Progress(Config config)
    : config_(std::move(config)), is_terminal_(isatty(STDERR_FILENO) == 1), begin_ns_(now_ns()) {}

Progress::~Progress() { clear_line(); }

void Progress::note(std::string_view text) {
  if (config_.quiet) return;
  clear_line();
  fmt::print(stderr, "{}\n", text);
}

void Progress::begin_trial(std::string title) {
  title_ = std::move(title);
  draw();
}

void Progress::frame_done() {
  ++done_frames_;
  if (now_ns() - last_draw_ns_ >= draw_period_ns) draw();
}

void Progress::end_trial(std::string_view result, int64_t skipped_frames) {
  skipped_frames_ += skipped_frames;
  if (config_.quiet) return;
  clear_line();
  fmt::print(stderr, "{}: {}\n", title_, result);
}

void Progress::draw() {
  if (config_.quiet || !is_terminal_) return;
  last_draw_ns_ = now_ns();
  const int64_t passed = done_frames_ + skipped_frames_;
  const double share =
      static_cast<double>(passed) / static_cast<double>(std::max<int64_t>(config_.total_frames, 1));
  const auto filled = static_cast<size_t>(std::clamp(share, 0.0, 1.0) * 20.0);
  std::string line =
      fmt::format("[{:=<{}}{: <{}}] {:3.0f} %", "", filled, "", 20 - filled, share * 100.0);
  if (done_frames_ > 0) {
    const double elapsed_s = static_cast<double>(last_draw_ns_ - begin_ns_) * 1e-9;
    const auto left = static_cast<double>(std::max<int64_t>(config_.total_frames - passed, 0));
    line += "  ETA " + duration_text(elapsed_s / static_cast<double>(done_frames_) * left);
  }
  if (config_.live_values)
    if (const std::string values = config_.live_values(); !values.empty()) line += "  " + values;
  line += "  " + title_;
  fmt::print(stderr, "\r\033[K{}", cut(std::move(line), terminal_width(stderr).value_or(80) - 1));
  std::fflush(stderr);
}

void Progress::clear_line() {
  if (!config_.quiet && is_terminal_) fmt::print(stderr, "\r\033[K");
}

}  // namespace energyprof::app
