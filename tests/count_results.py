#!/usr/bin/python3
"""Sums up JUnit files of a folder: "N passed, N failed", exit 1 on failure.

A file NAME.died stands for a program that ended without writing its results.
"""

import pathlib
import sys
import xml.etree.ElementTree


def count(path):
    passed = 0
    failed = []
    for case in xml.etree.ElementTree.parse(path).iter("testcase"):
        name = f'{path.stem}: {case.get("classname", "")}.{case.get("name")}'
        if case.get("status") in ("notrun", "disabled"):
            continue
        if case.find("failure") is not None or case.find("error") is not None:
            failed.append(name)
        else:
            passed += 1
    return passed, failed


def main():
    folder = pathlib.Path(sys.argv[1])
    passed = 0
    failed = [f"{path.stem}: died" for path in sorted(folder.glob("*.died"))]
    for path in sorted(folder.glob("*.xml")):
        more_passed, more_failed = count(path)
        passed += more_passed
        failed += more_failed
    print()
    for name in failed:
        print(f"FAILED {name}")
    print(f"{passed} passed, {len(failed)} failed")
    return 1 if failed or passed == 0 else 0


if __name__ == "__main__":
    sys.exit(main())
