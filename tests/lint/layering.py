#!/usr/bin/python3
"""Checks who may use what: the table of CONTRIBUTING.md, "Layers"; and that a
source file includes its own header first.

    layering.py ROOT

Reads the #include lines and the code below core, storage, server and client of
ROOT, and what their CMakeLists.txt link. Prints one line a violation and exits
with 1 if there is any.
"""

import pathlib
import re
import sys

# Third-party libraries: the headers that belong to each (a prefix), and its
# CMake targets (a prefix).
LIBRARIES = {
    "abseil": (("absl/",), ("absl::",)),
    "cli11": (("CLI/",), ("CLI11::",)),
    "eigen": (("Eigen/", "unsupported/Eigen/"), ("Eigen3::",)),
    "freetype": (("ft2build.h", "freetype/"), ("Freetype::",)),
    "geotiff": (("geotiff/",), ("${GEOTIFF_LIBRARY}",)),
    "glibc": (("malloc.h",), ()),
    "grpc": (("grpc/", "grpcpp/", "grpc++/"), ("gRPC::",)),
    "intrinsics": (("immintrin.h",), ()),
    "json": (("nlohmann/",), ("nlohmann_json::",)),
    "lz4": (("lz4",), ("PkgConfig::LZ4",)),
    "lzf": (("lzf.h",), ("PkgConfig::LZF",)),
    "nanoflann": (("nanoflann",), ("nanoflann::",)),
    "octomap": (("octomap/",), ("octomap", "octomath")),
    "png": (("png.h", "pngconf.h"), ("PNG::",)),
    "posix": (("unistd.h", "fcntl.h", "signal.h", "poll.h", "dirent.h",
               "dlfcn.h", "netdb.h", "pthread.h", "spawn.h", "termios.h",
               "sys/", "arpa/", "net/", "netinet/", "linux/"), ()),
    "proj": (("proj.h", "proj_experimental.h"), ("PkgConfig::PROJ",)),
    "prometheus": (("prometheus/",), ("prometheus-cpp::",)),
    "proto": (("mapsieve/v1/",), ("mapsieve_proto",)),
    "protobuf": (("google/",), ("protobuf::",)),
    "spdlog": (("spdlog/",), ("spdlog::",)),
    "sqlite": (("sqlite3",), ("SQLite::", "PkgConfig::SQLITE")),
    "threads": ((), ("Threads::",)),
    "xxhash": (("xxhash.h", "xxh3.h", "xxh_x86dispatch.h"), ("PkgConfig::XXHASH",)),
    "yaml": (("yaml-cpp/",), ("yaml-cpp",)),
    "zstd": (("zstd", "zdict.h"), ("PkgConfig::ZSTD",)),
}

# Our CMake targets and the folder that each is built from.
TARGETS = {
    "mapsieve_base": "core/base",
    "mapsieve_core": "core",
    "mapsieve_codec": "core/codec",
    "mapsieve_storage": "storage",
    "mapsieve_engine": "server/engine",
    "mapsieve_rpc": "server/rpc",
    "mapsieve_server": "server",
    "mapsieve_client": "client/api",
    "mapsieve_formats": "client/formats",
    "mapsieve_lab": "client/lab",
}
# The interface target of compile options belongs to everyone.
OPTIONS_TARGET = "mapsieve_options"

FILES = ("fstream", "filesystem", "cstdio", "stdio.h")
CLOCKS = ("chrono", "ctime", "time.h", "absl/time/")
LOGGING = ("iostream", "absl/log/")
THREADS = ("thread", "future")

# The columns that others may hold, without the algorithms on them.
CORE_TYPES = ("core/base", "core/cloud", "core/geometry")


class Rule:
    """What the files of a folder may use; the longest folder decides.

    may: folders, files and LIBRARIES. in_cc: those of `may` that headers do
    not show. never: headers, C++'s own among them, that are forbidden however
    they are spelled. targets: folders whose CMake targets may be linked
    although only some of their files may be included.
    """

    def __init__(self, may, in_cc=(), never=(), targets=()):
        self.may = tuple(may) + tuple(in_cc)
        self.in_cc = tuple(in_cc)
        self.never = tuple(never)
        self.targets = tuple(targets)


