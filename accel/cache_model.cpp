// Recording runs in parallel, the caches in the order of the workgroups.
#include "accel/cache_model.h"

#include <fmt/format.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_pipeline.h>

#include <algorithm>
#include <array>
#include <bit>
#include <limits>
#include <span>
#include <stdexcept>

namespace energyprof::accel {
namespace {

constexpr uint32_t no_line = std::numeric_limits<uint32_t>::max();
constexpr uint64_t page_bytes = 4096;
constexpr size_t run_count = 16;
constexpr size_t groups_in_flight = 64;

[[noreturn]] void fail(std::string_view why) {
  throw std::runtime_error(fmt::format("cannot model caches: {}.", why));
}

/// A set of lines that is emptied in no time.
class LineSet {
 public:
  void clear() {
    ++generation_;
    count_ = 0;
  }

  /// Returns whether the line is new.
  bool insert(uint32_t line) {
    if (2 * count_ >= slots_.size()) grow();
    Slot* const slot = find(line);
    if (slot->generation == generation_) return false;
    *slot = {line, generation_};
    ++count_;
    return true;
  }

  [[nodiscard]] size_t size() const { return count_; }

 private:
  struct Slot {
    uint32_t line = 0;
    uint32_t generation = 0;  // the slot is taken if it is the set's
  };

  /// Where the line is, or belongs.
  Slot* find(uint32_t line) {
    const size_t mask = slots_.size() - 1;
    size_t i = line & mask;
    while (slots_[i].generation == generation_ && slots_[i].line != line) i = (i + 1) & mask;
    return &slots_[i];
  }

  void grow() {
    std::vector<Slot> old(2 * slots_.size());
    old.swap(slots_);
    for (const Slot& slot : old)
      if (slot.generation == generation_) *find(slot.line) = slot;
  }

  std::vector<Slot> slots_ = std::vector<Slot>(256);
  uint32_t generation_ = 1;
  size_t count_ = 0;
};

/// The memory of a scene: nodes, references and triangles one behind the other.
class AddressSpace {
 public:
  AddressSpace(const CpuScene& scene, uint32_t line_bytes)
      : line_shift_(std::countr_zero(line_bytes)) {
    const std::array<uint64_t, 3> sizes{scene.blob.nodes.size(),
                                        scene.blob.refs.size() * sizeof(uint32_t),
                                        scene.triangles.size_bytes()};
    uint64_t end = 0;
    for (size_t i = 0; i < sizes.size(); ++i) {
      begins_[i] = end;
      end = (end + sizes[i] + page_bytes - 1) / page_bytes * page_bytes;
    }
    if ((end >> line_shift_) >= no_line) fail("the scene has more lines than 32 bits count");
    line_count_ = static_cast<uint32_t>(end >> line_shift_) + 1;
  }

  [[nodiscard]] uint32_t line_count() const { return line_count_; }
  [[nodiscard]] uint32_t first_line(const MemoryRead& read) const { return line_at(read, 0); }
  [[nodiscard]] uint32_t last_line(const MemoryRead& read) const {
    return line_at(read, read.size - 1);
  }

 private:
  [[nodiscard]] uint32_t line_at(const MemoryRead& read, uint32_t byte) const {
    return static_cast<uint32_t>((begins_[static_cast<size_t>(read.buffer)] + read.offset + byte) >>
                                 line_shift_);
  }

  int line_shift_;
  std::array<uint64_t, 3> begins_{};
  uint32_t line_count_ = 0;
};

struct Group {
  uint32_t x = 0;  // of its first pixel
  uint32_t y = 0;
  bool counts = true;  // false: only warms the caches
};

/// The workgroups to trace, in order.
std::vector<Group> choose_groups(const gpu::FrameConstants& constants,
                                 const CacheModelConfig& config) {
  const uint64_t columns = (uint64_t{constants.width} + config.group_x - 1) / config.group_x;
  const uint64_t rows = (uint64_t{constants.height} + config.group_y - 1) / config.group_y;
  const uint64_t total = columns * rows;
  std::vector<Group> groups;
  const auto add = [&](uint64_t i, bool counts) {
    groups.push_back({static_cast<uint32_t>(i % columns) * config.group_x,
                      static_cast<uint32_t>(i / columns) * config.group_y, counts});
  };
  if (uint64_t{constants.width} * constants.height <= config.max_pixel_count) {
    for (uint64_t i = 0; i < total; ++i) add(i, true);
    return groups;
  }
  const uint64_t group_size = uint64_t{config.group_x} * config.group_y;
  const uint64_t runs = std::min<uint64_t>(run_count, total);
  const uint64_t length =
      std::clamp<uint64_t>(config.max_pixel_count / (runs * group_size), 1, total / runs);
  for (uint64_t run = 0; run < runs; ++run)
    for (uint64_t i = 0; i < length; ++i) add(total * run / runs + i, i >= length / 4);
  return groups;
}

/// What a workgroup asks of the caches.
struct GroupTrace {
  bool counts = true;
  std::vector<uint32_t> lines;  // in order
  int64_t pixel_count = 0;
  int64_t ray_count = 0;
  int64_t read_count = 0;
  int64_t pixel_line_count = 0;  // distinct lines of each pixel, summed
};

/// Traces workgroups. One object a thread: it keeps its working memory.
class Recorder {
 public:
  Recorder(std::string_view algorithm, const CpuScene& scene, const gpu::FrameConstants& constants,
           const CacheModelConfig& config, const AddressSpace& space)
      : algorithm_(algorithm),
        scene_(scene),
        constants_(constants),
        config_(config),
        space_(space),
        primary_(config.lanes),
        bounce_(config.lanes) {}

