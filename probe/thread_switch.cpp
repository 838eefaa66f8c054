#include "probe/thread_switch.h"

#include <fcntl.h>
#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <limits>
#include <system_error>
#include <thread>

#include "core/clock.h"

namespace energyprof::probe {
namespace {

constexpr int round_trip_count = 60;

// A byte's way from one thread to another.
class Pipe {
 public:
  Pipe() { is_open_ = pipe2(ends_.data(), O_CLOEXEC) == 0; }
  ~Pipe() {
    if (!is_open_) return;
    close(ends_[0]);
    close(ends_[1]);
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  [[nodiscard]] bool is_open() const { return is_open_; }
  void send() const {
    const char byte = 0;
    while (write(ends_[1], &byte, 1) != 1) continue;
  }
  void wait() const {
    char byte = 0;
    while (read(ends_[0], &byte, 1) != 1) continue;
  }

 private:
  std::array<int, 2> ends_{};
  bool is_open_ = false;
};

// Keeps the calling thread, and what it starts, on the processor it is on; not where it could not
// be let go again (more than 1024 processors).
class Stay {
 public:
  Stay() {
    const int cpu = sched_getcpu();
    if (cpu < 0 || sched_getaffinity(0, sizeof before_, &before_) != 0) return;
    cpu_set_t here;
    CPU_ZERO(&here);
    CPU_SET(static_cast<size_t>(cpu), &here);
    is_pinned_ = sched_setaffinity(0, sizeof here, &here) == 0;
  }
  ~Stay() {
    if (is_pinned_) sched_setaffinity(0, sizeof before_, &before_);
  }
  Stay(const Stay&) = delete;
  Stay& operator=(const Stay&) = delete;

 private:
  cpu_set_t before_{};
  bool is_pinned_ = false;
};

}  // namespace

std::optional<int64_t> thread_switch_ns() {
  const Pipe there;
  const Pipe back;
  if (!there.is_open() || !back.is_open()) return std::nullopt;
  const Stay stay;
  std::jthread answering;
  try {
    answering = std::jthread([&] {
      for (int i = 0; i < round_trip_count; ++i) {
        there.wait();
        back.send();
      }
    });
  } catch (const std::system_error&) {
    return std::nullopt;
  }
  int64_t shortest_ns = std::numeric_limits<int64_t>::max();
  for (int i = 0; i < round_trip_count; ++i) {
    const int64_t begin_ns = now_ns();
    there.send();
    back.wait();
    shortest_ns = std::min(shortest_ns, now_ns() - begin_ns);
  }
  return shortest_ns / 2;
}

}  // namespace energyprof::probe
