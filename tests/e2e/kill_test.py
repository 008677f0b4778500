#!/usr/bin/python3
"""A server that is killed again and again loses nothing that it acknowledged.

usage: kill_test.py BIN_DIR [--kills N] [--seed S]

Four clients upload, others process, edit, roll back, delete and query, while
the server gets SIGKILL at random moments, some while it starts; some clients
die as well. Clients do again what nobody acknowledged. After each restart the
history of every map is followed from its first revision, with the points of
the files as they were written: what was seen before is unchanged, every
revision is whole, all acknowledgements are in it, raw points and products are
those that follow. In the end nothing but what the catalogue refers to is on the
disk. The choices follow from the seed, the moments do not quite.
"""

import argparse
import collections
import contextlib
import hashlib
import itertools
import json
import pathlib
import random
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
import unittest

from programs import (Server, answer_of, lines_of, mapsieve,
                      write_random_points)

PARSER = argparse.ArgumentParser(description=__doc__.split("\n")[0])
PARSER.add_argument("bin")
PARSER.add_argument("--kills", type=int, default=20)
PARSER.add_argument("--seed", type=int, default=1)
ARGUMENTS = PARSER.parse_args()

HEADER = "x,y,z,source"
# Millimetres of the square that all points lie in, and of a file's patch.
FIELD = 8000
PATCH = 3000
TILE_EDGE_M = 2
# Points of a file more than its number: the count tells the file of a map.
SMALLEST_FILE = 200
# A map is replaced by a new one when it has more.
MAX_POINTS = 10_000
MAX_REVISIONS = 60
# 26 MB: the server makes the first 8 MiB durable, and says so, long before the
# rest is sent.
BULK_POINTS = 100_000
CLIENT_DEATHS = 0.05
KILLS_AT_START = 0.2
# Far more than any command takes, on the busiest machine.
TIMEOUT_S = 900

RAW_QUERIES = (("--raw",), ("--raw", "--sphere", 4, 4, 1, 1.5))
QUERIES = (*RAW_QUERIES, (), ("--max-points", 150), ("--labels", "surface"),
           ("--spacing", 0.5))
# Of a client whose predecessor was killed a moment ago.
BUSY_UPLOAD = "another writer has it"


class File:
    """A file of points on a patch of floor or wall."""

    def __init__(self, folder, number, numbers):
        self.number = number
        corner = [numbers.randrange(FIELD - PATCH) for _ in range(2)]
        flat = numbers.randrange(3)

        def point():
            p = [corner[0] + numbers.randrange(PATCH),
                 corner[1] + numbers.randrange(PATCH),
                 numbers.randrange(PATCH)]
            p[flat] = p[flat] // PATCH * PATCH + round(numbers.gauss(1000, 10))
            return tuple(p)

        self.points = tuple(point() for _ in range(SMALLEST_FILE + number))
        self.path = folder / f"{number}.csv"
        write_points(self.path, {self: self.points})


def write_points(path, state):
    path.write_text("\n".join([HEADER, *raw_lines(state)]) + "\n")


def raw_lines(state):
    return [f"{x / 1000:.3f},{y / 1000:.3f},{z / 1000:.3f},{file.number}"
            for file, points in state.items() for x, y, z in points]


def random_region(numbers):
    """No border lies on a coordinate of the lattice."""
    center = [numbers.randrange(FIELD), numbers.randrange(FIELD), 1000]
    size = numbers.randrange(400, 1500) + 0.5
    if numbers.random() < 0.5:
        return ("--sphere", *(c / 1000 for c in center), size / 1000)
    return ("--box", *((c - size) / 1000 for c in center),
            *((c + size) / 1000 for c in center))


def outside(row, points):
    """The points that the region of a revision leaves."""
    if "sphere" in row:
        *center, radius = [1000 * v for v in row["sphere"]]
        return tuple(p for p in points
                     if sum((a - c) ** 2
                            for a, c in zip(p, center)) > radius ** 2)
    box = [1000 * v for v in row["box"]]
    return tuple(p for p in points
                 if not all(low < v < high
                            for low, v, high in zip(box[:3], p, box[3:])))


def filter_options(row):
    """How a revision was processed, for `sample`."""
    return [part for name, value in row["options"].items()
            for part in ("--" + name.replace("_", "-"), value)]


