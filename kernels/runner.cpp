// Records, submits and reads back frames.
#include "kernels/runner.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <span>
#include <stdexcept>
#include <thread>

#include "core/algorithms.h"
#include "embedded/reduce_spv.h"
#include "kernels/buffer.h"
#include "kernels/clock_sync.h"
#include "kernels/context.h"
#include "kernels/performance_counters.h"
#include "kernels/pipeline.h"
#include "kernels/reduce_layout.h"
#include "kernels/tiling.h"

namespace energyprof::kernels {
namespace {

constexpr uint32_t stack_step = 8;

uint32_t div_up(uint32_t value, uint32_t divisor) { return (value + divisor - 1) / divisor; }

const KernelInfo& require_kernel(const TraceSetup& setup) {
  const KernelInfo* kernel = find_kernel(setup.kernel);
  if (kernel == nullptr) {
    std::string names;
    for (const KernelInfo& known : kernel_list()) {
      names += fmt::format("{}{}", names.empty() ? "" : ", ", known.name);
    }
    throw std::runtime_error(fmt::format(
        "cannot trace with '{}': there is no such kernel; expected {}.", setup.kernel, names));
  }
  if (kernel->accel != setup.blob.kind) {
    throw std::runtime_error(fmt::format(
        "cannot trace with '{}': the scene was built as another structure than it traverses.",
        setup.kernel));
  }
  return *kernel;
}

/// Entries for the deepest path and one to spare, in steps, so that few shader variants exist.
uint32_t require_stack_size(const KernelInfo& kernel, const TraceSetup& setup) {
  if (!kernel.uses_stack) return stack_step;
  const uint32_t needed = setup.blob.max_depth + 1;
  if (needed > max_stack_size) {
    throw std::runtime_error(fmt::format(
        "cannot trace with '{}': the tree needs a stack of {} entries, the kernel has at most {}. "
        "Clean the mesh of coinciding triangles, or use a traversal without a stack.",
        setup.kernel, needed, max_stack_size));
  }
  return div_up(needed, stack_step) * stack_step;
}

/// A CPU driver's threads each take one run of workgroups: let each have rows from all over the
/// image.
uint32_t row_interleave(const DeviceInfo& info) {
  if (info.type != "cpu") return 1;
  return std::max(1u, std::thread::hardware_concurrency());
}

/// Checks image and workgroup against the device; returns the number of pixels.
uint64_t require_image(const DeviceInfo& info, const TraceSetup& setup) {
  const gpu::FrameConstants& constants = setup.constants;
  const TraceSetup::Config& config = setup.config;
  const auto refuse = [](const std::string& why) { throw std::runtime_error(why); };
  if (constants.width == 0 || constants.height == 0) {
    refuse(fmt::format("cannot trace an image of {} x {} pixels: it is empty.", constants.width,
                       constants.height));
  }
  const uint64_t threads = uint64_t{config.local_x} * config.local_y;
  if (threads == 0 || threads > info.max_workgroup_invocations ||
      config.local_x > info.max_workgroup_size_x || config.local_y > info.max_workgroup_size_y) {
    refuse(fmt::format(
        "cannot trace in workgroups of {} x {} on '{}': it allows {} x {}, at most {} threads "
        "together.",
        config.local_x, config.local_y, info.name, info.max_workgroup_size_x,
        info.max_workgroup_size_y, info.max_workgroup_invocations));
  }
  const uint32_t across = div_up(constants.width, config.local_x);
  const uint32_t down = div_up(constants.height, config.local_y);
  if (across > info.max_workgroup_count_x || down > info.max_workgroup_count_y) {
    refuse(fmt::format(
        "cannot trace an image of {} x {} pixels on '{}': that is {} x {} workgroups, it allows "
        "{} x {}.",
        constants.width, constants.height, info.name, across, down, info.max_workgroup_count_x,
        info.max_workgroup_count_y));
  }
  return uint64_t{constants.width} * constants.height;
}

/// The sums of a frame over all its pixels.
struct FrameSums {
  int64_t hit_count = 0;
  int64_t ray_count = 0;
  uint32_t checksum_x = 0;
  uint32_t checksum_y = 0;
};

FrameSums add_up(std::span<const gpu::ReducePartial> partials) {
  FrameSums sums;
  for (const gpu::ReducePartial& partial : partials) {
    sums.hit_count += partial.hit_count;
    sums.ray_count += partial.ray_count;
    sums.checksum_x += partial.checksum_x;
    sums.checksum_y += partial.checksum_y;
  }
  return sums;
}

Owned<VkQueryPool> make_timestamps(Context& context, uint32_t count) {
  VkQueryPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO;
  info.queryType = VK_QUERY_TYPE_TIMESTAMP;
  info.queryCount = count;
  VkQueryPool pool = VK_NULL_HANDLE;
  check(context.api.create_query_pool(context.device, &info, nullptr, &pool),
        fmt::format("create {} timestamp queries", count));
  return {context, pool, context.api.destroy_query_pool};
}

Owned<VkQueryPool> make_counter_query(Context& context) {
  const PhysicalDevice& physical = context.physical;
  VkQueryPoolPerformanceCreateInfoKHR counters{};
  counters.sType = VK_STRUCTURE_TYPE_QUERY_POOL_PERFORMANCE_CREATE_INFO_KHR;
  counters.queueFamilyIndex = physical.queue_family;
  counters.counterIndexCount = static_cast<uint32_t>(physical.counter_indices.size());
  counters.pCounterIndices = physical.counter_indices.data();
  VkQueryPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO;
  info.pNext = &counters;
  info.queryType = VK_QUERY_TYPE_PERFORMANCE_QUERY_KHR;
  info.queryCount = 1;
  VkQueryPool pool = VK_NULL_HANDLE;
  check(context.api.create_query_pool(context.device, &info, nullptr, &pool),
        fmt::format("create a query of {} performance counters", physical.counter_indices.size()));
  return {context, pool, context.api.destroy_query_pool};
}

/// The GPU's counters while they are reserved for this process.
class ProfilingLock {
 public:
  explicit ProfilingLock(Context& context) : context_(context) {
    VkAcquireProfilingLockInfoKHR info{};
    info.sType = VK_STRUCTURE_TYPE_ACQUIRE_PROFILING_LOCK_INFO_KHR;
    info.timeout = static_cast<uint64_t>(ns_per_s);
    check(context.api.acquire_profiling_lock(context.device, &info),
          fmt::format("reserve the performance counters of '{}'", context.info.name));
  }
  ~ProfilingLock() {
    if (!context_.abandoned) context_.api.release_profiling_lock(context_.device);
  }
  ProfilingLock(const ProfilingLock&) = delete;
  ProfilingLock& operator=(const ProfilingLock&) = delete;