  GroupTrace record(const Group& group) {
    GroupTrace trace;
    trace.counts = group.counts;
    const uint32_t thread_count = config_.group_x * config_.group_y;
    for (uint32_t first = 0; first < thread_count; first += config_.lanes) {
      for (uint32_t lane = 0; lane < config_.lanes; ++lane) {
        primary_[lane].clear();
        bounce_[lane].clear();
        const uint32_t thread = first + lane;
        const uint32_t x = group.x + thread % config_.group_x;
        const uint32_t y = group.y + thread / config_.group_x;
        if (thread < thread_count && x < constants_.width && y < constants_.height)
          record_pixel(x, y, lane, trace);
      }
      run_in_lockstep(primary_, trace.lines);
      run_in_lockstep(bounce_, trace.lines);
    }
    return trace;
  }

 private:
  struct LineRead {
    uint32_t line;
    uint32_t step;
  };
  using Lane = std::vector<LineRead>;

  void record_pixel(uint32_t x, uint32_t y, uint32_t lane, GroupTrace& trace) {
    const PixelReads reads = record_reads(algorithm_, scene_, constants_, x, y);
    ++trace.pixel_count;
    trace.ray_count += reads.ray_count;
    trace.read_count += static_cast<int64_t>(reads.primary.size() + reads.bounce.size());
    lines_.clear();
    append_lines(reads.primary, primary_[lane]);
    append_lines(reads.bounce, bounce_[lane]);
    trace.pixel_line_count += static_cast<int64_t>(lines_.size());
  }

  void append_lines(std::span<const MemoryRead> reads, Lane& lane) {
    for (const MemoryRead& read : reads) {
      const uint32_t last = space_.last_line(read);
      for (uint32_t line = space_.first_line(read); line <= last; ++line) {
        lane.push_back({line, read.step});
        lines_.insert(line);
      }
    }
  }

  /// Merges the lanes' reads by step; what is asked for twice in a step is asked for once.
  void run_in_lockstep(const std::vector<Lane>& lanes, std::vector<uint32_t>& out) {
    positions_.assign(lanes.size(), 0);
    while (true) {
      uint32_t step = std::numeric_limits<uint32_t>::max();
      for (size_t i = 0; i < lanes.size(); ++i)
        if (positions_[i] < lanes[i].size()) step = std::min(step, lanes[i][positions_[i]].step);
      if (step == std::numeric_limits<uint32_t>::max()) return;
      lines_.clear();
      for (size_t i = 0; i < lanes.size(); ++i)
        for (size_t& at = positions_[i]; at < lanes[i].size() && lanes[i][at].step == step; ++at)
          if (lines_.insert(lanes[i][at].line)) out.push_back(lanes[i][at].line);
    }
  }

  std::string_view algorithm_;
  const CpuScene& scene_;
  const gpu::FrameConstants& constants_;
  const CacheModelConfig& config_;
  const AddressSpace& space_;
  std::vector<Lane> primary_;
  std::vector<Lane> bounce_;
  std::vector<size_t> positions_;
  LineSet lines_;
};

/// Both levels, and what has been counted so far.
class Simulation {
 public:
  Simulation(const CacheModelConfig& config, uint32_t line_count)
      : line_bytes_(config.l1.line_bytes),
        llc_shift_(std::countr_zero(config.llc.line_bytes) -
                   std::countr_zero(config.l1.line_bytes)),
        l1_(config.l1),
        llc_(config.llc),
        is_touched_(line_count, 0) {}

