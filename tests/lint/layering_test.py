#!/usr/bin/python3
"""Tests layering.py: it accepts a tree that keeps all rules, and finds each
violation, one at a time, in an otherwise good tree."""

import pathlib
import tempfile
import unittest

import layering

# A small tree that uses all that each folder may use.
GOOD = {
    "core/base/mutex.h": "#include <mutex>\n",
    "core/base/executor.cc": '#include <thread>\n#include "core/base/mutex.h"\n',
    "core/base/hash.cc": '#include "xxhash.h"\n'
                         "void F() { throw std::bad_alloc(); }\n",
    "core/octree/tree.cc": '#include <nanoflann.hpp>\n#include "Eigen/Core"\n'
                           '#include "octomap/octomap.h"\n',
    "core/spdf/filter.cc": '#include "core/cloud/column.h"\n'
                           '#include "absl/status/status.h"\n',
    "core/codec/codec.cc": '#include "lz4.h"\n#include <zstd.h>\n'
                           '#include "xxhash.h"\n',
    "core/CMakeLists.txt":
        "target_link_libraries(mapsieve_base PUBLIC absl::status\n"
        "  Threads::Threads PRIVATE mapsieve_options PkgConfig::XXHASH)\n"
        "target_link_libraries(mapsieve_core PUBLIC mapsieve_base)\n",
    "storage/store.h": '#include <sqlite3.h>\n#include "core/codec/codec.h"\n',
    "storage/posix_file_system.cc": "#include <fcntl.h>\n"
                                    "#include <sys/stat.h>\n",
    "storage/CMakeLists.txt":
        "target_link_libraries(mapsieve_storage PUBLIC mapsieve_codec  # ours\n"
        "  PRIVATE SQLite::SQLite3)\n",
    "server/engine/engine.h": '#include "core/spdf/filter.h"\n'
                              '#include "storage/store.h"\n',
    "server/rpc/service.h": '#include "grpcpp/server.h"\n'
                            '#include "mapsieve/v1/types.pb.h"\n'
                            '#include "server/engine/engine.h"\n',
    "server/main.cc": "#include <iostream>\n#include <signal.h>\n"
                      '#include "absl/synchronization/mutex.h"\n'
                      '#include "CLI/CLI.hpp"\n'
                      'int main() { std::cerr << "x"; exit(2); }\n',
    "client/api/client.h": '#include "core/codec/codec.h"\n'
                           '#include "Eigen/Core"\n',
    "client/api/client.cc": '#include "client/api/client.h"\n'
                            '#include "grpcpp/channel.h"\n',
    "client/formats/las.cc": "#include <fcntl.h>\n#include <lzf.h>\n"
                             '#include "core/cloud/column.h"\n',
    "client/lab/image.cc": "#include <png.h>\n#include <ft2build.h>\n"
                           '#include "client/formats/las.h"\n',
    "client/cli/main.cc": '#include "client/api/client.h"\n'
                          '#include "nlohmann/json.hpp"\n'
                          'void F() { std::printf("x"); throw 1; }\n',
    # Nothing of this is code.
    "core/cloud/talk.cc":
        '// printf("x"); exit(1); throw std::cout;\n'
        "/* #define\n   abort(); */\n"
        'const char* kText = "\\"exit(1) // throw";\n'
        'const auto kRaw = R"(abort() "throw" )";\n'
        "const int kBig = 1'000'000;\n"
        "bool Ok(int n) { return app.exit(n) && snprintf(b, 1, f); }\n",
}

