#!/usr/bin/python3
"""Times the service on one large map, end to end, and prints a table.

usage: service_bench.py BIN_DIR POINTS [--memory 1GiB] [--clients 4]
                        [--tile-edge M] [--work DIR] [--cgroup DIR]

A campus of POINTS is simulated, uploaded and processed by a real server while
clients query it; then 1 % of the points, from five places, are uploaded again
5 mm beside themselves, and the map is brought up to date. Memory is the
server's peak resident set and disk traffic what the kernel counted for it, as
seen from outside.
"""

import argparse
import json
import pathlib
import random
import struct
import subprocess
import tempfile
import threading
import time

SPOTS = 5


class Server:
    def __init__(self, binary, data, memory, cgroup):
        def enter_cgroup():
            if cgroup:
                pathlib.Path(cgroup, "cgroup.procs").write_text("0")
        self.process = subprocess.Popen(
            [binary, "--data", data, "--listen", "127.0.0.1:0", "--memory",
             memory],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            preexec_fn=enter_cgroup)
        self.address = self.process.stdout.readline().split()[-1]

    def peak_mib(self):
        return self._field("status", "VmHWM") / 1024

    def cpu_s(self):
        fields = self._read("stat").rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / 100

    def disk_bytes(self):
        return self._field("io", "read_bytes") + self._field("io",
                                                             "write_bytes")

    def stop(self):
        self.process.terminate()
        return self.process.wait()

    def _read(self, name):
        return pathlib.Path(f"/proc/{self.process.pid}/{name}").read_text()

    def _field(self, name, key):
        for line in self._read(name).splitlines():
            if line.startswith(key + ":"):
                return int(line.split()[1])
        raise KeyError(key)


def shift_las(path, metres):
    """Moves all points of a LAS file along x: its offset is a double."""
    with open(path, "r+b") as file:
        for at in (155, 179, 187):  # offset, max and min of x
            file.seek(at)
            (value,) = struct.unpack("<d", file.read(8))
            file.seek(at)
            file.write(struct.pack("<d", value + metres))


def places_of(path, count):
    """Every so many-th point of a LAS file."""
    with open(path, "rb") as file:
        head = file.read(375)
        data, = struct.unpack_from("<I", head, 96)
        length, = struct.unpack_from("<H", head, 105)
        scale = struct.unpack_from("<3d", head, 131)
        offset = struct.unpack_from("<3d", head, 155)
        total = (path.stat().st_size - data) // length
        places = []
        for i in range(count):
            file.seek(data + i * total // count * length)
            q = struct.unpack("<3i", file.read(12))
            places.append(tuple(q[a] * scale[a] + offset[a] for a in range(3)))
        return places


class Bench:
    def __init__(self, arguments, work):
        self.bin = pathlib.Path(arguments.bin)
        self.arguments = arguments
        self.work = work
        self.server = Server(self.bin / "mapsieved", work / "data",
                             arguments.memory, arguments.cgroup)
        self.queries = 0
        self.failures = []
        self.stopping = threading.Event()

    def mapsieve(self, *command):
        result = subprocess.run(
            [self.bin / "mapsieve", "--server", self.server.address, "--json",
             *map(str, command)],
            capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise RuntimeError(f"{command}: {result.stderr.strip()}")
        return json.loads(result.stdout)

    def timed(self, *command):
        """Seconds, the server's processor seconds, and the answer."""
        start, cpu = time.monotonic(), self.server.cpu_s()
        answer = self.mapsieve(*command)
        return (time.monotonic() - start, self.server.cpu_s() - cpu, answer)

    def keep_asking(self, seed, centers):
        """Raw points around places of the map until the bench stops."""
        choose = random.Random(seed)
        while not self.stopping.is_set():
            x, y, z = choose.choice(centers)
            try:
                self.mapsieve("query", "campus", "--raw", "--sphere", x, y, z,
                              10, "-o", self.work / f"answer{seed}.ply")
                self.queries += 1
            except RuntimeError as error:
                self.failures.append(str(error))
            self.stopping.wait(0.2)

    def run(self):
        points = self.arguments.points
        las = self.work / "campus.las"
        self.mapsieve("simulate", las, "--points", points)
        edge = self.arguments.tile_edge
        self.mapsieve("create", "campus",
                      *(["--tile-edge", edge] if edge else []))
        upload_s, upload_cpu, _ = self.timed("upload", "campus", las)
        upload_disk = self.server.disk_bytes()
        las_bytes = las.stat().st_size
        centers = places_of(las, 1000)
        las.unlink()

        clients = [threading.Thread(target=self.keep_asking,
                                    args=(seed, centers))
                   for seed in range(self.arguments.clients)]
        for client in clients:
            client.start()
        process = ["process", "campus", "--rho", 0.2, "--reach", 0.6]
        process_s, process_cpu, first = self.timed(*process)
        process_disk = self.server.disk_bytes() - upload_disk
        self.stopping.set()
        for client in clients:
            client.join()

        added = self.append_spots(centers, points // 100)
        update_s, update_cpu, update = self.timed(*process)
        peak = self.server.peak_mib()
        info = self.mapsieve("info", "campus")
        code = self.server.stop()
        for failure in sorted(set(self.failures))[:3]:
            print(failure)

        def row(name, value):
            print(f"| {name} | {value} |")

        row("points", f"{points:,}")
        row("tiles", info["tile_count"])
        row("upload", f"{upload_s:.1f} s, {points / upload_s / 1e6:.2f} M/s, "
            f"server's processor {upload_cpu:.1f} s")
        row("disk traffic of the upload / LAS",
            f"{upload_disk / las_bytes:.2f}")
        row("process", f"{process_s:.1f} s, "
            f"{points / process_s / 1e6:.2f} M/s, processor "
            f"{process_cpu:.1f} s")
        row("disk traffic of it / LAS", f"{process_disk / las_bytes:.2f}")
        row("queries meanwhile, answered / failed",
            f"{self.queries} / {len(self.failures)}")
        row("points after the filter", f"{first['point_count']:,}")
        row("appended", f"{added:,} points in {SPOTS} places")
        row("update", f"{update_s:.1f} s ({update_s / process_s:.1%}), "
            f"processor {update_cpu:.1f} s ({update_cpu / process_cpu:.1%}), "
            f"{update['updated_tile_count']} of {info['tile_count']} tiles")
        row("stored / LAS", f"{info['stored_bytes'] / las_bytes:.2f}")
        row("server's peak memory", f"{peak:.0f} MiB of "
            f"{self.arguments.memory}")
        row("exit status", code)

    def append_spots(self, centers, wanted):
        added = 0
        for spot in range(SPOTS):
            x, y, z = centers[(2 * spot + 1) * len(centers) // (2 * SPOTS)]
            radius = 1.0
            path = self.work / f"spot{spot}.las"
            while True:
                answer = self.mapsieve("query", "campus", "--raw", "--sphere",
                                       x, y, z, radius, "-o", path)
                if answer["point_count"] * SPOTS >= wanted:
                    break
                radius *= 1.2
            shift_las(path, 0.005)
            added += answer["point_count"]
            self.mapsieve("upload", "campus", path)
        return added


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("bin")
    parser.add_argument("points", type=int)
    parser.add_argument("--memory", default="1GiB")
    parser.add_argument("--clients", type=int, default=4)
    parser.add_argument("--tile-edge", type=float, default=0)
    parser.add_argument("--work", help="folder for the data, default /tmp")
    parser.add_argument("--cgroup", help="control group to run the server in, "
                        "with the limits that it has")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.work) as work:
        Bench(arguments, pathlib.Path(work)).run()


if __name__ == "__main__":
    main()
