#!/usr/bin/python3
"""Where points lie, from file to map to file, and what an upload reports.

usage: place_test.py BIN_DIR [TEST_DATA]
"""

import pathlib
import struct
import sys
import unittest

from programs import ServedTest

DATA = pathlib.Path(sys.argv[2]) if len(sys.argv) > 2 else None

LAS_FILES = (
    # File, codes of the map if it has no WKT, how the WKT of the answer begins,
    # unit warned of.
    ("formats/las/pdal/1.2_0.las", "EPSG:26915",
     'PROJCS["NAD83 / UTM zone 15N"', None),
    ("formats/las/pdal/bad-geotiff-keys.las", "EPSG:32617",
     'PROJCS["WGS 84 / UTM zone 17N"', None),
    ("formats/las/pdal/wontcompress3.las", None,
     'PROJCS["NAD83 / UTM zone 19N"', None),
    ("formats/las/las-rs/autzen.las", "EPSG:2994",
     'PROJCS["NAD83(HARN) / Oregon GIC Lambert (ft)"', "foot"),
    ("formats/las/pdal/interesting.las", None,
     'PROJCS["NAD_1983_Oregon_Statewide_Lambert_Feet_Intl"', "foot"),
    ("formats/las/laspy/1_4_w_evlr.las", None,
     'PROJCS["NAD83(HARN) / New Mexico Central (ftUS)"', "US survey foot"),
    ("formats/las/pdal/spurious.las", "EPSG:4326", 'GEOGCS["WGS 84"',
     "degree"),
    ("formats/las/pdal/prec3.las", None,
     'PROJCS["NAD_1983_HARN_Lambert_Conformal_Conic"', "foot"),
    ("formats/las/laz-perf/1815.las", "EPSG:6580+5703",
     'COMPD_CS["NAD83(2011) / Texas Centric Lambert Conformal + NAVD88 height"',
     None),
)
# Of these with scales under 1 mm.
FINE_FILES = ("wontcompress3.las", "evlr.las", "spurious.las", "1815.las")
METRIC_FILES = (
    "maps/autzen_140m_metres.las",
    "registration/small_gicp/source.ply",
    "registration/libpointmatcher/car_cloud400.csv",
    "registration/libpointmatcher/cloud_0.vtk",
    "registration/norlab/cloud_1690309709_285305600.vtk",
)


def wkt_of_las(path):
    """The WKT of a LAS file, or None."""
    content = path.read_bytes()
    header_bytes, _, record_count = struct.unpack_from("<HII", content, 94)
    wkt = None
    at = header_bytes
    for _ in range(record_count):
        user = content[at + 2:at + 18].split(b"\0")[0]
        number, size = struct.unpack_from("<HH", content, at + 18)
        payload = content[at + 54:at + 54 + size]
        if (user, number) == (b"LASF_Projection", 2112):
            wkt = payload.split(b"\0")[0].decode()
        at += 54 + size
    return wkt


def header_of(path):
    """The text lines that a PLY or PCD file begins with."""
    lines = []
    for line in path.read_bytes().split(b"\n"):
        lines.append(line.decode())
        if line == b"end_header" or line.startswith(b"DATA"):
            return lines


