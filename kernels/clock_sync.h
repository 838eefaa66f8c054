/// GPU ticks -> CLOCK_MONOTONIC, with an error bound. Pure arithmetic but for calibrate().
///
/// Two ways: by calibration, where GPU and host clock are read together before each frame
/// (VK_EXT_calibrated_timestamps); else by enclosure, where all that is known is that the frame's
/// GPU span lies between its submission and the end of the wait for it.
#pragma once

#include <cstdint>

#include "kernels/device.h"

namespace energyprof::kernels {

/// A GPU's clock: it counts modulo 2^valid_bits.
struct TickScale {
  double period_ns = 1.0;
  uint32_t valid_bits = 64;
};

/// Both clocks at (nearly) one moment.
struct Calibration {
  uint64_t gpu_ticks = 0;
  int64_t host_ns = 0;
  int64_t deviation_ns = 0;  ///< the two were read at most this long apart
};

/// Begin and end of some GPU work, in the GPU's ticks.
struct TickSpan {
  uint64_t begin = 0;
  uint64_t end = 0;
};

/// The same in host time. end_ns - begin_ns is the GPU's own duration.
struct HostSpan {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
  int64_t error_ns = 0;  ///< begin_ns is right within +- this
};

/// Ticks from `earlier` to `later`, which is less than one wrap-around after it. Bits above
/// TickScale::valid_bits are ignored.
uint64_t ticks_between(uint64_t earlier, uint64_t later, const TickScale& scale);

/// Ticks from `origin` to `ticks`, negative if it lies before: at most half a wrap-around away.
int64_t signed_ticks(uint64_t origin, uint64_t ticks, const TickScale& scale);

/// The span by calibration. Error: what the driver says, one tick, and 100 ppm of the time since
/// the calibration, for the two clocks drift apart by tens of ppm.
HostSpan place_by_calibration(const Calibration& calibration, const TickSpan& span,
                              const TickScale& scale);

/// The span by enclosure in [submit_ns, done_ns]: in the middle, its error half of what is left. A
/// span longer than that (the GPU's clock was reset in between) becomes the whole, uncertain by its
/// length.
HostSpan place_by_enclosure(int64_t submit_ns, int64_t done_ns, const TickSpan& span,
                            const TickScale& scale);

/// The best of several readings of both clocks. Only for devices with calibrated timestamps.
/// Throws as kernels/vulkan_api.h check().
Calibration calibrate(Device::Context& context);

}  // namespace energyprof::kernels