RULES = {
    "core": Rule(
        ("core", "abseil", "eigen"), in_cc=("nanoflann", "octomap"),
        never=FILES + CLOCKS + LOGGING + THREADS + ("core/codec",)),
    "core/base": Rule(
        ("core/base", "abseil", "threads", "glibc", "posix"), in_cc=("xxhash",),
        never=FILES + CLOCKS + LOGGING),
    "core/spdf": Rule(
        ("core", "abseil", "intrinsics"),
        never=FILES + CLOCKS + LOGGING + THREADS + ("core/codec",)),
    "core/codec": Rule(
        CORE_TYPES + ("core/codec", "abseil"),
        in_cc=("lz4", "zstd", "xxhash"),
        never=FILES + CLOCKS + LOGGING + THREADS, targets=("core",)),
    "storage": Rule(
        CORE_TYPES + ("core/codec", "core/spdf/labels.h", "storage",
                      "abseil", "sqlite"),
        never=LOGGING + ("fstream",), targets=("core",)),
    "server/engine": Rule(
        ("core", "storage", "server/engine", "abseil"),
        never=LOGGING + ("fstream",)),
    "server/rpc": Rule(
        CORE_TYPES + ("core/codec", "server/engine", "server/rpc", "abseil",
                      "proto", "protobuf", "grpc"),
        never=FILES + LOGGING),
    "server": Rule(
        ("core/base", "server", "abseil", "proto", "grpc", "cli11", "spdlog",
         "prometheus", "posix")),
    "client/api": Rule(
        CORE_TYPES + ("core/codec", "client/api", "abseil", "eigen"),
        in_cc=("proto", "protobuf", "grpc"), never=LOGGING),
    "client/formats": Rule(
        CORE_TYPES + ("client/formats", "abseil", "posix"),
        in_cc=("geotiff", "lzf", "octomap", "proj"),
        never=LOGGING, targets=("core",)),
    "client/lab": Rule(
        ("core", "client/formats", "client/lab", "abseil"),
        in_cc=("png", "freetype", "yaml"), never=LOGGING),
    "client/cli": Rule(
        ("core", "client", "abseil", "cli11", "json", "posix")),
    "client/python": Rule(("core", "client", "abseil")),
    "client/examples": Rule(("core", "client", "abseil")),
}

# Uses of a folder or library that one file alone has.
ONE_FILE = {
    "storage/posix_file_system.cc": ("posix",),
    "core/base/executor.cc": THREADS,
    "core/base/mutex.h": ("mutex",),
    "core/base/heap.h": ("glibc",),
    "core/base/bulk_vector.h": ("posix",),
    "core/spdf/kernel_vectors.h": ("intrinsics",),
    # Not installed: what the client shows has no generated type.
    "client/api/answers.h": ("proto", "grpc"),
    "client/api/convert.h": ("proto", "grpc"),
}

# Headers that nobody includes, with the reason.
BANNED_HEADERS = {
    "ranges": "Clang 14 cannot parse libstdc++'s <ranges>",
    "format": "GCC 12 has no <format>: use absl::StrFormat",
    "expected": "C++20 has no <expected>: use absl::StatusOr",
    "mutex": "lock with core/base/mutex.h",
    "shared_mutex": "lock with core/base/mutex.h",
    "absl/synchronization/mutex.h": "lock with core/base/mutex.h",
}

# main switches Abseil's deadlock detection off, which its mutex header offers.
MAIN_ONLY_HEADERS = ("absl/synchronization/mutex.h",)

# What libraries never do. A program is client/cli, client/examples or a
# main.cc.
LIBRARY_BANS = (
    (re.compile(r"\bstd::(cout|cerr|clog)\b"
                r"|(?<![\w.>])(?:std::)?(?:printf|fprintf|vprintf|vfprintf|"
                r"puts|fputs|putchar|perror)\s*\("),
     "a library never prints: return a status"),
    (re.compile(r"(?<![\w.>:])(?:std::|::)?(?:exit|_exit|_Exit|quick_exit|"
                r"abort|terminate)\s*\("),
     "a library never ends the process: return a status"),
    (re.compile(r"\bthrow\b(?!\s+std::bad_alloc\b)"),
     "a library never throws: return a status"),
)

SOURCE_FOLDERS = ("core", "storage", "server", "client")
INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)
COMMENT_OR_LITERAL = re.compile(
    r'//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"'
    r"|(?<![0-9a-fA-F])'(?:\\.|[^'\\\n])*'", re.DOTALL)


def within(path, prefix):
    """Whether `path` is `prefix` or lies in that folder."""
    return path == prefix or path.startswith(prefix.rstrip("/") + "/")


def named_by(header, names):
    return any(within(header, name) for name in names)


def library_of_header(header):
    for library, (prefixes, _) in LIBRARIES.items():
        for prefix in prefixes:
            # A prefix with a dot or a slash at its end is a file or a folder;
            # the others are the beginnings of names.
            if header == prefix or (not prefix.endswith(".h") and
                                    header.startswith(prefix)):
                return library
    return None


def rule_of(path):
    folders = [f for f in RULES if within(path, f)]
    return RULES[max(folders, key=len)] if folders else None