class Place(ServedTest):
    def upload(self, name, path):
        """The report of one file, and the codes of its warnings."""
        report = self.mapsieve("upload", name, path)["files"][0]
        for warning in report["warnings"]:
            self.assertTrue(warning["message"])
        return report, [w["code"] for w in report["warnings"]]

    def write(self, name, text):
        path = self.work / name
        path.write_text(text)
        return path

    @unittest.skipIf(DATA is None, "no test data")
    def test_crs_of_real_files_comes_out_again(self):
        for i, (name, codes, wkt_head, unit) in enumerate(LAS_FILES):
            with self.subTest(name):
                self.mapsieve("create", f"las{i}", "--tile-edge", 2000)
                report, warned = self.upload(f"las{i}", DATA / name)
                expected = ["unit_not_metre"] if unit else []
                if name.endswith(FINE_FILES):
                    expected.append("step_too_coarse")
                self.assertEqual(warned, expected)
                if unit:
                    self.assertIn(f'"{unit}"',
                                  report["warnings"][0]["message"])
                answer = self.work / "answer.las"
                self.mapsieve("query", f"las{i}", "--raw", "-o", answer)
                wkt = wkt_of_las(answer)
                self.assertTrue(wkt.startswith(wkt_head + ","), wkt)
                crs = self.mapsieve("info", f"las{i}")["crs"]
                self.assertEqual(crs, codes or wkt)
                # The answer is of the same system as its map.
                self.assertEqual(
                    [c for c in self.upload(f"las{i}", answer)[1]
                     if c.startswith("crs")], [])

    @unittest.skipIf(DATA is None, "no test data")
    def test_keys_that_are_not_understood_are_told(self):
        self.mapsieve("create", "odd")
        path = DATA / "formats/las/laspy/simple1_3.las"
        report, codes = self.upload("odd", path)
        self.assertIn("crs_not_read", codes)
        self.assertIn("no horizontal system", report["warnings"][-1]["message"])
        report = self.mapsieve("replace-region", "odd", path, "--sphere", 0, 0,
                               0, 1)
        self.assertIn("crs_not_read", [w["code"] for w in report["warnings"]])

    @unittest.skipIf(DATA is None, "no test data")
    def test_metric_files_warn_of_nothing(self):
        for i, name in enumerate(METRIC_FILES):
            self.mapsieve("create", f"metric{i}")
            report, codes = self.upload(f"metric{i}", DATA / name)
            self.assertEqual(codes, [], name)
            self.assertGreater(report["added_point_count"], 0)

    def test_create_tells_of_a_crs_that_is_not_known(self):
        for name, crs, said in (("typo", "EPSG:99999", 'no coordinate '
                                 'reference system "EPSG:99999"'),
                                ("words", "UTM zone 32", "no coordinate"),
                                ("utm", "EPSG:25832+7837", "")):
            result = self.server.run_command("create", name, "--crs",
                                             crs)
            self.assertEqual(result.returncode, 0, result.stderr)
            self.assertIn(said, result.stderr)
            self.assertEqual(bool(said), "warning: --crs" in result.stderr)
            self.assertEqual(self.mapsieve("info", name)["crs"], crs)

    @unittest.skipIf(DATA is None, "no test data")
    def test_a_map_with_points_keeps_its_crs(self):
        utm15, utm19, feet = (DATA / LAS_FILES[i][0] for i in (0, 2, 3))
        self.mapsieve("create", "campus", "--crs", "EPSG:26915",
                      "--tile-edge", 2000)
        self.assertEqual(self.upload("campus", utm15)[1], [])
        report, codes = self.upload("campus", utm19)
        self.assertEqual(codes, ["crs_differs", "step_too_coarse"])
        self.assertIn("UTM zone 19N", report["warnings"][0]["message"])
        self.assertEqual(self.upload("campus", feet)[1],
                         ["crs_differs", "unit_not_metre"])
        self.assertEqual(self.mapsieve("info", "campus")["crs"], "EPSG:26915")
        self.mapsieve("create", "local")
        self.upload("local", self.write("p.csv", "x,y,z\n1,2,3\n"))
        self.assertEqual(self.upload("local", feet)[1],
                         ["crs_not_taken", "unit_not_metre"])
        self.assertEqual(self.mapsieve("info", "local")["crs"], "")
        # Of several files in one upload only what they agree on counts.
        self.mapsieve("create", "mixed")
        report = self.mapsieve("replace-region", "mixed", utm15, feet,
                               "--sphere", 0, 0, 0, 1)
        self.assertEqual([w["code"] for w in report["warnings"]],
                         ["files_differ", "files_differ"])
        self.assertEqual(self.mapsieve("info", "mixed")["crs"], "")

    def test_frame_id_goes_through_files(self):
        self.mapsieve("create", "robot", "--frame-id", "warehouse 2",
                      "--crs", "EPSG:2056")
        self.assertEqual(self.mapsieve("info", "robot")["frame_id"],
                         "warehouse 2")
        source = self.write("q.csv", "x,y,z\n1,2,3\n4,5,6\n")
        self.assertEqual(self.upload("robot", source)[1], [])
        for extension, prefix in (("ply", "comment "), ("pcd", "# ")):
            answer = self.work / f"frame.{extension}"
            self.mapsieve("query", "robot", "--raw", "-o", answer)
            lines = header_of(answer)
            self.assertIn(prefix + "frame_id: warehouse 2", lines)
            self.assertIn(prefix + "crs: EPSG:2056", lines)
            self.mapsieve("create", f"from-{extension}")
            self.assertEqual(self.upload(f"from-{extension}", answer)[1], [])
            info = self.mapsieve("info", f"from-{extension}")
            self.assertEqual(info["frame_id"], "warehouse 2")
            self.assertEqual(info["crs"], "EPSG:2056")
            self.mapsieve("create", f"other-{extension}", "--frame-id", "odom")
            self.assertEqual(self.upload(f"other-{extension}", answer)[1],
                             ["frame_id_differs"])
        refused = self.server.run_command("create", "bad", "--frame-id",
                                          "x" * 256)
        self.assertEqual(refused.returncode, 1)
        self.assertIn("frame_id", refused.stderr)

        self.mapsieve("process", "robot", "--reach", "6", "--sigma", "6")
        for place, found in ((("--origin", 0, 0, 0), True),
                             (("--origin", 1, 1, 0), False)):
            folder = self.work / f"window-{found}"
            self.mapsieve("sync", "robot", folder, "--around", 2, 3, 4, 9,
                          *place)
            files = list((folder / "current").glob("*.pcd"))
            self.assertGreater(len(files), 0)
            for path in files:
                self.assertEqual("# frame_id: warehouse 2" in header_of(path),
                                 found)

    def test_report_counts_duplicates_and_density(self):
        self.mapsieve("create", "dense")
        # Three cells of 1.024 m, of 1, 2 and 5 points; two pairs in one place.
        first = self.write(
            "first.csv",
            "x,y,z\n0,0,0\n0.0001,0,0\n5,0,0\n9,0,0\n9.1,0,0\n9.2,0,0\n"
            "9.1002,0,0\n9.1,0,0.5\nnan,0,0\n")
        report, codes = self.upload("dense", first)
        self.assertEqual(codes, [])
        self.assertEqual(report["added_point_count"], 8)
        self.assertEqual(report["refused_non_finite_count"], 1)
        self.assertEqual(report["duplicate_point_count"], 2)
        self.assertEqual(report["overlapping_point_count"], 0)
        self.assertEqual(report["density"], {
            "cell_edge": 1.024, "cells_by_log2_points": [1, 1, 1]})
        second = self.write("second.csv", "x,y,z\n5,0,0\n5,0,0\n6,0,0\n")
        text = self.server.run_command("upload", "dense", second).stdout
        self.assertEqual(text.splitlines(), [
            f"{second}: 3 points added, in 1 tiles, as revision 3",
            "  refused     0 not finite, 0 outside the lattice",
            "  duplicates  1 of the upload itself, 1 of points that the map had",
            "  density     cells of 1.024 by points: 1: 1, 2-3: 1",
            "  bounds      (5, 0, 0) to (6, 0, 0)"])
        again = self.server.run_command("upload", "dense", second).stdout
        self.assertIn("uploaded before, as revision 3; nothing was added", again)
        nothing = self.write("nothing.csv", "x,y,z\nnan,0,0\n1e30,0,0\n")
        report, codes = self.upload("dense", nothing)
        self.assertEqual(codes, [])
        self.assertEqual(report["added_point_count"], 0)
        self.assertEqual(report["refused_non_finite_count"], 1)
        self.assertEqual(report["refused_out_of_lattice_count"], 1)
        self.assertIsNone(report["bounds"])
        self.assertTrue(self.upload("dense", second)[0]["already_there"])


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
