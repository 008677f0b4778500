#!/usr/bin/python3
"""The commands of docs/evaluation.md that make the figures of compression, on a
fiftieth of the points.

usage: figures_test.py BIN_DIR EVALUATION_MD [DATA]
"""

import os
import pathlib
import re
import subprocess
import sys
import unittest

from programs import BIN, FolderTest, mapsieve

SECTION = "## Compression\n"
PICTURES = {"campus_30000.png", "room_40000.png",
            "room_report/saliencies.png"}


def documented_commands():
    """The indented lines of the section."""
    text = pathlib.Path(sys.argv[2]).read_text()
    section = text[text.index(SECTION) + len(SECTION):].split("\n## ")[0]
    return [line.strip() for line in section.splitlines()
            if line.startswith("    ")]


def smaller(line):
    """A command with fewer points; the filter needs some density."""
    def divided(match):
        return match[1] + str(int(match[2]) // (20 if match[1][2] == "m"
                                                else 50))
    return re.sub(r"(--(?:max-)?points )(\d+)", divided, line)


class Figures(FolderTest):
    def run_line(self, line):
        path = f"{BIN.resolve()}:{os.environ['PATH']}"
        result = subprocess.run(
            ["bash", "-c", line], cwd=self.work, timeout=300, text=True,
            capture_output=True, env={**os.environ, "PATH": path})
        self.assertEqual(result.returncode, 0, f"{line}: {result.stderr}")

    def test_documented_commands_draw_the_figures(self):
        lines = [line for line in documented_commands()
                 if line.startswith("mapsieve ")]
        self.assertEqual(len(lines), 8)
        for line in lines:
            self.run_line(smaller(line))
        for picture in PICTURES:
            png = (self.work / picture).read_bytes()
            self.assertEqual(png[:8], b"\x89PNG\r\n\x1a\n", picture)
        for sample, most in (("random", 1500), ("spdf", 1500),
                             ("spatial", 1500), ("room_40000", 2000)):
            printed = mapsieve("convert", self.work / f"{sample}.ply",
                               self.work / "points.csv")
            self.assertLessEqual(printed["point_count"], most)
            self.assertGreaterEqual(printed["point_count"], 0.8 * most)

    @unittest.skipIf(len(sys.argv) < 4, "no data")
    def test_reference_room_is_read_as_documented(self):
        line, = (line for line in documented_commands()
                 if line.startswith("(printf"))
        folder = pathlib.Path(sys.argv[3]).resolve() / "reference"
        self.run_line(line.replace("DATA", str(folder)))
        printed = mapsieve("convert", self.work / "room.ply",
                           self.work / "room.csv")
        self.assertEqual(printed["point_count"], 370000)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
