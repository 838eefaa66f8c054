/// What sampling does to frames, measured in the run itself.
#pragma once

#include <cstdint>

#include "app/sensors.h"
#include "core/run_db.h"
#include "kernels/runner.h"

namespace energyprof::app {

/// How the self-check divides its time. A round is four blocks: sampler on, off, off, on, so that
/// whatever drifts during a round falls on both states alike.
struct SelfCheckPlan {
  int64_t round_count = 0;
  int64_t frames_per_block = 0;
};

/// At least 4 rounds of blocks of at least 5 frames; more of both as long as they fit into
/// `budget_ns` at `frame_ns` a frame.
SelfCheckPlan plan_self_check(int64_t frame_ns, int64_t budget_ns);

/// The factor (at most 1) by which the image must shrink in width and height so that the fewest
/// rounds and frames fit into `budget_ns`, when a frame takes `frame_ns` in full size.
double self_check_image_factor(int64_t frame_ns, int64_t budget_ns);

/// Traces frames with the sampler on and off and records them. Each stretch without the sampler is
/// an event of kind "sampler-off". Ends early, after a whole round, when the time is up, and at
/// once on Ctrl-C. Leaves the sampler running, also when it throws what TraceProgram does.
void run_self_check(kernels::TraceProgram& program, Sensors& sensors, RunWriter& writer,
                    int64_t budget_ns);

}  // namespace energyprof::app
