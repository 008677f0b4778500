#!/usr/bin/python3
"""The main path by a client that shares no code with mapsieve.

It is gRPC for JavaScript from npm: once with the protos, once with what the
server's reflection tells. Point blocks are written by their byte table. The
packages are installed by their lock file into the build folder. Where npm or
its registry is missing the test is skipped, but under CI=true it fails.

usage: strangers_test.py BIN_DIR BUILD_FOLDER
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parent
ROOT = SOURCE.parents[1]
PACKAGES = pathlib.Path(sys.argv[2]) / "packages"

sys.path.insert(0, str(SOURCE.parent / "e2e"))
from programs import Server  # noqa: E402  (reads BIN_DIR)

# ctest knows a skipped test by it.
SKIPPED = 77


def install():
    """Installs what the lock file names; returns why that failed, or None."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return "node or npm is missing: deploy/install-deps.sh installs them"
    wanted = (SOURCE / "package-lock.json").read_bytes()
    installed = PACKAGES / "installed-lock.json"
    if installed.exists() and installed.read_bytes() == wanted:
        return None
    PACKAGES.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(SOURCE / name, PACKAGES / name)
    result = subprocess.run(
        ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund",
         "--fetch-retries=1", "--fetch-timeout=30000"],
        cwd=PACKAGES, capture_output=True, text=True, timeout=240)
    if result.returncode != 0:
        return ("npm could not install the packages of package-lock.json; is "
                f"its registry reachable?\n{result.stderr[-2000:]}")
    installed.write_bytes(wanted)
    return None


class Strangers(unittest.TestCase):
    def walk(self, how):
        with tempfile.TemporaryDirectory() as folder, \
                Server(pathlib.Path(folder) / "data") as server:
            result = subprocess.run(
                ["node", SOURCE / "main_path.js", server.address, how],
                env={**os.environ, "NODE_PATH": str(PACKAGES / "node_modules")},
                capture_output=True, text=True, timeout=120)
            self.assertEqual(result.returncode, 0, result.stderr)

    def test_main_path_with_the_protos(self):
        self.walk(ROOT / "proto")

    def test_main_path_with_reflection_alone(self):
        self.walk("--reflection")


def main():
    obstacle = install()
    if obstacle is not None:
        print(f"strangers: {obstacle}", file=sys.stderr)
        sys.exit(1 if os.environ.get("CI") == "true" else SKIPPED)
    unittest.main(argv=sys.argv[:1])


if __name__ == "__main__":
    main()
