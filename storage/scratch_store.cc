#include "storage/scratch_store.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "storage/names.h"

namespace mapsieve::storage {
namespace {

constexpr size_t kMaxNameBytes = 120;
constexpr int64_t kMaxBytes = int64_t{1} << 32;

absl::Status CheckName(const std::string& name) {
  if (!name.empty() && name.size() <= kMaxNameBytes &&
      std::all_of(name.begin(), name.end(), [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-';
      })) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrCat("scratch name ", Quoted(name), ": expected 1 to ",
                   kMaxNameBytes, " of a-z, 0-9 and -"));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Scratch>> Scratch::Create(
    FileSystem& file_system, std::string directory,
    const SpaceReserve& reserve) {
  MAPSIEVE_RETURN_IF_ERROR(file_system.RemoveTree(directory));
  MAPSIEVE_RETURN_IF_ERROR(file_system.MakeDirectories(directory));
  return std::unique_ptr<Scratch>(new Scratch(file_system, std::move(directory),
                                              reserve, /*is_lasting=*/false));
}

std::unique_ptr<Scratch> Scratch::OpenLasting(FileSystem& file_system,
                                              std::string directory,
                                              const SpaceReserve& reserve) {
  return std::unique_ptr<Scratch>(new Scratch(file_system, std::move(directory),
                                              reserve, /*is_lasting=*/true));
}

Scratch::Scratch(FileSystem& file_system, std::string directory,
                 const SpaceReserve& reserve, bool is_lasting)
    : file_system_(file_system),
      directory_(std::move(directory)),
      reserve_(reserve),
      is_lasting_(is_lasting) {}

Scratch::~Scratch() {
  if (is_lasting_) return;
  // What stays is removed when the store is opened again.
  file_system_.RemoveTree(directory_).IgnoreError();
}

absl::StatusOr<SpaceReserve::Claim> Scratch::RoomFor(const std::string& name,
                                                     int64_t size) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckName(name));
  if (size > kMaxBytes) {
    return absl::InvalidArgumentError(absl::StrCat("scratch ", name, " of ",
                                                   size, " bytes: at most ",
                                                   kMaxBytes, " are kept"));
  }
  return reserve_.Take(size);
}

absl::Status Scratch::Write(const std::string& name,
                            std::span<const std::byte> bytes) {
  const auto size = static_cast<int64_t>(bytes.size());
  MAPSIEVE_ASSIGN_OR_RETURN(const auto room, RoomFor(name, size));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto file,
      file_system_.Open(JoinPath(directory_, name), OpenMode::kCreateIfAbsent));
  MAPSIEVE_RETURN_IF_ERROR(file->WriteAt(0, bytes));
  return file->Truncate(size);
}

absl::Status Scratch::Append(const std::string& name,
                             std::span<const std::byte> bytes) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto room,
                            RoomFor(name, static_cast<int64_t>(bytes.size())));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const auto file,
      file_system_.Open(JoinPath(directory_, name), OpenMode::kCreateIfAbsent));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, file->Size());
  return file->WriteAt(size, bytes);
}

absl::StatusOr<std::vector<std::byte>> Scratch::Read(
    const std::string& name) const {
  MAPSIEVE_RETURN_IF_ERROR(CheckName(name));
  const std::string path = JoinPath(directory_, name);
  MAPSIEVE_ASSIGN_OR_RETURN(const auto file,
                            file_system_.Open(path, OpenMode::kRead));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t size, file->Size());
  if (size > kMaxBytes) {
    return absl::DataLossError(absl::StrCat(path, ": expected at most ",
                                            kMaxBytes,
                                            " bytes, the file holds ", size));
  }
  return ReadExactly(*file, path, 0, size);
}

absl::Status Scratch::ReadParts(const std::string& name,
                                std::span<const ByteRange> parts,
                                std::span<std::byte> room) const {
  // To read a small gap costs less than another call.
  constexpr int64_t kMaxGap = 4096;
  MAPSIEVE_RETURN_IF_ERROR(CheckName(name));
  const std::string path = JoinPath(directory_, name);
  MAPSIEVE_ASSIGN_OR_RETURN(const auto file,
                            file_system_.Open(path, OpenMode::kRead));
  auto to = room.begin();
  for (size_t i = 0; i < parts.size();) {
    const size_t first = i;
    int64_t end = parts[i++].end;
    while (i < parts.size() && parts[i].begin - end <= kMaxGap) {
      end = parts[i++].end;
    }
    const int64_t begin = parts[first].begin;
    MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<std::byte> bytes,
                              ReadExactly(*file, path, begin, end - begin));
    for (const ByteRange& part : parts.subspan(first, i - first)) {
      to = std::copy(bytes.begin() + (part.begin - begin),
                     bytes.begin() + (part.end - begin), to);
    }
  }
  return absl::OkStatus();
}

absl::Status Scratch::Remove(const std::string& name) {
  MAPSIEVE_RETURN_IF_ERROR(CheckName(name));
  const absl::Status status = file_system_.Remove(JoinPath(directory_, name));
  return absl::IsNotFound(status) ? absl::OkStatus() : status;
}

absl::Status Scratch::Clear() {
  MAPSIEVE_RETURN_IF_ERROR(file_system_.RemoveTree(directory_));
  return file_system_.MakeDirectories(directory_);
}

}  // namespace mapsieve::storage
