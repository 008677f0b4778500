#!/usr/bin/python3
"""`mapsieve evaluate` as a user runs it.

usage: evaluate_test.py BIN_DIR
"""

import csv
import html.parser
import json
import random
import sys
import unittest
import xml.etree.ElementTree

from programs import FolderTest, mapsieve, run_command

METHODS = ("random", "spatial-spdf-quota")
ICP = ("point-to-plane", "plane-to-plane")
FIGURES = tuple(f"{what}_{icp}" for what in ("translation", "rotation")
                for icp in ICP) + ("times",)


class Page(html.parser.HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.links = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.links += [value for name, value in attributes
                       if name in ("src", "href", "xlink:href")]


class Evaluate(FolderTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        (cls.work / "scans").mkdir()
        mapsieve("simulate", cls.work / "scans/street.ply", "--points", 6000)
        (cls.work / "pairs.yaml").write_text(
            "pairs:\n  - name: street\n    reference: street.ply\n"
            "    reading: street.ply\n    transform: "
            "[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n")
        cls.report = cls.work / "report"
        cls.printed = mapsieve("evaluate", "-o", cls.report, *cls.options())

    @classmethod
    def options(cls, min_normal_cosine=0.5):
        return ("--simulated", 1, 0, 0, "--rotations", 1, "--pairs",
                cls.work / "pairs.yaml", "--pairs-folder", cls.work / "scans",
                "--methods", ",".join(METHODS), "--counts", "300,600",
                "--trials", 2, "--min-normal-cosine", min_normal_cosine)

    def test_writes_every_registration(self):
        with open(self.report / "trials.csv") as file:
            trials = list(csv.DictReader(file))
        self.assertEqual(len(trials), 2 * 2 * 2 * 2 * 2)
        self.assertEqual(self.printed["registrations"], len(trials))
        self.assertEqual(self.printed["registrations_before"], 0)
        self.assertEqual({t["pair"] for t in trials},
                         {"structured-0-r1", "street"})
        self.assertEqual({t["method"] for t in trials}, set(METHODS))
        self.assertEqual({t["icp"] for t in trials}, set(ICP))
        for trial in trials:
            self.assertEqual(trial["environment"], {
                "street": "real"}.get(trial["pair"], "structured"))
            self.assertLessEqual(float(trial["initial_translation_m"]), 0.5)

    def test_summaries_agree_with_the_registrations(self):
        with open(self.report / "trials.csv") as file:
            trials = list(csv.DictReader(file))
        summary = json.loads((self.report / "summary.json").read_text())
        self.assertEqual(summary["settings"]["counts"], [300, 600])
        self.assertEqual(summary["settings"]["min_normal_cosine"], 0.5)
        with open(self.report / "summary.csv") as file:
            rows = list(csv.DictReader(file))
        # Two environments and all, two counts and all.
        self.assertEqual(len(rows), 3 * 3 * 2 * 2)
        self.assertEqual(len(rows), len(summary["summaries"]))
        for row, group in zip(rows, summary["summaries"]):
            errors = sorted(
                float(t["translation_error_m"]) for t in trials
                if row["environment"] in ("all", t["environment"])
                and row["count"] in ("all", t["count"])
                and (row["method"], row["icp"]) == (t["method"], t["icp"]))
            middle = len(errors) // 2
            median = (errors[middle - 1] + errors[middle]) / 2
            self.assertEqual(len(errors), int(row["trials"]))
            self.assertAlmostEqual(float(row["translation_m_median"]), median,
                                   delta=1e-8 + 1e-7 * median)
            self.assertAlmostEqual(group["translation_m"]["median"], median,
                                   delta=1e-8)
            self.assertEqual(group["failures"], sum(
                float(t["translation_error_m"]) > 0.2
                or float(t["rotation_error_deg"]) > 5 for t in trials
                if row["environment"] in ("all", t["environment"])
                and row["count"] in ("all", t["count"])
                and (row["method"], row["icp"]) == (t["method"], t["icp"])))

    def test_report_holds_all_that_it_shows(self):
        page = Page((self.report / "report.html").read_text())
        self.assertEqual(page.tags.count("table"), 1 + len(ICP))
        self.assertEqual(page.tags.count("svg"), len(FIGURES))
        for link in page.links:
            self.assertTrue(link.startswith("#"), link)
        for figure in FIGURES:
            svg = xml.etree.ElementTree.parse(self.report / f"{figure}.svg")
            text = " ".join(svg.getroot().itertext())
            for method in METHODS:
                self.assertIn(method, text)
            png = (self.report / f"{figure}.png").read_bytes()
            self.assertEqual(png[:8], b"\x89PNG\r\n\x1a\n")

    def test_goes_on_where_it_stopped(self):
        trials = self.report / "trials.csv"
        whole = trials.read_bytes()
        again = mapsieve("evaluate", "-o", self.report, *self.options())
        self.assertEqual(again["registrations_before"],
                         self.printed["registrations"])
        self.assertEqual(trials.read_bytes(), whole)
        for changed in ((*self.options(), "--seed", 7), self.options(0.8)):
            other = run_command("evaluate", "-o", self.report, *changed)
            self.assertEqual(other.returncode, 1)
            self.assertEqual(len(other.stderr.splitlines()), 1, other.stderr)
            self.assertIn("another evaluation", other.stderr)
            self.assertEqual(trials.read_bytes(), whole)

    def test_registers_a_scan_to_a_sampled_map(self):
        mapsieve("evaluate", "-o", self.work / "robot", "--simulated", 0, 0, 0,
                 "--surveyed", 1, "--reading-points", 700, "--methods",
                 "random,voxel", "--counts", "2000", "--icp", "plane-to-plane",
                 "--trials", 1, "--max-rotation", 2)
        with open(self.work / "robot/trials.csv") as file:
            trials = list(csv.DictReader(file))
        self.assertEqual([t["method"] for t in trials], ["random", "voxel"])
        for trial in trials:
            self.assertEqual(trial["pair"], "survey-0")
            self.assertEqual(trial["reading_point_count"], "700")
            self.assertLessEqual(int(trial["reading_points"]), 700)
            self.assertGreater(int(trial["reference_points"]), 1500)

    def test_estimates_without_a_run(self):
        few, full, part = (mapsieve("evaluate", "-o", self.work / "none",
                                    "--estimate", *options)
                           for options in (
                               self.options(), ("--rotations", 1, "--full"),
                               ("--rotations", 1, "--trials", 3, "--full")))
        self.assertEqual(few["registrations"], self.printed["registrations"])
        # 109 pairs, 8 counts, 13 methods, 2 ICP; options beside it count.
        of_a_trial = 109 * 8 * 13 * 2
        self.assertEqual(full["registrations"], of_a_trial * 313)
        self.assertEqual(part["registrations"], of_a_trial * 3)
        self.assertGreater(full["estimated_s"], 1000 * few["estimated_s"])
        self.assertFalse((self.work / "none").exists())

    def test_refuses_wrong_options(self):
        for options in (("--counts", "5"), ("--methods", "magic"),
                        ("--trials", 0), ("--simulated", 0, 0, 0),
                        ("--rotations", 40), ("--min-normal-cosine", 1.5),
                        ("--first-pair", -1), ("--surveyed", 13),
                        ("--reading-points", 9)):
            result = run_command("evaluate", "-o", self.work / "none",
                                 *options)
            self.assertEqual(result.returncode, 2, options)
        result = run_command("evaluate", "-o", self.work / "none", "--pairs",
                             self.work / "absent.yaml")
        self.assertEqual(result.returncode, 1)
        self.assertIn("absent.yaml", result.stderr)


class EvaluateMaps(FolderTest):
    """The same corner of a room twice, far from the origin, one moved."""

    SHIFT = (120, -35.5, 2)

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.first = cls.work / "first.csv"
        cls.second = cls.work / "second.csv"
        numbers = random.Random(5)
        with open(cls.first, "w") as file, open(cls.second, "w") as moved:
            print("x,y,z", file=file)
            print("x,y,z", file=moved)
            for i in range(6000):
                point = [331000, 5183000, 90]
                for axis in range(3):
                    if axis != i % 3:
                        point[axis] += numbers.uniform(0, 4)
                print(*(f"{a:.3f}" for a in point), sep=",", file=file)
                print(*(f"{a - b:.3f}" for a, b in zip(point, cls.SHIFT)),
                      sep=",", file=moved)
        x, y, z = cls.SHIFT
        cls.truth = ("--transform", 1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z,
                     0, 0, 0, 1)
        cls.few = ("--methods", ",".join(METHODS), "--icp", "plane-to-plane",
                   "--trials", 4, "--max-rotation", 5, "--max-translation",
                   0.2)

    def evaluate(self, name, *options):
        return mapsieve("evaluate", "-o", self.work / name, *options,
                        *self.few)

    def test_tells_the_fewest_points_for_the_target(self):
        printed = self.evaluate("asked", "--maps", self.first, self.second,
                                *self.truth, "--counts", "300,1000,9999999")
        self.assertEqual(printed["truth"], "given")
        self.assertGreater(printed["overlap"], 0.99)
        points = printed["points_of_smaller_map"]
        self.assertLess(5900, points)
        self.assertLessEqual(points, 6000)
        with open(self.work / "asked/trials.csv") as file:
            trials = list(csv.DictReader(file))
        # The largest count stands for all points, which meet the truth.
        self.assertEqual([int(t["count"]) for t in trials[::4]],
                         [n for n in (300, 1000, points) for _ in METHODS])
        for trial in trials:
            self.assertLess(float(trial["initial_translation_m"]), 0.2)
            self.assertLess(float(trial["initial_rotation_deg"]), 5)
        needed = printed["needed_points"]
        self.assertEqual({n["method"] for n in needed}, set(METHODS))
        for row in needed:
            medians = {}
            for count in (300, 1000, points):
                errors = sorted(
                    float(t["translation_error_m"]) for t in trials
                    if t["method"] == row["method"]
                    and int(t["count"]) == count)
                self.assertEqual(len(errors), 4)
                medians[count] = (errors[1] + errors[2]) / 2
            self.assertLess(medians[points], 0.001)
            reaching = [n for n in medians if medians[n] <= 0.02]
            self.assertTrue(row["reached"])
            self.assertEqual(row["count"], min(reaching))
            self.assertAlmostEqual(row["translation_m"], medians[row["count"]],
                                   delta=1e-8)
        with open(self.work / "asked/needed_points.csv") as file:
            rows = list(csv.DictReader(file))
        self.assertEqual([(r["method"], int(r["count"])) for r in rows],
                         [(n["method"], n["count"]) for n in needed])
        summary = json.loads((self.work / "asked/summary.json").read_text())
        self.assertEqual(summary["needed_points"], needed)

        # Another target is another table of the same registrations.
        options = ("evaluate", "-o", self.work / "asked", "--maps", self.first,
                   self.second, *self.truth, *self.few, "--counts",
                   f"300,1000,{points}", "--target")
        strict = mapsieve(*options, "1e-9")
        self.assertEqual(strict["registrations_before"], len(trials))
        self.assertFalse(any(n["reached"] for n in strict["needed_points"]))
        text = run_command(*options, "1e-9").stdout
        self.assertIn("No method reaches", text)
        self.assertEqual(text.count("not reached ("), len(METHODS))
        html = (self.work / "asked/report.html").read_text()
        self.assertEqual(html.count("not reached ("), len(METHODS))
        text = run_command(*options, "0.02").stdout
        self.assertIn(f"Fewest points for a median error of 20 mm: "
                      f"{needed[0]['count']} by {needed[0]['method']}", text)

    def test_takes_the_maps_as_they_lie_without_a_transform(self):
        result = run_command(
            "--json", "evaluate", "-o", self.work / "same", "--maps",
            self.first, self.first, *self.few, "--counts", 300)
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn("are taken as the truth", result.stderr)
        self.assertEqual(json.loads(result.stdout)["truth"], "identity")

    def test_tells_that_nothing_holds_maps_of_a_plane(self):
        plane = self.work / "plane.csv"
        numbers = random.Random(6)
        with open(plane, "w") as file:
            print("x,y,z", file=file)
            for _ in range(2000):
                print(*(f"{numbers.uniform(0, 5):.3f}" for _ in range(2)), 1,
                      sep=",", file=file)
        options = ("evaluate", "-o", self.work / "plane", "--maps", plane,
                   plane, *self.few, "--counts", 500)
        for row in mapsieve(*options)["needed_points"]:
            self.assertEqual(row["degenerate"], row["trials"])
        for name in ("needed_points.csv", "summary.csv"):
            with open(self.work / "plane" / name) as file:
                for row in csv.DictReader(file):
                    self.assertEqual(row["degenerate"], row["trials"])
        said = "In 8 of 8 registrations the points slide"
        self.assertIn(said, run_command(*options).stdout)
        self.assertIn(said, (self.work / "plane/report.html").read_text())
        held = self.evaluate("held", "--maps", self.first, self.second,
                             *self.truth, "--counts", 500)
        self.assertEqual([row["degenerate"] for row in held["needed_points"]],
                         [0, 0])
        self.assertNotIn("the points slide",
                         (self.work / "held/report.html").read_text())

    def test_refuses_wrong_maps_in_a_line(self):
        (self.work / "empty.csv").write_text("x,y,z\n")
        (self.work / "one.csv").write_text("x,y,z\n1,2,3\n")
        for maps, said in (
                ((self.first, self.work / "none.csv"), "none.csv"),
                ((self.work / "empty.csv", self.first), "empty.csv"),
                ((self.first, self.work / "one.csv"), "one.csv"),
                ((self.first, self.second), "do not overlap")):
            result = run_command("evaluate", "-o", self.work / "none",
                                 "--maps", *maps)
            self.assertEqual(result.returncode, 1, said)
            lines = [line for line in result.stderr.splitlines()
                     if "--transform" not in line]
            self.assertEqual(len(lines), 1, result.stderr)
            self.assertIn(said, lines[0])
        for options, said in (
                (("--transform", "nan", *self.truth[2:]), "not finite"),
                (("--transform", 2, *self.truth[2:]), "no rotation"),
                (("--transform", *self.truth[1:-1], 3), "16 numbers"),
                (("--transform", 1), "--transform"),
                (("--target", 0), "--target"),
                (("--simulated", 1, 0, 0), "--simulated"),
                (("--pairs", "x.yaml"), "--pairs")):
            result = run_command("evaluate", "-o", self.work / "none",
                                 "--maps", self.first, self.second, *options)
            self.assertEqual(result.returncode, 2, options)
            self.assertIn(said, result.stderr)
        alone = run_command("evaluate", "-o", self.work / "none", *self.truth)
        self.assertEqual(alone.returncode, 2)
        self.assertFalse((self.work / "none").exists())


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
