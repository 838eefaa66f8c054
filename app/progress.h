/// Progress on stderr: a bar with ETA and live values on a terminal, one line a trial elsewhere.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

namespace energyprof::app {

class Progress {
 public:
  struct Config {
    bool quiet = false;
    int64_t total_frames = 0;
    /// Live sensor values in words, "1300 MHz  21.0 W  71 C"; empty if there are none.
    std::function<std::string()> live_values;
  };

  explicit Progress(Config config);
  /// Leaves a clean line behind.
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// Something that takes time outside of trials: "building BVH_FTB_DF of dragon".
  void note(std::string_view text);
  /// A trial begins: "[3/9] dragon view 2 BVH_FTB_DF".
  void begin_trial(std::string title);
  void frame_done();
  /// The trial ended; `result` is appended to its title on a line of its own.
  void end_trial(std::string_view result, int64_t skipped_frames);

 private:
  void draw();
  void clear_line();

  Config config_;
  bool is_terminal_;
  std::string title_;
  int64_t done_frames_ = 0;
  int64_t skipped_frames_ = 0;
  int64_t begin_ns_;
  int64_t last_draw_ns_ = 0;
};

}  // namespace energyprof::app
