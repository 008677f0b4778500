#!/usr/bin/python3
"""`mapsieve sample --method` as a user runs it.

usage: sample_test.py BIN_DIR
"""

import csv
import json
import subprocess
import sys
import unittest

from programs import BIN, FolderTest, mapsieve

METHODS = ("random", "max-density", "ss-normal", "octree", "voxel", "nss",
           "covs", "spdf", "spatial-spdf")
VOTING = ("nss", "covs", "spdf", "spatial-spdf")


class Sample(FolderTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.source = cls.work / "campus.las"
        mapsieve("simulate", cls.source, "--points", 20000)

    def run_sample(self, *options):
        return subprocess.run(
            [BIN / "mapsieve", "--json", "sample", self.source, "-o",
             self.work / "out.csv", *options],
            capture_output=True, text=True, timeout=300)

    def sample(self, *options):
        """What is printed, and the rows of the output."""
        result = self.run_sample(*options)
        self.assertEqual(result.returncode, 0, result.stderr)
        with open(self.work / "out.csv", encoding="utf-8") as rows:
            return json.loads(result.stdout), list(csv.DictReader(rows))

    def test_every_method_gives_the_points_asked_for(self):
        for method in METHODS:
            with self.subTest(method):
                printed, rows = self.sample("--method", method,
                                            "--max-points", "1000")
                self.assertEqual(printed["method"], method)
                self.assertEqual(printed["points_in"], 20000)
                self.assertEqual(printed["points_out"], len(rows))
                self.assertGreater(printed["parameter"], 0)
                self.assertLessEqual(len(rows), 1000)
                self.assertGreaterEqual(
                    len(rows), 900 if method in ("voxel", "spdf") else 1000)
                self.assertIn("intensity", rows[0])
                self.assertEqual("label" in rows[0], method in VOTING)
                self.assertEqual("nx" in rows[0],
                                 method in VOTING + ("ss-normal",))
                self.assertEqual(sum(printed["label_counts"].values()),
                                 len(rows) if method in VOTING else 0)

    def test_takes_the_parameter_of_each_method(self):
        for options, least, most in (
                (("random", "--keep-probability", "0.25"), 4600, 5400),
                (("max-density", "--max-density", "0.5"), 100, 19000),
                (("ss-normal", "--max-cell-points", "7"), 4096, 4096),
                (("octree", "--max-cell-points", "7"), 2857, 19999),
                (("octree", "--cell-edge", "2"), 100, 19999),
                (("voxel", "--cell-edge", "2"), 100, 19999)):
            with self.subTest(options):
                printed, rows = self.sample("--method", *options)
                self.assertEqual(printed["points_out"], len(rows))
                self.assertGreaterEqual(len(rows), least)
                self.assertLessEqual(len(rows), most)

    def test_representatives(self):
        options = ("--method", "voxel", "--cell-edge", "3")
        samples = {}
        for name in ("first", "random", "centroid", "medoid", "nearest"):
            _, samples[name] = self.sample(*options, "--representative", name)
        self.assertEqual(samples["medoid"], samples["nearest"])
        self.assertNotEqual(samples["first"], samples["nearest"])
        self.assertNotEqual(samples["random"], samples["nearest"])
        self.assertNotEqual(samples["centroid"], samples["nearest"])
        _, flag = self.sample(*options, "--centroids")
        self.assertEqual(flag, samples["centroid"])
        _, default = self.sample(*options)
        self.assertEqual(default, samples["centroid"])

    def test_spatial_budgets_by_width_and_ideal_shapes(self):
        options = ("--method", "spatial-spdf", "--max-points", "500")
        _, fullest = self.sample(*options)
        _, same = self.sample(*options, "--cell-split", "fullest")
        _, widest = self.sample(*options, "--cell-split", "widest")
        _, midway = self.sample(*options, "--cell-split", "midway")
        _, surest = self.sample(*options, "--representative", "surest")
        _, ideal = self.sample(*options, "--ideal-share", "0.02")
        self.assertEqual(same, fullest)
        for other in (widest, midway, surest, ideal):
            self.assertEqual(len(other), 500)
            self.assertNotEqual(other, fullest)
        self.assertNotEqual(midway, widest)

    def test_refuses_what_does_not_belong_together(self):
        for options in (
                ("voxel",), ("nss",), ("spatial-spdf",), ("random",),
                ("median",), ("random", "--cell-edge", "1"),
                ("voxel", "--cell-edge", "1", "--max-points", "5"),
                ("spdf", "--rho", "0.3", "--max-points", "5"),
                ("spdf", "--density-radius", "0.3", "--max-points", "5"),
                ("random", "--max-points", "5", "--centroids"),
                ("spatial-spdf", "--max-points", "5", "--representative",
                 "first"),
                ("octree", "--max-points", "5", "--cell-split", "widest"),
                ("voxel", "--cell-edge", "1", "--representative", "surest"),
                ("spdf", "--ideal-share", "0.02"),
                ("spatial-spdf", "--max-points", "5", "--ideal-share", "2"),
                ("voxel", "--cell-edge", "0.0001"),
                ("octree", "--max-points", "5", "--centroids",
                 "--representative", "first")):
            with self.subTest(options):
                result = self.run_sample("--method", *options)
                self.assertEqual(result.returncode, 2)
                said = [line for line in result.stderr.splitlines()
                        if "--help" not in line]
                self.assertEqual(len(said), 1, result.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
