/// Built structures on disk, found by what they were built from.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "accel/built.h"
#include "accel/mesh.h"

namespace energyprof::accel {

/// Where structures are kept: $XDG_CACHE_HOME/energyprof/structures, else
/// ~/.cache/energyprof/structures. Throws std::runtime_error if neither is known.
std::filesystem::path blob_cache_dir();

/// SHA-256 in hexadecimal over positions and triangles: of two meshes that differ, they differ.
std::string mesh_digest(const Mesh& mesh);

/// Names a structure by all that its bytes depend on: the mesh (by its mesh_digest()), the
/// builder's parameters as text, the kind, and the revisions of file format and builders. 64
/// hexadecimal digits.
std::string blob_key(std::string_view mesh_digest, std::string_view builder_parameters,
                     AccelKind kind);

/// The structure that store_blob() wrote under `key`. nullopt where there is none; then `warning`
/// is empty. nullopt, and in `warning` one line that names the file and says why, where the file
/// cannot be read or is not what was written: its sizes, its checksum and its key are checked.
std::optional<Built> load_blob(const std::filesystem::path& dir, std::string_view key,
                               std::string& warning);

/// Writes a structure under `key` and makes `dir` where there is none. The file appears complete or
/// not at all; of two writers the later one wins. Throws std::runtime_error, naming the file and
/// why: no space, no permission.
void store_blob(const std::filesystem::path& dir, std::string_view key, const Built& built);

}  // namespace energyprof::accel