class Map:
    """What is known of a map, and what follows from it."""

    def __init__(self, name, folder):
        self.name = name
        # Where its files are, by number.
        self.folder = folder
        self.files = {}
        self.is_given_up = False
        # Revisions as they were listed, and the points of each by file, of
        # which edits may have left none.
        self.rows = []
        self.states = []
        # Files whose uploads are in the history that the revision continues.
        self.uploaded = []
        # Results of commands: a revision and what its row has to say.
        self.acknowledged = collections.deque()
        self.filtered = set()
        self.answers = {}

    def follow(self, rows):
        """Takes in the list of revisions, which must go on from the last."""
        known = len(self.rows)
        assert rows[:known] == self.rows, \
            f"{self.name}: known revisions changed: {self.rows} {rows[:known]}"
        for row in rows[known:]:
            self.follow_one(row)
        while self.acknowledged:
            revision, expected = self.acknowledged.popleft()
            assert revision <= len(rows), \
                f"{self.name}: revision {revision} was lost: {expected}"
            row = rows[revision - 1]
            assert expected.items() <= row.items(), \
                f"{self.name}: acknowledged {expected}, have {row}"

    def follow_one(self, row):
        number, kind = row["revision"], row["kind"]
        where = f"{self.name}: {row}"
        assert number == len(self.rows) + 1, where
        state = dict(self.states[-1]) if self.states else {}
        uploaded = self.uploaded[-1] if self.uploaded else frozenset()
        processed = self.rows[-1]["processed_revision"] if self.rows else 0
        removed = added = 0
        if kind in ("delete-region", "replace-region"):
            for file, points in list(state.items()):
                rest = outside(row, points)
                removed += len(points) - len(rest)
                state[file] = rest
        if kind in ("upload", "replace-region"):
            file = self.files.get(row["added_point_count"] - SMALLEST_FILE)
            assert file is not None, f"{where}: part of a file"
            assert file not in uploaded, f"{where}: twice in the map"
            added = len(file.points)
            state[file] = file.points
            uploaded |= {file}
        if kind == "rollback":
            restored = row["restored_revision"] - 1
            state, uploaded = self.states[restored], self.uploaded[restored]
            processed = self.rows[restored]["processed_revision"]
        elif kind == "process":
            processed = number
        if kind != "rollback":
            assert row["removed_point_count"] == removed, where
            assert row["added_point_count"] == added, where
        assert row["raw_point_count"] == sum(map(len, state.values())), where
        assert row["processed_revision"] == processed, where
        self.rows.append(row)
        self.states.append(state)
        self.uploaded.append(uploaded)

    def remember(self, revision, query, path):
        """The same question has the same answer, to the byte."""
        digest = hashlib.sha256(path.read_bytes()).digest()
        known = self.answers.setdefault((revision, query), digest)
        assert known == digest, \
            f"{self.name}: another answer to {query} of revision {revision}"


