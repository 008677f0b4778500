#!/usr/bin/python3
"""`mapsieve export` against OctoMap's own tools.

usage: export_test.py BIN_DIR
"""

import math
import random
import re
import subprocess
import sys
import unittest

from programs import ServedTest

EDGE = 0.25
BOX = (-4, -4, -2, 3, 4, 2)
TRANSLATION = re.compile(r"translation (\S+) (\S+) (\S+)")
SIZE = re.compile(r"size (\S+) ")


def octomap(tool, *arguments):
    result = subprocess.run([tool, *map(str, arguments)], capture_output=True,
                            text=True, timeout=120)
    assert result.returncode == 0, f"{tool}: {result.stderr}"


def voxels_of_vrml(path):
    """Smallest corners of all voxels in edges; a larger box is many."""
    voxels = set()
    text = path.read_text()
    sizes = SIZE.findall(text)
    centers = TRANSLATION.findall(text)
    assert len(sizes) == len(centers), path
    for size, center in zip(sizes, centers):
        count = round(float(size) / EDGE)
        first = [round(float(c) / EDGE - count / 2) for c in center]
        voxels.update((first[0] + x, first[1] + y, first[2] + z)
                      for x in range(count) for y in range(count)
                      for z in range(count))
    return voxels


class Export(ServedTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        numbers = random.Random(4)
        cls.points = [tuple(round(numbers.uniform(-6, 6), 3) for _ in range(3))
                      for _ in range(4000)]
        # A block that becomes one node.
        cls.points += [(x / 8 + 0.01, y / 8 + 0.01, z / 8 + 0.01)
                       for x in range(8) for y in range(8) for z in range(8)]
        source = cls.work / "points.csv"
        source.write_text("x,y,z\n" + "".join(
            f"{x:.3f},{y:.3f},{z:.3f}\n" for x, y, z in cls.points))
        cls.server.mapsieve("create", "map")
        cls.server.mapsieve("upload", "map", source)

    def voxels(self, origin):
        return {tuple(math.floor((c - o) / EDGE) for c, o in zip(p, origin))
                for p in self.points
                if all(lower <= c < upper for c, lower, upper
                       in zip(p, BOX[:3], BOX[3:]))}

    def test_octomap_reads_the_voxels_of_the_points(self):
        for name, origin in (("map.bt", (0, 0, 0)), ("map.ot", (1, -2, 0.125))):
            with self.subTest(name):
                path = self.work / name
                printed = self.server.mapsieve(
                    "export", "map", "--occupancy", EDGE, "-o", path,
                    "--box", *BOX, "--origin", *origin)
                self.assertEqual(
                    printed["point_count"],
                    sum(all(lower <= c < upper for c, lower, upper
                            in zip(p, BOX[:3], BOX[3:]))
                        for p in self.points))
                # bt2vrml reads .bt alone.
                if path.suffix == ".ot":
                    octomap("convert_octree", path, self.work / "other.bt")
                    path = self.work / "other.bt"
                octomap("bt2vrml", path)
                self.assertEqual(voxels_of_vrml(path.with_name(
                    path.name + ".wrl")), self.voxels(origin))

    def test_says_what_cannot_be_written_and_leaves_nothing(self):
        path = self.work / "none.bt"
        for arguments, message in (
                (("--occupancy", 1e-6, "-o", path), "larger voxels"),
                (("--occupancy", 1, "-o", path.with_suffix(".pcd")), ".bt")):
            with self.subTest(message):
                result = self.server.run_command("export", "map", *arguments)
                self.assertEqual(result.returncode, 1)
                self.assertIn(message, result.stderr)
        self.assertEqual(list(self.work.glob("*none*")), [])


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
