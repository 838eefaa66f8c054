/// Text on a terminal.
#pragma once

#include <cstddef>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>

namespace energyprof::app {

/// How many columns the terminal has that `to` is; absent where it is none, or does not tell.
std::optional<std::size_t> terminal_width(std::FILE* to);

/// How many columns the terminal needs for UTF-8 text.
std::size_t columns_of(std::string_view text);

/// Filled up to `width` columns, on the left if `right`; longer text stays as it is.
std::string padded(const std::string& text, std::size_t width, bool right = false);

/// `text` in lines of at most `width` columns, each after the first behind `indent` spaces; a
/// longer word has a line of its own.
std::string wrapped(std::string_view text, std::size_t indent, std::size_t width);

}  // namespace energyprof::app
