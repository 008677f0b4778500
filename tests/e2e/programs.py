"""What end-to-end tests share: the programs as processes, files of points.

The first argument of such a test is the folder of the programs.
"""

import json
import pathlib
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import unittest

BIN = pathlib.Path(sys.argv[1])


def run_command(*arguments, timeout=3600, stderr=subprocess.PIPE):
    """Runs `mapsieve`; one that takes longer than `timeout` s is killed."""
    return subprocess.run([BIN / "mapsieve", *map(str, arguments)],
                          stdout=subprocess.PIPE, stderr=stderr, text=True,
                          timeout=timeout)


def mapsieve(*arguments):
    """What a command that succeeds prints."""
    result = run_command("--json", *arguments)
    assert result.returncode == 0, f"{arguments}: {result.stderr}"
    return json.loads(result.stdout)


class Server:
    """A mapsieved on a free port; in a `with` it is stopped at the end.

    Its log goes to a file beside the data directory.
    """

    def __init__(self, data, *arguments):
        self.arguments = ["--data", data, *map(str, arguments)]
        self.log = pathlib.Path(f"{data}.log")
        self.start()

    def launch(self):
        """Starts the process and does not wait until it serves."""
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(
                [BIN / "mapsieved", "--listen", "127.0.0.1:0",
                 *self.arguments],
                stdout=subprocess.PIPE, stderr=log, text=True)

    def start(self):
        self.launch()
        line = self.process.stdout.readline()
        prefix = "mapsieved listening on "
        assert line.startswith(prefix), line or self.log.read_text()[-500:]
        self.address = line[len(prefix):].strip()

    def stop(self, with_signal=signal.SIGTERM):
        """Returns the exit status."""
        self.process.send_signal(with_signal)
        code = self.process.wait(timeout=60)
        self.process.stdout.close()
        return code

    def __enter__(self):
        return self

    def __exit__(self, *_):
        code = self.stop()
        assert code == 0, f"the server exited with {code} on SIGTERM"

    def run_command(self, *arguments, **options):
        return run_command("--server", self.address, *arguments, **options)

    def mapsieve(self, *arguments):
        return mapsieve("--server", self.address, *arguments)


class Relay:
    """Passes connections on to `target`, the first ones up to some bytes.

    Calls each of `breaks` before a connection is cut, one a connection.
    """

    # That a connection lets through, some messages of an upload.
    BYTES = 1_500_000

    def __init__(self, target, breaks=()):
        self.target = target
        self.breaks = list(breaks)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            try:
                client = self.listener.accept()[0]
            except OSError:
                return
            host, port = self.target.rsplit(":", 1)
            try:
                server = socket.create_connection((host, int(port)))
            except OSError:
                client.close()
                continue
            left = [self.BYTES if self.breaks else float("inf")]
            for ends in ((client, server), (server, client)):
                threading.Thread(target=self.pass_on, args=(*ends, left),
                                 daemon=True).start()

    def pass_on(self, source, sink, left):
        try:
            while data := source.recv(65536):
                left[0] -= len(data)
                if left[0] < 0:
                    sink.sendall(data[:len(data) // 2])
                    break
                sink.sendall(data)
        except OSError:
            pass
        if left[0] < 0:
            left[0] = float("inf")
            self.breaks.pop(0)()
        for end in (source, sink):
            try:
                # Without a farewell, as a network that breaks.
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER,
                               struct.pack("ii", 1, 0))
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            end.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.listener.close()


class FolderTest(unittest.TestCase):
    """Tests of a class share a folder, `work`."""

    @classmethod
    def setUpClass(cls):
        cls.work = pathlib.Path(
            cls.enterClassContext(tempfile.TemporaryDirectory()))


class ServedTest(FolderTest):
    """They share a server too."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.server = cls.enterClassContext(Server(cls.work / "data"))

    def mapsieve(self, *arguments):
        return self.server.mapsieve(*arguments)


def lines_of(path):
    """The head line of a CSV file, and the others."""
    header, *lines = path.read_text().splitlines()
    return header, lines


def answer_of(path):
    """Names of the columns and all rows, in an order of their own."""
    header, lines = lines_of(path)
    names = header.split(",")
    order = sorted(range(len(names)), key=names.__getitem__)
    rows = sorted(tuple(values[i] for i in order)
                  for values in (line.split(",") for line in lines))
    return sorted(names), rows


def write_random_points(path, point_count, numbers):
    """A PLY file in a cube of 2 m, about 260 bytes a point once uploaded."""
    words = 64
    head = "\n".join([
        "ply", "format binary_little_endian 1.0",
        f"element vertex {point_count}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uint word{i}" for i in range(words)), "end_header\n"])
    with open(path, "wb") as file:
        file.write(head.encode())
        for _ in range(point_count):
            file.write(struct.pack("<3f", *(numbers.uniform(0, 2)
                                            for _ in range(3))))
            file.write(numbers.randbytes(4 * words))
