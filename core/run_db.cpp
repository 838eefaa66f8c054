#include "core/run_db.h"

#include <fmt/format.h>
#include <fmt/std.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <condition_variable>
#include <map>
#include <mutex>
#include <numeric>
#include <set>
#include <stdexcept>
#include <thread>

#include "core/sqlite.h"

namespace energyprof {
namespace {

using sqlite::Database;
using sqlite::Statement;

constexpr const char* create_tables = R"sql(
CREATE TABLE meta(key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE channels(id INTEGER PRIMARY KEY, name TEXT UNIQUE, source TEXT, quantity TEXT,
    unit TEXT, kind TEXT, wrap_at INTEGER, period_ns INTEGER, read_cost_ns INTEGER, origin TEXT);
CREATE TABLE samples(channel_id INTEGER, t_ns INTEGER, value NUMERIC);
CREATE TABLE trials(id INTEGER PRIMARY KEY, model TEXT, view INTEGER, algorithm TEXT,
    repetition INTEGER, position INTEGER, begin_ns INTEGER, end_ns INTEGER, skip_reason TEXT,
    build_ns INTEGER, blob_bytes INTEGER, triangle_count INTEGER, node_count INTEGER,
    leaf_count INTEGER, max_depth INTEGER, sah_cost REAL, width INTEGER, height INTEGER,
    ref_count INTEGER, build_config TEXT, build_cached INTEGER, bytes_per_pixel_modelled REAL,
    l1_misses_per_ray_modelled REAL, llc_misses_per_ray_modelled REAL,
    footprint_bytes_modelled INTEGER, cache_model TEXT);
CREATE TABLE frames(id INTEGER PRIMARY KEY, trial_id INTEGER, frame INTEGER, phase TEXT,
    submit_ns INTEGER, begin_ns INTEGER, end_ns INTEGER, clock_error_ns INTEGER,
    ray_count INTEGER, hit_count INTEGER, hit_checksum TEXT, node_visit_count INTEGER,
    prim_test_count INTEGER, box_test_count INTEGER, dispatch_count INTEGER,
    loop_step_count INTEGER, simd_efficiency REAL);
CREATE TABLE events(t_ns INTEGER, end_ns INTEGER, severity TEXT, kind TEXT, channel_id INTEGER,
    text TEXT);
CREATE TABLE channel_traits(channel_id INTEGER PRIMARY KEY, limit_value INTEGER,
    read_cost_p99_ns INTEGER, update_period_ns INTEGER, quantum INTEGER, wakes_device INTEGER,
    gpu TEXT, stands_still INTEGER);
CREATE TABLE read_widths(channel_id INTEGER, t_ns INTEGER, width_ns INTEGER);
CREATE TABLE self_check_frames(block INTEGER, sampler_on INTEGER, begin_ns INTEGER,
    end_ns INTEGER);
)sql";

/// What waits for the next transaction.
struct Batch {
  std::vector<std::pair<std::string, std::string>> meta;
  std::vector<Channel> channels;
  std::vector<Sample> samples;
  std::vector<Trial> trials;
  std::vector<FrameRecord> frames;
  std::vector<SelfCheckFrame> self_check;
  std::vector<Event> events;

  [[nodiscard]] bool empty() const {
    return meta.empty() && channels.empty() && samples.empty() && trials.empty() &&
           frames.empty() && self_check.empty() && events.empty();
  }
};

/// "?,?,...": `count` of them.
std::string parameters(size_t count) {
  std::string list = "?";
  for (size_t i = 1; i < count; ++i) list += ",?";
  return list;
}

/// The statements that write a batch; prepared once.
class Inserter {
 public:
  explicit Inserter(Database& db)
      : db_(db),
        meta_(db, "INSERT OR REPLACE INTO meta VALUES(?,?)"),
        channel_(db, "INSERT OR REPLACE INTO channels VALUES(" + parameters(10) + ")"),
        traits_(db, "INSERT OR REPLACE INTO channel_traits VALUES(" + parameters(8) + ")"),
        sample_(db, "INSERT INTO samples VALUES(?,?,?)"),
        width_(db, "INSERT INTO read_widths VALUES(?,?,?)"),
        trial_(db, "INSERT OR REPLACE INTO trials VALUES(" + parameters(26) + ")"),
        frame_(db, "INSERT INTO frames VALUES(" + parameters(17) + ")"),
        self_check_(db, "INSERT INTO self_check_frames VALUES(?,?,?,?)"),
        event_(db, "INSERT INTO events VALUES(?,?,?,?,?,?)") {}

