#!/usr/bin/python3
"""Edits of a stored map as a user makes them: a real server, real files.

usage: edits_test.py BIN_DIR
"""

import csv
import pathlib
import re
import signal
import subprocess
import sys
import unittest

from programs import BIN, Relay, ServedTest, mapsieve, run_command

STEP = 0.001


class Edits(ServedTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.source = cls.work / "scan.csv"
        mapsieve("simulate", cls.work / "scan.las", "--points", 40000)
        mapsieve("convert", cls.work / "scan.las", cls.source)
        with open(cls.source, newline="") as file:
            cls.header, *cls.points = list(csv.reader(file))
        middle = sorted(cls.points, key=lambda p: float(p[0]))[20000]
        cls.center = [float(v) for v in middle[:3]]
        cls.radius = 12.0

    def processor_ticks(self):
        stat = pathlib.Path(f"/proc/{self.server.process.pid}/stat")
        return sum(map(int, stat.read_text().split()[13:15]))

    def fails(self, *arguments, status=1, message=""):
        result = self.server.run_command(*arguments)
        self.assertEqual(result.returncode, status,
                         f"{arguments}: {result.stdout} {result.stderr}")
        self.assertIn(message, result.stderr)

    def answer(self, name, *options):
        """The lines of an answer, sorted."""
        path = self.work / "answer.csv"
        self.mapsieve("query", name, *options, "-o", path)
        return sorted(path.read_text().splitlines())

    def make_map(self, name, points):
        """A processed map of points."""
        path = self.work / f"{name}.csv"
        with open(path, "w", newline="") as file:
            csv.writer(file).writerows([self.header, *points])
        self.mapsieve("create", name, "--tile-edge", 4)
        self.mapsieve("upload", name, path)
        self.mapsieve("process", name, "--rho", "0.2")

    def is_inside(self, point):
        q = [round(float(v) / STEP) * STEP for v in point[:3]]
        return sum((a - b) ** 2
                   for a, b in zip(q, self.center)) <= self.radius ** 2

    @property
    def sphere(self):
        return ("--sphere", *self.center, self.radius)

    def test_delete_process_and_roll_back(self):
        self.make_map("edited", self.points)
        before = self.mapsieve("info", "edited")
        answer = self.answer("edited")
        rest = [p for p in self.points if not self.is_inside(p)]
        self.assertLess(len(rest), len(self.points) - 100)
        deleted = self.mapsieve("delete-region", "edited", *self.sphere)
        self.assertEqual(deleted["removed_point_count"],
                         len(self.points) - len(rest))
        self.assertEqual(deleted["revision"], before["revision"] + 1)
        info = self.mapsieve("info", "edited")
        self.assertEqual(info["raw_point_count"], len(rest))
        self.assertEqual(info["stale_tile_count"], deleted["tile_count"])
        self.assertEqual(self.answer("edited"), answer)
        again = self.mapsieve("delete-region", "edited", *self.sphere)
        self.assertEqual(again["removed_point_count"], 0)
        self.assertEqual(again["revision"], deleted["revision"])

        self.server.stop(signal.SIGKILL)
        self.server.start()
        self.mapsieve("process", "edited")
        self.make_map("scratch", rest)
        self.assertEqual(self.answer("edited"), self.answer("scratch"))
        self.assertEqual(self.answer("edited", "--raw"),
                         self.answer("scratch", "--raw"))

        back = self.mapsieve("rollback", "edited", "--to", before["revision"])
        self.assertEqual(back["kind"], "rollback")
        self.assertEqual(back["restored_revision"], before["revision"])
        self.assertEqual(self.answer("edited"), answer)
        after = self.mapsieve("info", "edited")
        for key in ("raw_point_count", "point_count", "label_counts",
                    "stored_bytes", "stale_tile_count", "bounds"):
            self.assertEqual(after[key], before[key])
        self.assertEqual(before["reclaimable_bytes"], 0)
        self.assertGreater(after["reclaimable_bytes"], 0)
        self.assertEqual(after["oldest_revision"], 1)
        self.assertEqual(
            self.mapsieve("rollback", "edited", "--to",
                          before["revision"])["revision"], back["revision"])

        kinds = ["rollback", "process", "delete-region", "process", "upload",
                 "create"]
        revisions = self.mapsieve("revisions", "edited")["revisions"]
        self.assertEqual([r["kind"] for r in revisions], kinds)
        self.assertEqual(after["revisions"], revisions)
        self.assertEqual(revisions[2]["sphere"], [*self.center, self.radius])
        self.assertEqual(revisions[1]["options"]["rho"], 0.2)
        plain = self.server.run_command("info", "edited").stdout
        self.assertIn("delete-region", plain)
        self.assertIn("tile edge", plain)

        tiles = self.work / "tiles.csv"
        change = self.mapsieve("revisions", "edited", "--compare",
                               before["revision"], deleted["revision"],
                               "--tiles", tiles)
        self.assertEqual(change["tiles_removed"] + change["tiles_changed_raw"],
                         deleted["tile_count"])
        self.assertEqual(change["tiles_added"], 0)
        self.assertEqual(change["tiles_changed_product"], 0)
        with open(tiles, newline="") as file:
            rows = list(csv.DictReader(file))
        self.assertEqual(len(rows), deleted["tile_count"])
        self.assertEqual(
            sum(int(r["raw_points_before"]) - int(r["raw_points_after"])
                for r in rows), deleted["removed_point_count"])
        change = self.mapsieve("revisions", "edited", "--compare",
                               before["revision"], back["revision"])
        self.assertEqual(change["tiles_changed_product"], 0)
        self.assertEqual(change["label_counts_before"],
                         change["label_counts_after"])

    def test_replace_is_one_revision_of_several_files(self):
        self.make_map("replaced", self.points)
        first = self.mapsieve("info", "replaced")["revision"]
        inside = [p for p in self.points if self.is_inside(p)]
        halves = (self.work / "half1.csv", self.work / "half2.csv")
        for path, part in zip(halves, (inside[::2], inside[1::2])):
            with open(path, "w", newline="") as file:
                csv.writer(file).writerows([self.header, *part])
        answer = self.answer("replaced", "--raw")
        for already_there in (False, True):
            report = self.mapsieve("replace-region", "replaced", *halves,
                                   *self.sphere)
            self.assertEqual(report["already_there"], already_there)
            self.assertEqual(report["revision"], first + 1)
            self.assertEqual(
                self.mapsieve("info", "replaced")["revision"], first + 1)
            # Its own points took the place of those of the region.
            self.assertEqual(self.answer("replaced", "--raw"), answer)
        half = self.mapsieve("replace-region", "replaced", *self.sphere,
                             halves[0])
        self.assertEqual(half["removed_point_count"], len(inside))
        self.assertEqual(half["added_point_count"], len(inside[::2]))

    def test_deleted_points_come_again_when_asked_for(self):
        inside = [p for p in self.points if self.is_inside(p)]
        self.make_map("returning", inside)
        path = self.work / "returning.csv"
        raw = self.answer("returning", "--raw")
        self.mapsieve("delete-region", "returning", *self.sphere)
        for flags, count in (((), 0), (("--again",), len(inside)), ((), 0)):
            report, = self.mapsieve("upload", "returning", path,
                                    *flags)["files"]
            self.assertEqual(report["already_there"], count == 0)
            self.assertEqual(report["added_point_count"], count)
        self.assertEqual(self.answer("returning", "--raw"), raw)
        for flags, already_there in (((), False), ((), True),
                                     (("--again",), False)):
            report = self.mapsieve("replace-region", "returning", path,
                                   *self.sphere, *flags)
            self.assertEqual(report["already_there"], already_there)
            self.assertEqual(report["removed_point_count"],
                             0 if already_there else len(inside))
        self.assertEqual(self.answer("returning", "--raw"), raw)

    def test_what_the_map_refused_can_be_tried_again(self):
        self.mapsieve("create", "strict")
        files = []
        for scalar in ("uchar", "float"):
            files.append(self.work / f"{scalar}.ply")
            files[-1].write_text("\n".join([
                "ply", "format ascii 1.0", "element vertex 1",
                *(f"property double {axis}" for axis in "xyz"),
                f"property {scalar} gain", "end_header", "1 2 3 4", ""]))
        self.mapsieve("upload", "strict", files[0])
        for _ in range(2):
            self.fails("upload", "strict", files[1],
                       message='"gain" is float32 here and uint8 in the map')
        self.mapsieve("rollback", "strict", "--to", 1)
        report, = self.mapsieve("upload", "strict", files[1])["files"]
        self.assertEqual(report["added_point_count"], 1)

    def kill_while_it_processes(self, name, *options):
        """Kills the server under a `process`; the command, with a relay."""
        source = self.work / "long.las"
        self.mapsieve("simulate", source, "--points", 1000000)
        self.mapsieve("create", name)
        self.mapsieve("upload", name, source)
        before = self.processor_ticks()
        relay = self.enterContext(Relay(self.server.address))
        waiting = self.enterContext(subprocess.Popen(
            [BIN / "mapsieve", "--server", relay.address, "process", name,
             "--rho", "0.1", *options], stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True))
        while self.processor_ticks() < before + 20:
            self.assertIsNone(waiting.poll(), "ended before it was seen")
        self.server.stop(signal.SIGKILL)
        return waiting, relay

    def test_a_process_that_is_waited_for_outlives_the_server(self):
        waiting, relay = self.kill_while_it_processes("killed")
        self.server.start()
        relay.target = self.server.address
        messages = waiting.stderr.read()
        self.assertEqual(waiting.wait(), 0, messages)
        self.assertEqual(self.mapsieve("info", "killed")["stale_tile_count"],
                         0)

    def test_who_stops_waiting_is_told_how_to_go_on(self):
        waiting, _ = self.kill_while_it_processes("left", "--retry-for", "0")
        messages = waiting.stderr.read()
        self.server.start()
        self.assertEqual(waiting.wait(), 1, messages)
        hint = re.search(r"mapsieve operation (\w+) waits", messages)
        self.assertIsNotNone(hint, messages)
        ended = self.mapsieve("operation", hint[1])
        self.assertEqual(ended["state"], "succeeded")
        self.assertEqual(self.mapsieve("info", "left")["stale_tile_count"], 0)

    def test_an_operation_is_waited_for_or_cancelled(self):
        self.mapsieve("create", "busy")
        self.mapsieve("upload", "busy", self.source)
        first = self.mapsieve("process", "busy", "--no-wait")["operation"]
        ended = self.mapsieve("operation", first)
        self.assertEqual(ended, {"operation": first, "verb": "ProcessMap",
                                 "target": "maps/busy", "state": "succeeded"})
        before = self.mapsieve("info", "busy")["processed_revision"]
        self.assertGreater(before, 0)
        # What is done stays so.
        self.assertEqual(self.mapsieve("operation", first, "--cancel"), ended)
        second = self.mapsieve("process", "busy", "--rho", 0.3,
                               "--no-wait")["operation"]
        state = self.mapsieve("operation", second, "--cancel")["state"]
        after = self.mapsieve("info", "busy")["processed_revision"]
        self.assertEqual(after == before, state == "cancelled")
        if state == "cancelled":
            self.fails("operation", second, message="cancelled by request")
        self.fails("operation", "none", message='no operation "none"')

    def test_refusals(self):
        self.mapsieve("create", "refusing")
        for command in (("delete-region", "refusing"),
                        ("replace-region", "refusing", self.source),
                        ("rollback", "refusing"),
                        ("revisions", "refusing", "--compare", 1),
                        ("revisions", "refusing", "--tiles", "x.csv"),
                        ("delete-region", "refusing", *self.sphere, "--box",
                         0, 0, 0, 1, 1, 1)):
            self.fails(*command, status=2)
        self.fails("delete-region", "refusing", "--sphere", 0, 0, 0, -1,
                   message="radius")
        self.fails("delete-region", "nosuchmap", *self.sphere,
                   message="nosuchmap")
        self.fails("rollback", "refusing", "--to", 2, message="1 to 1")
        self.fails("revisions", "refusing", "--compare", 1, 7, message="7")
        self.fails("query", "refusing", "--max-points", 0, "-o", "x.ply",
                   status=2, message="expected a number above 0, have 0")
        result = run_command("--server", "127.0.0.1:1", "list")
        self.assertEqual(result.returncode, 1)
        self.assertIn("see that mapsieved runs there", result.stderr)
        absent = self.work / "absent.las"
        self.fails("replace-region", "refusing", *self.sphere, absent,
                   message="absent.las")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
