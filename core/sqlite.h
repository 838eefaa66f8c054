/// The few pieces of SQLite's C interface that run_db needs, with errors as exceptions.
/// Internal to core: no other header includes it.
#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

namespace energyprof::sqlite {

/// An open database. Errors are std::runtime_error whose text ends in SQLite's own words.
class Database {
 public:
  /// `flags` are sqlite3_open_v2()'s.
  Database(const std::filesystem::path& file, int flags);

  void execute(const std::string& sql);
  [[nodiscard]] std::string error_text() const { return sqlite3_errmsg(handle_.get()); }
  [[nodiscard]] sqlite3* handle() const { return handle_.get(); }

 private:
  struct Close {
    void operator()(sqlite3* db) const { sqlite3_close_v2(db); }
  };
  std::unique_ptr<sqlite3, Close> handle_;
};

/// A prepared statement. bind() fills the parameters from the first on; nullopt and "" (for
/// bind_text_or_null) become NULL.
class Statement {
 public:
  Statement(Database& db, const std::string& sql);

  Statement& bind(int64_t value);
  Statement& bind(double value);
  Statement& bind(std::string_view value);
  Statement& bind_text_or_null(std::string_view value);
  template <class T>
  Statement& bind(const std::optional<T>& value) {
    if (value) return bind(*value);
    return bind_null();
  }
  Statement& bind_null();

  /// Runs a statement that returns no rows and makes it ready for the next bind().
  void run();
  /// Advances to the next row; false after the last.
  bool next();

  [[nodiscard]] bool is_null(int column) const;
  /// An integer; throws naming the column when the stored value is none (a whole REAL is one).
  [[nodiscard]] int64_t integer(int column) const;
  [[nodiscard]] std::optional<int64_t> optional_integer(int column) const;
  [[nodiscard]] double real(int column) const;
  [[nodiscard]] std::string text(int column) const;

 private:
  void check(int code) const;

  struct Finalize {
    void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
  };
  Database& db_;
  std::unique_ptr<sqlite3_stmt, Finalize> handle_;
  int next_parameter_ = 1;
};

}  // namespace energyprof::sqlite
