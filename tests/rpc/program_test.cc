// The program mapsieved, as its users start and stop it.

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::rpc {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::Not;
using ::testing::StartsWith;

using Strings = std::vector<std::string>;

std::vector<char*> Pointers(Strings& strings) {
  std::vector<char*> pointers;
  for (std::string& text : strings) pointers.push_back(text.data());
  pointers.push_back(nullptr);
  return pointers;
}

// A running mapsieved; killed at the end if it still runs.
class Program {
 public:
  // `stderr_path`: where its standard error goes.
  Program(Strings arguments, const std::string& stderr_path,
          Strings environment = {})
      : stderr_path_(stderr_path) {
    arguments.insert(arguments.begin(), MAPSIEVED_PATH);
    for (char** variable = environ; *variable != nullptr; ++variable) {
      environment.emplace_back(*variable);
    }
    int out[2];
    EXPECT_EQ(pipe(out), 0);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
    posix_spawn_file_actions_addclose(&actions, out[0]);
    posix_spawn_file_actions_addclose(&actions, out[1]);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO,
                                     stderr_path.c_str(),
                                     O_WRONLY | O_CREAT | O_TRUNC, 0600);
    EXPECT_EQ(
        posix_spawn(&pid_, MAPSIEVED_PATH, &actions, nullptr,
                    Pointers(arguments).data(), Pointers(environment).data()),
        0);
    posix_spawn_file_actions_destroy(&actions);
    close(out[1]);
    out_ = out[0];
  }
  ~Program() {
    if (pid_ != 0) {
      Signal(SIGKILL);
      Wait();
    }
    close(out_);
  }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  // HOST:PORT of its line; empty if it ends without one.
  std::string Address() {
    std::string line;
    char c = 0;
    while (read(out_, &c, 1) == 1 && c != '\n') line += c;
    constexpr std::string_view kPrefix = "mapsieved listening on ";
    if (line.empty()) return "";
    EXPECT_THAT(line, StartsWith(std::string(kPrefix)));
    return line.substr(kPrefix.size());
  }

  void Signal(int number) const { kill(pid_, number); }

  // Its exit status, or minus the signal that ended it.
  int Wait() {
    int status = 0;
    EXPECT_EQ(waitpid(pid_, &status, 0), pid_);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }

  // What it still writes to standard output.
  std::string RestOfOutput() const {
    std::string text;
    char buffer[512];
    for (ssize_t size = 0; (size = read(out_, buffer, sizeof(buffer))) > 0;) {
      text.append(buffer, static_cast<size_t>(size));
    }
    return text;
  }

  std::string Errors() const {
    std::ostringstream text;
    text << std::ifstream(stderr_path_).rdbuf();
    return text.str();
  }

 private:
  std::string stderr_path_;
  pid_t pid_ = 0;
  int out_ = -1;
};

class ProgramTest : public ::testing::Test {
 protected:
  Strings Arguments(Strings more = {}) const {
    Strings arguments = {"--data", folder_.path() + "/data"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }
  std::unique_ptr<Program> Run(Strings arguments, Strings environment = {}) {
    return std::make_unique<Program>(std::move(arguments),
                                     folder_.path() + "/stderr",
                                     std::move(environment));
  }
  std::unique_ptr<Program> RunServer() {
    return Run(Arguments({"--listen", "127.0.0.1:0", "--threads", "1"}));
  }

  testing::TemporaryDirectory folder_;
};

TEST_F(ProgramTest, ServesAndEndsOnASignal) {
  for (const int number : {SIGTERM, SIGINT}) {
    const auto program = RunServer();
    const std::string address = program->Address();
    ASSERT_THAT(address, MatchesRegex("127.0.0.1:[1-9][0-9]*"))
        << program->Errors();
    TestClient client(address);
    v1::ListMapsResponse response;
    MAPSIEVE_EXPECT_OK(FromGrpc(
        client.maps->ListMaps(client.NewContext().get(), {}, &response)));
    program->Signal(number);
    EXPECT_EQ(program->RestOfOutput(), "");
    EXPECT_EQ(program->Wait(), 0) << program->Errors();
  }
}

TEST_F(ProgramTest, LosesNothingAcknowledgedWhenKilled) {
  const core::LatticeCloud cloud = TestScene(20'000);
  const std::vector<std::byte> more = UploadBytes(TestScene(5000), 700);
  std::string operation;
  {
    const auto program = RunServer();
    TestClient client(program->Address());
    MAPSIEVE_ASSERT_OK(client.CreateMap("campus"));
    MAPSIEVE_ASSERT_OK(client.Upload("campus", "u", cloud));
    MAPSIEVE_ASSERT_OK(client.CreateUpload("campus", "v", more));
    MAPSIEVE_ASSERT_OK(
        client.Write("maps/campus/uploads/v", std::span(more).first(5000)));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto started, client.Process("campus"));
    operation = started.name();
    program->Signal(SIGKILL);
    EXPECT_EQ(program->Wait(), -SIGKILL);
  }
  const auto program = RunServer();
  TestClient client(program->Address());
  v1::QueryRegionRequest raw;
  raw.set_name("maps/campus");
  raw.set_raw(true);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer answer, client.Query(raw));
  EXPECT_EQ(answer.cloud.size(), cloud.size());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto upload,
                                client.GetUpload("maps/campus/uploads/v"));
  EXPECT_EQ(upload.committed_bytes(), 5000);
  // Both go on.
  MAPSIEVE_EXPECT_OK(client.Wait(operation));
  MAPSIEVE_EXPECT_OK(client.Write("maps/campus/uploads/v",
                                  std::span(more).subspan(5000), 5000));
}

