#include "storage/file_system.h"

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "storage/space_reserve.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/fault_file_system.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {
namespace {

using ::mapsieve::testing::IsOk;
using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class PosixFileSystemTest : public ::testing::Test {
 protected:
  std::unique_ptr<File> Create(const std::string& name) {
    auto file = files_.Open(directory_ / name, OpenMode::kCreateNew);
    EXPECT_THAT(file, IsOk());
    return *std::move(file);
  }

  FileSystem& files_ = PosixFileSystem();
  TemporaryDirectory directory_;
};

TEST_F(PosixFileSystemTest, AFileHoldsWhatWasWritten) {
  const auto file = Create("a");
  MAPSIEVE_ASSERT_OK(file->WriteAt(0, Bytes("hello")));
  MAPSIEVE_ASSERT_OK(file->WriteAt(7, Bytes("there")));
  MAPSIEVE_ASSERT_OK(file->Sync());
  EXPECT_EQ(*file->Size(), 12);
  std::vector<std::byte> buffer(20);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const size_t got, file->ReadAt(0, buffer));
  buffer.resize(got);
  EXPECT_EQ(Text(buffer), std::string("hello\0\0there", 12));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const size_t tail, file->ReadAt(10, buffer));
  EXPECT_EQ(tail, 2u);
  MAPSIEVE_ASSERT_OK(file->Truncate(3));
  EXPECT_EQ(*files_.FileSize(directory_ / "a"), 3);
}

TEST_F(PosixFileSystemTest, OpenModesSayWhatMustExist) {
  const std::string path = directory_ / "a";
  EXPECT_THAT(files_.Open(path, OpenMode::kRead),
              StatusIs(absl::StatusCode::kNotFound,
                       AllOf(HasSubstr(path), HasSubstr("open"))));
  EXPECT_THAT(files_.Open(path, OpenMode::kReadWrite),
              StatusIs(absl::StatusCode::kNotFound, _));
  EXPECT_THAT(files_.Open(path, OpenMode::kCreateIfAbsent), IsOk());
  EXPECT_THAT(files_.Open(path, OpenMode::kCreateNew),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr(path)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto file,
                                files_.Open(path, OpenMode::kRead));
  EXPECT_FALSE(file->WriteAt(0, Bytes("x")).ok());
  EXPECT_THAT(files_.Open(directory_.path(), OpenMode::kRead),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
  EXPECT_THAT(files_.Open(path + "/b", OpenMode::kRead),
              StatusIs(absl::StatusCode::kFailedPrecondition, _));
}

TEST_F(PosixFileSystemTest, NamesAreRenamedRemovedAndListed) {
  Create("b");
  Create("a");
  MAPSIEVE_ASSERT_OK(files_.MakeDirectories(directory_ / "d/e/f/"));
  MAPSIEVE_ASSERT_OK(files_.MakeDirectories(directory_ / "d/e"));
  EXPECT_THAT(*files_.List(directory_.path()), ElementsAre("a", "b", "d"));
  EXPECT_THAT(*files_.List(directory_ / "d/e"), ElementsAre("f"));
  MAPSIEVE_ASSERT_OK(files_.Rename(directory_ / "a", directory_ / "b"));
  MAPSIEVE_ASSERT_OK(files_.SyncDirectory(directory_.path()));
  EXPECT_FALSE(*files_.Exists(directory_ / "a"));
  EXPECT_TRUE(*files_.Exists(directory_ / "b"));
  MAPSIEVE_ASSERT_OK(files_.Remove(directory_ / "b"));
  EXPECT_THAT(files_.Remove(directory_ / "b"),
              StatusIs(absl::StatusCode::kNotFound, _));
  MAPSIEVE_ASSERT_OK(files_.RemoveTree(directory_ / "d"));
  MAPSIEVE_ASSERT_OK(files_.RemoveTree(directory_ / "d"));
  EXPECT_THAT(*files_.List(directory_.path()), ElementsAre());
  EXPECT_THAT(files_.List(directory_ / "d"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("list")));
  EXPECT_THAT(files_.SyncDirectory(directory_ / "d"),
              StatusIs(absl::StatusCode::kNotFound, _));
}

TEST_F(PosixFileSystemTest, AFileInTheWayOfADirectoryIsNamed) {
  Create("a");
  EXPECT_THAT(files_.MakeDirectories(directory_ / "a"),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("/a")));
  EXPECT_FALSE(files_.MakeDirectories(directory_ / "a/b").ok());
}

