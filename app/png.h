/// PNG files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>

namespace energyprof::app {

/// Writes an 8-bit RGB image, row-major, 3 bytes a pixel. The file appears whole or not at all.
/// Throws std::runtime_error naming the file.
void write_png(const std::filesystem::path& file, uint32_t width, uint32_t height,
               std::span<const uint8_t> rgb);

}  // namespace energyprof::app