TEST_F(ProgramTest, DrainsWhileItWorks) {
  const auto program = RunServer();
  TestClient client(program->Address());
  MAPSIEVE_ASSERT_OK(client.CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client.Upload("campus", "u", TestScene(60'000)));
  MAPSIEVE_ASSERT_OK(client.Process("campus"));
  const absl::Time begin = absl::Now();
  program->Signal(SIGTERM);
  EXPECT_EQ(program->Wait(), 0) << program->Errors();
  EXPECT_LT(absl::Now() - begin, absl::Seconds(60));
}

TEST_F(ProgramTest, WrongArgumentsAreUsage) {
  const std::vector<std::pair<Strings, std::string>> wrong = {
      {{}, "data: "},
      {Arguments({"--nonsense"}), "--nonsense"},
      {Arguments({"surplus"}), "surplus"},
      {Arguments({"--listen", "nowhere"}), "listen: expected HOST:PORT"},
      {Arguments({"--listen", "0.0.0.0:0"}), "--insecure"},
      {Arguments({"--memory", "much"}), "memory: "},
      {Arguments({"--memory", "1MiB"}), "memory: "},
      {Arguments({"--threads", "-1"}), "threads: "},
      {Arguments({"--config", "/nowhere.conf"}), "/nowhere.conf"},
  };
  for (const auto& [arguments, message] : wrong) {
    const auto program = Run(arguments);
    EXPECT_EQ(program->Wait(), 2) << message;
    EXPECT_EQ(program->RestOfOutput(), "");
    EXPECT_THAT(program->Errors(),
                AllOf(HasSubstr(message), HasSubstr("Usage: mapsieved")));
  }
}

TEST_F(ProgramTest, HelpAndVersionGoToStandardOutput) {
  const auto help = Run({"--help"});
  EXPECT_EQ(help->Wait(), 0);
  EXPECT_THAT(help->RestOfOutput(),
              AllOf(HasSubstr("--data"), HasSubstr("--insecure"),
                    HasSubstr("MAPSIEVED_NAME")));
  const auto version = Run({"--version"});
  EXPECT_EQ(version->Wait(), 0);
  EXPECT_THAT(version->RestOfOutput(), MatchesRegex("mapsieved [0-9.]+\n"));
}

TEST_F(ProgramTest, FailsToStartWithOneLine) {
  const auto program = RunServer();
  const std::string address = program->Address();
  const auto expect_failure = [&](const Strings& arguments) {
    Program second(arguments, folder_.path() + "/stderr2");
    EXPECT_EQ(second.Wait(), 1);
    EXPECT_EQ(second.RestOfOutput(), "");
    std::string errors = second.Errors();
    // gRPC adds warnings of its own.
    const size_t ours = errors.rfind("mapsieved: ");
    ASSERT_NE(ours, std::string::npos) << errors;
    EXPECT_EQ(errors.find('\n', ours), errors.size() - 1) << errors;
  };
  // The directory is taken.
  expect_failure(Arguments({"--listen", "127.0.0.1:0"}));
  // The port is taken.
  expect_failure({"--data", folder_.path() + "/other", "--listen", address});
  // The directory is a file.
  expect_failure(
      {"--data", folder_.path() + "/stderr", "--listen", "127.0.0.1:0"});
}

TEST_F(ProgramTest, CommandLineGoesBeforeEnvironmentBeforeFile) {
  const std::string config = folder_.path() + "/config";
  std::ofstream(config) << "data = /proc/nowhere\n"
                        << "listen = 0.0.0.0:0\n"
                        << "threads = 1\n";
  const std::string data = folder_.path() + "/data";
  // The file's directory is impossible, the environment's listen address is
  // refused.
  const auto program =
      Run({"--config", config, "--listen", "127.0.0.1:0"},
          {"MAPSIEVED_DATA=" + data, "MAPSIEVED_LISTEN=0.0.0.0:0"});
  EXPECT_THAT(program->Address(), StartsWith("127.0.0.1:"))
      << program->Errors();
  program->Signal(SIGTERM);
  EXPECT_EQ(program->Wait(), 0);
  // The file alone.
  const auto refused = Run({}, {"MAPSIEVED_CONFIG=" + config});
  EXPECT_EQ(refused->Wait(), 2);
  EXPECT_THAT(refused->Errors(), HasSubstr("0.0.0.0:0"));
}

}  // namespace
}  // namespace mapsieve::rpc
