#ifndef MAPSIEVE_CLIENT_LAB_TEXT_H_
#define MAPSIEVE_CLIENT_LAB_TEXT_H_

#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "client/lab/image.h"

namespace mapsieve::client {

/// A typeface that draws on images. Texts are UTF-8; bytes that are not, and
/// characters that the typeface lacks, show as its replacement glyph. Sizes are
/// pixels of the em. Not thread-safe.
class Font {
 public:
  /// Opens a font file, or, if `path` is empty, the system's DejaVu Sans.
  /// kNotFound: no such file, or DejaVu Sans is not installed;
  /// kInvalidArgument: not a font.
  static absl::StatusOr<Font> Open(const std::filesystem::path& path);

  Font(Font&& other) noexcept;
  Font& operator=(Font&& other) noexcept;
  ~Font();

  /// Pixels from the start of `text` to its end.
  double Width(std::string_view text, double size) const;
  /// `text`, or as much of its start as fits `max_width`, then an ellipsis.
  std::string Fit(std::string_view text, double size, double max_width) const;
  /// Draws `text` from `x` on, on the line `baseline`.
  void Draw(std::string_view text, double size, double x, double baseline,
            Color color, Image& image) const;

 private:
  struct Library;
  explicit Font(std::unique_ptr<Library> library);

  std::unique_ptr<Library> library_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_TEXT_H_
