// Maps GPU ticks to host time.
#include "kernels/clock_sync.h"

#include <array>
#include <cmath>

#include "kernels/context.h"

namespace energyprof::kernels {
namespace {

constexpr int calibration_reading_count = 5;
constexpr double drift_ratio = 100e-6;

uint64_t mask_of(const TickScale& scale) {
  return scale.valid_bits >= 64 ? ~uint64_t{0} : (uint64_t{1} << scale.valid_bits) - 1;
}

/// Not yet an integer: the difference of two ticks of a clock that was reset can be any number.
double duration_of(const TickSpan& span, const TickScale& scale) {
  return static_cast<double>(ticks_between(span.begin, span.end, scale)) * scale.period_ns;
}

int64_t tick_ns(const TickScale& scale) { return static_cast<int64_t>(std::ceil(scale.period_ns)); }

Calibration read_clocks(Context& context) {
  // No other domain is ever asked for: newer ones need structures of their own.
  std::array<VkCalibratedTimestampInfoEXT, 2> infos{};
  for (VkCalibratedTimestampInfoEXT& info : infos) {
    info.sType = VK_STRUCTURE_TYPE_CALIBRATED_TIMESTAMP_INFO_EXT;
  }
  infos[0].timeDomain = VK_TIME_DOMAIN_DEVICE_EXT;
  infos[1].timeDomain = VK_TIME_DOMAIN_CLOCK_MONOTONIC_EXT;
  std::array<uint64_t, 2> times{};
  uint64_t deviation_ns = 0;
  check(context.api.get_calibrated_timestamps(context.device, 2, infos.data(), times.data(),
                                              &deviation_ns),
        "read the clock of the GPU");
  return {times[0], static_cast<int64_t>(times[1]), static_cast<int64_t>(deviation_ns)};
}

}  // namespace

uint64_t ticks_between(uint64_t earlier, uint64_t later, const TickScale& scale) {
  return (later - earlier) & mask_of(scale);
}

int64_t signed_ticks(uint64_t origin, uint64_t ticks, const TickScale& scale) {
  const uint64_t forward = ticks_between(origin, ticks, scale);
  const uint64_t backward = ticks_between(ticks, origin, scale);
  return forward <= backward ? static_cast<int64_t>(forward) : -static_cast<int64_t>(backward);
}

HostSpan place_by_calibration(const Calibration& calibration, const TickSpan& span,
                              const TickScale& scale) {
  const double since_ns =
      static_cast<double>(signed_ticks(calibration.gpu_ticks, span.begin, scale)) * scale.period_ns;
  HostSpan host;
  host.begin_ns = calibration.host_ns + std::llround(since_ns);
  host.end_ns = host.begin_ns + std::llround(duration_of(span, scale));
  host.error_ns = calibration.deviation_ns + tick_ns(scale) +
                  std::llround(std::ceil(std::abs(since_ns) * drift_ratio));
  return host;
}

HostSpan place_by_enclosure(int64_t submit_ns, int64_t done_ns, const TickSpan& span,
                            const TickScale& scale) {
  const int64_t whole_ns = done_ns - submit_ns;
  if (duration_of(span, scale) > static_cast<double>(whole_ns))
    return {submit_ns, done_ns, whole_ns};
  const int64_t duration_ns = std::llround(duration_of(span, scale));
  const int64_t slack_ns = whole_ns - duration_ns;
  HostSpan host;
  host.begin_ns = submit_ns + slack_ns / 2;
  host.end_ns = host.begin_ns + duration_ns;
  host.error_ns = slack_ns - slack_ns / 2 + tick_ns(scale);
  return host;
}

Calibration calibrate(Context& context) {
  Calibration best = read_clocks(context);
  for (int i = 1; i < calibration_reading_count; ++i) {
    const Calibration reading = read_clocks(context);
    if (reading.deviation_ns < best.deviation_ns) best = reading;
  }
  return best;
}

}  // namespace energyprof::kernels
