#!/usr/bin/python3
"""Checks that everything is built.

    build_lists.py ROOT

Below core, storage, server, client, proto and tests, every .cc and .proto file
must be named in a CMakeLists.txt, and every CMakeLists.txt must be added by the
one above it: a test that nobody builds passes for ever. Prints one line a file
that is left out and exits with 1 if there is any.
"""

import pathlib
import re
import sys

FOLDERS = ("core", "storage", "server", "client", "proto", "tests")
SOURCE = re.compile(r"[^\s()\";<>$]+\.(?:cc|proto)\b")


def code_of(path):
    return re.sub(r"#[^\n]*", "", path.read_text(encoding="utf-8"))


def list_above(root, folder):
    """The nearest CMakeLists.txt of a folder above `folder`."""
    for parent in folder.parents:
        if (parent / "CMakeLists.txt").exists() or parent == root:
            return parent / "CMakeLists.txt"
    return root / "CMakeLists.txt"


def check_tree(root):
    """All complaints about the tree at `root`."""
    listed = set()
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("CMakeLists.txt")):
            for name in SOURCE.findall(code_of(path)):
                listed.add((path.parent / name).resolve())
            above = list_above(root, path.parent)
            name = path.parent.relative_to(above.parent).as_posix()
            added = above.exists() and re.search(
                rf"\badd_subdirectory\s*\(\s*{re.escape(name)}\s*\)",
                code_of(above))
            if not added:
                yield (f"{path.relative_to(root)}: "
                       f"{above.relative_to(root)} does not add this folder")
    for folder in FOLDERS:
        for suffix in ("cc", "proto"):
            for path in sorted((root / folder).rglob(f"*.{suffix}")):
                if path.resolve() not in listed:
                    yield (f"{path.relative_to(root)}: no CMakeLists.txt names "
                           "this file, so it is not built")


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    root = pathlib.Path(sys.argv[1]).resolve()
    if not (root / "CMakeLists.txt").exists():
        sys.exit(f"{root}: there is no CMakeLists.txt")
    complaints = list(check_tree(root))
    for complaint in complaints:
        print(complaint)
    sys.exit(1 if complaints else 0)


if __name__ == "__main__":
    main()
