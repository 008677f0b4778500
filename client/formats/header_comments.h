#ifndef MAPSIEVE_CLIENT_FORMATS_HEADER_COMMENTS_H_
#define MAPSIEVE_CLIENT_FORMATS_HEADER_COMMENTS_H_

#include <string>
#include <string_view>

#include "client/formats/point_file.h"

/// What PLY and PCD have no fields for and keep in comments of their headers,
/// a line each: "frame_id: TEXT" and "crs: TEXT".
namespace mapsieve::client {

/// Takes the text of a comment into `info` if it is one of these; of a CRS only
/// WKT and codes of EPSG, for other programs write such comments too.
void TakeHeaderComment(std::string_view comment, PointFileInfo& info);

/// The lines for `options`, each behind `prefix`. A text that makes a line too
/// long for readers of such files is left out; of a CRS as long WKT there are
/// the codes of EPSG that it bears, "EPSG:n" or "EPSG:n+m".
std::string MakeHeaderComments(std::string_view prefix,
                               const WriteOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_HEADER_COMMENTS_H_
