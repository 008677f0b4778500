#!/usr/bin/python3
"""`mapsieve sample --report` as a user runs it.

usage: report_test.py BIN_DIR
"""

import json
import os
import pathlib
import subprocess
import sys
import unittest
import xml.etree.ElementTree

from programs import BIN, FolderTest, mapsieve

PICTURES = ("density", "saliencies")


class SampleReport(FolderTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.source = cls.work / "campus.las"
        mapsieve("simulate", cls.source, "--points", 60000)

    def sample(self, name, *options, env=None):
        return subprocess.run(
            [BIN / "mapsieve", "--json", "sample", self.source, "-o",
             self.work / f"{name}.csv", "--rho", "0.4", "--report",
             self.work / name, *options],
            capture_output=True, text=True, timeout=300, env=env)

    def test_compares_both_rules_and_draws_them(self):
        (self.work / "it's \"new\"").mkdir()
        result = self.sample("it's \"new\"/report", "--rule", "quota")
        self.assertEqual(result.returncode, 0, result.stderr)
        printed = json.loads(result.stdout)
        folder = pathlib.Path(printed["report"])
        report = json.loads((folder / "report.json").read_text())

        rules = {rule["rule"]: rule for rule in report["rules"]}
        self.assertEqual(list(rules), ["paper", "quota"])
        self.assertEqual(printed["points_after_rounds"],
                         rules["quota"]["points_after_rounds"])
        self.assertEqual(printed["points_out"],
                         rules["quota"]["points_after_outliers"])
        self.assertEqual(printed["label_counts"],
                         rules["quota"]["label_counts"])
        for name, rule in rules.items():
            self.assertGreater(rule["filter_s"], 0)
            self.assertLess(rule["points_after_rounds"], rule["points_in"])
            for label, density in rule["density"].items():
                histogram = density["reached_over_target_histogram"]
                self.assertEqual(
                    sum(histogram),
                    density["survivors"] - density["below_target_in_input"])
                self.assertEqual(
                    density["survivors"],
                    rule["label_counts_after_rounds"][label])
            known = {c["attribute"]: c["classes"]
                     for c in rule["known_classes"]}
            self.assertEqual(set(known), {"classification", "truth"})
            for classes in known.values():
                for column, count in (
                        ("thinned",
                         rule["points_in"] - rule["points_after_rounds"]),
                        ("outlier", rule["points_after_rounds"] -
                         rule["points_after_outliers"]),
                        ("surface", rule["label_counts"]["surface"])):
                    self.assertEqual(sum(c[column] for c in classes), count)
        surface = rules["quota"]["density"]["surface"]
        self.assertAlmostEqual(surface["target"], 50 / (3.141592653589793 * .16))
        self.assertLess(surface["reached_over_target"]["mean"], 1.05)

        for picture in PICTURES:
            svg = xml.etree.ElementTree.parse(folder / f"{picture}.svg")
            text = " ".join(svg.getroot().itertext())
            for word in ("paper", "quota", "curve", "surface", "junction"):
                self.assertIn(word, text)
            png = (folder / f"{picture}.png").read_bytes()
            self.assertEqual(png[:8], b"\x89PNG\r\n\x1a\n")

    def test_takes_the_radius_that_a_count_asks_for(self):
        source = ("sample", self.source, "-o", self.work / "few.csv",
                  "--max-points", 5000)
        printed = mapsieve(*source, "--report", self.work / "few")
        self.assertEqual(printed["parameter"],
                         mapsieve(*source)["parameter"])
        report = json.loads((self.work / "few/report.json").read_text())
        self.assertEqual(report["options"]["rho"], printed["parameter"])
        self.assertEqual(report["rules"][0]["points_after_outliers"],
                         printed["points_out"])
        self.assertLessEqual(printed["points_out"], 5000)

    def test_says_what_to_install_where_gnuplot_is_absent(self):
        result = self.sample("bare", env={"PATH": str(self.work)})
        self.assertEqual(result.returncode, 1)
        self.assertEqual(len(result.stderr.splitlines()), 1, result.stderr)
        self.assertIn("gnuplot-nox", result.stderr)
        self.assertTrue((self.work / "bare.csv").exists())
        json.loads((self.work / "bare/report.json").read_text())
        self.assertFalse((self.work / "bare/density.svg").exists())

    def test_is_for_the_filter_alone(self):
        result = self.sample("random", "--method", "random", "--max-points",
                             "100")
        self.assertEqual(result.returncode, 2)
        self.assertFalse((self.work / "random").exists())


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