 private:
  Context& context_;
};

}  // namespace

struct TraceProgram::Impl {
  Impl(Device& device, const TraceSetup& setup);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  FrameRecord run_frame(uint32_t frame, Phase phase);
  std::optional<HardwareCounts> count_hardware(uint32_t frame);

  // The steps of a frame.
  void settle();
  void bind(VkCommandBuffer commands, VkPipeline pipeline);
  void dispatch_tile(VkCommandBuffer commands, uint32_t tile);
  void record_tile(VkCommandBuffer commands, uint32_t tile, VkPipeline pipeline);
  void record_reduce();
  TickSpan read_timestamps(uint32_t tile_count);
  FrameSums reduce();

  template <typename T>
  [[nodiscard]] std::vector<T> read(const Buffer& buffer) const {
    std::vector<T> items(buffer.byte_count() / sizeof(T));
    buffer.download(std::as_writable_bytes(std::span(items)));
    return items;
  }

  Context& context;
  const TraceSetup::Config config;
  gpu::FrameConstants constants;
  const TickScale scale;
  const KernelInfo& kernel;
  const Specialization specialization;
  const uint64_t pixel_count;

  Buffer nodes;
  Buffer refs;
  Buffer triangles;
  Buffer hits;
  Buffer counts;
  Buffer lanes;
  const uint32_t reduce_thread_count;
  Buffer partials;
  PipelineLayout layout;
  DescriptorSet buffers;
  Owned<VkPipeline> timed_pipeline;
  Owned<VkPipeline> counting_pipeline;
  Owned<VkPipeline> reduce_pipeline;
  Owned<VkQueryPool> timestamps;  ///< two for each tile
  Owned<VkCommandPool> pool;
  std::vector<VkCommandBuffer> tile_commands;
  VkCommandBuffer reduce_commands = VK_NULL_HANDLE;
  Owned<VkFence> fence;

