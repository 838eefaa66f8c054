/// A program that runs as if the shell had started it: our terminal, our signals, its exit code.
#pragma once

#include <signal.h>
#include <sys/types.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

namespace energyprof::app {

/// The signals that people send to programs wait as long as this lives; Child::wait() hands them
/// on. Construct it before any thread: threads inherit it.
class HeldSignals {
 public:
  HeldSignals();
  /// Forgets what still waits.
  ~HeldSignals();
  HeldSignals(const HeldSignals&) = delete;
  HeldSignals& operator=(const HeldSignals&) = delete;

  /// A waiting signal that asks to end; nullopt: none.
  [[nodiscard]] std::optional<int> end_wanted() const;

 private:
  friend class Child;
  sigset_t held_{};
  sigset_t before_{};
  bool ignored_children_ = false;  // SIGCHLD was ignored: nothing could be waited for
};

/// The program could not be started: exit code 127 if there is none of that name, else 126.
struct CannotRun : std::runtime_error {
  CannotRun(const std::string& text, int code) : std::runtime_error(text), exit_code(code) {}
  int exit_code;
};

struct ChildEnd {
  int exit_code = 0;          ///< 128 + the signal if one killed it
  std::optional<int> signal;  ///< that signal
};

class Child {
 public:
  /// Starts `command`, its first word searched in PATH, with our standard streams and what was the
  /// signal mask before `signals`. Throws CannotRun, std::system_error.
  Child(const std::vector<std::string>& command, const HeldSignals& signals);
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  /// Waits for its end. Signals that someone sent to us are sent on; those of the terminal, which
  /// its whole process group gets, and those it sent itself are not. Where SIGTSTP stops it, we
  /// stop too.
  ChildEnd wait();

 private:
  const HeldSignals& signals_;
  pid_t pid_ = 0;
};

}  // namespace energyprof::app
