// Expects in a card's directory, since Linux 5.19
//
//   gt/gt0/rps_act_freq_mhz  rps_cur_freq_mhz  punit_req_freq_mhz       1300
//   gt/gt0/rps_max_freq_mhz  rps_RP0_freq_mhz  rps_RPn_freq_mhz         1500
//   gt/gt0/throttle_reason_status  throttle_reason_pl1  ...             0 or 1
//   gt/gt0/rc6_residency_ms                                             184467
//
// and before that, for all GTs together,
//
//   gt_act_freq_mhz  gt_cur_freq_mhz  gt_max_freq_mhz  gt_RP0_freq_mhz  gt_RPn_freq_mhz
//   power/rc6_residency_ms
#include "probe/i915.h"

#include <fmt/format.h>

#include <limits>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
#include "probe/names.h"
#include "probe/throttle_reasons.h"

namespace energyprof::probe {
namespace {

constexpr int64_t clock_period_ns = 20 * ns_per_ms;
constexpr int64_t limit_period_ns = ns_per_s;
constexpr int64_t idle_period_ns = 100 * ns_per_ms;

// Where the files of one GT lie.
struct Gt {
  std::string prefix;  // of channel names: "i915.gt0"
  std::string path;
  std::string clock_files;  // how the clocks' files begin: path + "/rps_" or "/gt_"
  std::string rc6_file;
  bool has_directory = false;  // of its own: the kernel is 5.19 or newer
};

std::vector<Gt> list_gts(const Root& root, const NamedCard& named) {
  const std::string& card = named.card.path;
  std::vector<Gt> gts;
  for (const std::string& entry : root.list(card + "/gt")) {
    if (!is_numbered(entry, "gt")) continue;
    const std::string path = fmt::format("{}/gt/{}", card, entry);
    std::string rc6_file = path + "/rc6_residency_ms";
    std::string clock_files = path + "/rps_";
    if (entry == "gt0" && !root.exists(rc6_file)) rc6_file = card + "/power/rc6_residency_ms";
    if (entry == "gt0" && !root.exists(clock_files + "act_freq_mhz")) clock_files = card + "/gt_";
    gts.push_back({fmt::format("{}.{}", named.prefix, entry), path, std::move(clock_files),
                   std::move(rc6_file), true});
  }
  if (gts.empty())
    gts.push_back({named.prefix + ".gt0", card, card + "/gt_", card + "/power/rc6_residency_ms"});
  return gts;
}

Channel clock_channel(std::string name, Quantity quantity, std::optional<int64_t> limit) {
  Channel channel = make_channel(std::move(name), quantity, Unit::megahertz);
  channel.limit = limit;
  return channel;
}

Missing no_reasons(const Root& root, const Gt& gt) {
  if (gt.has_directory)
    return {"i915",
            fmt::format("no throttle_reason_* of {} in '{}': GPU generation before 11, for which "
                        "the driver exposes no throttle reasons",
                        gt.prefix, root.display(gt.path)),
            ""};
  return {"i915",
          fmt::format("no throttle_reason_* of {} in '{}': the driver gives them from Linux 5.19 "
                      "and GPU generation 11 on",
                      gt.prefix, root.display(gt.path)),
          ""};
}

void discover_gt(const Root& root, const Gt& gt, const std::string& gpu, Discovery& discovery) {
  const auto file = [&](std::string_view which) {
    return fmt::format("{}{}_freq_mhz", gt.clock_files, which);
  };
  std::optional<int64_t> highest = check_int_file(root, file("RP0")).value;
  if (highest == 0) highest.reset();
  const SourceTraits quiet{.gpu = gpu};
  std::vector<FileChannel> clocks;
  const auto add_clock = [&](std::string_view name, const std::string& path) {
    add_file_row(root, discovery, "i915", clocks,
                 clock_channel(fmt::format("{}.{}", gt.prefix, name), Quantity::frequency, highest),
                 path);
  };
  add_clock("act_freq", file("act"));
  add_clock("requested_freq", file("cur"));
  add_clock("punit_requested_freq", gt.path + "/punit_req_freq_mhz");
  if (clocks.empty())
    discovery.missing.push_back(
        {"i915", fmt::format("no clock of {} in '{}'", gt.prefix, root.display(gt.path)), ""});
  add_file_source(discovery, "i915", clock_period_ns, std::move(clocks), quiet);

  std::vector<FileChannel> limits;
  for (const auto& [name, which] :
       {std::pair{"max_freq", "max"}, std::pair{"rp0_freq", "RP0"}, std::pair{"rpn_freq", "RPn"}})
    add_file_row(root, discovery, "i915", limits,
                 clock_channel(fmt::format("{}.{}", gt.prefix, name), Quantity::limit, highest),
                 file(which));
  add_file_source(discovery, "i915", limit_period_ns, std::move(limits), quiet);

  if (!add_reason_files(root, discovery, "i915", gt.prefix, gt.path, "throttle_reason_",
                        "throttle_reason_status", gpu))
    discovery.missing.push_back(no_reasons(root, gt));

  Channel idle = make_channel(gt.prefix + ".rc6_residency", Quantity::utilization,
                              Unit::millisecond, Kind::cumulative);
  idle.wrap_at = std::numeric_limits<uint32_t>::max();
  std::vector<FileChannel> residency;
  add_file_row(root, discovery, "i915", residency, std::move(idle), gt.rc6_file);
  add_file_source(discovery, "i915", idle_period_ns, std::move(residency),
                  {.slow = true, .wakes_device = true, .gpu = gpu});
}

}  // namespace

void discover_i915(const Root& root, Discovery& discovery) {
  const std::vector<NamedCard> cards = drm_cards_of(root, "i915");
  if (cards.empty()) discovery.missing.push_back({"i915", "no GPU runs under the i915 driver", ""});
  for (const NamedCard& named : cards) {
    for (const Gt& gt : list_gts(root, named)) discover_gt(root, gt, named.card.gpu, discovery);
    report_absent_chip(root, named.card, discovery);
  }
}

}  // namespace energyprof::probe
