#include "client/cli/gnuplot.h"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>

#include "core/base/status.h"

namespace mapsieve::client {
namespace {

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
/// Files that nobody else sees, gone when closed.
using TemporaryFile = std::unique_ptr<std::FILE, CloseFile>;

absl::Status SystemError(const char* what, int error) {
  return absl::ResourceExhaustedError(
      absl::StrCat("gnuplot: ", what, ": ", std::strerror(error)));
}

std::string ReadAll(std::FILE* file) {
  std::string text;
  std::array<char, 65536> buffer;
  std::rewind(file);
  while (const size_t count =
             std::fread(buffer.data(), 1, buffer.size(), file)) {
    text.append(buffer.data(), count);
  }
  return text;
}

/// The exit code of gnuplot with these files as its streams, or an error number
/// below 0 if it cannot be started.
int Spawn(const std::array<TemporaryFile, 3>& streams) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  for (int i = 0; i < 3; ++i) {
    posix_spawn_file_actions_adddup2(
        &actions, fileno(streams[static_cast<size_t>(i)].get()), i);
  }
  std::string name = "gnuplot";
  std::string no_settings_of_the_user = "-d";
  char* const arguments[] = {name.data(), no_settings_of_the_user.data(),
                             nullptr};
  pid_t pid = 0;
  const int error =
      posix_spawnp(&pid, name.data(), &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) return -error;
  int status = 0;
  while (waitpid(pid, &status, 0) < 0) {
    if (errno != EINTR) return -errno;
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace

absl::StatusOr<std::string> RunGnuplot(std::string_view script) {
  std::array<TemporaryFile, 3> streams;
  for (TemporaryFile& stream : streams) {
    stream.reset(std::tmpfile());
    if (!stream) return SystemError("cannot make a temporary file", errno);
  }
  std::FILE* const input = streams[0].get();
  if (std::fwrite(script.data(), 1, script.size(), input) != script.size() ||
      std::fflush(input) != 0) {
    return SystemError("cannot write the script", errno);
  }
  std::rewind(input);
  const int code = Spawn(streams);
  if (code == -ENOENT || code == 127) {
    return absl::FailedPreconditionError(
        "gnuplot, which draws the plots, is not installed: install the package "
        "gnuplot-nox");
  }
  if (code < 0) return SystemError("cannot be started", -code);
  if (code != 0) {
    // The last line that says anything; before it gnuplot shows the place.
    std::string message = ReadAll(streams[2].get());
    message.erase(message.find_last_not_of(" \n") + 1);
    return absl::InvalidArgumentError(
        absl::StrCat("gnuplot: exit status ", code, ": ",
                     message.substr(message.rfind('\n') + 1)));
  }
  return ReadAll(streams[1].get());
}

}  // namespace mapsieve::client
