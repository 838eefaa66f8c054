/// Names of channels and the order of numbered things.
#pragma once

#include <string>
#include <string_view>

namespace energyprof::probe {

/// "Package id 0" -> "package_id_0": lower case; letters, digits, '-', ':' and '@' stay, every run
/// of others becomes one '_', none at the ends; at most 64. "unnamed" if nothing is left.
std::string slug(std::string_view text);

/// `text` without white space at its ends.
std::string_view trim(std::string_view text);

/// Whether `text` has a letter or digit that slug() keeps.
bool has_name(std::string_view text);

/// What a file holds, as it may stand in a message: the first line, at most 60 characters of it,
/// with '?' for what cannot be printed.
std::string shown(std::string_view text);

/// Whether `a` sorts before `b` when runs of digits compare as numbers: "cpu2" before "cpu12".
bool natural_less(std::string_view a, std::string_view b);

/// Whether `text` is `prefix` and a decimal number: "cpu12".
bool is_numbered(std::string_view text, std::string_view prefix);

}  // namespace energyprof::probe
