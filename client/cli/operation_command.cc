#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/api/map_client.h"
#include "client/cli/commands.h"
#include "client/cli/output.h"
#include "client/cli/progress_bar.h"
#include "core/base/status.h"

namespace mapsieve::client {

absl::Status RunOperation(const CommonOptions& common,
                          const OperationCommand& command) {
  MapClient client(common.server, absl::Seconds(common.retry_s));
  if (command.cancel) {
    MAPSIEVE_RETURN_IF_ERROR(client.CancelOperation(command.operation));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const OperationInfo operation,
                            client.GetOperation(command.operation));
  absl::Status ended;
  {
    ProgressBar bar(absl::StrCat(operation.verb, " of ", operation.target),
                    "units");
    ended = client.WaitForOperation(
        command.operation,
        [&bar](int64_t done, int64_t total) { bar.Report(done, total); });
  }
  const bool is_cancelled = command.cancel && absl::IsCancelled(ended);
  if (!is_cancelled) MAPSIEVE_RETURN_IF_ERROR(ended);
  PrintResult(common.json,
              {{"operation", operation.id},
               {"verb", operation.verb},
               {"target", operation.target},
               {"state", is_cancelled ? "cancelled" : "succeeded"}});
  return absl::OkStatus();
}

}  // namespace mapsieve::client
