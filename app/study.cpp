#include "app/study.h"

#include <fmt/format.h>
#include <fmt/std.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <memory>
#include <new>
#include <optional>
#include <thread>
#include <utility>

#include "accel/cache_model.h"
#include "accel/trace_cpu.h"
#include "analysis/stats.h"
#include "app/cache_choice.h"
#include "app/gpu_counters.h"
#include "app/heat_map.h"
#include "app/host.h"
#include "app/interrupt.h"
#include "app/pictures.h"
#include "app/progress.h"
#include "app/scene.h"
#include "app/self_check.h"
#include "app/sensors.h"
#include "app/structure_store.h"
#include "app/trial_order.h"
#include "core/algorithms.h"
#include "core/clock.h"
#include "core/run_db.h"
#include "kernels/device.h"
#include "kernels/runner.h"

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;

constexpr double cooldown_band_c =
    5.0;  // a trial begins within this of the run's first temperature
constexpr size_t verified_pixel_limit = size_t{1} << 21;
constexpr int reference_frame_limit = 64;
constexpr int64_t reference_time_limit_ns = 3 * ns_per_s;
constexpr auto wait_step = std::chrono::milliseconds(20);  // between looks at Ctrl-C

nlohmann::json to_json(const kernels::DeviceInfo& info) {
  nlohmann::json j{{"name", info.name},
                   {"type", info.type},
                   {"driver", info.driver_name},
                   {"driver_info", info.driver_info},
                   {"api_version", info.api_version},
                   {"vendor_id", info.vendor_id},
                   {"device_id", info.device_id},
                   {"uuid", info.uuid},
                   {"max_storage_buffer_bytes", info.max_storage_buffer_bytes},
                   {"subgroup_size", info.subgroup_size},
                   {"timestamp_period_ns", info.timestamp_period_ns},
                   {"timestamp_valid_bits", info.timestamp_valid_bits},
                   {"calibrated_timestamps", info.calibrated_timestamps}};
  j["pci_address"] = info.pci_address ? nlohmann::json(*info.pci_address) : nlohmann::json(nullptr);
  return j;
}

/// One study from its first file to its last.
class Study {
 public:
  Study(const Config& config, const StudyOptions& options)
      : config_(config),
        options_(options),
        sensors_(options.root, config, {.sources = {}, .allow_msr = options.allow_msr}),
        structures_({config.structures, config.structure_cache,
                     [this](const std::string& why) { warn("cache", why); }}),
        pictures_(options.out / "images") {}

  StudyResult run() {
    create_run_dir(options_.out);
    try {
      load_scenes();
      open_device();
      match_sensors();
      start_recording();
    } catch (...) {
      if (!writer_) remove_empty_run_dir();
      throw;
    }
    try {
      run_trials();
    } catch (...) {
      finish_recording();
      throw;
    }
    finish_recording();
    if (const std::string why = writer_->failure(); !why.empty()) throw std::runtime_error(why);
    writer_->close();
    check_validation();
    return result_;
  }

 private:
  // ---------------------------------------------------------------- before the first trial

  /// Nothing was recorded: leave nothing behind.
  void remove_empty_run_dir() const {
    std::error_code ignored;  // not empty: it was there before and holds something else
    fs::remove(options_.out / "images", ignored);
    fs::remove(options_.out, ignored);
  }

  /// A model that cannot be had costs its trials, unless no model can be had.
  void load_scenes() {
    for (const std::string& model : config_.models) scenes_.push_back(load_or_explain(model));
    const auto failed = [](const Scene& scene) { return !scene.failure.empty(); };
    if (std::all_of(scenes_.begin(), scenes_.end(), failed))
      throw std::runtime_error(scenes_.front().failure);
    for (const Scene& scene : scenes_)
      if (failed(scene)) note(fmt::format("without {}: {}", scene.model, scene.failure));
  }

