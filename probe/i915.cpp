// Expects in a card's directory, since Linux 5.19
//
//   gt/gt0/rps_act_freq_mhz  rps_cur_freq_mhz  rps_max_freq_mhz  rps_RP0_freq_mhz     1300
//   gt/gt0/throttle_reason_status  throttle_reason_pl1  ...                           0 or 1
//   gt/gt0/rc6_residency_ms                                                           184467
//
// and before that, for all GTs together,
//
//   gt_act_freq_mhz  gt_cur_freq_mhz  gt_max_freq_mhz  gt_RP0_freq_mhz  power/rc6_residency_ms
#include "probe/i915.h"

#include <fmt/format.h>

#include <limits>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
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
};

std::vector<Gt> list_gts(const Root& root, const NamedCard& named) {
  const std::string& card = named.card.path;
  std::vector<Gt> gts;
  for (const std::string& entry : root.list(card + "/gt")) {
    if (!entry.starts_with("gt")) continue;
    const std::string path = fmt::format("{}/gt/{}", card, entry);
    std::string rc6_file = path + "/rc6_residency_ms";
    if (entry == "gt0" && !root.exists(rc6_file)) rc6_file = card + "/power/rc6_residency_ms";
    gts.push_back(
        {fmt::format("{}.{}", named.prefix, entry), path, path + "/rps_", std::move(rc6_file)});
  }
  if (gts.empty())
    gts.push_back({named.prefix + ".gt0", card, card + "/gt_", card + "/power/rc6_residency_ms"});
  return gts;
}

Channel clock_channel(std::string name, Quantity quantity, std::optional<int64_t> limit) {
  Channel channel;
  channel.name = std::move(name);
  channel.quantity = quantity;
  channel.unit = Unit::megahertz;
  channel.limit = limit;
  return channel;
}

// Adds the file as a row, or says why not. An absent file is no news.
void add_row(const Root& root, Discovery& discovery, std::vector<FileChannel>& rows,
             Channel channel, const std::string& path) {
  if (!root.exists(path)) return;
  CheckedFile checked = check_int_file(root, path);
  if (checked.problem.empty())
    rows.push_back({std::move(channel), std::move(checked.file)});
  else
    discovery.missing.push_back({"i915", checked.problem, ""});
}

void discover_gt(const Root& root, const Gt& gt, const std::string& gpu, Discovery& discovery) {
  const auto file = [&](std::string_view which) {
    return fmt::format("{}{}_freq_mhz", gt.clock_files, which);
  };
  const std::optional<int64_t> highest = check_int_file(root, file("RP0")).value;
  const SourceTraits quiet{.gpu = gpu};
  std::vector<FileChannel> clocks;
  add_row(root, discovery, clocks,
          clock_channel(gt.prefix + ".act_freq", Quantity::frequency, highest), file("act"));
  add_row(root, discovery, clocks,
          clock_channel(gt.prefix + ".requested_freq", Quantity::frequency, highest), file("cur"));
  if (clocks.empty())
    discovery.missing.push_back(
        {"i915", fmt::format("no clock of {} in '{}'", gt.prefix, root.display(gt.path)), ""});
  add_file_source(discovery, "i915", clock_period_ns, std::move(clocks), quiet);

  std::vector<FileChannel> limits;
  add_row(root, discovery, limits, clock_channel(gt.prefix + ".max_freq", Quantity::limit, highest),
          file("max"));
  add_file_source(discovery, "i915", limit_period_ns, std::move(limits), quiet);

  if (!add_reason_files(root, discovery, "i915", gt.prefix, gt.path, "throttle_reason_",
                        "throttle_reason_status", gpu))
    discovery.missing.push_back(
        {"i915",
         fmt::format(
             "no throttle_reason_* of {} in '{}': the driver gives them from Linux 5.19 and "
             "GPU generation 11 on",
             gt.prefix, root.display(gt.path)),
         ""});

  Channel idle;
  idle.name = gt.prefix + ".rc6_residency";
  idle.quantity = Quantity::utilization;
  idle.unit = Unit::millisecond;
  idle.kind = Kind::cumulative;
  idle.wrap_at = std::numeric_limits<uint32_t>::max();
  std::vector<FileChannel> residency;
  add_row(root, discovery, residency, std::move(idle), gt.rc6_file);
  add_file_source(discovery, "i915", idle_period_ns, std::move(residency),
                  {.slow = true, .wakes_device = true, .gpu = gpu});
}

}  // namespace

void discover_i915(const Root& root, Discovery& discovery) {
  const std::vector<NamedCard> cards = drm_cards_of(root, "i915");
  if (cards.empty()) discovery.missing.push_back({"i915", "no GPU runs under the i915 driver", ""});
  for (const NamedCard& named : cards)
    for (const Gt& gt : list_gts(root, named)) discover_gt(root, gt, named.card.gpu, discovery);
}

}  // namespace energyprof::probe
