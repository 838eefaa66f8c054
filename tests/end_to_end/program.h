// Runs the program as a user would and collects what it said.
#pragma once

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace energyprof::test {

namespace fs = std::filesystem;

inline std::string read_text(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

struct Output {
  int code = -1;  ///< exit code; 128 + signal if killed
  std::string out;
  std::string err;
};

/// A folder that goes away with its test.
class TempDir {
 public:
  TempDir() {
    std::string pattern = (fs::temp_directory_path() / "energyprof_XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("mkdtemp failed");
    path_ = pattern;
  }
  ~TempDir() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  TempDir(const TempDir&) = delete;
  TempDir& operator=(const TempDir&) = delete;
  [[nodiscard]] const fs::path& path() const { return path_; }
  fs::path operator/(const std::string& name) const { return path_ / name; }

 private:
  fs::path path_;
};

/// A command that runs.
class Process {
 public:
  Process(const std::vector<std::string>& command, const std::map<std::string, std::string>& env) {
    pid_ = fork();
    if (pid_ < 0) throw std::runtime_error("fork failed");
    if (pid_ == 0) {
      for (const auto& [key, value] : env) setenv(key.c_str(), value.c_str(), 1);
      redirect(logs_ / "out", STDOUT_FILENO);
      redirect(logs_ / "err", STDERR_FILENO);
      std::vector<char*> argv;
      for (const std::string& argument : command)
        argv.push_back(const_cast<char*>(argument.c_str()));
      argv.push_back(nullptr);
      execvp(argv[0], argv.data());
      _exit(127);
    }
  }
  ~Process() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void send(int signal) const { kill(pid_, signal); }
  [[nodiscard]] std::string err_so_far() const { return read_text(logs_ / "err"); }
  [[nodiscard]] bool is_running() const { return kill(pid_, 0) == 0; }

  Output wait() {
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = 0;
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status),
            read_text(logs_ / "out"), read_text(logs_ / "err")};
  }

 private:
  static void redirect(const fs::path& file, int fd) {
    const int target = open(file.c_str(), O_CREAT | O_WRONLY | O_TRUNC, 0644);
    dup2(target, fd);
    close(target);
  }

  TempDir logs_;
  pid_t pid_ = 0;
};

inline Output run(const std::vector<std::string>& command,
                  const std::map<std::string, std::string>& env = {}) {
  return Process(command, env).wait();
}

}  // namespace energyprof::test
