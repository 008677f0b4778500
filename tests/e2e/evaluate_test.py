#!/usr/bin/python3
"""`mapsieve evaluate` as a user runs it.

usage: evaluate_test.py BIN_DIR
"""

import csv
import html.parser
import json
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
    def options(cls):
        return ("--simulated", 1, 0, 0, "--rotations", 1, "--pairs",
                cls.work / "pairs.yaml", "--pairs-folder", cls.work / "scans",
                "--methods", ",".join(METHODS), "--counts", "300,600",
                "--trials", 2)

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
        self.assertEqual(page.tags.count("table"), len(ICP))
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
        other = run_command("evaluate", "-o", self.report, *self.options(),
                            "--seed", 7)
        self.assertEqual(other.returncode, 1)
        self.assertEqual(len(other.stderr.splitlines()), 1, other.stderr)
        self.assertIn("another evaluation", other.stderr)
        self.assertEqual(trials.read_bytes(), whole)

    def test_estimates_without_a_run(self):
        few, full, part = (mapsieve("evaluate", "-o", self.work / "none",
                                    "--estimate", *options)
                           for options in (
                               self.options(), ("--rotations", 1, "--full"),
                               ("--rotations", 1, "--trials", 3, "--full")))
        self.assertEqual(few["registrations"], self.printed["registrations"])
        # 109 pairs, 8 counts, 12 methods, 2 ICP; options beside it count.
        of_a_trial = 109 * 8 * 12 * 2
        self.assertEqual(full["registrations"], of_a_trial * 313)
        self.assertEqual(part["registrations"], of_a_trial * 3)
        self.assertGreater(full["estimated_s"], 1000 * few["estimated_s"])
        self.assertFalse((self.work / "none").exists())

    def test_refuses_wrong_options(self):
        for options in (("--counts", "5"), ("--methods", "magic"),
                        ("--trials", 0), ("--simulated", 0, 0, 0),
                        ("--rotations", 40)):
            result = run_command("evaluate", "-o", self.work / "none",
                                 *options)
            self.assertEqual(result.returncode, 2, options)
        result = run_command("evaluate", "-o", self.work / "none", "--pairs",
                             self.work / "absent.yaml")
        self.assertEqual(result.returncode, 1)
        self.assertIn("absent.yaml", result.stderr)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