  uint32_t rows_per_dispatch = 0;
  int64_t slowest_dispatch_ns = 0;  ///< of the last frame
  int64_t frame_ns = 0;             ///< how long the last frame took
  bool in_flight = false;           ///< submitted and not waited for: the last frame failed
  bool has_hits = false;
  std::optional<WorkSums> work;  ///< of the last counted frame
};

TraceProgram::Impl::Impl(Device& device, const TraceSetup& setup)
    : context(device.context()),
      config(setup.config),
      constants(setup.constants),
      scale{context.info.timestamp_period_ns, context.info.timestamp_valid_bits},
      kernel(require_kernel(setup)),
      specialization{config.local_x,
                     config.local_y,
                     VK_FALSE,
                     require_stack_size(kernel, setup),
                     setup.blob.refs.empty() ? VK_FALSE : VK_TRUE,
                     row_interleave(context.info)},
      pixel_count(require_image(context.info, setup)),
      nodes(context, "node buffer", setup.blob.nodes.size()),
      refs(context, "reference buffer", setup.blob.refs.size() * sizeof(uint32_t)),
      triangles(context, "triangle buffer", setup.triangles.size_bytes()),
      hits(context, "hit buffer", pixel_count * sizeof(gpu::PixelHits)),
      counts(context, "work buffer", pixel_count * sizeof(gpu::PixelCounts)),
      lanes(context, "lane buffer", pixel_count * sizeof(gpu::PixelLanes)),
      // The hit buffer fits the device, so the pixels can be counted in 32 bits.
      reduce_thread_count(
          div_up(static_cast<uint32_t>(pixel_count), gpu::reduce_pixels_per_thread)),
      partials(context, "sum buffer", reduce_thread_count * sizeof(gpu::ReducePartial),
               Buffer::Use::readback),
      layout(context),
      buffers(context, layout, {&nodes, &refs, &triangles, &hits, &counts, &partials, &lanes}),
      timestamps(make_timestamps(context, 2 * div_up(constants.height, config.local_y))),
      pool(make_command_pool(context)),
      fence(make_fence(context)) {
  assert(setup.blob.nodes.size() % node_bytes(setup.blob.kind) == 0);
  nodes.upload(setup.blob.nodes);
  refs.upload(std::as_bytes(std::span(setup.blob.refs)));
  triangles.upload(std::as_bytes(setup.triangles));
  set_structure(constants, setup.blob);

  Specialization counting = specialization;
  counting.count_work = VK_TRUE;
  timed_pipeline = make_pipeline(context, layout, kernel.name, kernel.spirv, specialization);
  counting_pipeline = make_pipeline(context, layout, kernel.name, kernel.spirv, counting);
  reduce_pipeline =
      make_pipeline(context, layout, "the sums of a frame", embedded::reduce_spv(), specialization);

  // The smallest tile is one row of workgroups.
  const uint32_t smallest = std::min(config.local_y, constants.height);
  uint32_t rows = context.info.type == "cpu" ? constants.height : first_rows_per_dispatch;
  rows = config.rows_per_dispatch.value_or(rows);
  rows_per_dispatch = std::clamp(rows, smallest, constants.height);
}

TraceProgram::Impl::~Impl() {
  // A frame that ended in an exception may still be running.
  if (!context.abandoned) context.api.device_wait_idle(context.device);
}

/// After a frame that ended in an exception: nothing of it may run any more, nor have left its
/// mark.
void TraceProgram::Impl::settle() {
  if (context.abandoned) {
    throw DeviceLost(fmt::format("cannot trace a frame on '{}': the device was lost earlier.",
                                 context.info.name));
  }
  if (!in_flight) return;
  const std::string what = fmt::format("trace a frame on '{}'", context.info.name);
  check(context.api.device_wait_idle(context.device), what);
  const VkFence frame_fence = fence.get();
  check(context.api.reset_fences(context.device, 1, &frame_fence), what);
  in_flight = false;
}

void TraceProgram::Impl::bind(VkCommandBuffer commands, VkPipeline pipeline) {
  const VkDescriptorSet set = buffers.get();
  context.api.cmd_bind_pipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline);
  context.api.cmd_bind_descriptor_sets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout.get(), 0, 1,
                                       &set, 0, nullptr);
}

