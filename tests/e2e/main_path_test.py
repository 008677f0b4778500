#!/usr/bin/python3
"""The programs as a user runs them: a real server process, real files.

usage: main_path_test.py BIN_DIR [TEST_DATA]
"""

import csv
import math
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest

from programs import BIN, Server, ServedTest, run_command

DATA = pathlib.Path(sys.argv[2]) if len(sys.argv) > 2 else None
STEP = 0.001


class MainPath(ServedTest):
    def run_command(self, *arguments):
        return self.server.run_command("--json", *arguments)

    def fails(self, *arguments, status=1, message=""):
        result = self.run_command(*arguments)
        self.assertEqual(result.returncode, status,
                         f"{arguments}: {result.stdout} {result.stderr}")
        if status == 1:
            self.assertEqual(len(result.stderr.splitlines()), 1, result.stderr)
        self.assertIn(message, result.stderr)

    def rows(self, path):
        """Rows of a CSV file by lattice point; values as text."""
        by_point = {}
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                point = tuple(round(float(row.pop(a)) / STEP) for a in "xyz")
                by_point.setdefault(point, []).append(row)
        return by_point

    def check_map(self, name, source, process_options=()):
        """Takes a file through the main path and compares attributes."""
        self.mapsieve("create", name)
        upload = self.mapsieve("upload", name, source)["files"][0]
        process = self.mapsieve("process", name, *process_options)
        info = self.mapsieve("info", name)
        self.assertEqual(info["raw_point_count"], upload["added_point_count"])
        self.assertEqual(info["point_count"], process["point_count"])
        self.assertEqual(info["stale_tile_count"], 0)
        self.assertGreater(info["point_count"], 0)

        converted = self.work / f"{name}_input.csv"
        answer = self.work / f"{name}_answer.csv"
        self.mapsieve("convert", source, converted)
        query = self.mapsieve("query", name, "-o", answer)
        self.assertEqual(query["point_count"], info["point_count"])
        self.assertEqual(query["label_counts"], info["label_counts"])
        before = self.rows(converted)
        after = self.rows(answer)
        self.assertEqual(len(after), info["point_count"])
        own = ("label", "confidence", "nx", "ny", "nz")
        for point, (row,) in after.items():
            attributes = {}
            for key, value in row.items():
                if key not in own:
                    attributes[key.removeprefix("input_")] = value
            self.assertIn(attributes, before[point])

        budget = max(1, info["point_count"] // 3)
        spread = self.work / f"{name}_spread.csv"
        self.assertEqual(
            self.mapsieve("query", name, "--max-points", budget, "-o",
                          spread)["point_count"], budget)
        self.assertLessEqual(set(self.rows(spread)), set(after))
        return info

    def check_query_options(self, center):
        """Each region, filter, budget and column of `query` on the campus."""
        x, y, z = center

        def ask(*options):
            path = self.work / "part.csv"
            result = self.mapsieve("query", "campus", *options, "-o", path)
            rows = self.rows(path)
            self.assertEqual(result["point_count"], len(rows))
            self.assertGreater(len(rows), 0)
            return result, rows

        def positions(rows):
            return [[q * STEP for q in point] for point in rows]

        for px, py, pz in positions(ask("--cylinder", x, y, 20, "--z-range",
                                        z - 5, z + 1)[1]):
            self.assertLessEqual(math.hypot(px - x, py - y), 20.001)
            self.assertLessEqual(abs(pz - z + 2), 3.001)
        # A square as a polygon, as a box that is turned twice, and as a box.
        square = ask("--box", x - 9, y - 9, z - 50, x + 9, y + 9, z + 50)[1]
        self.assertEqual(
            set(ask("--polygon", x - 9, y - 9, x + 9, y - 9, x + 9, y + 9,
                    x - 9, y + 9, "--z-range", z - 50, z + 50)[1]),
            set(square))
        turned = set(ask("--oriented-box", x, y, z, 18, 18, 100, 90)[1])
        self.assertLess(len(turned ^ set(square)), 5 + len(square) // 100)
        for px, py, pz in positions(ask("--frustum", x, y, z, x, y + 1, z, 60,
                                        1.5, 0.5, 40)[1]):
            self.assertTrue(0.499 <= py - y <= 40.001)
            self.assertLessEqual(abs(pz - z), 0.5774 * (py - y) + 0.001)
            self.assertLessEqual(abs(px - x), 0.8661 * (py - y) + 0.001)
        for px, py, pz in positions(ask("--corridor", 6, x - 20, y, z, x + 20,
                                        y, z)[1]):
            self.assertLessEqual(math.hypot(py - y, pz - z), 6.001)
            self.assertLessEqual(abs(px - x), 26.001)

        result, rows = ask("--columns", "confidence,covariance,intensity",
                           "--confidence", 0.02, 0.1, "--range", "intensity",
                           10000, "inf")
        for (row,) in rows.values():
            self.assertEqual(set(row), {
                "confidence", "cov_xx", "cov_xy", "cov_xz", "cov_yy",
                "cov_yz", "cov_zz", "intensity"})
            self.assertTrue(0.02 <= float(row["confidence"]) <= 0.1)
            self.assertGreaterEqual(float(row["intensity"]), 10000)
        small = ask("--max-bytes", 70000, "--weights", 1, 1, 1)[0]
        self.assertGreater(small["available_point_count"],
                           small["point_count"])
        self.assertTrue(66500 <= small["block_bytes"] <= 70000, small)
        for options, message in (
                (("--polygon", 0, 0, 1, 1, 0, 1, 1), "x y for each vertex"),
                (("--polygon", 0, 0, 2, 2, 2, 0, 0, 2), "must not cross"),
                (("--frustum", 0, 0, 0, 0, 0, 1, 60, 1, 0, 9), "to the side"),
                (("--range", "nothing", 0, 1), "nothing"),
                (("--range", "intensity", "low", 1), "low")):
            self.fails("query", "campus", *options, "-o",
                       self.work / "x.csv", message=message)
        self.fails("query", "campus", "--box", 0, 0, 0, 1, 1, 1, "--cylinder",
                   0, 0, 1, "-o", self.work / "x.csv", status=2)

    def test_simulated_campus(self):
        source = self.work / "campus.las"
        self.mapsieve("simulate", source, "--points", 150000)
        options = ("--rho", "0.2", "--label-neighbors", "90")
        info = self.check_map("campus", source, options)
        self.assertGreater(info["label_counts"]["surface"],
                           info["label_counts"]["curve"])

        again = self.mapsieve("upload", "campus", source)["files"][0]
        self.assertTrue(again["already_there"])
        self.assertEqual(self.mapsieve("info", "campus"), info)

        center = [(a + b) / 2 for a, b in zip(info["bounds"]["min"],
                                              info["bounds"]["max"])]
        curves = self.work / "curves.csv"
        self.mapsieve("query", "campus", "--sphere", *center, 30, "--labels",
                      "curve,junction", "-o", curves)
        for x, y, z in self.rows(curves):
            d2 = sum((q * STEP - c) ** 2 for q, c in zip((x, y, z), center))
            self.assertLessEqual(d2, 30.0001 ** 2)
        for (row,) in self.rows(curves).values():
            self.assertIn(row["label"], ("1", "2"))

        self.check_query_options(center)

        example = subprocess.run(
            [BIN / "quickstart", self.server.address, "campus",
             *map(str, center), "30"],
            capture_output=True, text=True, timeout=60)
        self.assertEqual(example.returncode, 0, example.stderr)
        printed = {tuple(round(float(v) / STEP) for v in line.split())
                   for line in example.stdout.splitlines()}
        self.assertEqual(printed, set(self.rows(curves)))

        local = self.work / "local.csv"
        served = self.work / "served.csv"
        self.mapsieve("sample", source, *options, "-o", local)
        self.mapsieve("query", "campus", "-o", served)
        self.assertEqual(self.rows(local), self.rows(served))

    def test_picture(self):
        source = self.work / "small.ply"
        picture = self.work / "small.png"
        self.mapsieve("simulate", source, "--points", 20000)
        self.mapsieve("render", source, "-o", picture)
        self.assertEqual(picture.read_bytes()[:8], b"\x89PNG\r\n\x1a\n")

    @unittest.skipUnless(DATA, "no real data")
    def test_real_maps(self):
        self.check_map("metres", DATA / "maps/autzen_140m_metres.las",
                       ("--rho", "1", "--sigma", "2"))
        self.check_map("trim", DATA / "maps/autzen_trim.las",
                       ("--rho", "3", "--sigma", "6"))

    @unittest.skipUnless(DATA, "no real data")
    def test_real_scans(self):
        for name, file in (
                ("car", "libpointmatcher/car_cloud400.csv"),
                ("apartment", "libpointmatcher/cloud_0.vtk"),
                ("vehicle", "norlab/cloud_1690309709_285305600.vtk"),
                ("velodyne", "small_gicp/source.ply")):
            self.check_map(name, DATA / "registration" / file, ("--rho", "0.2"))

    def test_bad_input_is_refused_in_one_line_and_changes_nothing(self):
        good = self.work / "good.csv"
        good.write_text("x,y,z,t\n1,2,3,4\n")
        self.mapsieve("create", "bad")
        self.mapsieve("upload", "bad", good)
        before = self.mapsieve("info", "bad")

        whole = self.work / "whole.las"
        self.mapsieve("simulate", whole, "--points", 1000)
        cut = self.work / "cut.las"
        cut.write_bytes(whole.read_bytes()[:-100])
        self.fails("upload", "bad", cut, message="cut.las")
        empty = self.work / "empty.las"
        empty.write_bytes(b"")
        self.fails("upload", "bad", empty, message="empty.las")
        self.fails("upload", "bad", self.work / "absent.las", message="absent")
        typed = self.work / "typed.ply"
        typed.write_text(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
            "property float y\nproperty float z\nproperty uchar t\n"
            "end_header\n1 1 1 1\n")
        self.fails("upload", "bad", typed, message="uint8")
        self.fails("process", "bad", "--rho", "-1", message="density_radius_m")
        self.fails("process", "bad", "--label-neighbors", "5",
                   message="label_neighbor_count is 5; it must be 6 to 127")
        self.fails("query", "bad", "-o", self.work / "x.ply", message="process")
        self.fails("query", "bad", "--raw", "-o", self.work / "x.doc",
                   message="x.doc")
        self.fails("create", "bad", message="bad")
        self.fails("create", "../etc", message="../etc")
        self.fails("info", "nosuchmap", message="nosuchmap")
        self.fails("query", "bad", status=2)
        self.fails("proces", "bad", status=2,
                   message='unknown command or option "proces"')
        self.fails("nosuchcommand", status=2)
        self.assertEqual(self.mapsieve("info", "bad"), before)

    def test_watch_prints_a_line_for_each_revision(self):
        source = self.work / "watched.csv"
        source.write_text("x,y,z\n1,2,3\n")
        self.mapsieve("create", "watched")
        watch = subprocess.Popen(
            [BIN / "mapsieve", "--server", self.server.address, "--json",
             "watch", "watched"], stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True)
        lines = [json.loads(watch.stdout.readline())]
        self.mapsieve("upload", "watched", source)
        lines.append(json.loads(watch.stdout.readline()))
        self.mapsieve("process", "watched")
        lines.append(json.loads(watch.stdout.readline()))
        self.assertEqual(lines, [
            {key: value for key, value in line.items() if key != "map"}
            for line in reversed(
                self.mapsieve("revisions", "watched")["revisions"])])
        again = self.run_command("watch", "watched", "--from", 2, "--count", 1)
        self.assertEqual(json.loads(again.stdout), lines[1])
        plain = self.server.run_command("watch", "watched", "--count", "1")
        self.assertEqual(len(plain.stdout.splitlines()), 1)
        self.assertIn("revision 3: process, 1 raw points", plain.stdout)
        self.fails("watch", "watched", "--from", 9, message="newest revision")

        self.mapsieve("delete", "watched")
        self.assertEqual(watch.wait(timeout=20), 1)
        self.assertIn("watched", watch.stderr.read())
        watch.stdout.close()
        watch.stderr.close()

    def test_refused_points_are_counted_by_reason(self):
        source = self.work / "refused.csv"
        source.write_text("x,y,z\n1,2,3\nnan,2,3\n1,inf,3\n1e300,0,0\n")
        self.mapsieve("create", "refused")
        file = self.mapsieve("upload", "refused", source)["files"][0]
        self.assertEqual(file["added_point_count"], 1)
        self.assertEqual(file["refused_non_finite_count"], 2)
        self.assertEqual(file["refused_out_of_lattice_count"], 1)

    def test_one_point_and_many_in_one_voxel(self):
        one = self.work / "one.csv"
        one.write_text("x,y,z\n1,2,3\n")
        self.mapsieve("create", "one")
        self.mapsieve("upload", "one", one, "--process")
        self.assertEqual(self.mapsieve("info", "one")["raw_point_count"], 1)
        many = self.work / "many.csv"
        many.write_text("x,y,z\n" + "5,5,5\n" * 1000000)
        self.mapsieve("create", "many")
        result = self.mapsieve("upload", "many", many, "--process")
        self.assertEqual(result["files"][0]["added_point_count"], 1000000)
        self.assertEqual(result["process"]["distinct_point_count"], 1)

    def test_restart_and_kill_lose_nothing(self):
        source = self.work / "kept.las"
        self.mapsieve("simulate", source, "--points", 30000)
        self.mapsieve("create", "kept")
        self.mapsieve("upload", "kept", source, "--process")
        before = self.mapsieve("info", "kept")
        for with_signal, code in ((signal.SIGKILL, -signal.SIGKILL),
                                  (signal.SIGTERM, 0)):
            self.assertEqual(self.server.stop(with_signal), code)
            self.server.start()
            self.assertEqual(self.mapsieve("info", "kept"), before)
        answer = self.mapsieve("query", "kept", "-o", self.work / "kept.ply")
        self.assertEqual(answer["point_count"], before["point_count"])

    def test_verify_finds_damage_and_nothing_else(self):
        source = self.work / "whole.las"
        self.mapsieve("simulate", source, "--points", 50000, "--seed", 5)
        self.mapsieve("create", "whole")
        self.mapsieve("upload", "whole", source)
        self.fails("verify", "whole", "--tiling", message="never processed")
        self.mapsieve("process", "whole", "--rho", "0.2")
        blobs = self.work / "data" / "blobs"
        report = self.mapsieve("verify", "whole", "--tiling", "--tiles", 5)
        self.assertEqual(report["damaged_chunks"], [])
        self.assertEqual(report["differing_tiles"], [])
        self.assertEqual(report["compared_tile_count"], 5)
        self.assertGreater(report["compared_point_count"], 100)

        # Damage one stored object after the other, if it is of this map.
        for victim in sorted(blobs.glob("??/*")):
            whole = victim.read_bytes()
            victim.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
            result = self.run_command("verify", "whole")
            victim.write_bytes(whole)
            if result.returncode == 0:
                continue
            self.assertEqual(result.returncode, 1)
            self.assertEqual(len(result.stderr.splitlines()), 1)
            damaged, = json.loads(result.stdout)["damaged_chunks"]
            self.assertEqual(damaged["blob"], victim.name)
            self.assertIn("whole", damaged["problem"])
            break
        else:
            self.fail("no damage was found")
        self.mapsieve("verify", "whole")

    def test_damaged_results_are_left_out_and_made_again(self):
        source = self.work / "worn.las"
        self.mapsieve("simulate", source, "--points", 50000, "--seed", 6)
        self.mapsieve("create", "worn", "--tile-edge", 8)
        self.mapsieve("upload", "worn", source)
        self.mapsieve("process", "worn", "--rho", "0.2")
        answer = self.work / "worn.csv"
        whole = self.mapsieve("query", "worn", "-o", answer)
        points = self.rows(answer)

        # The largest chunk that the query reads.
        blobs = self.work / "data" / "blobs"
        for victim in sorted(blobs.glob("??/*"), reverse=True,
                             key=lambda path: path.stat().st_size):
            stored = victim.read_bytes()
            victim.unlink()
            result = self.run_command("query", "worn", "-o", answer)
            if result.returncode == 1:
                break
            victim.write_bytes(stored)
        self.assertIn("map worn", result.stderr)
        self.assertIn(str(victim), result.stderr)

        result = self.run_command("query", "worn", "--allow-partial",
                                  "-o", answer)
        self.assertEqual(result.returncode, 0, result.stderr)
        line, = result.stderr.splitlines()
        self.assertIn("left out", line)
        self.assertIn(str(victim), line)
        part = json.loads(result.stdout)
        self.assertEqual(part["missing_chunk_count"], 1)
        self.assertLess(part["point_count"], whole["point_count"])
        self.assertGreaterEqual(
            part["point_count"] + part["missing_point_count"],
            whole["point_count"])
        for point, row in self.rows(answer).items():
            self.assertEqual(row, points[point])

        self.fails("verify", "worn", message="--repair")
        report = self.mapsieve("verify", "worn", "--repair")
        self.assertEqual(report["repaired_chunk_count"], 1)
        self.assertEqual(report["damaged_chunks"], [])
        self.assertEqual(victim.read_bytes(), stored)
        again = self.mapsieve("query", "worn", "-o", answer)
        self.assertEqual(again["point_count"], whole["point_count"])
        self.assertEqual(self.rows(answer), points)

    def test_delete_removes_the_map_only(self):
        self.mapsieve("create", "kept-map")
        self.mapsieve("create", "gone")
        self.mapsieve("delete", "gone")
        names = [m["map"] for m in self.mapsieve("list")["maps"]]
        self.assertIn("kept-map", names)
        self.assertNotIn("gone", names)


class WithoutServer(unittest.TestCase):
    def test_unreachable_server_is_named(self):
        result = run_command("--server", "127.0.0.1:1", "list", timeout=60)
        self.assertEqual(result.returncode, 1)
        self.assertIn("127.0.0.1:1", result.stderr)

    def test_data_directory_has_one_server(self):
        with tempfile.TemporaryDirectory() as folder:
            server = Server(pathlib.Path(folder) / "data")
            second = subprocess.run(
                [BIN / "mapsieved", "--data", pathlib.Path(folder) / "data",
                 "--listen", "127.0.0.1:0"],
                capture_output=True, text=True, timeout=60)
            self.assertEqual(second.returncode, 1)
            self.assertIn(str(server.process.pid), second.stderr)
            self.assertEqual(server.stop(), 0)


if __name__ == "__main__":
    os.environ.pop("MAPSIEVE_SERVER", None)
    unittest.main(argv=sys.argv[:1], verbosity=2)