  /// All of `batch` in one transaction, or nothing of it.
  void commit(const Batch& batch) {
    if (batch.empty()) return;
    db_.execute("BEGIN");
    try {
      for (const auto& [key, value] : batch.meta) meta_.bind(key).bind(value).run();
      for (const Channel& channel : batch.channels) insert(channel);
      for (const Sample& sample : batch.samples) insert(sample);
      for (const Trial& trial : batch.trials) insert(trial);
      for (const FrameRecord& frame : batch.frames) insert(frame);
      for (const SelfCheckFrame& frame : batch.self_check) insert(frame);
      for (const Event& event : batch.events) insert(event);
      db_.execute("COMMIT");
    } catch (...) {
      // SQLite has already rolled back after some errors (a full disk); then this does nothing.
      sqlite3_exec(db_.handle(), "ROLLBACK", nullptr, nullptr, nullptr);
      throw;
    }
  }

 private:
  void insert(const Channel& channel) {
    channel_.bind(int64_t{channel.id})
        .bind(channel.name)
        .bind(channel.source)
        .bind(to_string(channel.quantity))
        .bind(unit_info(channel.unit).name)
        .bind(to_string(channel.kind))
        .bind(channel.wrap_at)
        .bind(channel.period_ns)
        .bind(channel.read_cost_ns)
        .bind_text_or_null(channel.origin)
        .run();
    traits_.bind(int64_t{channel.id})
        .bind(channel.limit)
        .bind(channel.read_cost_p99_ns)
        .bind(channel.update_period_ns)
        .bind(channel.quantum)
        .bind(int64_t{channel.wakes_device})
        .bind_text_or_null(channel.gpu)
        .bind(int64_t{channel.stands_still})
        .run();
  }

  void insert(const Sample& sample) {
    sample_.bind(int64_t{sample.channel_id}).bind(sample.t_ns).bind(sample.value).run();
    if (sample.width_ns == 0) return;
    width_.bind(int64_t{sample.channel_id}).bind(sample.t_ns).bind(int64_t{sample.width_ns}).run();
  }

  void insert(const Trial& trial) {
    trial_.bind(trial.id)
        .bind(trial.model)
        .bind(trial.view)
        .bind(trial.algorithm)
        .bind(trial.repetition)
        .bind(trial.position)
        .bind(trial.begin_ns)
        .bind(trial.end_ns)
        .bind_text_or_null(trial.skip_reason)
        .bind(trial.build_ns)
        .bind(trial.blob_bytes)
        .bind(trial.triangle_count)
        .bind(trial.node_count)
        .bind(trial.leaf_count)
        .bind(trial.max_depth)
        .bind(trial.sah_cost)
        .bind(trial.width)
        .bind(trial.height)
        .bind(trial.ref_count)
        .bind_text_or_null(trial.build_config)
        .bind(trial.build_cached ? std::optional<int64_t>(*trial.build_cached) : std::nullopt)
        .bind(trial.bytes_per_pixel)
        .bind(trial.l1_misses_per_ray)
        .bind(trial.llc_misses_per_ray)
        .bind(trial.footprint_bytes)
        .bind_text_or_null(trial.cache_model)
        .run();
  }

  void insert(const FrameRecord& frame) {
    frame_.bind(frame.id)
        .bind(frame.trial_id)
        .bind(frame.frame)
        .bind(to_string(frame.phase))
        .bind(frame.submit_ns)
        .bind(frame.begin_ns)
        .bind(frame.end_ns)
        .bind(frame.clock_error_ns)
        .bind(frame.ray_count)
        .bind(frame.hit_count)
        .bind_text_or_null(frame.hit_checksum)
        .bind(frame.node_visit_count)
        .bind(frame.prim_test_count)
        .bind(frame.box_test_count)
        .bind(frame.dispatch_count)
        .bind(frame.loop_step_count)
        .bind(frame.simd_efficiency)
        .run();
  }

  void insert(const SelfCheckFrame& frame) {
    self_check_.bind(frame.block)
        .bind(int64_t{frame.sampler_on})
        .bind(frame.begin_ns)
        .bind(frame.end_ns)
        .run();
  }

