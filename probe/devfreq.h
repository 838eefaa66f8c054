/// Clocks, load and thermal clamps of GPUs on ARM systems: Mali, Adreno, Tegra.
#pragma once

#include <string_view>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Channels of each GPU ("devfreq.fb000000_gpu"):
///   .freq, .target_freq: Hz, limit the highest available. On some SoCs .freq repeats the target.
///   .max_freq: Hz, quantity limit; .throttle.clamp: flag, 1 while max_freq is below the highest
///     available clock, as a cooling device (or an administrator) makes it.
///   .load: percent (Rockchip, kgsl) or permille (Tegra).
///   .time_at.<Hz>: ms, .transitions: count; cumulative, from trans_stat.
///   .temp: mC (kgsl).
/// GPUs of Qualcomm's kgsl driver are called by their node: "devfreq.kgsl-3d0". Other devices of
/// the class (memory controllers) are listed as missing.
/// Kernel: Documentation/ABI/testing/sysfs-class-devfreq.
void discover_devfreq(const Root& root, Discovery& discovery);

/// The one device of the class, as SourceTraits::gpu, if it is a GPU; empty if there are others.
std::string only_devfreq_gpu(const Root& root);

/// Whether a device's name, driver or compatible text is that of a GPU: "fb000000.gpu",
/// "17000000.ga10b". What throttles the memory for one ("soc:qcom,gpubw", "soc:qcom,kgsl-busmon")
/// is none.
bool is_gpu_name(std::string_view text);

}  // namespace energyprof::probe
