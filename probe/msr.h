/// RAPL and throttle reasons straight from model-specific registers.
#pragma once

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// Only with Selection::allow_msr. Channels:
///   rapl.<domain>.energy: nJ, cumulative, wraps with the 32-bit register; only domains that
///   neither
///     perf nor powercap gives
///   rapl.package-0.pl1, .pl2: uW; likewise, where they are enabled
///   msr.core.throttle.*, msr.gfx.throttle.*, msr.ring.throttle.*: flags, the status half of the
///     perf-limit reasons (0x64f, 0x6b0, 0x6b1); gfx belongs to the integrated GPU, and is left out
///     where there is none
///   msr.package.throttle.thermal, .prochot, .critical, .power_limit: flags of 0x1b1. PROCHOT
///   beside a
///     cool readout is asserted from outside: power supply or embedded controller.
/// On AMD energy alone. Below a --root the registers are read from dev/cpu/0/msr.tsv, lines of
/// number, tab and value: a plain file cannot stand for the device. Register layout: Intel Software
/// Developer's Manual, volumes 3B and 4; AMD: Processor Programming Reference.
void discover_msr(const Root& root, const Selection& selection, Discovery& discovery);

}  // namespace energyprof::probe