class World:
    """The server, its clients, and what they were told."""

    def __init__(self, work, server, kills, seed):
        self.work = work
        self.server = server
        self.kills = kills
        self.seed = seed
        self.numbers = random.Random(seed)
        self.map_numbers = itertools.count(1)
        self.bulk = work / "bulk.ply"
        self.bulk_log = work / "bulk.log"
        self.clients = []
        self.failures = []
        self.acknowledged = collections.Counter()
        # Guards what follows.
        self.changed = threading.Condition()
        self.is_open = True
        self.finishing = False
        self.bulk_is_wanted = False
        self.kill_count = 0
        self.active_count = 0
        self.created = set()
        self.deleted = set()
        self.maps = [self.make_map(self.numbers) for _ in range(2)]

    # Commands.

    def ask(self, numbers, *arguments, of=None, excuses=(), log=None):
        """Runs a command; None if it was not acknowledged, for a reason.

        Reasons: the server or the client was killed, the map `of` was given up,
        or the message is one of `excuses`. `log`: a file for messages.
        """
        with self.changed:
            self.changed.wait_for(lambda: self.is_open)
            kills = self.kill_count
            self.active_count += 1
        dies = numbers.random() < CLIENT_DEATHS
        limit_s = numbers.uniform(0.02, 0.2) if dies else TIMEOUT_S
        try:
            with open(log or self.work / f"{threading.get_ident()}.log",
                      "w+") as messages:
                result = self.server.run_command(
                    "--json", "--retry-for", 0, *arguments, timeout=limit_s,
                    stderr=messages)
                messages.seek(0)
                message = messages.read().strip()
        except subprocess.TimeoutExpired:
            assert dies, f"{arguments}: hangs"
            return None
        finally:
            with self.changed:
                self.active_count -= 1
                self.changed.notify_all()
        if result.returncode == 0:
            self.acknowledged[arguments[0]] += 1
            return json.loads(result.stdout)
        assert result.returncode == 1, f"{arguments}: {message}"
        with self.changed:
            if self.kill_count != kills or (of and of.is_given_up):
                return None
        assert any(e in message for e in excuses), f"{arguments}: {message}"
        return None

    def insist(self, numbers, *arguments, of=None, excuses=(), log=None):
        """Runs a command until it is acknowledged, or the map given up."""
        while not (of and of.is_given_up):
            result = self.ask(numbers, *arguments, of=of, excuses=excuses,
                              log=log)
            if result is not None:
                return result
        return None

    def create(self, numbers, name):
        command = ("create", name, "--tile-edge", TILE_EDGE_M)
        # Done before, and not acknowledged: the name is not used otherwise.
        while self.ask(numbers, *command, excuses=("exists already",)) is None:
            if self.ask(numbers, "info", name, excuses=(name,)) is not None:
                break
        with self.changed:
            self.created.add(name)

    def delete(self, numbers, name):
        with self.changed:
            self.created.remove(name)
        while self.ask(numbers, "delete", name, "--force",
                       excuses=(name,)) is None:
            names = self.insist(numbers, "list")["maps"]
            if name not in [m["map"] for m in names]:
                break
        with self.changed:
            self.deleted.add(name)

    def make_map(self, numbers):
        name = f"map-{next(self.map_numbers)}"
        folder = self.work / name
        folder.mkdir()
        self.create(numbers, name)
        return Map(name, folder)

    def new_file(self, numbers, map_):
        with self.changed:
            file = File(map_.folder, len(map_.files) + 1, numbers)
            map_.files[file.number] = file
            return file

    # Clients.

    def start_client(self, run, name, *arguments):
        def guarded():
            try:
                run(random.Random(f"{self.seed} {name}"), *arguments)
            except Exception as error:  # It ends the test.
                self.failures.append(error)
        thread = threading.Thread(target=guarded, daemon=True)
        thread.start()
        self.clients.append(thread)

    def upload_files(self, numbers, place):
        """Adds new files to a map, and now and then an old one."""
        map_, files = None, []
        while not self.finishing:
            if map_ is not self.maps[place]:
                map_, files = self.maps[place], []
            if files and numbers.random() < 0.15:
                file = numbers.choice(files)
            else:
                file = self.new_file(numbers, map_)
                files.append(file)
            result = self.insist(numbers, "upload", map_.name, file.path,
                                 of=map_, excuses=(BUSY_UPLOAD,))
            if result is not None:
                report, = result["files"]
                map_.acknowledged.append((
                    report["revision"],
                    {"kind": "upload",
                     "added_point_count": len(file.points)}))

    def upload_bulk(self, numbers):
        """A file so large that a part of it is acknowledged, when wanted."""
        for number in itertools.count(1):
            with self.changed:
                self.changed.wait_for(
                    lambda: self.bulk_is_wanted or self.finishing)
                if self.finishing:
                    return
                self.bulk_is_wanted = False
            name = f"bulk-{number}"
            self.create(numbers, name)
            shown_percent = 0
            while True:
                result = self.ask(numbers, "upload", name, self.bulk,
                                  excuses=(BUSY_UPLOAD,), log=self.bulk_log)
                if result is not None:
                    break
                shares = re.findall(r" (\d+) %", self.bulk_log.read_text())
                shown_percent = max([shown_percent, *map(int, shares)])
            report, = result["files"]
            if 0 < shown_percent < 100:
                self.acknowledged["resumed upload"] += 1
            # What was shown is rounded.
            assert report["sent_bytes"] <= report["upload_bytes"] * (
                100.5 - shown_percent) / 100, (shown_percent, report)
            stored = self.insist(numbers, "info", name)
            assert stored["raw_point_count"] == BULK_POINTS, stored
            assert stored["revision"] == report["revision"] == 2, stored
            self.insist(numbers, "verify", name)
            self.delete(numbers, name)

    def edit(self, numbers):
        while not self.finishing:
            place = numbers.randrange(len(self.maps))
            map_ = self.maps[place]
            newest = map_.rows[-1] if map_.rows else None
            if newest and (newest["raw_point_count"] > MAX_POINTS or
                           newest["revision"] > MAX_REVISIONS):
                self.maps[place] = self.make_map(numbers)
                map_.is_given_up = True
                self.delete(numbers, map_.name)
                continue
            command, = numbers.choices(
                (self.process, self.delete_region, self.replace_region,
                 self.roll_back), (5, 2, 2, 1))
            command(numbers, map_)

    def process(self, numbers, map_):
        options = numbers.choice(((), (), ("--rule", "quota")))
        result = self.ask(numbers, "process", map_.name, "--rho", 0.3, *options,
                          of=map_, excuses=("going on already", "no points"))
        if result is not None:
            map_.acknowledged.append((
                result["revision"],
                {"kind": "process", "point_count": result["point_count"],
                 "label_counts": result["label_counts"]}))

    def delete_region(self, numbers, map_):
        result = self.ask(numbers, "delete-region", map_.name,
                          *random_region(numbers), of=map_)
        if result is not None and result["removed_point_count"] > 0:
            map_.acknowledged.append((
                result["revision"],
                {"kind": "delete-region",
                 "removed_point_count": result["removed_point_count"]}))

    def replace_region(self, numbers, map_):
        file = self.new_file(numbers, map_)
        result = self.insist(numbers, "replace-region", map_.name, file.path,
                             *random_region(numbers), of=map_,
                             excuses=(BUSY_UPLOAD,))
        if result is not None:
            map_.acknowledged.append((
                result["revision"],
                {"kind": "replace-region",
                 "added_point_count": len(file.points)}))

    def roll_back(self, numbers, map_):
        if not map_.rows:
            return
        target = numbers.choice(map_.rows)["revision"]
        result = self.ask(numbers, "rollback", map_.name, "--to", target,
                          of=map_, excuses=("operation that is not done",))
        if result is not None:
            del result["map"]
            map_.acknowledged.append((result["revision"], result))

    def query(self, numbers):
        path = self.work / "answer.csv"
        while not self.finishing:
            map_ = numbers.choice(self.maps)
            if not map_.rows:
                # Until the first check there is nothing to compare with.
                time.sleep(0.05)
                continue
            row = numbers.choice(map_.rows[-4:])
            query = numbers.choice(
                QUERIES if row["processed_revision"] > 0 else RAW_QUERIES)
            result = self.ask(numbers, "query", map_.name, "--revision",
                              row["revision"], *query, "-o", path, of=map_)
            if result is not None:
                map_.remember(row["revision"], query, path)

    # The checker.

    def check(self):
        """Compares everything that the server has with what is known."""
        names = {m["map"] for m in self.server.mapsieve("list")["maps"]}
        assert self.created <= names, f"lost: {self.created - names}"
        assert not self.deleted & names, f"back: {self.deleted & names}"
        for map_ in self.maps:
            rows = self.server.mapsieve("revisions", map_.name)["revisions"]
            map_.follow(rows[::-1])
            self.check_points(map_)
        map_ = self.numbers.choice(self.maps)
        self.check_answer(map_, *self.numbers.choice(list(map_.answers)))

    def check_answer(self, map_, revision, query):
        path = self.work / "checked.csv"
        self.server.mapsieve("query", map_.name, "--revision", revision, *query,
                             "-o", path)
        map_.remember(revision, query, path)
        return path

    def check_points(self, map_):
        """Raw points and product of the newest revision."""
        newest = map_.rows[-1]
        path = self.check_answer(map_, newest["revision"], ("--raw",))
        assert sorted(lines_of(path)[1]) == sorted(
            raw_lines(map_.states[-1])), \
            f"{map_.name}: other points than the history says: {newest}"
        revision = newest["processed_revision"]
        if revision == 0 or revision in map_.filtered:
            return
        map_.filtered.add(revision)
        path = self.check_answer(map_, revision, ())
        row, state = map_.rows[revision - 1], map_.states[revision - 1]
        if row["raw_point_count"] == 0:
            assert row["point_count"] == 0, row
            return
        raw, expected = self.work / "raw.csv", self.work / "expected.csv"
        write_points(raw, state)
        mapsieve("sample", raw, *filter_options(row), "-o", expected)
        assert answer_of(path) == answer_of(expected), \
            f"{map_.name}: another product than the filter's: {row}"

    # The killer.

    def run(self):
        for name, place in (("uploader 1", 0), ("uploader 2", 0),
                            ("uploader 3", 1)):
            self.start_client(self.upload_files, name, place)
        self.start_client(self.upload_bulk, "bulk uploader")
        self.start_client(self.edit, "editor")
        self.start_client(self.query, "reader")
        moments = itertools.cycle((False, True, False))
        while self.kill_count < self.kills:
            self.wait_for_moment(next(moments))
            self.kill()
            self.server.start()
            self.check()
            with self.changed:
                self.is_open = True
                self.changed.notify_all()
        self.finish()

    def wait_for_moment(self, is_in_upload):
        """Some commands later, or in the middle of the large upload."""
        start_s = time.time()
        longest_s = 0.15
        if is_in_upload:
            with self.changed:
                self.bulk_is_wanted = True
                self.changed.notify_all()
            longest_s = 0.02

            def has_come():
                return (self.bulk_log.exists() and
                        self.bulk_log.stat().st_mtime > start_s and
                        self.bulk_log.stat().st_size > 0)
        else:
            wanted = self.acknowledged.total() + self.numbers.randrange(1, 10)

            def has_come():
                return self.acknowledged.total() >= wanted
        while not has_come() and time.time() < start_s + 30:
            time.sleep(0.005)
        time.sleep(self.numbers.uniform(0, longest_s))

    def kill(self):
        with self.changed:
            self.is_open = False
        self.kill_server()
        with self.changed:
            idle = self.changed.wait_for(lambda: self.active_count == 0,
                                         TIMEOUT_S)
        assert idle, "commands hang although there is no server"
        self.raise_failures()
        while (self.kill_count < self.kills and
               self.numbers.random() < KILLS_AT_START):
            self.server.launch()
            time.sleep(self.numbers.uniform(0, 0.2))
            self.kill_server()

    def kill_server(self):
        with self.changed:
            self.kill_count += 1
        code = self.server.stop(signal.SIGKILL)
        assert code == -signal.SIGKILL, f"the server ended with {code} itself"

    def raise_failures(self):
        for failure in self.failures:
            raise failure

    # The end.

    def finish(self):
        with self.changed:
            self.finishing = True
            self.changed.notify_all()
        for client in self.clients:
            client.join(TIMEOUT_S)
            assert not client.is_alive(), "a client never gets done"
        self.raise_failures()
        for map_ in self.maps:
            # It may be new and empty.
            file = self.new_file(self.numbers, map_)
            self.server.mapsieve("upload", map_.name, file.path)
            self.server.mapsieve("process", map_.name, "--rho", 0.3)
        self.check()
        for map_ in self.maps:
            for revision, query in map_.answers:
                self.check_answer(map_, revision, query)
            report = self.server.mapsieve("verify", map_.name, "--tiling",
                                          "--tiles", 4)
            assert not report["differing_tiles"], report
        # There is always something to collect.
        self.delete(self.numbers, self.maps.pop().name)
        self.stop()
        data = self.work / "data"
        # What was there, while nothing changes any more.
        with contextlib.closing(sqlite3.connect(data / "catalogue.db")) as db:
            referenced = {blob for blob, in db.execute(
                "SELECT blob_id FROM chunks JOIN maps USING (map_key)"
                " WHERE NOT deleted")}
        assert referenced
        # Collects when it starts.
        self.server.start()
        deadline = time.monotonic() + 60
        while True:
            stored = {path.name for path in (data / "blobs").glob("??/*")}
            left = [path for folder in ("uploads", "scratch", "runs",
                                        "blobs/tmp")
                    for path in (data / folder).glob("*")]
            if stored == referenced and not left:
                break
            assert time.monotonic() < deadline, (
                f"lost: {referenced - stored}, left over: "
                f"{stored - referenced} {left}")
            time.sleep(0.05)
        self.check()
        self.stop()

    def stop(self):
        code = self.server.stop()
        assert code == 0, f"the server exited with {code} on SIGTERM"


class Kill(unittest.TestCase):
    def test_nothing_acknowledged_is_lost(self):
        with tempfile.TemporaryDirectory() as folder:
            work = pathlib.Path(folder)
            write_random_points(work / "bulk.ply", BULK_POINTS,
                                random.Random(ARGUMENTS.seed))
            server = Server(work / "data", "--memory", "256MiB")
            try:
                world = World(work, server, ARGUMENTS.kills, ARGUMENTS.seed)
                world.run()
            except BaseException as error:
                error.add_note(f"--kills {ARGUMENTS.kills} "
                               f"--seed {ARGUMENTS.seed}")
                server.process.kill()
                raise
            print(f"{world.kill_count} kills; acknowledged: "
                  f"{dict(world.acknowledged)}")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