void TraceProgram::Impl::dispatch_tile(VkCommandBuffer commands, uint32_t tile) {
  gpu::FrameConstants tile_constants = constants;
  tile_constants.first_row = tile * rows_per_dispatch;
  tile_constants.row_count =
      std::min(rows_per_dispatch, constants.height - tile_constants.first_row);
  context.api.cmd_push_constants(commands, layout.get(), VK_SHADER_STAGE_COMPUTE_BIT, 0,
                                 sizeof tile_constants, &tile_constants);
  context.api.cmd_dispatch(commands, div_up(constants.width, config.local_x),
                           div_up(tile_constants.row_count, config.local_y), 1);
}

void TraceProgram::Impl::record_tile(VkCommandBuffer commands, uint32_t tile, VkPipeline pipeline) {
  const DeviceApi& api = context.api;
  begin_commands(context, commands);
  api.cmd_reset_query_pool(commands, timestamps.get(), 2 * tile, 2);
  bind(commands, pipeline);
  api.cmd_write_timestamp(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, timestamps.get(), 2 * tile);
  dispatch_tile(commands, tile);
  api.cmd_write_timestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, timestamps.get(),
                          2 * tile + 1);
  end_commands(context, commands);
}

void TraceProgram::Impl::record_reduce() {
  const DeviceApi& api = context.api;
  const gpu::ReduceConstants reduce_constants{static_cast<uint32_t>(pixel_count),
                                              reduce_thread_count};
  const VkDescriptorSet set = buffers.get();
  VkMemoryBarrier barrier{};
  barrier.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER;
  barrier.srcAccessMask = VK_ACCESS_SHADER_WRITE_BIT;
  begin_commands(context, reduce_commands);
  // The traced hits are to be seen by this shader, and by later copies.
  barrier.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_TRANSFER_READ_BIT;
  api.cmd_pipeline_barrier(reduce_commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                           VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT, 0,
                           1, &barrier, 0, nullptr, 0, nullptr);
  api.cmd_bind_pipeline(reduce_commands, VK_PIPELINE_BIND_POINT_COMPUTE, reduce_pipeline.get());
  api.cmd_bind_descriptor_sets(reduce_commands, VK_PIPELINE_BIND_POINT_COMPUTE, layout.get(), 0, 1,
                               &set, 0, nullptr);
  api.cmd_push_constants(reduce_commands, layout.get(), VK_SHADER_STAGE_COMPUTE_BIT, 0,
                         sizeof reduce_constants, &reduce_constants);
  api.cmd_dispatch(reduce_commands, div_up(reduce_thread_count, gpu::reduce_workgroup_size), 1, 1);
  // Hits and sums alike may be read by the host.
  barrier.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
  api.cmd_pipeline_barrier(reduce_commands, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT,
                           VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &barrier, 0, nullptr, 0, nullptr);
  end_commands(context, reduce_commands);
}

/// Begin of the first and end of the last tile. Only after the frame's fence: Mesa's CPU driver
/// waits for the queue in vkGetQueryPoolResults even when told not to.
TickSpan TraceProgram::Impl::read_timestamps(uint32_t tile_count) {
  std::vector<uint64_t> ticks(size_t{2} * tile_count);
  check(context.api.get_query_pool_results(context.device, timestamps.get(), 0, 2 * tile_count,
                                           ticks.size() * sizeof(uint64_t), ticks.data(),
                                           sizeof(uint64_t), VK_QUERY_RESULT_64_BIT),
        "read the timestamps of a frame");
  slowest_dispatch_ns = 0;
  for (size_t tile = 0; tile < tile_count; ++tile) {
    // A tile's commands may start while the one before still runs: measured end to end.
    const uint64_t begin = tile == 0 ? ticks[0] : ticks[2 * tile - 1];
    const auto took = static_cast<double>(ticks_between(begin, ticks[2 * tile + 1], scale));
    slowest_dispatch_ns =
        std::max(slowest_dispatch_ns, static_cast<int64_t>(took * scale.period_ns));
  }
  return {ticks.front(), ticks.back()};
}

