#include "app/self_check.h"

#include <algorithm>
#include <cmath>

#include "app/interrupt.h"
#include "core/clock.h"

namespace energyprof::app {
namespace {

constexpr int64_t blocks_per_round = 4;
constexpr int64_t fewest_rounds = 4;
constexpr int64_t most_rounds = 8;
constexpr int64_t fewest_frames = 5;
constexpr int64_t most_frames = 2000;
// A block shorter than this says little about energy: more rounds are not worth that.
constexpr int64_t shortest_block_ns = 100 * ns_per_ms;
constexpr int warmup_frame_count = 3;

/// The sampler, which is on again when this goes away.
class Switch {
 public:
  Switch(Sensors& sensors, RunWriter& writer) : sensors_(sensors), writer_(writer) {}
  ~Switch() { set(true); }
  Switch(const Switch&) = delete;
  Switch& operator=(const Switch&) = delete;

  void set(bool on) {
    if (on == is_on_) return;
    is_on_ = on;
    if (!on) {
      sensors_.pause();
      off_since_ns_ = now_ns();
      return;
    }
    writer_.add_event({off_since_ns_, now_ns(), Severity::info, "sampler-off", std::nullopt,
                       "nothing was sampled, to see what sampling costs"});
    sensors_.resume();
  }

 private:
  Sensors& sensors_;
  RunWriter& writer_;
  bool is_on_ = true;
  int64_t off_since_ns_ = 0;
};

}  // namespace

SelfCheckPlan plan_self_check(int64_t frame_ns, int64_t budget_ns) {
  const int64_t block_ns = std::max(fewest_frames * frame_ns, shortest_block_ns);
  SelfCheckPlan plan;
  plan.round_count =
      std::clamp(budget_ns / (blocks_per_round * block_ns), fewest_rounds, most_rounds);
  plan.frames_per_block =
      std::clamp(budget_ns / (blocks_per_round * plan.round_count * std::max<int64_t>(frame_ns, 1)),
                 fewest_frames, most_frames);
  return plan;
}

double self_check_image_factor(int64_t frame_ns, int64_t budget_ns) {
  const auto least_ns =
      static_cast<double>(frame_ns) * (fewest_rounds * blocks_per_round * fewest_frames);
  return std::min(1.0, std::sqrt(static_cast<double>(budget_ns) / std::max(least_ns, 1.0)));
}

void run_self_check(kernels::TraceProgram& program, Sensors& sensors, RunWriter& writer,
                    int64_t budget_ns) {
  uint32_t frame = 0;
  const int64_t begin_ns = now_ns();
  for (int i = 0; i < warmup_frame_count; ++i)
    static_cast<void>(program.run_frame(frame++, Phase::warmup));
  const SelfCheckPlan plan = plan_self_check((now_ns() - begin_ns) / warmup_frame_count, budget_ns);

  Switch sampler(sensors, writer);
  int64_t block = 0;
  for (int64_t round = 0; round < plan.round_count && now_ns() < begin_ns + budget_ns; ++round)
    for (const bool on : {true, false, false, true}) {
      sampler.set(on);
      for (int64_t i = 0; i < plan.frames_per_block; ++i) {
        if (InterruptGuard::requested()) return;
        const FrameRecord record = program.run_frame(frame++, Phase::timed);
        writer.add_self_check_frame({block, on, record.begin_ns, record.end_ns});
      }
      ++block;
    }
}

}  // namespace energyprof::app
