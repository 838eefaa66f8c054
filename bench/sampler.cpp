// What one sensor file costs, and what a tick over 40 of them costs. One core:
//
//   taskset -c 0 sampler_bench --benchmark_repetitions=9
//   --benchmark_enable_random_interleaving=true
#include <benchmark/benchmark.h>
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <string>

#include "probe/file_source.h"

namespace fs = std::filesystem;
namespace probe = energyprof::probe;

namespace {

constexpr int file_count = 40;

/// A folder on tmpfs with `file_count` files of one integer each; removed again.
class Files {
 public:
  Files() {
    std::string name = "/dev/shm/energyprof-bench-XXXXXX";
    directory_ = mkdtemp(name.data());
    for (int i = 0; i < file_count; ++i) std::ofstream(path(i)) << 26'963'529'117 + i << '\n';
  }
  ~Files() { fs::remove_all(directory_); }
  Files(const Files&) = delete;
  Files& operator=(const Files&) = delete;
  [[nodiscard]] std::string path(int i) const {
    return directory_ + "/channel" + std::to_string(i);
  }

 private:
  std::string directory_;
};

const Files& files() {
  static const Files all;
  return all;
}

/// pread() of a file kept open: the least that any reader of files can take.
void pread_alone(benchmark::State& state) {
  const int fd = open(files().path(0).c_str(), O_RDONLY | O_CLOEXEC);
  std::array<char, 64> buffer;
  for (auto _ : state) benchmark::DoNotOptimize(pread(fd, buffer.data(), buffer.size(), 0));
  close(fd);
}

/// How many peers read: open, read, close.
void open_read_close(benchmark::State& state) {
  std::array<char, 64> buffer;
  for (auto _ : state) {
    const int fd = open(files().path(0).c_str(), O_RDONLY | O_CLOEXEC);
    benchmark::DoNotOptimize(read(fd, buffer.data(), buffer.size()));
    close(fd);
  }
}

/// One channel of ours: two clock reads, pread(), the number parsed.
void channel(benchmark::State& state) {
  probe::TextFile file(probe::Root(), files().path(0));
  for (auto _ : state) benchmark::DoNotOptimize(file.read_int());
}

/// The same below a --root, where files may be replaced.
void channel_below_a_root(benchmark::State& state) {
  probe::TextFile file(probe::Root("/dev/shm"), files().path(0).substr(8));
  for (auto _ : state) benchmark::DoNotOptimize(file.read_int());
}

/// All 40 channels of one source.
void tick(benchmark::State& state) {
  std::vector<probe::FileChannel> rows;
  for (int i = 0; i < file_count; ++i)
    rows.push_back({{}, probe::TextFile(probe::Root(), files().path(i))});
  probe::FileSource source("bench", 1, std::move(rows));
  std::vector<probe::Reading> readings(file_count);
  for (auto _ : state) {
    source.poll(readings);
    benchmark::DoNotOptimize(readings.data());
  }
}

BENCHMARK(pread_alone);
BENCHMARK(open_read_close);
BENCHMARK(channel);
BENCHMARK(channel_below_a_root);
BENCHMARK(tick)->Unit(benchmark::kMicrosecond);

}  // namespace

BENCHMARK_MAIN();