  Scene load_or_explain(const std::string& model) {
    Scene scene;
    try {
      scene = load_scene(model, [this](std::string_view text) { note(text); });
    } catch (const std::runtime_error& error) {
      scene.model = model;
      scene.failure = error.what();
    }
    // Two files of the same name in different folders are told apart by their paths.
    if (std::any_of(scenes_.begin(), scenes_.end(),
                    [&](const Scene& other) { return other.model == scene.model; }))
      scene.model = model;
    return scene;
  }

  void open_device() {
    device_.reset();  // the old one first: a lost device must be gone before its successor
    device_ = std::make_unique<kernels::Device>(
        kernels::DeviceRequest{options_.device, options_.validation});
    caches_ = choose_caches(config_.cache_model, device_->info(), read_host_caches());
  }

  /// The sensors of another machine's files belong to none of this machine's devices: all stay.
  void match_sensors() {
    if (options_.root != "/") return;
    const kernels::DeviceInfo& info = device_->info();
    probe::TracingDevice device{info.name, info.type == "cpu", info.pci_address, {}, info.uuid};
    for (const auto& node : {info.drm_primary, info.drm_render})
      if (node) device.drm_nodes.emplace_back(node->major, node->minor);
    sensors_.keep_gpu(device, probe::Root(options_.root), config_);
  }

  void start_recording() {
    RunWriter::Config writer_config;
    writer_config.pull_samples = [this](std::vector<Sample>& out) { sensors_.drain(out); };
    writer_ = std::make_unique<RunWriter>(options_.out / "run.sqlite", std::move(writer_config));
    int32_t last_id = 0;
    for (const Channel& channel : sensors_.channels()) {
      writer_->add_channel(channel);
      last_id = std::max(last_id, channel.id);
    }
    counter_channels_ = counter_channels(device_->info(), last_id + 1);
    for (const Channel& channel : counter_channels_) writer_->add_channel(channel);
    record_meta();
    sensors_.start();
    first_temperature_c_ = sensors_.hottest_c();
  }

  void record_meta() {
    const kernels::DeviceInfo& info = device_->info();
    nlohmann::json refusals = nlohmann::json::array();
    for (const kernels::DeviceRefusal& refusal : device_->refusals())
      refusals.push_back({{"name", refusal.name}, {"reason", refusal.reason}});
    const auto set = [this](const char* key, std::string value) {
      writer_->set_meta(key, std::move(value));
    };
    set("name", config_.name);
    set("config", config_.json.dump());
    set("host", describe_host().dump());
    set("device", to_json(info).dump());
    set("device_refusals", refusals.dump());
    set("driver", info.driver_name + " " + info.driver_info);
    set("code_version", ENERGYPROF_VERSION);
    set("build_type", ENERGYPROF_BUILD_TYPE);
    set("begin_ns", std::to_string(now_ns()));
    set("begin_utc", utc_now());
    set("interrupted", "0");
    set("simulated", options_.root == "/" ? "0" : "1");
    set("quick", options_.quick ? "1" : "0");
    set("quick_note", options_.quick_note);
    set("clock_method", info.clock_note);
    set("missing_sensors", sensors_.missing_json());
    set("verdict", sensors_.verdict());
  }

  // ---------------------------------------------------------------- trials

  void run_trials() {
    const std::vector<PlannedTrial> plan = plan_trials(
        {scenes_.size(), config_.views.size(), config_.algorithms.size(), config_.repetitions},
        config_.latin_square, config_.seed);
    frames_per_trial_ = config_.warmup_frames + config_.timed_frames + 1;
    Progress::Config progress_config;
    progress_config.quiet = options_.quiet;
    progress_config.total_frames = static_cast<int64_t>(plan.size()) * frames_per_trial_;
    progress_config.live_values = [this] { return sensors_.live_values(); };
    progress_ = std::make_unique<Progress>(std::move(progress_config));

    for (size_t i = 0; i < plan.size() && !InterruptGuard::requested(); ++i) {
      run_trial(plan[i], i, plan.size());
      const bool is_last = i + 1 == plan.size() || InterruptGuard::requested();
      if (is_last || plan[i + 1].model != plan[i].model || plan[i + 1].view != plan[i].view)
        finish_view(plan[i]);
    }
    self_check();
    if (idle_before_count_ > 0) idle(config_.idle.after_s);
    picture([this] { pictures_.finish(); });
    progress_.reset();
    result_.interrupted = InterruptGuard::requested();
  }

