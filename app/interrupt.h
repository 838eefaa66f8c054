/// Ctrl-C: once asks the run to stop after the frame, twice ends the program at once.
#pragma once

namespace energyprof::app {

/// Handles SIGINT and SIGTERM as long as it lives.
class InterruptGuard {
 public:
  InterruptGuard();
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;

  /// Has the user asked to stop?
  [[nodiscard]] static bool requested();
};

/// The exit code of an interrupted run.
inline constexpr int exit_interrupted = 130;

}  // namespace energyprof::app
