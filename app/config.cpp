#include "app/config.h"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <set>
#include <sstream>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validator.hpp>

#include "accel/models.h"
#include "app/usage_error.h"
#include "embedded/config_schema.h"

namespace energyprof::app {
namespace {

using nlohmann::json;

const json& schema() {
  static const json parsed = json::parse(embedded::config_schema());
  return parsed;
}

// ------------------------------------------------------------------ reading

std::string read_file(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  if (in) text << in.rdbuf();
  if (!in)
    throw std::runtime_error(
        fmt::format("cannot read config '{}': {}.", file.string(), std::strerror(errno)));
  return text.str();
}

std::filesystem::path find_config(const std::string& name) {
  std::error_code ignored;
  if (std::filesystem::exists(name, ignored)) {
    if (std::filesystem::is_directory(name, ignored))
      throw std::runtime_error(fmt::format("cannot read config '{}': it is a directory.", name));
    return name;
  }
  if (name.find('/') == std::string::npos)
    for (const std::filesystem::path& dir : config_dirs())
      if (std::filesystem::exists(dir / name, ignored)) return dir / name;
  throw std::runtime_error(fmt::format(
      "cannot read config '{}': there is no such file, and no shipped config of that name.", name));
}

/// Parses JSON with // and /* */ comments; a key given twice is an error.
json parse(const std::string& text, const std::string& file) {
  std::vector<std::set<std::string>> open_objects;
  std::string duplicate;
  const auto watch_keys = [&](int, json::parse_event_t event, json& value) {
    if (event == json::parse_event_t::object_start) open_objects.emplace_back();
    if (event == json::parse_event_t::object_end) open_objects.pop_back();
    if (event == json::parse_event_t::key && duplicate.empty() &&
        !open_objects.back().insert(value.get<std::string>()).second)
      duplicate = value.get<std::string>();
    return true;
  };
  try {
    json parsed = json::parse(text, watch_keys, true, true);
    if (!duplicate.empty())
      throw UsageError(fmt::format("{}: key '{}' is given twice", file, duplicate));
    return parsed;
  } catch (const json::exception& error) {
    // nlohmann's text: "[json.exception.parse_error.101] parse error at line 3, column 5: ..."
    std::string why = error.what();
    if (const size_t end = why.find("] "); end != std::string::npos) why = why.substr(end + 2);
    std::replace(why.begin(), why.end(), '\n', ' ');
    throw UsageError(fmt::format("{}: not JSON: {}", file, why));
  }
}

/// Applies one `key.path=value`. A value that is not JSON is taken as a string.
void apply_setting(json& config, const std::string& setting) {
  const size_t equals = setting.find('=');
  if (equals == std::string::npos || equals == 0)
    throw UsageError(
        fmt::format("--set '{}': expected key.path=value, as in --set image.width=640", setting));
  const std::string value_text = setting.substr(equals + 1);
  json value = json::parse(value_text, nullptr, false);
  if (value.is_discarded()) value = value_text;

  json* place = &config;
  std::istringstream path(setting.substr(0, equals));
  for (std::string key; std::getline(path, key, '.');) {
    if (place->is_array()) {
      const bool is_index =
          !key.empty() && key.size() < 6 && std::all_of(key.begin(), key.end(), ::isdigit);
      if (!is_index || std::stoul(key) >= place->size())
        throw UsageError(
            fmt::format("--set '{}': '{}' is not an index below {}", setting, key, place->size()));
      place = &(*place)[std::stoul(key)];
    } else if (place->is_object() || place->is_null()) {
      place = &(*place)[key];
    } else {
      throw UsageError(fmt::format("--set '{}': '{}' is inside {}, which holds no keys", setting,
                                   key, place->dump()));
    }
  }
  *place = std::move(value);
}

// ------------------------------------------------------------------ checking

/// "<root>", "[algorithms]", "[2]" -> /algorithms/2
json::json_pointer to_pointer(const std::vector<std::string>& context) {
  json::json_pointer pointer;
  for (size_t i = 1; i < context.size(); ++i) {
    const std::string& part = context[i];
    pointer /= part.size() > 2 ? part.substr(1, part.size() - 2) : part;
  }
  return pointer;
}

/// The alternative of an anyOf that has `key`, else the schema itself.
const json& alternative_with(const json& node, const char* key) {
  if (node.contains("anyOf"))
    for (const json& alternative : node.at("anyOf"))
      if (alternative.contains(key)) return alternative;
  return node;
}

/// The part of the schema that describes `pointer`; nullptr for a key that the schema does not
/// know.
const json* schema_at(const json::json_pointer& pointer) {
  std::vector<std::string> keys;
  for (json::json_pointer rest = pointer; !rest.empty(); rest.pop_back())
    keys.push_back(rest.back());
  const json* node = &schema();
  for (auto key = keys.rbegin(); key != keys.rend(); ++key) {
    const json& object = alternative_with(*node, "properties");
    const json& array = alternative_with(*node, "items");
    if (object.contains("properties") && object.at("properties").contains(*key))
      node = &object.at("properties").at(*key);
    else if (object.contains("additionalProperties") &&
             object.at("additionalProperties").is_object())
      node = &object.at("additionalProperties");
    else if (array.contains("items"))
      node = &array.at("items");
    else
      return nullptr;
  }
  return node;
}

std::string join_keys(const json& properties) {
  std::string keys;
  for (const auto& [key, unused] : properties.items())
    if (key != "$schema") keys += (keys.empty() ? "" : ", ") + key;
  return keys;
}

/// What the schema allows at a place, in words.
std::string expected(const json& node) {
  if (node.contains("enum")) {
    std::string names;
    for (const json& name : node.at("enum"))
      names +=
          (names.empty() ? "" : ", ") + (name.is_string() ? name.get<std::string>() : name.dump());
    return names;
  }
  if (node.contains("description")) return node.at("description");
  const std::string type = node.value("type", "a value");
  std::string text = type == "integer" ? "an integer" : type == "number" ? "a number" : "a " + type;
  if (node.contains("minimum") && node.contains("maximum"))
    text += fmt::format(" from {} to {}", node.at("minimum").dump(), node.at("maximum").dump());
  return text;
}

/// What is wrong with `value` at `pointer`: an unknown key, a missing key, or the value itself.
std::string describe_problem(const json& config, const json::json_pointer& pointer) {
  const json& value = config.at(pointer);
  const json* node = schema_at(pointer);
  const std::string place = pointer.empty() ? "/" : pointer.to_string();
  if (node == nullptr) return fmt::format("{}: {} is not allowed here", place, value.dump());
  const json& object = alternative_with(*node, "properties");
  if (value.is_object() && object.contains("properties")) {
    const json& properties = object.at("properties");
    for (const auto& [key, unused] : value.items())
      if (!properties.contains(key))
        return fmt::format("{}: unknown key '{}'; expected {}", place, key, join_keys(properties));
    for (const json& key : object.value("required", json::array()))
      if (!value.contains(key.get<std::string>()))
        return fmt::format("{}: key '{}' is missing", place, key.get<std::string>());
  }
  std::string shown = value.dump();
  if (shown.size() > 80) shown = shown.substr(0, 77) + "...";
  return fmt::format("{}: {} is not allowed; expected {}", place, shown, expected(*node));
}

void check(const json& config, const std::string& file) {
  valijson::Schema compiled;
  const valijson::adapters::NlohmannJsonAdapter schema_adapter(schema());
  valijson::SchemaParser().populateSchema(schema_adapter, compiled);
  valijson::Validator validator;
  valijson::ValidationResults results;
  const valijson::adapters::NlohmannJsonAdapter adapter(config);
  if (validator.validate(compiled, adapter, &results)) return;

  // The deepest place is the most telling one.
  std::vector<std::string> deepest;
  for (valijson::ValidationResults::Error error; results.popError(error);)
    if (error.context.size() > deepest.size()) deepest = error.context;
  throw UsageError(fmt::format("{}: {}", file, describe_problem(config, to_pointer(deepest))));
}

/// Fills in the schema's defaults, so that what is recorded says everything.
void add_defaults(json& config, const json& node) {
  if (!node.contains("properties")) return;
  for (const auto& [key, child] : node.at("properties").items()) {
    if (child.contains("default") && !config.contains(key)) config[key] = child.at("default");
    if (child.value("type", "") == "object") {
      if (!config.contains(key)) config[key] = json::object();
      add_defaults(config[key], child);
    }
  }
}

// ------------------------------------------------------------------ meaning

std::vector<ViewChoice> parse_views(const json& views) {
  if (views.is_string()) return {0, 1, 2};
  std::vector<ViewChoice> choices;
  for (const json& view : views) {
    if (view.is_number_integer()) {
      choices.emplace_back(view.get<int>());
      continue;
    }
    ViewConfig v{view.at("phi"), view.at("theta"), view.at("distance"), glm::dvec3(0.0)};
    if (view.contains("target"))
      v.target = {view.at("target")[0], view.at("target")[1], view.at("target")[2]};
    choices.emplace_back(v);
  }
  return choices;
}

/// A name of the catalogue, the teapot with a number from 1 to 256, or a path.
bool is_model_name(const std::string& name) {
  constexpr std::string_view tessellated = "teapot:";
  if (name.starts_with(tessellated)) {
    int n = 0;
    const char* end = name.data() + name.size();
    const auto [rest, error] = std::from_chars(name.data() + tessellated.size(), end, n);
    return error == std::errc() && rest == end && n >= 1 && n <= 256;
  }
  return accel::find_model(name) != nullptr || name.find('/') != std::string::npos ||
         accel::is_mesh_name(name);
}

std::string model_names() {
  std::string names;
  for (const accel::ModelInfo& model : accel::catalogue())
    names += (names.empty() ? "" : ", ") + std::string(model.name);
  return names;
}

/// Also enters the presets' values into the document, so that what is recorded says everything.
void read_structures(json& document, Config& c) {
  json& structures = document.at("structures");
  c.structures = read_structure_parameters(structures);
  for (const AccelKind kind : {AccelKind::bvh_depth_first, AccelKind::kd_tree, AccelKind::grid})
    structures.at(builder_name(kind)).update(describe_parameters(c.structures, kind));
}

CacheSettings parse_cache_settings(const json& block) {
  const auto value = [&](const char* key) {
    return block.contains(key) ? std::optional<int64_t>(block.at(key)) : std::nullopt;
  };
  return {value("l1_kib"), value("l1_ways"), value("llc_kib"), value("llc_ways"),
          value("line_bytes")};
}

Config interpret(json document, const std::string& file) {
  add_defaults(document, schema());
  Config c;
  c.file = file;
  c.name = document.at("name");
  c.question = document.value("question", "");
  c.models = document.at("models");
  c.views = parse_views(document.at("views"));
  c.algorithms = document.at("algorithms");
  c.width = document.at("image").at("width");
  c.height = document.at("image").at("height");
  c.bounces = document.at("bounces");
  c.warmup_frames = document.at("frames").at("warmup");
  c.timed_frames = document.at("frames").at("timed");
  const std::string pace = document.at("frames").at("pace");
  if (pace != "back-to-back") {
    c.frames_per_second = std::stod(pace.substr(4));
    if (*c.frames_per_second <= 0.0)
      throw UsageError(
          fmt::format("{}: /frames/pace: \"{}\" is not allowed; expected more than 0 "
                      "frames per second",
                      file, pace));
  }
  c.latin_square = document.at("order").at("design") == "latin-square";
  c.repetitions = document.at("order").at("repetitions");
  c.seed = document.at("order").at("seed");
  c.cooldown_max_s = document.at("cooldown").at("max_s");
  const json& idle = document.at("idle");
  c.idle = {idle.at("before_s"), idle.at("between_s"), idle.at("after_s")};
  read_structures(document, c);
  c.structure_cache = document.at("structure_cache");
  c.cache_model = parse_cache_settings(document.at("cache_model"));
  c.sampler_rate_hz = document.at("sampler").at("rate_hz");
  if (document.at("sampler").at("sources").is_array())
    c.sources = document.at("sampler").at("sources");
  c.required = document.at("sampler").value("require", std::vector<std::string>{});
  for (const auto& [source, period_ms] : document.at("sampler").at("periods_ms").items())
    c.sampler_periods_ns[source] = std::llround(period_ms.get<double>() * 1e6);
  c.self_check = document.at("sampler").at("self_check");
  for (size_t i = 0; i < c.models.size(); ++i)
    if (!is_model_name(c.models[i]))
      throw UsageError(fmt::format(
          "{}: /models/{}: '{}' is not a model; expected {}, teapot:N (N from 1 to 256) or a "
          "path to .ply, .ply.gz or .obj",
          file, i, c.models[i], model_names()));
  c.json = std::move(document);
  return c;
}

}  // namespace

std::vector<std::filesystem::path> config_dirs() {
  std::vector<std::filesystem::path> dirs;
  std::error_code failed;
  const auto program = std::filesystem::read_symlink("/proc/self/exe", failed);
  if (failed) return dirs;
  const std::filesystem::path bin = program.parent_path();
  dirs.push_back(bin.parent_path() / "share" / "energyprof" / "configs");     // installed
  dirs.push_back(bin.parent_path().parent_path().parent_path() / "configs");  // build/<preset>/app
  return dirs;
}

Config load_config(const std::string& file, const std::vector<std::string>& settings) {
  json document = parse(read_file(find_config(file)), file);
  for (const std::string& setting : settings) apply_setting(document, setting);
  check(document, file);
  return interpret(std::move(document), file);
}

std::string apply_quick(Config& config) {
  std::string changes;
  const auto cap = [&](auto& value, auto limit, const char* what) {
    if (value <= limit) return;
    changes +=
        fmt::format("{}{} {} instead of {}", changes.empty() ? "" : ", ", what, limit, value);
    value = limit;
  };
  if (config.width > 320 || config.height > 180) {
    // Keep the shape of the image.
    const double factor = std::min(320.0 / config.width, 180.0 / config.height);
    const auto scaled = [&](uint32_t pixels) {
      return std::max(1u, static_cast<uint32_t>(std::lround(pixels * factor)));
    };
    const uint32_t width = scaled(config.width);
    const uint32_t height = scaled(config.height);
    changes +=
        fmt::format("image {}x{} instead of {}x{}", width, height, config.width, config.height);
    config.width = width;
    config.height = height;
  }
  cap(config.warmup_frames, int64_t{2}, "warm-up frames");
  cap(config.timed_frames, int64_t{16}, "timed frames");
  cap(config.repetitions, int64_t{1}, "repetitions");
  cap(config.cooldown_max_s, 2.0, "cool-down of at most (s)");
  cap(config.idle.before_s, 1.0, "idle before (s)");
  cap(config.idle.between_s, 0.0, "idle between (s)");
  cap(config.idle.after_s, 1.0, "idle after (s)");
  config.json["image"] = {{"width", config.width}, {"height", config.height}};
  config.json["frames"]["warmup"] = config.warmup_frames;
  config.json["frames"]["timed"] = config.timed_frames;
  config.json["order"]["repetitions"] = config.repetitions;
  config.json["cooldown"]["max_s"] = config.cooldown_max_s;
  config.json["idle"] = {{"before_s", config.idle.before_s},
                         {"between_s", config.idle.between_s},
                         {"after_s", config.idle.after_s}};
  return changes;
}

}  // namespace energyprof::app
