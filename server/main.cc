// mapsieved: serves maps until SIGTERM or SIGINT.

#include <signal.h>

#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/status/status.h"
#include "absl/synchronization/mutex.h"
#include "absl/time/time.h"
#include "core/base/heap.h"
#include "core/base/status.h"
#include "grpc/support/log.h"
#include "server/server.h"
#include "server/server_options.h"
#include "spdlog/sinks/stdout_sinks.h"
#include "spdlog/spdlog.h"

namespace mapsieve::rpc {
namespace {

constexpr int kExitFailure = 1;
constexpr int kExitUsage = 2;

// Calls in flight may go on this long after a signal.
constexpr absl::Duration kGrace = absl::Seconds(20);

constexpr char kFooter[] =
    "Every option NAME can also be given as MAPSIEVED_NAME in the environment\n"
    "(capitals, '_' for '-') and as a line NAME = VALUE of the configuration\n"
    "file. The command line goes before the environment, the environment\n"
    "before the file.\n\n"
    "On SIGTERM or SIGINT the server drains and exits with status 0; a second\n"
    "signal ends it at once. Exit status 1: it could not start; 2: usage.";

// The command line as it was given.
struct CommandLine {
  std::string config;
  // One a setting; empty: not given.
  std::vector<std::string> values;
};

absl::StatusOr<ServerOptions> ReadOptions(const CommandLine& line) {
  ServerOptions options;
  std::string config = line.config;
  if (config.empty()) {
    const char* text = std::getenv(EnvironmentName("config").c_str());
    if (text != nullptr) config = text;
  }
  if (!config.empty()) {
    MAPSIEVE_RETURN_IF_ERROR(ApplyConfigFile(config, options));
  }
  MAPSIEVE_RETURN_IF_ERROR(ApplyEnvironment(
      [](const char* name) { return std::getenv(name); }, options));
  const auto settings = ServerSettings();
  for (size_t i = 0; i < settings.size(); ++i) {
    if (line.values[i].empty()) continue;
    MAPSIEVE_RETURN_IF_ERROR(
        ApplySetting(settings[i].name, line.values[i], options));
  }
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  return options;
}

void LogGrpc(gpr_log_func_args* args) {
  const auto level = args->severity == GPR_LOG_SEVERITY_ERROR
                         ? spdlog::level::warn
                         : spdlog::level::debug;
  spdlog::log(level, "grpc: {}", args->message);
}

// The signals that end the server, which it takes one at a time.
sigset_t StopSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  return signals;
}

int Serve(const ServerOptions& options) {
  const auto logger = spdlog::stderr_logger_mt("mapsieved");
  logger->set_pattern("%Y-%m-%dT%H:%M:%S.%e %l %v");
  logger->set_level(spdlog::level::from_str(options.log_level));
  spdlog::set_default_logger(logger);
  gpr_set_log_function(LogGrpc);

  // Threads inherit the mask: no signal interrupts them.
  const sigset_t signals = StopSignals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  signal(SIGPIPE, SIG_IGN);

  auto server = Server::Start(options, *logger);
  if (!server.ok()) {
    std::fprintf(stderr, "mapsieved: %s\n",
                 std::string(server.status().message()).c_str());
    return kExitFailure;
  }
  std::printf("mapsieved listening on %s\n",
              (*server)->address().ToString().c_str());
  std::fflush(stdout);
  logger->info("serving {} with {} MiB for points", options.data_dir,
               options.memory_bytes >> 20);

  int number = 0;
  sigwait(&signals, &number);
  logger->info("signal {}: draining", number);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  (*server)->Shutdown(kGrace);
  logger->info("drained");
  return EXIT_SUCCESS;
}

int Main(int argc, char** argv) {
  CLI::App app("Serves point-cloud maps.", "mapsieved");
  app.footer(kFooter);
  app.set_version_flag("--version", "mapsieved " MAPSIEVE_VERSION);
  CommandLine line;
  line.values.resize(ServerSettings().size());
  app.add_option("--config", line.config, "configuration file")
      ->option_text("FILE");
  for (size_t i = 0; i < ServerSettings().size(); ++i) {
    const ServerSetting& setting = ServerSettings()[i];
    std::string& value = line.values[i];
    const std::string name = std::string("--") + setting.name;
    if (setting.value_name != nullptr) {
      app.add_option(name, value, setting.help)
          ->option_text(setting.value_name);
    } else {
      app.add_flag_callback(
          name, [&value] { value = "true"; }, setting.help);
    }
  }
  const auto usage = [&](std::string_view message) {
    std::cerr << "mapsieved: " << message << "\n\n" << app.help();
    return kExitUsage;
  };
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return app.exit(success);
  } catch (const CLI::ParseError& error) {
    return usage(error.what());
  }
  const auto options = ReadOptions(line);
  if (!options.ok()) return usage(ToStd(options.status().message()));
  return Serve(*options);
}

}  // namespace
}  // namespace mapsieve::rpc

int main(int argc, char** argv) {
  mapsieve::ReturnFreedBlocks();
  absl::SetMutexDeadlockDetectionMode(absl::OnDeadlockCycle::kIgnore);
  try {
    return mapsieve::rpc::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "mapsieved: " << error.what() << "\n";
    return mapsieve::rpc::kExitFailure;
  }
}
