#ifndef MAPSIEVE_CLIENT_CLI_GNUPLOT_H_
#define MAPSIEVE_CLIENT_CLI_GNUPLOT_H_

#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace mapsieve::client {

/// Runs gnuplot on `script` in a process of its own and returns what it writes
/// on its standard output, where a script that sets no output draws.
/// kFailedPrecondition: there is no gnuplot, with the package to install;
/// kInvalidArgument: gnuplot refuses the script, with its message;
/// kResourceExhausted: no room for temporary files or processes.
absl::StatusOr<std::string> RunGnuplot(std::string_view script);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_GNUPLOT_H_