# Files that each break one rule, and what the complaint says.
BAD = [
    # core: geometry and algorithms, no outside world.
    ("core/a.h", "#include <fstream>\n", "not for this folder"),
    ("core/a.h", "#include <filesystem>\n", "not for this folder"),
    ("core/a.h", "#include <iostream>\n", "not for this folder"),
    ("core/a.h", "#include <chrono>\n", "not for this folder"),
    ("core/a.h", '#include "absl/time/clock.h"\n', "not for this folder"),
    ("core/a.h", '#include "absl/log/log.h"\n', "not for this folder"),
    ("core/a.h", "#include <thread>\n", "not for this folder"),
    ("core/a.h", "#include <unistd.h>\n", "may not use posix"),
    ("core/a.h", "#include <sys/socket.h>\n", "may not use posix"),
    ("core/a.h", '#include "spdlog/spdlog.h"\n', "may not use spdlog"),
    ("core/a.h", '#include "grpcpp/grpcpp.h"\n', "may not use grpc"),
    ("core/a.h", '#include "google/protobuf/message.h"\n',
     "may not use protobuf"),
    ("core/a.h", "#include <nanoflann.hpp>\n", "not for headers"),
    ("core/a.h", "#include <octomap/octomap.h>\n", "not for headers"),
    ("core/a.cc", '#include "core/codec/codec.h"\n', "not for this folder"),
    ("core/a.cc", '#include "storage/store.h"\n', "may not use that one"),
    ("core/a.cc", '#include "tests/testing/clouds.h"\n',
     "may not use that one"),
    ("core/base/a.cc", '#include "core/cloud/column.h"\n',
     "may not use that one"),
    ("core/spdf/a.cc", "#include <nanoflann.hpp>\n", "may not use nanoflann"),
    ("core/spdf/a.cc", "#include <lz4.h>\n", "may not use lz4"),
    ("core/codec/a.h", "#include <lz4.h>\n", "not for headers"),
    ("core/codec/a.h", "#include <zstd.h>\n", "not for headers"),
    ("core/codec/a.h", "#include <xxhash.h>\n", "not for headers"),
    ("core/codec/a.cc", "#include <cstdio>\n", "not for this folder"),
    ("core/codec/a.cc", '#include "core/spdf/filter.h"\n',
     "may not use that one"),
    # storage
    ("storage/a.cc", "#include <unistd.h>\n", "may not use posix"),
    ("storage/a.cc", '#include "grpcpp/grpcpp.h"\n', "may not use grpc"),
    ("storage/a.cc", '#include "mapsieve/v1/types.pb.h"\n',
     "may not use proto"),
    ("storage/a.cc", '#include "core/spdf/filter.h"\n',
     "may not use that one"),
    ("storage/a.cc", '#include "server/engine/engine.h"\n',
     "may not use that one"),
    # server
    ("server/engine/a.cc", '#include "grpcpp/grpcpp.h"\n', "may not use grpc"),
    ("server/engine/a.cc", '#include "mapsieve/v1/types.pb.h"\n',
     "may not use proto"),
    ("server/engine/a.cc", "#include <sqlite3.h>\n", "may not use sqlite"),
    ("server/engine/a.cc", '#include "server/rpc/service.h"\n',
     "may not use that one"),
    ("server/engine/a.cc", '#include "client/api/client.h"\n',
     "may not use that one"),
    ("server/rpc/a.cc", "#include <fstream>\n", "not for this folder"),
    ("server/rpc/a.cc", "#include <fcntl.h>\n", "may not use posix"),
    ("server/rpc/a.cc", '#include "storage/store.h"\n',
     "may not use that one"),
    ("server/rpc/a.cc", '#include "core/spdf/filter.h"\n',
     "may not use that one"),
    ("server/a.cc", '#include "storage/store.h"\n', "may not use that one"),
    # client
    ("client/api/a.h", '#include "grpcpp/grpcpp.h"\n', "not for headers"),
    ("client/api/a.h", '#include "mapsieve/v1/types.pb.h"\n',
     "not for headers"),
    ("client/api/a.cc", '#include "client/formats/las.h"\n',
     "may not use that one"),
    ("client/api/a.cc", '#include "client/lab/image.h"\n',
     "may not use that one"),
    ("client/api/a.cc", '#include "server/engine/engine.h"\n',
     "may not use that one"),
    ("client/formats/a.cc", '#include "grpcpp/grpcpp.h"\n',
     "may not use grpc"),
    ("client/formats/a.cc", '#include "core/spdf/filter.h"\n',
     "may not use that one"),
    ("client/formats/a.cc", '#include "client/lab/image.h"\n',
     "may not use that one"),
    ("client/formats/a.h", "#include <lzf.h>\n", "not for headers"),
    ("client/lab/a.h", "#include <png.h>\n", "not for headers"),
    ("client/lab/a.cc", '#include "grpcpp/grpcpp.h"\n', "may not use grpc"),
    ("client/lab/a.cc", '#include "client/api/client.h"\n',
     "may not use that one"),
    ("client/cli/a.cc", '#include "grpcpp/grpcpp.h"\n', "may not use grpc"),
    ("client/cli/a.cc", '#include "storage/store.h"\n',
     "may not use that one"),
    # Everywhere.
    ("client/cli/a.cc", "#include <ranges>\n", "Clang 14"),
    ("client/cli/a.cc", "#  include <format>\n", "GCC 12"),
    ("client/cli/a.cc", "#include <expected>\n", "absl::StatusOr"),
    ("client/cli/a.cc", "#include <mutex>\n", "core/base/mutex.h"),
    ("server/engine/a.h", '#include "absl/synchronization/mutex.h"\n',
     "core/base/mutex.h"),
    ("client/lab/a.cc", '#include "boost/any.hpp"\n', "no library"),
    ("client/viewer/a.cc", "\n", "no rule"),
    ("server/engine/engine.cc",
     '#include <vector>\n#include "server/engine/engine.h"\n',
     "own header"),
    # Libraries neither print, exit nor throw.
    ("client/lab/a.cc", 'void F() { std::cout << "x"; }\n', "never prints"),
    ("core/a.cc", 'void F() { std::cerr << "x"; }\n', "never prints"),
    ("storage/a.cc", 'void F() { printf("x"); }\n', "never prints"),
    ("storage/a.cc", 'void F() { std::fprintf(stderr, "x"); }\n',
     "never prints"),
    ("server/engine/a.cc", "void F() { exit(1); }\n", "never ends"),
    ("server/engine/a.cc", "void F() { std::abort(); }\n", "never ends"),
    ("client/api/a.cc", "void F() { throw 1; }\n", "never throws"),
    # What is linked.
    ("core/spdf/CMakeLists.txt",
     "target_link_libraries(mapsieve_core PRIVATE gRPC::grpc++)\n",
     "may not use grpc"),
    ("core/spdf/CMakeLists.txt",
     "target_link_libraries(mapsieve_core PUBLIC mapsieve_codec)\n",
     "may not use that one"),
    ("core/codec/CMakeLists.txt",
     "target_link_libraries(mapsieve_codec\n  PUBLIC mapsieve_core\n  "
     "PRIVATE mapsieve_storage)\n", "may not use that one"),
    ("server/CMakeLists.txt",
     "target_link_libraries(mapsieve_engine PUBLIC mapsieve_proto)\n",
     "may not use proto"),
    ("client/CMakeLists.txt",
     "target_link_libraries(mapsieve_lab PRIVATE mapsieve_client)\n",
     "may not use that one"),
    ("client/lab/CMakeLists.txt",
     "target_link_libraries(mapsieve_lab PRIVATE Boost::any)\n", "no library"),
]


