#!/usr/bin/python3
"""`mapsieve sync`: a local window of a map, kept up to date.

usage: sync_test.py BIN_DIR
"""

import fcntl
import math
import pathlib
import shutil
import struct
import sys
import tempfile
import unittest

from programs import ServedTest, Server, answer_of, mapsieve

TILE = 4.096
RADIUS = 5.0


def points_of_pcd(path):
    """Positions of a binary PCD file whose first fields are x y z."""
    head, data = path.read_bytes().split(b"DATA binary\n", 1)
    fields = {line.split()[0]: line.split()[1:]
              for line in head.decode().splitlines() if not line.startswith("#")}
    assert fields["FIELDS"][:3] == ["x", "y", "z"], path
    assert fields["SIZE"][:3] == ["4", "4", "4"], path
    stride = sum(map(int, fields["SIZE"]))
    count = int(fields["POINTS"][0])
    assert len(data) == stride * count, path
    return [struct.unpack_from("<3f", data, i * stride) for i in range(count)]


def metadata_of(window):
    """Cell size, and the lower corner of each file, which is whole: Autoware's
    map loader reads it as integers."""
    entries = {}
    for line in (window / "pointcloud_map_metadata.yaml").read_text(
            ).splitlines():
        name, value = line.split(": ")
        entries[name] = value
    size = (float(entries.pop("x_resolution")),
            float(entries.pop("y_resolution")))
    return size, {name: tuple(map(int, value.strip("[]").split(", ")))
                  for name, value in entries.items()}


