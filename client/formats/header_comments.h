#ifndef MAPSIEVE_CLIENT_FORMATS_HEADER_COMMENTS_H_
#define MAPSIEVE_CLIENT_FORMATS_HEADER_COMMENTS_H_

#include <string>
#include <string_view>

#include "client/formats/point_file.h"

/// What PLY and PCD have no fields for and keep in comments of their headers,
/// a line each: "frame_id: TEXT" and "crs: TEXT".
namespace mapsieve::client {

/// Takes the text of a comment into `info` if it is one of these; of a CRS only
/// WKT and "EPSG:n", for other programs write such comments too.
void TakeHeaderComment(std::string_view comment, PointFileInfo& info);

/// The lines for `options`, each behind `prefix`. A text that makes a line too
/// long for readers of such files, that is a CRS as long WKT, is left out.
std::string MakeHeaderComments(std::string_view prefix,
                               const WriteOptions& options);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_HEADER_COMMENTS_H_