def is_program(path):
    return (within(path, "client/cli") or within(path, "client/examples") or
            pathlib.PurePosixPath(path).name == "main.cc")


def check_include(path, header, rule):
    """The complaint about one #include of the file `path`, or None."""
    alone = ONE_FILE.get(path, ())
    if named_by(header, alone):
        return None
    if header in BANNED_HEADERS and not (
            path.endswith("main.cc") and header in MAIN_ONLY_HEADERS):
        return BANNED_HEADERS[header]
    if named_by(header, rule.never):
        return "not for this folder"
    if header.split("/")[0] in SOURCE_FOLDERS + ("tests",):
        uses = [m for m in rule.may if within(header, m)]
        return None if uses else "this folder may not use that one"
    library = library_of_header(header)
    if library is None:
        # C++'s own headers have neither folder nor extension.
        if "/" not in header and "." not in header:
            return None
        return "belongs to no library in the table of layering.py"
    if library in alone:
        return None
    if library not in rule.may:
        return f"this folder may not use {library}"
    if library in rule.in_cc and path.endswith(".h"):
        return f"{library} is not for headers"
    return None


def check_own_header(path, text):
    """A source file includes its own header first: that shows that the header
    compiles alone."""
    own = path[:-len(".cc")] + ".h"
    includes = INCLUDE.findall(text)
    if not includes or includes[0] != own:
        yield f"{path}: includes {own} first: it is the file's own header"


def check_source(path, text):
    rule = rule_of(path)
    if rule is None:
        yield f"{path}: no rule of layering.py covers this folder"
        return
    for match in INCLUDE.finditer(text):
        complaint = check_include(path, match[1], rule)
        if complaint:
            line = text.count("\n", 0, match.start(1)) + 1
            yield f"{path}:{line}: includes {match[1]}: {complaint}"
    if is_program(path):
        return
    # Line breaks stay, so that lines can be counted.
    code = COMMENT_OR_LITERAL.sub(
        lambda m: re.sub(r"[^\n]", " ", m[0]), text)
    for pattern, reason in LIBRARY_BANS:
        for match in pattern.finditer(code):
            line = code.count("\n", 0, match.start()) + 1
            yield f"{path}:{line}: {match[0].strip()}: {reason}"


def cmake_calls(text, command):
    """The arguments of each call of `command`."""
    code = re.sub(r"#[^\n]*", "", text)
    for match in re.finditer(rf"\b{command}\s*\(([^()]*)\)", code):
        yield match[1].split()


def check_link(target, rule):
    if target == OPTIONS_TARGET:
        return None
    if target in TARGETS:
        module = TARGETS[target]
        allowed = any(within(module, m) for m in rule.may + rule.targets)
        return None if allowed and not named_by(module, rule.never) else "this folder may not use that one"
    for library, (_, prefixes) in LIBRARIES.items():
        if target.startswith(prefixes):
            return None if library in rule.may else (
                f"this folder may not use {library}")
    return "belongs to no library in the table of layering.py"


def check_links(path, text):
    folder = str(pathlib.PurePosixPath(path).parent)
    for arguments in cmake_calls(text, "target_link_libraries"):
        rule = rule_of(TARGETS.get(arguments[0], folder))
        if rule is None:
            continue
        for target in arguments[1:]:
            if target in ("PUBLIC", "PRIVATE", "INTERFACE"):
                continue
            complaint = check_link(target, rule)
            if complaint:
                yield f"{path}: links {target}: {complaint}"


def files_below(root, folders, suffixes):
    for folder in folders:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in suffixes or path.name in suffixes:
                yield path.relative_to(root).as_posix(), path


def check_tree(root):
    """All complaints about the tree at `root`."""
    for name, path in files_below(root, SOURCE_FOLDERS, (".h", ".cc")):
        text = path.read_text(encoding="utf-8")
        yield from check_source(name, text)
        if path.suffix == ".cc" and path.with_suffix(".h").exists():
            yield from check_own_header(name, text)
    for name, path in files_below(root, SOURCE_FOLDERS, ("CMakeLists.txt",)):
        yield from check_links(name, path.read_text(encoding="utf-8"))


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    root = pathlib.Path(sys.argv[1])
    complaints = list(check_tree(root))
    for complaint in complaints:
        print(complaint)
    checked = sum(1 for _ in files_below(root, SOURCE_FOLDERS, (".h", ".cc")))
    print(f"{checked} files, {len(complaints)} violations")
    if checked == 0:
        sys.exit(f"{root}: there is nothing to check")
    sys.exit(1 if complaints else 0)


if __name__ == "__main__":
    main()