  /// The model's own views keep their numbers, those of the config are counted on from there.
  [[nodiscard]] int64_t view_number(size_t index) const {
    if (const int* own = std::get_if<int>(&config_.views[index])) return *own;
    int64_t number = 3;
    for (size_t i = 0; i < index; ++i)
      if (std::holds_alternative<ViewConfig>(config_.views[i])) ++number;
    return number;
  }

  void run_trial(const PlannedTrial& planned, size_t position, size_t trial_count) {
    const Scene& scene = scenes_[planned.model];
    Trial trial;
    trial.id = static_cast<int64_t>(position) + 1;
    trial.model = scene.model;
    trial.view = view_number(planned.view);
    trial.algorithm = config_.algorithms[planned.algorithm];
    trial.repetition = planned.repetition;
    trial.position = static_cast<int64_t>(position);
    trial.width = config_.width;
    trial.height = config_.height;

    progress_->begin_trial(fmt::format("[{}/{}] {} view {} {}", position + 1, trial_count,
                                       trial.model, trial.view, trial.algorithm));
    const int64_t frames_before = frames_done_;
    std::string outcome;
    try {
      prepare_and_trace(planned, trial, outcome);
    } catch (const kernels::DeviceLost& error) {
      fail(trial, error.what());
      replace_device(error.what());
    } catch (const kernels::OutOfMemory& error) {
      fail(trial, error.what());
      replace_device(error.what());
    } catch (const std::bad_alloc&) {
      fail(trial, "the host is out of memory");
    } catch (const RecordingFailed&) {
      throw;
    } catch (const std::runtime_error& error) {
      fail(trial, error.what());
    }
    if (trial.begin_ns == 0) trial.begin_ns = now_ns();
    if (!trial.end_ns) trial.end_ns = now_ns();
    writer_->put_trial(trial);
    for (Event& event : sensors_.drain_events()) writer_->add_event(std::move(event));

    ++result_.trial_count;
    if (!trial.skip_reason.empty()) {
      ++result_.skipped_count;
      if (result_.first_skip_reason.empty()) result_.first_skip_reason = trial.skip_reason;
      outcome = "skipped: " + trial.skip_reason;
    }
    progress_->end_trial(outcome, frames_per_trial_ - (frames_done_ - frames_before));
  }

  /// What goes wrong once a trial's frames are done costs an event, not the trial.
  void fail(Trial& trial, const std::string& why) {
    if (trial.end_ns)
      writer_->add_event(
          {now_ns(), std::nullopt, Severity::warning, "after-trial", std::nullopt, why});
    else
      trial.skip_reason = why;
  }

  /// One trial from its structure to its pictures; `outcome` is its result in words.
  void prepare_and_trace(const PlannedTrial& planned, Trial& trial, std::string& outcome) {
    const Scene& scene = scenes_[planned.model];
    if (!scene.failure.empty()) throw std::runtime_error(scene.failure);
    trial.triangle_count = static_cast<int64_t>(scene.mesh.triangles.size());
    const AlgorithmInfo& algorithm = *find_algorithm(trial.algorithm);
    const Structure& structure = structures_.get(scene, algorithm.kind);
    describe(structure, trial);
    cool_down();
    idle(idle_before_count_ == 0 ? config_.idle.before_s : config_.idle.between_s);
    ++idle_before_count_;
    trial.begin_ns = now_ns();
    writer_->put_trial(trial);

    const kernels::TraceSetup setup = make_setup(planned, structure, config_.width, config_.height);
    const std::vector<double> timed_ms = trace(setup, trial);
    if (InterruptGuard::requested()) {
      outcome = "interrupted";
      return;
    }
    const double median_ms = analysis::median(timed_ms);
    outcome = fmt::format("{} frames, median {:.2f} ms", timed_ms.size(), median_ms);
    if (!first_usable_ && trial.skip_reason.empty()) first_usable_ = {planned, median_ms};
    if (trial.repetition != 0) return;
    picture([&] { draw_heat_map(setup, trial); });
    model_caches(setup, trial);
  }

