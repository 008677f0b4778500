#!/usr/bin/python3
"""What a map answers does not depend on how it came to be.

usage: tiling_test.py BIN_DIR [--large] [TEST_DATA]

Clouds, hostile ones among them, go through real servers with other tile edges,
numbers of threads, orders of points and splits into uploads. Every answer is,
to the last digit, that of the filter in memory; `verify --tiling` agrees. With
--large the clouds are so large that the server filters them in several units.
"""

import pathlib
import random
import signal
import sys
import tempfile
import time
import unittest

from programs import Server, answer_of, lines_of, mapsieve

ARGUMENTS = [a for a in sys.argv[1:] if a != "--large"]
LARGE = "--large" in sys.argv
DATA = pathlib.Path(ARGUMENTS[1]) if len(ARGUMENTS) > 1 else None

# Tile edge in metres, threads, uploads, points in another order.
VARIANTS = ((8, 1, 1, False), (16, 2, 7, True), (32, 8, 1, True),
            (64, 2, 50, True))
RULES = ("paper", "quota")
HEADER = "x,y,z"


def clump(random_numbers, centre, size, spread):
    """A flat clump of points in millimetres."""
    return [tuple(round(c + random_numbers.gauss(0, s))
                  for c, s in zip(centre, (spread, spread, 20)))
            for _ in range(size)]


def hostile_clouds():
    """Names and points, in millimetres."""
    numbers = random.Random(7)
    tile = 32768
    # Everything on faces, edges and corners of tiles of every edge: the ground
    # on z = 0, walls on x = 0 and y = 0, and the corners themselves.
    faces = []
    for _ in range(9000):
        a, b = numbers.randrange(-3000, 3000), numbers.randrange(-3000, 3000)
        faces.append(((a, b, 0), (0, a, b), (a, 0, b))[len(faces) % 3])
    yield "faces", faces + [(x, y, z) for x in (-tile, 0, tile)
                            for y in (-tile, 0, tile) for z in (-tile, 0, tile)]
    yield "one-per-tile", [(2 * tile * x + 5, 2 * tile * y, -7)
                           for x in range(20) for y in range(15)]
    yield "grid", [(40 * x, 40 * y, 40 * z) for x in range(22)
                   for y in range(22) for z in range(22)]
    yield "gaps", [p for x in (0, 1, 4) for p in
                   clump(numbers, (1_000_000 * x, -1_000_000 * x, 0), 3000, 900)]
    yield "far", [p for sign in (-1, 1) for p in
                  clump(numbers, (sign * 10 ** 9, -sign * 10 ** 9, 10 ** 9),
                        4000, 900)]


class Tiling(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.work = pathlib.Path(folder.name)
        self.numbers = random.Random(11)

    def write(self, name, header, lines):
        path = self.work / name
        path.write_text("\n".join([header, *lines]) + "\n")
        return path

    def pieces(self, source, count, shuffled):
        """The cloud as `count` files, in any order."""
        header, lines = lines_of(source)
        if shuffled:
            self.numbers.shuffle(lines)
        size = -(-len(lines) // count)
        paths = [self.write(f"piece{i}.csv", header,
                            lines[i * size:(i + 1) * size])
                 for i in range(count) if lines[i * size:(i + 1) * size]]
        self.numbers.shuffle(paths)
        return paths

    def check(self, source, options, variants=VARIANTS, memory="256MiB"):
        expected = {}
        for rule in RULES:
            out = self.work / f"{rule}.csv"
            mapsieve("sample", source, "--rule", rule, *options, "-o", out)
            expected[rule] = answer_of(out)
        for edge, threads, uploads, shuffled in variants:
            data = tempfile.mkdtemp(dir=self.work)
            with Server(data, "--threads", threads, "--memory",
                        memory) as server:
                server.mapsieve("create", "m", "--tile-edge", edge)
                server.mapsieve("upload", "m",
                                *self.pieces(source, uploads, shuffled))
                for rule in RULES:
                    with self.subTest(edge=edge, rule=rule):
                        server.mapsieve("process", "m", "--rule", rule,
                                        *options)
                        answer = self.work / "answer.csv"
                        server.mapsieve("query", "m", "-o", answer)
                        names, rows = answer_of(answer)
                        self.assertEqual(names, expected[rule][0])
                        # Not assertEqual: its message would take hours.
                        self.assertTrue(rows == expected[rule][1])
                        report = server.mapsieve("verify", "m", "--tiling",
                                                 "--tiles", 6)
                        self.assertEqual(report["differing_tiles"], [])

    def check_file(self, path, options):
        source = self.work / "input.csv"
        mapsieve("convert", path, source)
        self.check(source, options)

    def test_campus(self):
        path = self.work / "campus.las"
        mapsieve("simulate", path, "--points", 2_500_000 if LARGE else 40_000)
        self.check_file(path, ("--rho", "0.2", "--label-neighbors", "90"))

    def test_real_maps(self):
        if DATA is None:
            self.skipTest("no real data")
        names = ["autzen_140m_metres.las"]
        if LARGE:
            names.append("autzen_trim.las")
        for name in names:
            with self.subTest(map=name):
                self.check_file(DATA / "maps" / name,
                                ("--rho", "2", "--sigma", "5"))

    @unittest.skipIf(LARGE, "in the other run")
    def test_hostile_clouds(self):
        for name, points in hostile_clouds():
            with self.subTest(cloud=name):
                path = self.write(
                    f"{name}.csv", HEADER,
                    [",".join(f"{v / 1000:.3f}" for v in p) for p in points])
                self.check(path, ("--rho", "0.2", "--outlier-share", "0"),
                           (VARIANTS[0], VARIANTS[-1]))

    @unittest.skipIf(not LARGE, "in the run with --large")
    def test_killed_run_goes_on(self):
        source = self.work / "campus.las"
        mapsieve("simulate", source, "--points", 3_000_000)
        mapsieve("sample", source, "--rho", "0.2", "-o",
                 self.work / "whole.csv")
        data = self.work / "data"
        with Server(data, "--threads", 2, "--memory", "256MiB") as server:
            server.mapsieve("create", "m")
            server.mapsieve("upload", "m", source)
            server.mapsieve("process", "m", "--rho", "0.2", "--no-wait")
            log, = self.wait_for(lambda: [
                path for path in (data / "runs").glob("*/log")
                if path.stat().st_size > 20_000])
            server.stop(signal.SIGKILL)
            finished = log.read_bytes()
            server.start()
            # The log only grows: no finished visit is made again.
            self.wait_for(lambda: log.stat().st_size > len(finished))
            self.assertTrue(log.read_bytes().startswith(finished))
            self.wait_for(lambda: not log.exists())
            self.wait_for(lambda: server.mapsieve("info", "m")["point_count"])
            server.mapsieve("query", "m", "-o", self.work / "answer.csv")
        self.assertTrue(answer_of(self.work / "answer.csv") ==
                        answer_of(self.work / "whole.csv"))

    def wait_for(self, condition):
        for _ in range(6000):
            result = condition()
            if result:
                return result
            time.sleep(0.02)
        self.fail("it never came")

    @unittest.skipIf(not LARGE, "in the run with --large")
    def test_cube_denser_than_a_unit(self):
        lines = [",".join(f"{self.numbers.uniform(0, 10):.3f}"
                          for _ in range(3)) for _ in range(5_000_000)]
        self.check(self.write("cube.csv", HEADER, lines), ("--rho", "0.2"),
                   memory="1GiB")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
