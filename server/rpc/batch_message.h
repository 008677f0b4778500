#ifndef MAPSIEVE_SERVER_RPC_BATCH_MESSAGE_H_
#define MAPSIEVE_SERVER_RPC_BATCH_MESSAGE_H_

#include <cstddef>
#include <string>
#include <vector>

#include "grpcpp/support/byte_buffer.h"

namespace mapsieve::rpc {

/// The bytes of a v1::QueryRegionResponse whose batch holds `blocks`, back to
/// back, and `resume_token`. The blocks are sent from where they lie: writing
/// them into a message and that into a buffer would copy them twice.
grpc::ByteBuffer MakeBatchMessage(std::vector<std::vector<std::byte>> blocks,
                                  const std::string& resume_token);

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_RPC_BATCH_MESSAGE_H_