  void run(const GroupTrace& trace) {
    int64_t l1_miss_count = 0;
    int64_t llc_miss_count = 0;
    for (const uint32_t line : trace.lines) {
      if (!l1_.touch(line)) {
        ++l1_miss_count;
        if (!llc_.touch(line >> llc_shift_)) ++llc_miss_count;
      }
    }
    if (!trace.counts) return;
    for (const uint32_t line : trace.lines) is_touched_[line] = 1;
    result_.pixel_count += trace.pixel_count;
    result_.ray_count += trace.ray_count;
    result_.read_count += trace.read_count;
    result_.access_count += static_cast<int64_t>(trace.lines.size());
    result_.l1_miss_count += l1_miss_count;
    result_.llc_miss_count += llc_miss_count;
    pixel_line_count_ += trace.pixel_line_count;
  }

  [[nodiscard]] CacheModelResult result() const {
    CacheModelResult result = result_;
    result.footprint_bytes = line_bytes_ * std::ranges::count(is_touched_, 1);
    if (result.pixel_count == 0) return result;
    const auto rays = static_cast<double>(result.ray_count);
    result.l1_misses_per_ray = static_cast<double>(result.l1_miss_count) / rays;
    result.llc_misses_per_ray = static_cast<double>(result.llc_miss_count) / rays;
    result.bytes_per_pixel = static_cast<double>(line_bytes_ * pixel_line_count_) /
                             static_cast<double>(result.pixel_count);
    return result;
  }

 private:
  int64_t line_bytes_;
  int llc_shift_;
  CacheLevel l1_;
  CacheLevel llc_;
  std::vector<uint8_t> is_touched_;
  CacheModelResult result_;
  int64_t pixel_line_count_ = 0;
};

}  // namespace

CacheLevel::CacheLevel(const CacheGeometry& geometry) : way_count_(geometry.ways), set_count_(0) {
  if (geometry.ways == 0 || !std::has_single_bit(geometry.line_bytes))
    fail(fmt::format("{} ways and lines of {} bytes; expected at least 1, and a power of two",
                     geometry.ways, geometry.line_bytes));
  const uint64_t sets = geometry.size_bytes / (uint64_t{geometry.ways} * geometry.line_bytes);
  if (sets == 0 || sets * geometry.ways >= no_line)
    fail(fmt::format("{} bytes are {} sets of {} lines of {} bytes", geometry.size_bytes, sets,
                     geometry.ways, geometry.line_bytes));
  set_count_ = static_cast<uint32_t>(sets);
  ways_.assign(sets * geometry.ways, no_line);
}

CacheModelResult model_cache(std::string_view algorithm, const CpuScene& scene,
                             const gpu::FrameConstants& constants, const CacheModelConfig& config) {
  if (config.group_x == 0 || config.group_y == 0 || config.lanes == 0)
    fail(fmt::format("workgroups of {} x {} threads in subgroups of {}", config.group_x,
                     config.group_y, config.lanes));
  if (config.llc.line_bytes < config.l1.line_bytes)
    fail(fmt::format("the LLC's lines of {} bytes are shorter than the L1's of {}",
                     config.llc.line_bytes, config.l1.line_bytes));
  if (!std::has_single_bit(config.l1.line_bytes))
    fail(fmt::format("lines of {} bytes; expected a power of two", config.l1.line_bytes));

  const AddressSpace space(scene, config.l1.line_bytes);
  Simulation simulation(config, space.line_count());
  const std::vector<Group> groups = choose_groups(constants, config);
  oneapi::tbb::enumerable_thread_specific<Recorder> recorders(
      [&] { return Recorder(algorithm, scene, constants, config, space); });
  size_t next = 0;
  oneapi::tbb::parallel_pipeline(
      groups_in_flight,
      oneapi::tbb::make_filter<void, Group>(oneapi::tbb::filter_mode::serial_in_order,
                                            [&](oneapi::tbb::flow_control& control) {
                                              if (next < groups.size()) return groups[next++];
                                              control.stop();
                                              return Group();
                                            }) &
          oneapi::tbb::make_filter<Group, GroupTrace>(
              oneapi::tbb::filter_mode::parallel,
              [&](const Group& group) { return recorders.local().record(group); }) &
          oneapi::tbb::make_filter<GroupTrace, void>(
              oneapi::tbb::filter_mode::serial_in_order,
              [&](const GroupTrace& trace) { simulation.run(trace); }));
  return simulation.result();
}

}  // namespace energyprof::accel
