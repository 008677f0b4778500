#include "server/server_options.h"

#include <fstream>
#include <map>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;

ServerOptions OptionsFor(const std::string& data_dir) {
  ServerOptions options;
  options.data_dir = data_dir;
  return options;
}

absl::Status ApplyConfig(const std::string& name, const std::string& text,
                         ServerOptions& options) {
  const testing::TemporaryDirectory folder;
  std::ofstream(folder / name) << text;
  return ApplyConfigFile(folder / name, options);
}

TEST(ListenAddress, ReadsHostAndPort) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto v4,
                                ListenAddress::Parse("127.0.0.1:0"));
  EXPECT_EQ(v4.host, "127.0.0.1");
  EXPECT_EQ(v4.port, 0);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto v6,
                                ListenAddress::Parse("[::1]:65535"));
  EXPECT_EQ(v6.ToString(), "[::1]:65535");
}

TEST(ListenAddress, RefusesWhatIsNone) {
  for (const char* text : {"", "7070", ":7070", "host:", "host:x", "host:-1",
                           "host:65536", "host:70 ", "::1:7070", "host:+7"}) {
    EXPECT_THAT(ListenAddress::Parse(text), StatusIs(kInvalid, _)) << text;
  }
}

TEST(ListenAddress, KnowsLoopback) {
  for (const char* host : {"127.0.0.1", "127.1.2.3", "[::1]", "localhost"}) {
    EXPECT_TRUE((ListenAddress{host, 1}.IsLoopback())) << host;
  }
  for (const char* host : {"0.0.0.0", "[::]", "192.168.0.1", "example.org"}) {
    EXPECT_FALSE((ListenAddress{host, 1}.IsLoopback())) << host;
  }
}

TEST(ServerOptions, NeedsADirectory) {
  EXPECT_THAT(ServerOptions().Validate(),
              StatusIs(kInvalid, HasSubstr("data")));
  MAPSIEVE_EXPECT_OK(OptionsFor("d").Validate());
}

TEST(ServerOptions, OtherMachinesOnlyWithInsecure) {
  ServerOptions options = OptionsFor("d");
  options.listen.host = "0.0.0.0";
  EXPECT_THAT(options.Validate(), StatusIs(kInvalid, HasSubstr("--insecure")));
  options.insecure = true;
  MAPSIEVE_EXPECT_OK(options.Validate());
}

TEST(ServerOptions, RefusesTooLittleMemory) {
  ServerOptions options = OptionsFor("d");
  options.memory_bytes = 1000;
  EXPECT_THAT(options.Validate(), StatusIs(kInvalid, AllOf(HasSubstr("256MiB"),
                                                           HasSubstr("1000"))));
}

TEST(ApplySetting, ReadsSizes) {
  const std::map<std::string, int64_t> sizes = {
      {"1073741824", int64_t{1} << 30},
      {"2GiB", int64_t{2} << 30},
      {"512M", int64_t{512} << 20},
      {"1.5gb", int64_t{3} << 29},
      {"4096k", int64_t{4} << 20},
      {"1T", int64_t{1} << 40},
      {"7B", 7}};
  for (const auto& [text, bytes] : sizes) {
    ServerOptions options;
    MAPSIEVE_EXPECT_OK(ApplySetting("memory", text, options));
    EXPECT_EQ(options.memory_bytes, bytes) << text;
  }
  for (const char* text :
       {"", "GiB", "-1", "1XB", "1 GiB", "1e30T", "9999999999G", "nan", "."}) {
    ServerOptions options;
    EXPECT_THAT(ApplySetting("memory", text, options),
                StatusIs(kInvalid, HasSubstr("memory: expected a size")))
        << text;
  }
}

TEST(ApplySetting, NamesTheSettingAndTheValue) {
  ServerOptions options;
  EXPECT_THAT(
      ApplySetting("threads", "many", options),
      StatusIs(kInvalid, AllOf(HasSubstr("threads"), HasSubstr("many"))));
  EXPECT_THAT(
      ApplySetting("insecure", "maybe", options),
      StatusIs(kInvalid, HasSubstr("insecure: expected true or false")));
  for (const char* text : {"-1", "all", "1.5", ""}) {
    EXPECT_THAT(ApplySetting("keep-revisions", text, options),
                StatusIs(kInvalid, HasSubstr("keep-revisions: expected 0")))
        << text;
  }
  EXPECT_THAT(ApplySetting("log-level", "loud", options),
              StatusIs(kInvalid, HasSubstr("log-level")));
  EXPECT_THAT(ApplySetting("tsl", "1", options),
              StatusIs(kInvalid, HasSubstr("\"tsl\"")));
}

TEST(ApplyConfigFile, ReadsEverySetting) {
  ServerOptions options;
  MAPSIEVE_ASSERT_OK(ApplyConfig("every.conf",
                                 "# comment\n"
                                 "\n"
                                 "data = /tmp/some dir#1\n"
                                 "  listen=0.0.0.0:99  \n"
                                 "memory = 1GiB\n"
                                 "threads = 3\n"
                                 "keep-revisions = 12\n"
                                 "insecure = true\r\n"
                                 "log-level = debug",
                                 options));
  EXPECT_EQ(options.data_dir, "/tmp/some dir#1");
  EXPECT_EQ(options.listen.ToString(), "0.0.0.0:99");
  EXPECT_EQ(options.memory_bytes, int64_t{1} << 30);
  EXPECT_EQ(options.thread_count, 3);
  EXPECT_EQ(options.kept_revision_count, 12);
  EXPECT_TRUE(options.insecure);
  EXPECT_EQ(options.log_level, "debug");
}

TEST(ApplyConfigFile, NamesFileAndLine) {
  ServerOptions options;
  EXPECT_THAT(
      ApplyConfig("line.conf", "data = d\nthreads\n", options),
      StatusIs(kInvalid, HasSubstr("line.conf:2: expected NAME = VALUE")));
  EXPECT_THAT(
      ApplyConfig("name.conf", "datum = d\n", options),
      StatusIs(kInvalid, AllOf(HasSubstr("name.conf:1"), HasSubstr("datum"))));
  EXPECT_THAT(ApplyConfigFile("/nowhere/at/all.conf", options),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("/nowhere")));
}

TEST(ApplyEnvironment, GoesOverTheNamesOfTheSettings) {
  const std::map<std::string, std::string> variables = {
      {"MAPSIEVED_DATA", "from-env"}, {"MAPSIEVED_LOG_LEVEL", "error"}};
  const auto get = [&](const char* name) {
    const auto at = variables.find(name);
    return at == variables.end() ? nullptr : at->second.c_str();
  };
  ServerOptions options = OptionsFor("before");
  options.thread_count = 5;
  MAPSIEVE_ASSERT_OK(ApplyEnvironment(get, options));
  EXPECT_EQ(options.data_dir, "from-env");
  EXPECT_EQ(options.log_level, "error");
  EXPECT_EQ(options.thread_count, 5);
}

}  // namespace
}  // namespace mapsieve::rpc
