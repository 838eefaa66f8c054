#include "core/sqlite.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

namespace energyprof::sqlite {

Database::Database(const std::filesystem::path& file, int flags) {
  sqlite3* raw = nullptr;
  const int code = sqlite3_open_v2(file.c_str(), &raw, flags, nullptr);
  handle_.reset(raw);
  if (code != SQLITE_OK)
    throw std::runtime_error(raw != nullptr ? sqlite3_errmsg(raw) : sqlite3_errstr(code));
  sqlite3_extended_result_codes(raw, 1);
}

void Database::execute(const std::string& sql) {
  if (sqlite3_exec(handle_.get(), sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK)
    throw std::runtime_error(error_text());
}

Statement::Statement(Database& db, const std::string& sql) : db_(db) {
  sqlite3_stmt* raw = nullptr;
  const int code =
      sqlite3_prepare_v2(db.handle(), sql.c_str(), static_cast<int>(sql.size()), &raw, nullptr);
  handle_.reset(raw);
  check(code);
}

void Statement::check(int code) const {
  if (code != SQLITE_OK) throw std::runtime_error(db_.error_text());
}

Statement& Statement::bind(int64_t value) {
  check(sqlite3_bind_int64(handle_.get(), next_parameter_++, value));
  return *this;
}

Statement& Statement::bind(double value) {
  check(sqlite3_bind_double(handle_.get(), next_parameter_++, value));
  return *this;
}

Statement& Statement::bind(std::string_view value) {
  check(sqlite3_bind_text(handle_.get(), next_parameter_++, value.data(),
                          static_cast<int>(value.size()), SQLITE_TRANSIENT));
  return *this;
}

Statement& Statement::bind_text_or_null(std::string_view value) {
  return value.empty() ? bind_null() : bind(value);
}

Statement& Statement::bind_null() {
  check(sqlite3_bind_null(handle_.get(), next_parameter_++));
  return *this;
}

void Statement::run() {
  next();
  check(sqlite3_reset(handle_.get()));
  next_parameter_ = 1;
}

bool Statement::next() {
  const int code = sqlite3_step(handle_.get());
  if (code == SQLITE_ROW) return true;
  if (code == SQLITE_DONE) return false;
  const std::string why = db_.error_text();
  sqlite3_reset(handle_.get());
  throw std::runtime_error(why);
}

bool Statement::is_null(int column) const {
  return sqlite3_column_type(handle_.get(), column) == SQLITE_NULL;
}

int64_t Statement::integer(int column) const {
  const int type = sqlite3_column_type(handle_.get(), column);
  if (type == SQLITE_INTEGER) return sqlite3_column_int64(handle_.get(), column);
  if (type == SQLITE_FLOAT) {
    const double value = sqlite3_column_double(handle_.get(), column);
    if (std::trunc(value) == value && std::fabs(value) < 9.2e18) return static_cast<int64_t>(value);
  }
  throw std::runtime_error(fmt::format("column '{}' holds '{}'; expected an integer",
                                       sqlite3_column_name(handle_.get(), column), text(column)));
}

std::optional<int64_t> Statement::optional_integer(int column) const {
  if (is_null(column)) return std::nullopt;
  return integer(column);
}

double Statement::real(int column) const {
  const int type = sqlite3_column_type(handle_.get(), column);
  if (type == SQLITE_FLOAT || type == SQLITE_INTEGER)
    return sqlite3_column_double(handle_.get(), column);
  throw std::runtime_error(fmt::format("column '{}' holds '{}'; expected a number",
                                       sqlite3_column_name(handle_.get(), column), text(column)));
}

std::string Statement::text(int column) const {
  const auto* chars = reinterpret_cast<const char*>(sqlite3_column_text(handle_.get(), column));
  if (chars == nullptr) return {};
  return {chars, static_cast<size_t>(sqlite3_column_bytes(handle_.get(), column))};
}

}  // namespace energyprof::sqlite