FrameSums TraceProgram::Impl::reduce() {
  record_reduce();
  submit(context, reduce_commands, fence.get(), "sum up a frame");
  wait_and_reset(context, fence.get(), "sum up a frame");
  return add_up(read<gpu::ReducePartial>(partials));
}

FrameRecord TraceProgram::Impl::run_frame(uint32_t frame, Phase phase) {
  settle();
  const bool counted = phase == Phase::counted;
  constants.frame = frame;
  const uint32_t tile_count = div_up(constants.height, rows_per_dispatch);

  check(context.api.reset_command_pool(context.device, pool.get(), 0), "reset GPU commands");
  if (reduce_commands == VK_NULL_HANDLE) {
    reduce_commands = make_command_buffers(context, pool.get(), 1).front();
  }
  if (tile_commands.size() < tile_count) {
    const auto more = make_command_buffers(
        context, pool.get(), tile_count - static_cast<uint32_t>(tile_commands.size()));
    tile_commands.insert(tile_commands.end(), more.begin(), more.end());
  }
  for (uint32_t tile = 0; tile < tile_count; ++tile) {
    record_tile(tile_commands[tile], tile,
                counted ? counting_pipeline.get() : timed_pipeline.get());
  }

  std::optional<Calibration> calibration;
  if (context.info.calibrated_timestamps) calibration = calibrate(context);
  FrameRecord record;
  record.frame = frame;
  record.phase = phase;
  record.dispatch_count = tile_count;
  in_flight = true;
  record.submit_ns = now_ns();
  for (uint32_t tile = 0; tile < tile_count; ++tile) {
    // Fences signal in order: the last one's covers all.
    const bool last = tile + 1 == tile_count;
    submit(context, tile_commands[tile], last ? fence.get() : VK_NULL_HANDLE, "trace a frame");
  }
  wait_and_reset(context, fence.get(), "trace a frame");
  const int64_t done_ns = now_ns();

  const TickSpan span = read_timestamps(tile_count);
  const HostSpan host = calibration ? place_by_calibration(*calibration, span, scale)
                                    : place_by_enclosure(record.submit_ns, done_ns, span, scale);
  frame_ns = host.end_ns - host.begin_ns;
  record.begin_ns = host.begin_ns;
  record.end_ns = host.end_ns;
  record.clock_error_ns = host.error_ns;

  const FrameSums sums = reduce();
  in_flight = false;
  has_hits = true;
  record.ray_count = sums.ray_count;
  record.hit_count = sums.hit_count;
  record.hit_checksum = fmt::format("{:08x}{:08x}", sums.checksum_x, sums.checksum_y);
  if (counted) {
    work = sum_work(
        read<gpu::PixelCounts>(counts), read<gpu::PixelLanes>(lanes),
        {constants.width, constants.height, config.local_x, config.local_y, rows_per_dispatch});
    record.node_visit_count = work->node_visits;
    record.box_test_count = work->box_tests;
    record.prim_test_count = work->prim_tests;
    record.loop_step_count = work->loop_steps;
    record.simd_efficiency = work->simd_efficiency;
    if (context.info.type == "cpu" && work->max_subgroup_steps > max_cpu_subgroup_steps) {
      throw std::runtime_error(fmt::format(
          "cannot trust '{}' on '{}': a SIMD group took {} loop steps, beyond {} this "
          "CPU driver may end loops early. Trace on a GPU, or a model with less "
          "overlap.",
          kernel.name, context.info.name, work->max_subgroup_steps, max_cpu_subgroup_steps));
    }
  }
  if (context.info.type != "cpu" && !config.rows_per_dispatch) {
    rows_per_dispatch = next_rows_per_dispatch(rows_per_dispatch, slowest_dispatch_ns,
                                               config.local_y, constants.height);
  }
  return record;
}