  void insert(const Event& event) {
    event_.bind(event.t_ns)
        .bind(event.end_ns)
        .bind(to_string(event.severity))
        .bind(event.kind)
        .bind(event.channel_id ? std::optional<int64_t>(*event.channel_id) : std::nullopt)
        .bind(event.text)
        .run();
  }

  Database& db_;
  Statement meta_, channel_, traits_, sample_, width_, trial_, frame_, self_check_, event_;
};

}  // namespace

// ---------------------------------------------------------------------------- recording

struct RunWriter::Impl {
  Impl(std::filesystem::path path, Config writer_config)
      : file(std::move(path)),
        config(std::move(writer_config)),
        db(open_new(file)),
        inserter(prepare(db, config)) {
    thread = std::thread([this] { write_until_closed(); });
  }

  /// The empty run under its final name: made beside it and renamed, so that a run that exists has
  /// all its tables, whenever the process is killed.
  static Database open_new(const std::filesystem::path& file) {
    if (std::filesystem::exists(file))
      throw std::runtime_error(
          fmt::format("cannot record to '{}': it exists already and a run is never overwritten.",
                      file.string()));
    const std::filesystem::path unfinished = file.string() + ".part";
    try {
      std::filesystem::remove(unfinished);
      Database empty(unfinished, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE);
      empty.execute(fmt::format("PRAGMA application_id={}; PRAGMA user_version={}",
                                run_application_id, schema_version));
      empty.execute(fmt::format("BEGIN; {} COMMIT", create_tables));
      std::filesystem::rename(unfinished, file);
    } catch (const std::runtime_error& error) {
      std::error_code ignored;
      std::filesystem::remove(unfinished, ignored);
      throw std::runtime_error(fmt::format("cannot create '{}': {}.", file.string(), error.what()));
    }
    return {file, SQLITE_OPEN_READWRITE | SQLITE_OPEN_NOMUTEX};
  }

  Inserter prepare(Database& database, const Config& writer_config) const {
    try {
      database.execute("PRAGMA journal_mode=WAL");
      database.execute("PRAGMA synchronous=NORMAL");
      if (writer_config.max_page_count > 0)
        database.execute(fmt::format("PRAGMA max_page_count={}", writer_config.max_page_count));
      return Inserter(database);
    } catch (const std::runtime_error& error) {
      throw std::runtime_error(fmt::format("cannot create '{}': {}.", file.string(), error.what()));
    }
  }

  template <class Append>
  void append(Append&& add) {
    const std::lock_guard lock(mutex);
    if (failure.empty()) add(pending);
  }

  void write_until_closed() {
    const auto period = std::chrono::nanoseconds(config.commit_period_ns);
    std::unique_lock lock(mutex);
    for (;;) {
      wake.wait_for(lock, period, [this] { return closing || flush_wanted > flush_done; });
      const bool last = closing;
      const int64_t flush_target = flush_wanted;
      Batch batch;
      std::swap(batch, pending);
      const bool failed_before = !failure.empty();
      lock.unlock();

      std::string why;
      if (!failed_before) why = commit(batch);

      lock.lock();
      if (!why.empty()) failure = std::move(why);
      flush_done = flush_target;
      flushed.notify_all();
      if (last && pending.empty()) return;
    }
  }

  /// Empty, or why the batch could not be written.
  std::string commit(Batch& batch) {
    try {
      if (config.pull_samples) config.pull_samples(batch.samples);
      inserter.commit(batch);
      return {};
    } catch (const std::exception& error) {
      return fmt::format("cannot record to '{}': {}. What was recorded until then is readable.",
                         file.string(), error.what());
    }
  }

  void stop() {
    {
      const std::lock_guard lock(mutex);
      closing = true;
    }
    wake.notify_all();
    if (thread.joinable()) thread.join();
  }

  std::filesystem::path file;
  Config config;
  Database db;
  Inserter inserter;