def complaints_about(files):
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        for name, text in files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return list(layering.check_tree(root))


class LayeringTest(unittest.TestCase):

    def test_accepts_a_tree_that_keeps_the_rules(self):
        self.assertEqual(complaints_about(GOOD), [])

    def test_finds_each_violation(self):
        for name, text, complaint in BAD:
            with self.subTest(file=name, text=text):
                self.assertNotIn(name, GOOD)
                found = complaints_about({**GOOD, name: text})
                self.assertTrue(found)
                self.assertEqual(found, [c for c in found if name in c])
                self.assertIn(complaint, found[0])

    def test_finds_every_violation_of_a_file_with_its_line(self):
        found = complaints_about({
            "core/a.cc": '\n#include <ranges>\n\n#include "storage/a.h"\n'
                         "/* two\n   lines */ void F() { exit(1); }\n"})
        self.assertEqual([c.split(": ")[0] for c in found],
                         ["core/a.cc:2", "core/a.cc:4", "core/a.cc:6"])

    def test_rules_name_what_exists(self):
        for folder, rule in layering.RULES.items():
            for name in rule.may + rule.targets:
                self.assertTrue(
                    name in layering.LIBRARIES or
                    name.split("/")[0] in layering.SOURCE_FOLDERS,
                    f"{folder}: {name}")


if __name__ == "__main__":
    unittest.main()