  [[nodiscard]] kernels::TraceSetup make_setup(const PlannedTrial& planned,
                                               const Structure& structure, uint32_t width,
                                               uint32_t height) const {
    const Scene& scene = scenes_[planned.model];
    return {.blob = structure.built.blob,
            .triangles = scene.triangles,
            .kernel = config_.algorithms[planned.algorithm],
            .constants = frame_constants(scene, resolve_view(scene, config_.views[planned.view]),
                                         width, height, config_.bounces, config_.seed),
            .config = {}};
  }

  /// The frames of a trial, and the view's reference image if there is none yet. The times of the
  /// timed frames.
  std::vector<double> trace(const kernels::TraceSetup& setup, Trial& trial) {
    kernels::TraceProgram program(*device_, setup);
    std::vector<double> timed_ms = run_frames(program, trial);
    trial.end_ns = now_ns();
    writer_->put_trial(trial);
    if (InterruptGuard::requested()) return timed_ms;
    if (trial.repetition == 0) verify(program.read_hits(), setup, trial);
    count_hardware(program);
    picture([&] {
      if (!pictures_.has_reference(trial.model, trial.view)) render_reference(program, trial);
    });
    return timed_ms;
  }

  /// Compares the counted frame with the CPU's: a driver may end loops early or miscompile a
  /// kernel, and nothing else would tell. A trial that fails keeps its data and is not used.
  void verify(const std::vector<gpu::PixelHits>& hits, const kernels::TraceSetup& setup,
              Trial& trial) {
    if (hits.size() > verified_pixel_limit) {
      writer_->add_event({now_ns(), std::nullopt, Severity::info, "verification", std::nullopt,
                          fmt::format("frames of {} pixels are not compared with the CPU's; up to "
                                      "{} are",
                                      hits.size(), verified_pixel_limit)});
      return;
    }
    gpu::FrameConstants constants = setup.constants;
    constants.frame = static_cast<uint32_t>(frames_per_trial_ - 1);
    const accel::CpuFrame expected =
        accel::trace_cpu(setup.kernel, {setup.blob, setup.triangles}, constants);
    size_t different = 0;
    for (size_t i = 0; i < hits.size(); ++i)
      if (hits[i].primary_id != expected.hits[i].primary_id ||
          hits[i].bounce_id != expected.hits[i].bounce_id)
        ++different;
    if (different <= 1 + hits.size() / 10'000) return;
    trial.skip_reason = fmt::format(
        "{} of {} pixels hit other triangles than the CPU finds with the same traversal; 1 in "
        "10,000 may. The driver '{}' cannot be trusted with this kernel",
        different, hits.size(), device_->info().name);
    writer_->put_trial(trial);
  }

  /// The counted frame once more, under the GPU's own counters: reserving them changes clocks or
  /// power, so that it is done when the trial is over.
  void count_hardware(kernels::TraceProgram& program) {
    if (counter_channels_.empty()) return;
    try {
      const auto counts = program.count_hardware(static_cast<uint32_t>(frames_per_trial_ - 1));
      if (!counts) return;
      writer_->add_samples(counter_samples(counter_channels_, *counts));
      writer_->add_event({counts->begin_ns, counts->end_ns, Severity::info, "performance-query",
                          std::nullopt, "the counted frame was traced under the GPU's counters"});
    } catch (const kernels::DeviceLost&) {
      throw;
    } catch (const kernels::OutOfMemory&) {
      throw;
    } catch (const std::runtime_error& error) {
      writer_->add_event({now_ns(), std::nullopt, Severity::warning, "performance-query",
                          std::nullopt, error.what()});
    }
  }

  static void describe(const Structure& structure, Trial& trial) {
    const BuildStats& stats = structure.built.stats;
    trial.build_ns = stats.build_ns;
    trial.build_config = structure.parameters;
    trial.build_cached = structure.cached;
    trial.blob_bytes = stats.blob_bytes;
    trial.node_count = stats.node_count;
    trial.leaf_count = stats.leaf_count;
    trial.ref_count = stats.ref_count;
    if (structure.built.blob.kind != AccelKind::grid) trial.max_depth = stats.max_depth;
    trial.sah_cost = stats.sah_cost;
  }

  /// Warm-up, timed and counted frames; the times of the timed ones, fewer after Ctrl-C.
  std::vector<double> run_frames(kernels::TraceProgram& program, const Trial& trial) {
    std::vector<double> timed_ms;
    int64_t next_frame_ns = now_ns();
    for (int64_t frame = 0; frame < frames_per_trial_; ++frame) {
      const Phase phase = frame < config_.warmup_frames   ? Phase::warmup
                          : frame < frames_per_trial_ - 1 ? Phase::timed
                                                          : Phase::counted;
      if (InterruptGuard::requested()) break;
      next_frame_ns = pace(next_frame_ns);
      FrameRecord record = program.run_frame(static_cast<uint32_t>(frame), phase);
      record.id = ++frame_id_;
      record.trial_id = trial.id;
      if (phase == Phase::timed)
        timed_ms.push_back(static_cast<double>(record.end_ns - record.begin_ns) * 1e-6);
      writer_->add_frame(std::move(record));
      ++frames_done_;
      progress_->frame_done();
      check_recording();
    }
    return timed_ms;
  }

  /// Waits for the next frame's turn; returns the turn after it.
  [[nodiscard]] int64_t pace(int64_t turn_ns) const {
    if (!config_.frames_per_second) return turn_ns;
    const int64_t now = now_ns();
    if (turn_ns > now) std::this_thread::sleep_for(std::chrono::nanoseconds(turn_ns - now));
    // After a late frame the rhythm starts anew: no burst to catch up.
    return std::max(turn_ns, now) +
           static_cast<int64_t>(static_cast<double>(ns_per_s) / *config_.frames_per_second);
  }

  // ---------------------------------------------------------------- beside the timed frames

  /// A picture that cannot be made costs an event.
  void picture(const std::function<void()>& make) {
    try {
      make();
    } catch (const kernels::DeviceLost&) {
      throw;
    } catch (const kernels::OutOfMemory&) {
      throw;
    } catch (const std::runtime_error& error) {
      writer_->add_event(
          {now_ns(), std::nullopt, Severity::warning, "image", std::nullopt, error.what()});
    }
  }

  /// What the primary rays of the counted frame cost: with the bounce rays the study's colour scale
  /// would not reach.
  void draw_heat_map(kernels::TraceSetup setup, const Trial& trial) {
    setup.constants.bounce_count = 0;
    kernels::TraceProgram program(*device_, setup);
    static_cast<void>(
        program.run_frame(static_cast<uint32_t>(frames_per_trial_ - 1), Phase::counted));
    pictures_.add_heat_map(trial.model, trial.view, trial.algorithm,
                           heat_map(program.read_counts(), config_.width, config_.height,
                                    heat_full_scale(trial.model)));
  }

  void render_reference(kernels::TraceProgram& program, const Trial& trial) {
    ReferenceImage reference(config_.width, config_.height);
    const int64_t begin_ns = now_ns();
    for (int i = 0; i < reference_frame_limit; ++i) {
      const auto frame = static_cast<uint32_t>(frames_per_trial_ + i);
      static_cast<void>(program.run_frame(frame, Phase::warmup));
      reference.add(program.read_hits());
      if (InterruptGuard::requested() || now_ns() - begin_ns > reference_time_limit_ns) break;
    }
    pictures_.add_reference(trial.model, trial.view, reference.image());
  }

  void finish_view(const PlannedTrial& planned) {
    picture(
        [&] { pictures_.finish_view(scenes_[planned.model].model, view_number(planned.view)); });
  }

  /// Cache misses of the frame that was counted.
  void model_caches(const kernels::TraceSetup& setup, Trial& trial) const {
    gpu::FrameConstants constants = setup.constants;
    constants.frame = static_cast<uint32_t>(frames_per_trial_ - 1);
    const accel::CacheModelResult result = accel::model_cache(
        trial.algorithm, accel::CpuScene{setup.blob, setup.triangles}, constants, caches_.model);
    trial.bytes_per_pixel = result.bytes_per_pixel;
    trial.l1_misses_per_ray = result.l1_misses_per_ray;
    trial.llc_misses_per_ray = result.llc_misses_per_ray;
    trial.footprint_bytes = result.footprint_bytes;
    trial.cache_model = app::describe(caches_, result).dump();
  }

  /// What sampling costs: the work of the first usable trial with the sampler on and off in turn.
  /// Where its frames are too long, in a smaller image.
  void self_check() {
    if (!config_.self_check || !first_usable_ || InterruptGuard::requested()) return;
    progress_->note("tracing with the sampler on and off, to see what it costs");
    const int64_t budget_ns = (options_.quick ? 3 : 8) * ns_per_s;
    const auto& [planned, frame_ms] = *first_usable_;
    const double factor = self_check_image_factor(std::llround(frame_ms * 1e6), budget_ns);
    const auto shrunk = [&](uint32_t pixels) {
      return std::max(1u, static_cast<uint32_t>(std::lround(pixels * factor)));
    };
    try {
      const AccelKind kind = find_algorithm(config_.algorithms[planned.algorithm])->kind;
      kernels::TraceProgram program(
          *device_, make_setup(planned, structures_.get(scenes_[planned.model], kind),
                               shrunk(config_.width), shrunk(config_.height)));
      run_self_check(program, sensors_, *writer_, budget_ns);
    } catch (const std::runtime_error& error) {
      writer_->add_event(
          {now_ns(), std::nullopt, Severity::warning, "self-check", std::nullopt, error.what()});
    }
    check_recording();
  }

  /// Leaves the machine alone for a while, so that the sensors show what idling takes. Nothing is
  /// read then that would wake a GPU.
  void idle(double seconds) {
    if (seconds <= 0.0 || InterruptGuard::requested()) return;
    const int64_t begin_ns = now_ns();
    const int64_t end_ns = begin_ns + static_cast<int64_t>(seconds * 1e9);
    sensors_.set_idle(true);
    while (!InterruptGuard::requested() && now_ns() < end_ns)
      std::this_thread::sleep_for(std::min<std::chrono::nanoseconds>(
          wait_step, std::chrono::nanoseconds(end_ns - now_ns())));
    sensors_.set_idle(false);
    writer_->add_event(
        {begin_ns, now_ns(), Severity::info, "idle", std::nullopt, "nothing was submitted"});
  }

  /// A warning for the record and, in one line, for stderr.
  void warn(const std::string& kind, const std::string& why) {
    writer_->add_event({now_ns(), std::nullopt, Severity::warning, kind, std::nullopt, why});
    progress_->note(why);
  }

  /// After a lost device or a failed allocation: the next trial starts on a new device.
  void replace_device(const std::string& why) {
    writer_->add_event({now_ns(), std::nullopt, Severity::error, "device", std::nullopt, why});
    collect_validation();
    open_device();
  }

  /// Waits until the hottest sensor is back in the band of the run's beginning.
  void cool_down() {
    if (!first_temperature_c_ || config_.cooldown_max_s <= 0.0) return;
    const int64_t begin_ns = now_ns();
    const auto limit_ns = static_cast<int64_t>(config_.cooldown_max_s * 1e9);
    const double target_c = *first_temperature_c_ + cooldown_band_c;
    bool waited = false;
    while (!InterruptGuard::requested() && now_ns() - begin_ns < limit_ns) {
      const std::optional<double> hottest_c = sensors_.hottest_c();
      if (!hottest_c || *hottest_c <= target_c) break;
      waited = true;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    if (waited)
      writer_->add_event({begin_ns, now_ns(), Severity::info, "cooldown", std::nullopt,
                          fmt::format("waited for {:.1f} C or less", target_c)});
  }

  // ---------------------------------------------------------------- the end

  struct RecordingFailed : std::runtime_error {
    using std::runtime_error::runtime_error;
  };

  void check_recording() const {
    if (const std::string why = writer_->failure(); !why.empty()) throw RecordingFailed(why);
  }

  /// Ends the sampler and says so in the record. Safe after any failure.
  void finish_recording() {
    progress_.reset();
    sensors_.stop();
    for (Event& event : sensors_.drain_events()) writer_->add_event(std::move(event));
    for (const auto& [key, value] : sensors_.cost_meta()) writer_->set_meta(key, value);
    writer_->set_meta("interrupted", InterruptGuard::requested() ? "1" : "0");
    writer_->set_meta("end_ns", std::to_string(now_ns()));
    writer_->flush();
  }

  void collect_validation() {
    for (std::string& message : device_->validation_messages())
      validation_messages_.push_back(std::move(message));
  }

  void check_validation() {
    collect_validation();
    if (!validation_messages_.empty())
      throw std::runtime_error(fmt::format("Vulkan validation has {} complaints; the first: {}",
                                           validation_messages_.size(),
                                           validation_messages_.front()));
  }

  void note(std::string_view text) const {
    if (!options_.quiet) fmt::print(stderr, "{}\n", text);
  }

  const Config& config_;
  const StudyOptions& options_;
  Sensors sensors_;  // first: its counters must exist before the device's threads do
  std::vector<Scene> scenes_;
  std::unique_ptr<kernels::Device> device_;
  std::unique_ptr<RunWriter> writer_;
  std::unique_ptr<Progress> progress_;
  StructureStore structures_;
  CacheChoice caches_;
  std::vector<Channel> counter_channels_;  ///< of the GPU's own counters
  Pictures pictures_;
  std::vector<std::string> validation_messages_;
  std::optional<double> first_temperature_c_;
  StudyResult result_;
  /// The first trial that went well, and the median of its frames in milliseconds.
  std::optional<std::pair<PlannedTrial, double>> first_usable_;
  int64_t frames_per_trial_ = 0;
  int64_t frames_done_ = 0;
  int64_t frame_id_ = 0;
  int64_t idle_before_count_ = 0;
};

}  // namespace

void create_run_dir(const fs::path& dir) {
  std::error_code failed;
  fs::create_directories(dir / "images", failed);
  if (failed)
    throw std::runtime_error(
        fmt::format("cannot create run directory '{}': {}. Give another with --out.", dir.string(),
                    failed.message()));
  for (const char* name :
       {"run.sqlite", "timeline.json", "report.json", "report.md", "report.html"})
    if (fs::exists(dir / name))
      throw std::runtime_error(
          fmt::format("cannot record to '{}': it already holds '{}', and a run is never "
                      "overwritten. Give another directory with --out.",
                      dir.string(), name));
}

StudyResult record_study(const Config& config, const StudyOptions& options) {
  return Study(config, options).run();
}

}  // namespace energyprof::app