class Sync(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.work = pathlib.Path(folder.name)
        self.server = self.enterContext(Server(self.work / "data"))
        self.folder = self.work / "window"
        mapsieve("simulate", self.work / "scan.las", "--points", 60000)
        mapsieve("convert", self.work / "scan.las", self.work / "scan.csv")
        names, rows = answer_of(self.work / "scan.csv")
        columns = [names.index(axis) for axis in "xyz"]
        points = sorted(tuple(float(row[i]) for i in columns) for row in rows)
        self.around = (*points[len(points) // 2], RADIUS)
        self.origin = tuple(map(math.floor, self.around[:3]))
        self.server.mapsieve("create", "map", "--tile-edge", TILE)
        self.server.mapsieve("upload", "map", self.work / "scan.las")
        self.server.mapsieve("process", "map", "--rho", 0.4)

    def sync(self, *options, around=None, origin=None):
        return self.server.mapsieve("sync", "map", self.folder, "--around",
                                    *(around or self.around), "--origin",
                                    *(origin or self.origin), *options)

    def window(self):
        return (self.folder / "current").resolve(strict=True)

    def check_window(self, around=None, origin=None):
        """Every tile is whole, and all around the place is there."""
        around = around or self.around
        origin = origin or self.origin
        window = self.window()
        size, corners = metadata_of(window)
        self.assertEqual(sorted(corners),
                         sorted(path.name for path in window.glob("*.pcd")))
        answer = self.work / "all.csv"
        self.server.mapsieve("query", "map", "-o", answer)
        names, rows = answer_of(answer)
        columns = [names.index(axis) for axis in "xyz"]
        points = [tuple(float(row[i]) for i in columns) for row in rows]
        by_tile = {}
        for p in points:
            tile = "_".join(str(math.floor(c / TILE)) for c in p)
            by_tile.setdefault(tile, []).append(p)

        tiles = set()
        # How far a tile reaches beyond its cell, along x and y.
        beyond = []
        for name, corner in corners.items():
            tile = name.split("-")
            tile = "-".join(tile[:-1])
            tiles.add(tile)
            x, y, _ = map(int, tile.split("_"))
            begin = (x * TILE - origin[0], y * TILE - origin[1])
            self.assertEqual(corner, tuple(map(math.floor, begin)))
            beyond.append([b + TILE - (c + edge)
                           for b, c, edge in zip(begin, corner, size)])
            found = sorted(points_of_pcd(window / name))
            expected = sorted(tuple(c - o for c, o in zip(p, origin))
                              for p in by_tile[tile])
            self.assertEqual(len(found), len(expected))
            for a, b in zip(found, expected):
                for u, v in zip(a, b):
                    self.assertAlmostEqual(u, v, places=4)
        for of_axis in zip(*beyond):
            self.assertAlmostEqual(max(of_axis), 0, places=6)
        for tile, inside in by_tile.items():
            if any(math.dist(p, around[:3]) <= around[3] for p in inside):
                self.assertIn(tile, tiles)
        return tiles

    def test_brings_only_what_changed(self):
        first = self.sync()
        self.assertGreater(first["chunk_count"], 3)
        self.assertEqual(first["received_chunk_count"], first["chunk_count"])
        self.check_window()
        window = self.window()

        again = self.sync()
        self.assertEqual(again["received_chunk_count"], 0)
        self.assertEqual(again["dropped_chunk_count"], 0)
        self.assertEqual(again["point_count"], first["point_count"])
        self.assertEqual(self.window(), window)

        # A clump far enough from most tiles for their product to stay.
        clump = self.work / "clump.csv"
        x, y, z = self.around[:3]
        clump.write_text("x,y,z\n" + "".join(
            f"{x + i % 7 / 50:.3f},{y + i // 7 % 7 / 50:.3f},"
            f"{z + i // 49 / 50:.3f}\n" for i in range(343)))
        self.server.mapsieve("upload", "map", clump)
        self.server.mapsieve("process", "map")
        inodes = {path.name: path.stat().st_ino for path in window.iterdir()}
        changed = self.sync()
        self.check_window()
        self.assertGreater(changed["received_chunk_count"], 0)
        self.assertLess(changed["received_chunk_count"],
                        changed["chunk_count"])
        kept = [path for path in self.window().glob("*.pcd")
                if path.name in inodes]
        self.assertGreater(len(kept), 0)
        for path in kept:
            self.assertEqual(path.stat().st_ino, inodes[path.name])
        # Who was still in the window before finds it whole.
        self.assertEqual(sorted(inodes),
                         sorted(path.name for path in window.iterdir()))

        there = (x + 9, y, z, RADIUS)
        moved = self.sync(around=there)
        self.assertGreater(moved["dropped_chunk_count"], 0)
        self.check_window(there)
        self.assertFalse(window.exists())

    def test_other_options_are_another_window(self):
        fine = self.sync()
        coarse = self.sync("--depth", 2)
        self.assertEqual(coarse["received_chunk_count"],
                         coarse["chunk_count"])
        self.assertLess(coarse["point_count"], fine["point_count"])
        origin = tuple(c + 0.25 for c in self.origin)
        moved = self.sync(origin=origin)
        self.assertEqual(moved["received_chunk_count"], fine["chunk_count"])
        self.check_window(origin=origin)

    def test_a_break_leaves_a_whole_window(self):
        self.sync()
        window = self.window()
        files = sorted(path.name for path in window.iterdir())
        # What a process that was killed leaves.
        left = self.folder / "window-2"
        left.mkdir()
        (left / "0_0_0-01234567.pcd").write_text("half")
        # And what a user did.
        gone = next(window.glob("*.pcd"))
        gone.unlink()
        result = self.sync()
        self.assertEqual(result["received_chunk_count"], 1)
        self.assertEqual(sorted(path.name for path in self.window().iterdir()),
                         files)
        self.check_window()
        (self.window() / "window.json").write_text("{")
        self.assertEqual(self.sync()["received_chunk_count"],
                         result["chunk_count"])
        self.check_window()

    def test_says_what_is_wrong_and_leaves_the_window(self):
        self.sync()
        window = self.window()
        with open(self.folder / "lock") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self.refused("another sync", "map", self.folder)
        other = self.work / "other"
        other.mkdir()
        (other / "letter.txt").write_text("mine")
        self.refused("holds other things", "map", other)
        self.assertEqual([path.name for path in other.iterdir()],
                         ["letter.txt"])
        self.refused('map "none"', "none", self.folder)
        self.refused("give an --origin", "map", self.folder)
        self.assertEqual(self.window(), window)
        copy = self.work / "copy"
        shutil.copytree(window, copy)
        self.server.stop()
        self.refused("", "map", self.folder)
        self.assertEqual(sorted(path.name for path in self.window().iterdir()),
                         sorted(path.name for path in copy.iterdir()))
        self.server.start()

    def refused(self, message, *arguments):
        result = self.server.run_command("sync", *arguments, "--around",
                                         *self.around)
        self.assertEqual(result.returncode, 1, result.stdout)
        self.assertIn(message, result.stderr)


class LocalFrames(ServedTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        scan = cls.work / "scan.las"
        mapsieve("simulate", scan, "--points", 20000)
        cls.server.mapsieve("create", "map", "--step", 2**-9, "--tile-edge",
                            16)
        upload = cls.server.mapsieve("upload", "map", scan)
        bounds = upload["files"][0]["bounds"]
        cls.server.mapsieve("process", "map", "--rho", 0.4)
        cls.origin = [math.floor((a + b) / 2)
                      for a, b in zip(bounds["min"], bounds["max"])]

    def test_tiles_of_whole_units_are_the_cells_of_a_sync(self):
        self.mapsieve("sync", "map", self.work / "window", "--around",
                      *self.origin, 50, "--origin", *self.origin)
        size, corners = metadata_of(self.work / "window" / "current")
        self.assertEqual(size, (16, 16))
        self.assertGreater(len(corners), 3)
        for name, corner in corners.items():
            x, y = map(int, name.split("_")[:2])
            self.assertEqual(corner, (16 * x - self.origin[0],
                                      16 * y - self.origin[1]))

    def test_a_query_writes_float32_around_an_origin(self):
        answer = self.work / "answer.csv"
        self.mapsieve("query", "map", "-o", answer)
        names, rows = answer_of(answer)
        columns = [names.index(axis) for axis in "xyz"]
        expected = sorted(tuple(float(row[c]) - o
                                for c, o in zip(columns, self.origin))
                          for row in rows)
        local = self.work / "local.pcd"
        self.mapsieve("query", "map", "-o", local, "--origin", *self.origin)
        found = sorted(points_of_pcd(local))
        self.assertGreater(len(found), 1000)
        self.assertEqual(len(found), len(expected))
        for a, b in zip(found, expected):
            for u, v in zip(a, b):
                self.assertAlmostEqual(u, v, places=4)
        far = self.server.run_command("query", "map", "-o", local, "--origin",
                                      0, 0, 0)
        self.assertEqual(far.returncode, 1)
        self.assertIn("give an --origin near them", far.stderr)
        self.assertEqual(sorted(points_of_pcd(local)), found)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