std::optional<HardwareCounts> TraceProgram::Impl::count_hardware(uint32_t frame) {
  constexpr int64_t longest_submission_ns = ns_per_s;
  const PhysicalDevice& physical = context.physical;
  if (physical.counter_indices.empty()) return std::nullopt;
  if (context.info.type != "cpu" && frame_ns > longest_submission_ns) {
    throw std::runtime_error(fmt::format(
        "cannot count with the GPU's own counters: a frame took {:.2g} s, more than {:.2g} s in "
        "one submission may be taken for a hang. Take a smaller model or image.",
        static_cast<double>(frame_ns) / ns_per_s,
        static_cast<double>(longest_submission_ns) / ns_per_s));
  }
  settle();
  constants.frame = frame;
  const DeviceApi& api = context.api;
  const Owned<VkQueryPool> query = make_counter_query(context);
  const Owned<VkCommandPool> commands_pool = make_command_pool(context);
  const auto commands = make_command_buffers(context, commands_pool.get(), 2);
  HardwareCounts counted;
  std::vector<VkPerformanceCounterResultKHR> results(physical.counters.size());
  counted.begin_ns = now_ns();
  {
    // To be held while queries are recorded, too.
    const ProfilingLock lock(context);
    begin_commands(context, commands[0]);
    api.cmd_reset_query_pool(commands[0], query.get(), 0, 1);
    end_commands(context, commands[0]);
    // The query is the first and the last command, as counters of whole command buffers want it.
    begin_repeated_commands(context, commands[1]);
    api.cmd_begin_query(commands[1], query.get(), 0, 0);
    bind(commands[1], timed_pipeline.get());
    for (uint32_t tile = 0; tile < div_up(constants.height, rows_per_dispatch); ++tile) {
      dispatch_tile(commands[1], tile);
    }
    api.cmd_end_query(commands[1], query.get(), 0);
    end_commands(context, commands[1]);
    in_flight = true;
    submit(context, commands[0], fence.get(), "reset the performance counters");
    wait_and_reset(context, fence.get(), "reset the performance counters");
    for (uint32_t pass = 0; pass < physical.counter_pass_count; ++pass) {
      VkPerformanceQuerySubmitInfoKHR which{};
      which.sType = VK_STRUCTURE_TYPE_PERFORMANCE_QUERY_SUBMIT_INFO_KHR;
      which.counterPassIndex = pass;
      submit(context, commands[1], fence.get(), "trace a frame under performance counters", &which);
      wait_and_reset(context, fence.get(), "trace a frame under performance counters");
    }
    in_flight = false;
    const size_t bytes = results.size() * sizeof results.front();
    check(api.get_query_pool_results(context.device, query.get(), 0, 1, bytes, results.data(),
                                     bytes, 0),
          "read the performance counters");
  }
  counted.end_ns = now_ns();
  for (size_t i = 0; i < results.size(); ++i) {
    counted.values.push_back(counter_value(physical.counters[i], results[i]));
  }
  return counted;
}

TraceProgram::TraceProgram(Device& device, const TraceSetup& setup)
    : impl_(std::make_unique<Impl>(device, setup)) {}
TraceProgram::~TraceProgram() = default;
TraceProgram::TraceProgram(TraceProgram&&) noexcept = default;
TraceProgram& TraceProgram::operator=(TraceProgram&&) noexcept = default;

FrameRecord TraceProgram::run_frame(uint32_t frame, Phase phase) {
  return impl_->run_frame(frame, phase);
}

std::optional<HardwareCounts> TraceProgram::count_hardware(uint32_t frame) {
  return impl_->count_hardware(frame);
}

std::vector<gpu::PixelHits> TraceProgram::read_hits() const {
  if (!impl_->has_hits) return {};
  return impl_->read<gpu::PixelHits>(impl_->hits);
}

std::vector<gpu::PixelCounts> TraceProgram::read_counts() const {
  if (!impl_->work) return {};
  return impl_->read<gpu::PixelCounts>(impl_->counts);
}

std::optional<WorkSums> TraceProgram::work() const { return impl_->work; }

}  // namespace energyprof::kernels