TEST_F(PosixFileSystemTest, ALockIsHeldOnce) {
  const std::string path = directory_ / "lock";
  {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto lock, files_.Lock(path));
    EXPECT_THAT(files_.Lock(path),
                StatusIs(absl::StatusCode::kAborted,
                         HasSubstr("process " + std::to_string(::getpid()))));
  }
  EXPECT_THAT(files_.Lock(path), IsOk());
}

TEST_F(PosixFileSystemTest, ALockDiesWithItsProcess) {
  const std::string path = directory_ / "lock";
  int ready[2];
  ASSERT_EQ(::pipe(ready), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    const auto lock = files_.Lock(path);
    const char byte = lock.ok() ? 'y' : 'n';
    if (::write(ready[1], &byte, 1) == 1) ::pause();
    ::_exit(1);
  }
  char byte = 0;
  ASSERT_EQ(::read(ready[0], &byte, 1), 1);
  EXPECT_EQ(byte, 'y');
  EXPECT_THAT(files_.Lock(path),
              StatusIs(absl::StatusCode::kAborted,
                       HasSubstr("process " + std::to_string(child))));
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  EXPECT_THAT(files_.Lock(path), IsOk());
  ::close(ready[0]);
  ::close(ready[1]);
}

TEST_F(PosixFileSystemTest, ReadExactlyMissesNoByte) {
  const auto file = Create("a");
  MAPSIEVE_ASSERT_OK(file->WriteAt(0, Bytes("hello")));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto bytes,
                                ReadExactly(*file, "a", 1, 4));
  EXPECT_EQ(Text(bytes), "ello");
  EXPECT_THAT(ReadExactly(*file, "a", 2, 4),
              StatusIs(absl::StatusCode::kDataLoss,
                       "a, offset 2: expected 4 bytes, the file holds 3"));
}

TEST_F(PosixFileSystemTest, TheReserveIsLeftFree) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const int64_t free,
                                files_.FreeBytes(directory_.path()));
  EXPECT_GT(free, 0);
  const SpaceReserve modest(files_, directory_.path(), 0);
  MAPSIEVE_EXPECT_OK(modest.Take(1));
  const SpaceReserve greedy(files_, directory_.path(), int64_t{1} << 60);
  EXPECT_THAT(greedy.Take(1), StatusIs(absl::StatusCode::kResourceExhausted,
                                       HasSubstr("reserve")));
}

TEST(SpaceReserve, WritersAtTheSameTimeDoNotGetTheSameRoom) {
  testing::FaultFileSystem files(PosixFileSystem());
  files.SetFreeBytes(100);
  const SpaceReserve reserve(files, "/", 40);
  {
    const auto first = reserve.Take(50);
    MAPSIEVE_EXPECT_OK(first);
    MAPSIEVE_EXPECT_OK(reserve.Take(10));
    EXPECT_THAT(reserve.Take(11),
                StatusIs(absl::StatusCode::kResourceExhausted, _));
  }
  // What was refused, and what was written, holds no room.
  MAPSIEVE_EXPECT_OK(reserve.Take(60));
  MAPSIEVE_EXPECT_OK(reserve.Take(60));
  EXPECT_THAT(reserve.Take(61),
              StatusIs(absl::StatusCode::kResourceExhausted, _));
}

}  // namespace
}  // namespace mapsieve::storage
