#!/usr/bin/python3
"""A server whose disk is full refuses writers, answers readers and recovers.

usage: disk_full_test.py BIN_DIR

The disk is a small file system in memory, so the test needs the right to mount.
"""

import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time
import unittest

from programs import Server, answer_of, mapsieve, write_random_points

MIB = 1 << 20
DISK = 128 * MIB
RESERVE = 64 * MIB
# What the catalogue, which may use the reserve, takes at most here.
CATALOGUE = 6 * MIB
LARGE_POINTS = 40_000
# Of LARGE_POINTS.
LARGE_BYTES = 10 * MIB


class DiskFull(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.work = pathlib.Path(folder.name)
        self.disk = self.work / "disk"
        self.disk.mkdir()
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", self.disk],
            capture_output=True, text=True)
        if mounted.returncode != 0:
            self.skipTest(f"no right to mount: {mounted.stderr.strip()}")
        self.addCleanup(subprocess.run, ["umount", self.disk], check=True)
        self.server = Server(self.disk / "data", "--memory", "256MiB")
        self.addCleanup(self.stop)

    def stop(self):
        self.assertEqual(self.server.stop(), 0)

    def free_bytes(self):
        state = os.statvfs(self.disk)
        return state.f_bavail * state.f_frsize

    def leave_free(self, size):
        """Lets a file of others take all space but so much."""
        taken = self.free_bytes() - size
        if taken > 0:
            with open(self.disk / "ballast", "ab") as file:
                os.posix_fallocate(file.fileno(), file.tell(), taken)

    def is_refused(self, *arguments):
        result = self.server.run_command(*arguments)
        self.assertEqual(result.returncode, 1, result.stdout)
        self.assertIn("kept in reserve; free some space", result.stderr)

    def answer(self, *options):
        path = self.work / "answer.csv"
        self.server.mapsieve("query", "campus", *options, "-o", path)
        return answer_of(path)

    def large_file(self, number):
        path = self.work / f"large{number}.ply"
        write_random_points(path, LARGE_POINTS, random.Random(number))
        return path

    def test_refuses_before_the_reserve_and_recovers(self):
        source = self.work / "campus.las"
        mapsieve("simulate", source, "--points", 20000)
        self.server.mapsieve("create", "campus")
        self.server.mapsieve("upload", "campus", source)
        self.server.mapsieve("process", "campus", "--rho", 0.2)
        before = self.server.mapsieve("info", "campus")
        answer = self.answer()

        self.server.mapsieve("create", "unwanted")
        self.server.mapsieve("upload", "unwanted", self.large_file(1))

        # There is room for the bytes of an upload, but not for its chunks.
        self.server.mapsieve("create", "large")
        staged, unsent = self.large_file(2), self.large_file(3)
        self.leave_free(RESERVE + LARGE_BYTES * 3 // 2)
        self.is_refused("upload", "large", staged)
        self.assertGreater(self.free_bytes(), RESERVE - CATALOGUE)
        # There is none for anything, also once what the refused upload left
        # behind is collected.
        for step in (("upload", "large", unsent),
                     ("process", "campus", "--rho", 0.3),
                     ("delete-region", "campus", "--sphere",
                      *before["bounds"]["min"], 50)):
            self.leave_free(RESERVE)
            self.is_refused(*step)
        self.assertGreater(self.free_bytes(), RESERVE - CATALOGUE)

        # Readers notice nothing, even where others took half of the reserve
        # and the server starts like that.
        self.leave_free(RESERVE // 2)
        self.server.stop(signal.SIGKILL)
        self.server.start()
        self.assertEqual(self.server.mapsieve("info", "campus"), before)
        self.assertEqual(self.answer(), answer)
        self.answer("--max-points", 100)
        self.server.mapsieve("verify", "campus", "--tiling")
        # Whoever deletes gets space.
        before_bytes = self.free_bytes()
        self.server.mapsieve("delete", "unwanted")
        deadline = time.monotonic() + 60
        while self.free_bytes() < before_bytes + LARGE_BYTES * 9 // 10:
            self.assertLess(time.monotonic(), deadline)
            time.sleep(0.02)

        (self.disk / "ballast").unlink()
        for path, is_staged in ((staged, True), (unsent, False)):
            report, = self.server.mapsieve("upload", "large", path)["files"]
            self.assertEqual(report["added_point_count"], LARGE_POINTS)
            self.assertEqual(report["sent_bytes"] == 0, is_staged)
        self.assertEqual(self.server.mapsieve("info", "large")
                         ["raw_point_count"], 2 * LARGE_POINTS)
        self.server.mapsieve("verify", "large")
        self.server.mapsieve("process", "campus", "--rho", 0.3)
        self.server.mapsieve("verify", "campus", "--tiling")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
