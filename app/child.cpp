#include "app/child.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <system_error>

namespace energyprof::app {
namespace {

constexpr std::array end_signals{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
constexpr std::array other_signals{SIGUSR1, SIGUSR2, SIGTSTP, SIGCONT, SIGWINCH};

[[noreturn]] void fail(const char* what) {
  throw std::system_error(errno, std::generic_category(), what);
}

}  // namespace

HeldSignals::HeldSignals() {
  sigemptyset(&held_);
  sigaddset(&held_, SIGCHLD);
  for (const int signal : end_signals) sigaddset(&held_, signal);
  for (const int signal : other_signals) sigaddset(&held_, signal);
  pthread_sigmask(SIG_BLOCK, &held_, &before_);
  struct sigaction children {};
  sigaction(SIGCHLD, nullptr, &children);
  ignored_children_ = children.sa_handler == SIG_IGN;
  if (ignored_children_) signal(SIGCHLD, SIG_DFL);
}

HeldSignals::~HeldSignals() {
  const timespec at_once{};
  while (sigtimedwait(&held_, nullptr, &at_once) > 0) {
  }
  pthread_sigmask(SIG_SETMASK, &before_, nullptr);
}

std::optional<int> HeldSignals::end_wanted() const {
  sigset_t waiting;
  sigpending(&waiting);
  for (const int signal : end_signals)
    if (sigismember(&waiting, signal) == 1) return signal;
  return std::nullopt;
}

Child::Child(const std::vector<std::string>& command, const HeldSignals& signals)
    : signals_(signals) {
  // Closed by a successful exec; else it carries the reason.
  std::array<int, 2> report{};
  if (pipe2(report.data(), O_CLOEXEC) != 0) fail("cannot make a pipe");
  std::vector<char*> words;
  for (const std::string& word : command) words.push_back(const_cast<char*>(word.c_str()));
  words.push_back(nullptr);

  pid_ = fork();
  if (pid_ < 0) fail("cannot start a process");
  if (pid_ == 0) {
    if (signals.ignored_children_) signal(SIGCHLD, SIG_IGN);
    pthread_sigmask(SIG_SETMASK, &signals.before_, nullptr);
    execvp(words[0], words.data());
    const int error = errno;
    [[maybe_unused]] const ssize_t told = write(report[1], &error, sizeof error);
    _exit(127);
  }
  close(report[1]);
  int error = 0;
  ssize_t got = 0;
  do {
    got = read(report[0], &error, sizeof error);
  } while (got < 0 && errno == EINTR);
  close(report[0]);
  if (got != sizeof error) return;
  waitpid(pid_, nullptr, 0);
  throw CannotRun(fmt::format("cannot run '{}': {}.", command.front(), std::strerror(error)),
                  error == ENOENT ? 127 : 126);
}

ChildEnd Child::wait() {
  for (;;) {
    siginfo_t info{};
    const int signal = sigwaitinfo(&signals_.held_, &info);
    if (signal == SIGCHLD) {
      int status = 0;
      if (waitpid(pid_, &status, WNOHANG | WUNTRACED) != pid_) continue;
      if (WIFSTOPPED(status)) {
        // The shell waits for us to stop. Other signals stop a program for somebody who means to
        // let it go on without us, or have stopped us as well.
        if (WSTOPSIG(status) == SIGTSTP) raise(SIGSTOP);
        continue;
      }
      if (WIFSIGNALED(status)) return {128 + WTERMSIG(status), WTERMSIG(status)};
      return {WEXITSTATUS(status), std::nullopt};
    }
    // Above 0 the kernel sent it: for a key, to the whole group of the terminal's processes.
    if (signal > 0 && info.si_code <= 0 && info.si_pid != pid_) kill(pid_, signal);
  }
}

}  // namespace energyprof::app
