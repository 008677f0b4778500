#include "client/lab/text.h"

#include <ft2build.h>
#include FT_FREETYPE_H

#include <array>
#include <cmath>
#include <cstdint>
#include <system_error>
#include <utility>
#include <vector>

#include "core/base/status.h"

namespace mapsieve::client {
namespace {

// Where distributions put DejaVu Sans: Debian and Ubuntu, Fedora, Arch, Alpine.
constexpr std::array<const char*, 4> kSystemFonts = {
    "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf",
    "/usr/share/fonts/dejavu-sans-fonts/DejaVuSans.ttf",
    "/usr/share/fonts/TTF/DejaVuSans.ttf",
    "/usr/share/fonts/dejavu/DejaVuSans.ttf",
};

constexpr char32_t kReplacement = 0xFFFD;

// Code points of `text`; every byte that starts no sequence is a replacement.
std::u32string DecodeUtf8(std::string_view text) {
  std::u32string result;
  for (size_t i = 0; i < text.size();) {
    const auto byte = [&](size_t at) {
      return at < text.size() ? static_cast<uint8_t>(text[at]) : uint8_t{0};
    };
    const uint8_t lead = byte(i);
    const size_t length = lead < 0x80             ? 1
                          : (lead & 0xE0) == 0xC0 ? 2
                          : (lead & 0xF0) == 0xE0 ? 3
                          : (lead & 0xF8) == 0xF0 ? 4
                                                  : 0;
    char32_t code = length <= 1 ? lead : lead & (0x7F >> length);
    bool valid = length != 0;
    for (size_t k = 1; k < length; ++k) {
      valid = valid && (byte(i + k) & 0xC0) == 0x80;
      code = code << 6 | (byte(i + k) & 0x3F);
    }
    result.push_back(valid ? code : kReplacement);
    i += valid ? length : 1;
  }
  return result;
}

}  // namespace

struct Font::Library {
  FT_Library library = nullptr;
  FT_Face face = nullptr;

  ~Library() {
    if (face != nullptr) FT_Done_Face(face);
    if (library != nullptr) FT_Done_FreeType(library);
  }

  // Visits the glyphs of `text`, which starts at `pen`, with the pixel columns
  // that they count from; returns the pen after the last one. The glyphs have
  // pictures if `render` is set.
  template <typename Visit>
  double ForEachGlyph(std::string_view text, double size, double pen,
                      bool render, Visit&& visit) const {
    if (FT_Set_Char_Size(face, 0, std::lround(size * 64), 72, 72) != 0) {
      return pen;
    }
    const auto flags = static_cast<FT_Int32>(FT_LOAD_NO_HINTING |
                                             (render ? FT_LOAD_RENDER : 0));
    for (const char32_t code : DecodeUtf8(text)) {
      const double column = std::floor(pen);
      FT_Vector shift{std::lround((pen - column) * 64), 0};
      FT_Set_Transform(face, nullptr, &shift);
      if (FT_Load_Char(face, code, flags) != 0) continue;
      visit(*face->glyph, static_cast<int>(column));
      pen += static_cast<double>(face->glyph->linearHoriAdvance) / 65536;
    }
    return pen;
  }
};

Font::Font(std::unique_ptr<Library> library) : library_(std::move(library)) {}
Font::Font(Font&& other) noexcept = default;
Font& Font::operator=(Font&& other) noexcept = default;
Font::~Font() = default;

absl::StatusOr<Font> Font::Open(const std::filesystem::path& path) {
  std::filesystem::path file = path;
  std::error_code error;
  for (const char* system_font : kSystemFonts) {
    if (!file.empty()) break;
    if (std::filesystem::exists(system_font, error)) file = system_font;
  }
  if (file.empty()) {
    return absl::NotFoundError(
        "captions need the font DejaVu Sans, which is not installed: install "
        "the package fonts-dejavu-core, name another font file, or draw "
        "without captions");
  }
  if (!std::filesystem::exists(file, error)) {
    return absl::NotFoundError(
        absl::StrCat("font ", file.string(), ": no such file"));
  }
  auto library = std::make_unique<Library>();
  if (FT_Init_FreeType(&library->library) != 0) {
    return absl::ResourceExhaustedError("FreeType cannot be started");
  }
  if (FT_New_Face(library->library, file.c_str(), 0, &library->face) != 0 ||
      (library->face->face_flags & FT_FACE_FLAG_SCALABLE) == 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("font ", file.string(), ": not a scalable font file"));
  }
  return Font(std::move(library));
}

double Font::Width(std::string_view text, double size) const {
  return library_->ForEachGlyph(text, size, 0, /*render=*/false,
                                [](const auto&, int) {});
}

std::string Font::Fit(std::string_view text, double size,
                      double max_width) const {
  if (Width(text, size) <= max_width) return std::string(text);
  while (!text.empty()) {
    // Take a whole character away: its continuation bytes, then its lead.
    while (text.size() > 1 && (text.back() & 0xC0) == 0x80) {
      text.remove_suffix(1);
    }
    text.remove_suffix(1);
    std::string shorter = std::string(text) + "…";
    if (Width(shorter, size) <= max_width) return shorter;
  }
  return "";
}

void Font::Draw(std::string_view text, double size, double x, double baseline,
                Color color, Image& image) const {
  library_->ForEachGlyph(
      text, size, x, /*render=*/true,
      [&](const FT_GlyphSlotRec& glyph, int first_column) {
        const int left = first_column + glyph.bitmap_left;
        const int top =
            static_cast<int>(std::lround(baseline)) - glyph.bitmap_top;
        for (unsigned row = 0; row < glyph.bitmap.rows; ++row) {
          const uint8_t* coverage =
              glyph.bitmap.buffer +
              static_cast<ptrdiff_t>(row) * glyph.bitmap.pitch;
          for (unsigned column = 0; column < glyph.bitmap.width; ++column) {
            image.Blend(left + static_cast<int>(column),
                        top + static_cast<int>(row), color,
                        coverage[column] / 255.0);
          }
        }
      });
}

}  // namespace mapsieve::client
