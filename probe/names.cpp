#include "probe/names.h"

#include <algorithm>
#include <cstddef>

namespace energyprof::probe {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// The run of digits at the start of `text`, without its leading zeros; `text` moves past it.
std::string_view take_number(std::string_view& text) {
  size_t end = 0;
  while (end < text.size() && is_digit(text[end])) ++end;
  std::string_view digits = text.substr(0, end);
  text.remove_prefix(end);
  digits.remove_prefix(std::min(digits.find_first_not_of('0'), digits.size()));
  return digits;
}

}  // namespace

std::string slug(std::string_view text) {
  std::string result;
  bool gap = false;
  for (char c : text) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    if ((c >= 'a' && c <= 'z') || is_digit(c) || c == '-' || c == ':' || c == '@') {
      if (gap && !result.empty()) result += '_';
      result += c;
      gap = false;
    } else {
      gap = true;
    }
  }
  constexpr size_t longest = 64;
  if (result.size() > longest) result.resize(longest);
  if (result.ends_with('_')) result.pop_back();
  return result.empty() ? "unnamed" : result;
}

std::string_view trim(std::string_view text) {
  constexpr std::string_view white_space = " \t\r\n";
  const size_t begin = text.find_first_not_of(white_space);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(white_space) - begin + 1);
}

bool has_name(std::string_view text) {
  return std::any_of(text.begin(), text.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || is_digit(c);
  });
}

std::string shown(std::string_view text) {
  constexpr size_t longest = 60;
  std::string line(text.substr(0, std::min(text.find('\n'), longest + 1)));
  for (char& c : line)
    if (c < ' ' || c > '~') c = '?';
  if (line.size() > longest) line.replace(longest, std::string::npos, "...");
  return line;
}

bool natural_less(std::string_view a, std::string_view b) {
  const std::string_view whole_a = a;
  const std::string_view whole_b = b;
  while (!a.empty() && !b.empty()) {
    if (is_digit(a[0]) && is_digit(b[0])) {
      const std::string_view x = take_number(a);
      const std::string_view y = take_number(b);
      if (x.size() != y.size()) return x.size() < y.size();
      if (x != y) return x < y;
    } else {
      if (a[0] != b[0]) return a[0] < b[0];
      a.remove_prefix(1);
      b.remove_prefix(1);
    }
  }
  if (a.empty() != b.empty()) return a.empty();
  return whole_a < whole_b;  // equal but for leading zeros
}

bool is_numbered(std::string_view text, std::string_view prefix) {
  if (!text.starts_with(prefix)) return false;
  text.remove_prefix(prefix.size());
  return !text.empty() && std::all_of(text.begin(), text.end(), is_digit);
}

}  // namespace energyprof::probe