  mutable std::mutex mutex;
  std::condition_variable wake;     // there is something to write, or the end
  std::condition_variable flushed;  // flush_done has advanced
  Batch pending;
  std::string failure;
  int64_t flush_wanted = 0;
  int64_t flush_done = 0;
  bool closing = false;
  std::thread thread;
};

RunWriter::RunWriter(const std::filesystem::path& file, Config config)
    : impl_(std::make_unique<Impl>(file, std::move(config))) {
  set_meta("schema_version", std::to_string(schema_version));
}

RunWriter::~RunWriter() {
  if (impl_) impl_->stop();
}

void RunWriter::set_meta(std::string key, std::string value) {
  impl_->append([&](Batch& b) { b.meta.emplace_back(std::move(key), std::move(value)); });
}

void RunWriter::add_channel(Channel channel) {
  impl_->append([&](Batch& b) { b.channels.push_back(std::move(channel)); });
}

void RunWriter::add_samples(std::span<const Sample> samples) {
  impl_->append(
      [&](Batch& b) { b.samples.insert(b.samples.end(), samples.begin(), samples.end()); });
}

void RunWriter::put_trial(Trial trial) {
  impl_->append([&](Batch& b) { b.trials.push_back(std::move(trial)); });
}

void RunWriter::add_frame(FrameRecord frame) {
  impl_->append([&](Batch& b) { b.frames.push_back(std::move(frame)); });
}

void RunWriter::add_self_check_frame(const SelfCheckFrame& frame) {
  impl_->append([&](Batch& b) { b.self_check.push_back(frame); });
}

void RunWriter::add_event(Event event) {
  impl_->append([&](Batch& b) { b.events.push_back(std::move(event)); });
}

void RunWriter::flush() {
  std::unique_lock lock(impl_->mutex);
  const int64_t target = ++impl_->flush_wanted;
  impl_->wake.notify_all();
  impl_->flushed.wait(lock, [&] { return impl_->flush_done >= target; });
}

std::string RunWriter::failure() const {
  const std::lock_guard lock(impl_->mutex);
  return impl_->failure;
}

void RunWriter::close() {
  impl_->stop();
  const std::unique_ptr<Impl> impl = std::move(impl_);
  if (!impl->failure.empty()) throw std::runtime_error(impl->failure);
  try {
    impl->db.execute("PRAGMA journal_mode=DELETE");
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(fmt::format("cannot finish '{}': {}. What was recorded is readable.",
                                         impl->file.string(), error.what()));
  }
}

// ---------------------------------------------------------------------------- reading back

namespace {

/// The columns a table has; empty if there is no such table.
std::set<std::string> columns_of(Database& db, const std::string& table) {
  std::set<std::string> columns;
  Statement statement(db, "SELECT name FROM pragma_table_info('" + table + "')");
  while (statement.next()) columns.insert(statement.text(0));
  return columns;
}

/// SELECT of `required` columns and of those of `optional` that the table has; the others as NULL.
std::string select(Database& db, const std::string& table, const std::vector<std::string>& required,
                   const std::vector<std::string>& optional, const std::string& order_by) {
  const std::set<std::string> present = columns_of(db, table);
  if (present.empty()) throw std::runtime_error(fmt::format("table '{}' is missing", table));
  std::string list;
  for (const std::string& column : required) {
    if (!present.contains(column))
      throw std::runtime_error(fmt::format("table '{}' has no column '{}'", table, column));
    list += (list.empty() ? "" : ",") + column;
  }
  for (const std::string& column : optional)
    list += present.contains(column) ? "," + column : ",NULL";
  return fmt::format("SELECT {} FROM {}{}{}", list, table, order_by.empty() ? "" : " ORDER BY ",
                     order_by);
}

std::optional<double> optional_real(const Statement& s, int column) {
  if (s.is_null(column)) return std::nullopt;
  return s.real(column);
}

template <class T>
T parse_name(std::optional<T> parsed, std::string_view column, const std::string& text) {
  if (!parsed) throw std::runtime_error(fmt::format("{} '{}' is not known", column, text));
  return *parsed;
}

Phase parse_phase(const std::string& text) {
  for (const Phase phase : {Phase::warmup, Phase::timed, Phase::counted})
    if (text == to_string(phase)) return phase;
  throw std::runtime_error(
      fmt::format("frames.phase '{}' is not known; expected warmup, timed or counted", text));
}

/// The contract names no severities: other tools call them as syslog(3) does, or otherwise.
Severity parse_severity(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  for (const std::string_view word : {"err", "crit", "fatal", "alert", "emerg", "panic"})
    if (text.starts_with(word)) return Severity::error;
  return text.starts_with("warn") ? Severity::warning : Severity::info;
}

void read_meta(Database& db, RunRecord& run) {
  Statement s(db, select(db, "meta", {"key", "value"}, {}, "key"));
  while (s.next()) run.meta[s.text(0)] = s.text(1);
  const auto version = run.meta.find("schema_version");
  if (version == run.meta.end()) return;
  int found = 0;
  try {
    found = std::stoi(version->second);
  } catch (const std::exception&) {
    throw std::runtime_error(
        fmt::format("meta schema_version is '{}'; expected a number", version->second));
  }
  if (found > schema_version)
    throw std::runtime_error(fmt::format("its schema_version is {}, this program reads up to {}",
                                         found, schema_version));
}

void read_channels(Database& db, RunRecord& run) {
  Statement s(db, select(db, "channels",
                         {"id", "name", "source", "quantity", "unit", "kind", "wrap_at",
                          "period_ns", "read_cost_ns", "origin"},
                         {}, "id"));
  while (s.next()) {
    Channel c;
    c.id = static_cast<int32_t>(s.integer(0));
    c.name = s.text(1);
    c.source = s.text(2);
    c.quantity = parse_name(parse_quantity(s.text(3)), "channels.quantity", s.text(3));
    c.unit_text = s.text(4);
    c.unit = parse_unit(c.unit_text).value_or(Unit::none);
    c.kind = parse_name(parse_kind(s.text(5)), "channels.kind", s.text(5));
    c.wrap_at = s.optional_integer(6);
    c.period_ns = s.optional_integer(7).value_or(0);
    c.read_cost_ns = s.optional_integer(8);
    c.origin = s.text(9);
    run.channels.push_back(std::move(c));
  }
}

/// Whether a table that other tools and older versions do not write is there with these columns.
bool has_table(Database& db, const std::string& table, const std::set<std::string>& columns) {
  const std::set<std::string> present = columns_of(db, table);
  return std::includes(present.begin(), present.end(), columns.begin(), columns.end());
}

void read_channel_traits(Database& db, RunRecord& run) {
  if (!has_table(db, "channel_traits", {"channel_id"})) return;
  std::map<int64_t, Channel*> channels;
  for (Channel& channel : run.channels) channels.emplace(channel.id, &channel);
  Statement s(db, select(db, "channel_traits", {"channel_id"},
                         {"limit_value", "read_cost_p99_ns", "update_period_ns", "quantum",
                          "wakes_device", "gpu", "stands_still"},
                         "channel_id"));
  while (s.next()) {
    const auto channel = channels.find(s.integer(0));
    if (channel == channels.end()) continue;
    Channel& c = *channel->second;
    c.limit = s.optional_integer(1);
    c.read_cost_p99_ns = s.optional_integer(2);
    c.update_period_ns = s.optional_integer(3);
    c.quantum = s.optional_integer(4);
    c.wakes_device = s.optional_integer(5).value_or(0) != 0;
    c.gpu = s.text(6);
    c.stands_still = s.optional_integer(7).value_or(0) != 0;
  }
}

/// `series` by time; samples of the same time stay in the order in which they were stored.
void sort_by_time(SampleSeries& series) {
  if (std::is_sorted(series.t_ns.begin(), series.t_ns.end())) return;
  std::vector<std::size_t> order(series.t_ns.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return series.t_ns[a] < series.t_ns[b]; });
  SampleSeries sorted;
  for (const std::size_t i : order) {
    sorted.t_ns.push_back(series.t_ns[i]);
    sorted.value.push_back(series.value[i]);
  }
  series = std::move(sorted);
}

/// In the order of the file, which is nearly that of time: SQLite takes longer to sort all samples
/// than to read them.
void read_samples(Database& db, RunRecord& run) {
  Statement s(db, select(db, "samples", {"channel_id", "t_ns", "value"}, {}, ""));
  int64_t channel_id = 0;
  SampleSeries* series = nullptr;
  struct Infinite {
    int64_t first_ns = 0;
    std::size_t count = 0;
  };
  std::map<int32_t, Infinite> infinite;
  while (s.next()) {
    if (s.is_null(2)) continue;
    const int64_t id = s.integer(0);
    if (series == nullptr || id != channel_id) series = &run.series[static_cast<int32_t>(id)];
    channel_id = id;
    const double value = s.real(2);
    if (!std::isfinite(value)) {
      Infinite& channel =
          infinite.try_emplace(static_cast<int32_t>(id), s.integer(1)).first->second;
      ++channel.count;
      continue;
    }
    series->t_ns.push_back(s.integer(1));
    series->value.push_back(value);
  }
  for (const auto& [id, channel] : infinite) {
    Event event;
    event.t_ns = channel.first_ns;
    event.severity = Severity::warning;
    event.kind = "sensor-bad-value";
    event.channel_id = id;
    event.text = fmt::format("{} of its samples are infinite and were left out", channel.count);
    run.events.push_back(std::move(event));
  }
  for (auto& [id, each] : run.series) sort_by_time(each);
}

void read_wide_reads(Database& db, RunRecord& run) {
  const std::vector<std::string> columns{"channel_id", "t_ns", "width_ns"};
  if (!has_table(db, "read_widths", {columns.begin(), columns.end()})) return;
  Statement s(db, select(db, "read_widths", columns, {}, "channel_id, t_ns"));
  while (s.next())
    run.wide_reads[static_cast<int32_t>(s.integer(0))].push_back({s.integer(1), s.integer(2)});
}

/// Gives the places of trials whose begin is not known: of those that were skipped, say.
std::vector<std::size_t> read_trials(Database& db, RunRecord& run) {
  std::vector<std::size_t> undated;
  Statement s(db, select(db, "trials",
                         {"id", "model", "view", "algorithm", "repetition", "position", "begin_ns",
                          "end_ns", "skip_reason", "build_ns", "blob_bytes"},
                         {"triangle_count", "node_count", "leaf_count", "max_depth", "sah_cost",
                          "width", "height", "ref_count", "build_config", "build_cached",
                          "bytes_per_pixel_modelled", "l1_misses_per_ray_modelled",
                          "llc_misses_per_ray_modelled", "footprint_bytes_modelled", "cache_model"},
                         "begin_ns, id"));
  while (s.next()) {
    Trial t;
    t.id = s.integer(0);
    t.model = s.text(1);
    t.view = s.optional_integer(2).value_or(0);
    t.algorithm = s.text(3);
    t.repetition = s.optional_integer(4).value_or(0);
    t.position = s.optional_integer(5).value_or(0);
    t.end_ns = s.optional_integer(7);
    if (s.is_null(6)) undated.push_back(run.trials.size());
    t.begin_ns = s.optional_integer(6).value_or(0);
    t.skip_reason = s.text(8);
    t.build_ns = s.optional_integer(9);
    t.blob_bytes = s.optional_integer(10);
    t.triangle_count = s.optional_integer(11);
    t.node_count = s.optional_integer(12);
    t.leaf_count = s.optional_integer(13);
    t.max_depth = s.optional_integer(14);
    t.sah_cost = optional_real(s, 15);
    t.width = s.optional_integer(16);
    t.height = s.optional_integer(17);
    t.ref_count = s.optional_integer(18);
    t.build_config = s.text(19);
    if (const auto cached = s.optional_integer(20)) t.build_cached = *cached != 0;
    t.bytes_per_pixel = optional_real(s, 21);
    t.l1_misses_per_ray = optional_real(s, 22);
    t.llc_misses_per_ray = optional_real(s, 23);
    t.footprint_bytes = s.optional_integer(24);
    t.cache_model = s.text(25);
    run.trials.push_back(std::move(t));
  }
  return undated;
}

/// A trial whose begin is not known began with its first frame; without frames, at its end, or,
/// where that is unknown too, behind everything that was recorded.
void date_trials(RunRecord& run, const std::vector<std::size_t>& undated) {
  if (undated.empty()) return;
  std::map<int64_t, int64_t> first_ns;
  int64_t last_ns = 0;
  for (const auto& [id, series] : run.series)
    if (!series.t_ns.empty()) last_ns = std::max(last_ns, series.t_ns.back());
  for (const FrameRecord& frame : run.frames) {
    const auto first = first_ns.try_emplace(frame.trial_id, frame.begin_ns).first;
    first->second = std::min(first->second, frame.begin_ns);
    last_ns = std::max(last_ns, frame.end_ns);
  }
  for (const std::size_t i : undated) {
    Trial& trial = run.trials[i];
    const auto first = first_ns.find(trial.id);
    trial.begin_ns = first != first_ns.end() ? first->second : trial.end_ns.value_or(last_ns);
  }
}

void read_frames(Database& db, RunRecord& run) {
  std::size_t undated_count = 0;
  std::optional<int64_t> undated_ns;
  Statement s(db, select(db, "frames",
                         {"id", "trial_id", "frame", "phase", "submit_ns", "begin_ns", "end_ns",
                          "clock_error_ns", "ray_count", "hit_count", "hit_checksum",
                          "node_visit_count", "prim_test_count"},
                         {"box_test_count", "dispatch_count", "loop_step_count", "simd_efficiency"},
                         "begin_ns, id"));
  while (s.next()) {
    if (s.is_null(5) || s.is_null(6)) {
      ++undated_count;
      for (const int column : {4, 5, 6})
        if (!undated_ns) undated_ns = s.optional_integer(column);
      continue;
    }
    FrameRecord f;
    f.id = s.integer(0);
    f.trial_id = s.integer(1);
    f.frame = s.integer(2);
    f.phase = parse_phase(s.text(3));
    f.begin_ns = s.integer(5);
    f.end_ns = s.integer(6);
    f.submit_ns = s.optional_integer(4).value_or(f.begin_ns);
    f.clock_error_ns = s.optional_integer(7);
    f.ray_count = s.optional_integer(8);
    f.hit_count = s.optional_integer(9);
    f.hit_checksum = s.text(10);
    f.node_visit_count = s.optional_integer(11);
    f.prim_test_count = s.optional_integer(12);
    f.box_test_count = s.optional_integer(13);
    f.dispatch_count = s.optional_integer(14);
    f.loop_step_count = s.optional_integer(15);
    f.simd_efficiency = optional_real(s, 16);
    run.frames.push_back(std::move(f));
  }
  if (undated_count == 0) return;
  Event event;
  event.t_ns = undated_ns.value_or(run.frames.empty() ? 0 : run.frames.back().end_ns);
  event.severity = Severity::warning;
  event.kind = "frame-undated";
  event.text =
      fmt::format("frames without a begin or an end, which were left out: {}", undated_count);
  run.events.push_back(std::move(event));
}

void read_self_check(Database& db, RunRecord& run) {
  const std::vector<std::string> columns{"block", "sampler_on", "begin_ns", "end_ns"};
  if (!has_table(db, "self_check_frames", {columns.begin(), columns.end()})) return;
  Statement s(db, select(db, "self_check_frames", columns, {}, "begin_ns"));
  while (s.next())
    run.self_check.push_back({s.integer(0), s.integer(1) != 0, s.integer(2), s.integer(3)});
}

void read_events(Database& db, RunRecord& run) {
  Statement s(db, select(db, "events", {"t_ns", "end_ns", "severity", "kind", "channel_id", "text"},
                         {}, "t_ns"));
  while (s.next()) {
    Event e;
    e.t_ns = s.integer(0);
    e.end_ns = s.optional_integer(1);
    e.severity = parse_severity(s.text(2));
    e.kind = s.text(3);
    if (!s.is_null(4)) e.channel_id = static_cast<int32_t>(s.integer(4));
    e.text = s.text(5);
    run.events.push_back(std::move(e));
  }
}

}  // namespace

std::filesystem::path run_file(const std::filesystem::path& run) {
  return std::filesystem::is_directory(run) ? run / "run.sqlite" : run;
}

RunRecord read_run(const std::filesystem::path& run) {
  const std::filesystem::path file = run_file(run);
  if (!std::filesystem::exists(file))
    throw std::runtime_error(
        fmt::format("cannot read run '{}': there is no such file. Give a run directory or the "
                    "run.sqlite inside it.",
                    file.string()));
  try {
    Database db(file, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX);
    db.execute("BEGIN");  // one consistent view, also of a run that is still being recorded
    RunRecord record;
    read_meta(db, record);
    read_channels(db, record);
    read_channel_traits(db, record);
    read_samples(db, record);
    read_wide_reads(db, record);
    const std::vector<std::size_t> undated = read_trials(db, record);
    read_frames(db, record);
    date_trials(record, undated);
    read_self_check(db, record);
    read_events(db, record);
    return record;
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(fmt::format("cannot read run '{}': {}.", file.string(), error.what()));
  }
}

}  // namespace energyprof
