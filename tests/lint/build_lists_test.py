#!/usr/bin/python3
"""Tests build_lists.py on small trees."""

import pathlib
import tempfile
import unittest

import build_lists

GOOD = {
    "CMakeLists.txt": "add_subdirectory(core)\nadd_subdirectory(tests)\n",
    "core/CMakeLists.txt": "add_library(core a.cc deep/b.cc)\n",
    "core/a.cc": "",
    "core/deep/b.cc": "",
    "tests/CMakeLists.txt": "add_subdirectory(unit)\n",
    "tests/testing/clouds.cc": "",
    "tests/unit/CMakeLists.txt": "test(t a_test.cc ../testing/clouds.cc)\n",
    "tests/unit/a_test.cc": "",
}


def complaints_about(changes):
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder).resolve()
        for name, text in {**GOOD, **changes}.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        return list(build_lists.check_tree(root))


class BuildListsTest(unittest.TestCase):

    def test_accepts_a_tree_that_builds_everything(self):
        self.assertEqual(complaints_about({}), [])

    def test_finds_a_file_that_no_list_names(self):
        for name in ("tests/unit/b_test.cc", "tests/unit/deep/a_test.cc",
                     "core/deep/a.cc", "proto/v1/a.proto"):
            with self.subTest(name):
                found = complaints_about({name: ""})
                self.assertEqual(len(found), 1)
                self.assertIn(f"{name}: no CMakeLists.txt names", found[0])

    def test_takes_no_comment_for_a_list(self):
        found = complaints_about({
            "tests/unit/CMakeLists.txt":
                "# a_test.cc\ntest(t ../testing/clouds.cc)\n"})
        self.assertEqual(len(found), 1)
        self.assertIn("tests/unit/a_test.cc", found[0])

    def test_finds_a_folder_that_is_not_added(self):
        for changes, left_out in (
                ({"tests/CMakeLists.txt": "# add_subdirectory(unit)\n"},
                 "tests/unit/CMakeLists.txt"),
                ({"storage/CMakeLists.txt": ""}, "storage/CMakeLists.txt")):
            with self.subTest(left_out):
                found = complaints_about(changes)
                self.assertEqual(len(found), 1)
                self.assertIn(f"{left_out}: ", found[0])
                self.assertIn("does not add this folder", found[0])


if __name__ == "__main__":
    unittest.main()
