#include "analysis/write_reports.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <tbb/parallel_invoke.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>
#include <ostream>
#include <stdexcept>
#include <streambuf>

#include "analysis/csv.h"
#include "analysis/report_html.h"
#include "analysis/report_json.h"
#include "analysis/report_md.h"

namespace energyprof::analysis {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void fail(const fs::path& file, int error) {
  throw std::runtime_error(fmt::format("cannot write '{}': {}. {}", file.string(),
                                       std::strerror(error),
                                       error == ENOSPC || error == EDQUOT || error == EFBIG
                                           ? "Free some space and run 'energyprof analyze' again."
                                           : "Choose a directory that can be written to."));
}

/// A buffered stream into a file descriptor that remembers why a write failed, which std::ofstream
/// does not promise.
class FileBuffer : public std::streambuf {
 public:
  explicit FileBuffer(int descriptor) : descriptor_(descriptor) { reset(); }
  [[nodiscard]] int error() const { return error_; }

 protected:
  int_type overflow(int_type c) override {
    if (sync() != 0) return traits_type::eof();
    if (!traits_type::eq_int_type(c, traits_type::eof())) sputc(traits_type::to_char_type(c));
    return traits_type::not_eof(c);
  }
  int sync() override {
    const char* at = pbase();
    while (error_ == 0 && at < pptr()) {
      const ssize_t count = ::write(descriptor_, at, static_cast<std::size_t>(pptr() - at));
      if (count >= 0) {
        at += count;
      } else if (errno != EINTR) {
        error_ = errno;
      }
    }
    reset();
    return error_ == 0 ? 0 : -1;
  }

 private:
  void reset() { setp(buffer_.data(), buffer_.data() + buffer_.size()); }

  std::array<char, 1 << 16> buffer_;
  int descriptor_;
  int error_ = 0;
};

using Fill = std::function<void(std::ostream&)>;

/// Writes beside `file` and renames, so that a reader never meets half a file.
void write_file(const fs::path& file, const Fill& fill) {
  const fs::path draft = file.string() + ".part";
  const int descriptor = ::open(draft.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (descriptor < 0) fail(file, errno);
  FileBuffer buffer(descriptor);
  std::ostream out(&buffer);
  fill(out);
  out.flush();
  int error = buffer.error();
  if (::close(descriptor) != 0 && error == 0) error = errno;
  if (error == 0 && ::rename(draft.c_str(), file.c_str()) != 0) error = errno;
  if (error == 0) return;
  ::unlink(draft.c_str());
  fail(file, error);
}

std::string read_bytes(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Pictures by name; only reference images and heat maps, which the page shows, with their bytes.
std::vector<ReportImage> read_images(const fs::path& directory) {
  std::vector<fs::path> files;
  std::error_code none;
  for (fs::directory_iterator entry(directory, none), end; entry != end; entry.increment(none))
    if (entry->path().extension() == ".png") files.push_back(entry->path());
  std::sort(files.begin(), files.end());
  std::vector<ReportImage> images;
  for (const fs::path& file : files) {
    const std::string title = file.stem().string();
    const bool shown = title.ends_with("_reference") || title.ends_with("_heat");
    images.push_back({title, shown ? read_bytes(file) : std::string()});
  }
  return images;
}

}  // namespace

std::vector<fs::path> write_reports(const RunRecord& run, const Analysis& analysis,
                                    const fs::path& directory, const TimelineConfig& timeline) {
  const fs::path timeline_file = directory / "timeline.json";
  const fs::path json_file = directory / "report.json";
  const fs::path md_file = directory / "report.md";
  const fs::path html_file = directory / "report.html";
  const std::vector<ReportImage> images = read_images(directory / "images");
  std::vector<std::string> image_files;
  for (const ReportImage& image : images) image_files.push_back(image_file(image.title));
  std::string json_text;
  std::string md_text;
  std::string html_text;
  // Texts come to be beside the timeline, but are written after it: what fails first is the same
  // each time.
  tbb::parallel_invoke([&] { export_timeline(run, timeline_file, timeline, &analysis); },
                       [&] {
                         json_text = report_json_text(run, analysis, image_files);
                         md_text = report_md(run, analysis, image_files);
                         html_text = report_html(run, analysis, images);
                       });
  write_file(json_file, [&](std::ostream& out) { out << json_text << '\n'; });
  write_file(md_file, [&](std::ostream& out) { out << md_text; });
  write_file(html_file, [&](std::ostream& out) { out << html_text; });
  return {timeline_file, json_file, md_file, html_file};
}

std::vector<fs::path> export_csv(const RunRecord& run, const fs::path& directory) {
  std::error_code error;
  fs::create_directories(directory, error);
  if (error) fail(directory, error.value());
  const fs::path frames_file = directory / "frames.csv";
  const fs::path samples_file = directory / "samples.csv";
  write_file(frames_file, [&](std::ostream& out) { write_frames_csv(run, out); });
  const fs::path meta_file = directory / "meta.csv";
  write_file(samples_file, [&](std::ostream& out) { write_samples_csv(run, out); });
  write_file(meta_file, [&](std::ostream& out) { write_meta_csv(run, out); });
  return {frames_file, samples_file, meta_file};
}

void export_timeline(const RunRecord& run, const fs::path& file, const TimelineConfig& timeline,
                     const Analysis* analysis) {
  write_file(file, [&](std::ostream& out) { write_timeline(run, out, timeline, analysis); });
}

}  // namespace energyprof::analysis
