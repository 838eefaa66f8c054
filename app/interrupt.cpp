#include "app/interrupt.h"

#include <signal.h>
#include <unistd.h>

namespace energyprof::app {
namespace {

volatile sig_atomic_t signal_count = 0;

void on_signal(int) {
  signal_count = signal_count + 1;
  if (signal_count >= 2) _exit(exit_interrupted);
}

void handle(void (*handler)(int)) {
  struct sigaction action {};
  action.sa_handler = handler;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

}  // namespace

InterruptGuard::InterruptGuard() { handle(on_signal); }
InterruptGuard::~InterruptGuard() { handle(SIG_DFL); }
bool InterruptGuard::requested() { return signal_count > 0; }

}  // namespace energyprof::app
