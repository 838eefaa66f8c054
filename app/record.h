/// `energyprof record -- CMD`: the sensors while any other program runs.
#pragma once

#include <string>
#include <vector>

namespace energyprof::app {

struct RecordOptions {
  std::string out;  ///< empty: runs/<program>-<time>
  double rate_hz = 997.0;
  std::string root = "/";
  bool allow_msr = false;
  bool quiet = false;                ///< nothing on stderr after the program's end
  std::vector<std::string> command;  ///< program and arguments
};

/// Runs the command under the sampler. Its standard streams are the caller's own; signals sent to
/// this process go to it; what energyprof has to say comes on stderr when it has ended. Returns its
/// exit code, or 128 + the signal that ended it. Throws CannotRun (app/child.h) when there is no
/// such program, std::runtime_error when nothing can be recorded.
int record_command(const RecordOptions& options);

}  // namespace energyprof::app
