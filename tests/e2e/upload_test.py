#!/usr/bin/python3
"""`mapsieve upload` over a network that breaks, to a server that is killed.

usage: upload_test.py BIN_DIR
"""

import signal
import socket
import struct
import sys
import threading
import time
import unittest

from programs import ServedTest, mapsieve, run_command

POINTS = 600_000
# Bytes that a connection that is cut lets through, some messages of the upload.
SHARE = 1_500_000


class Relay:
    """Passes connections on to `target`, the first ones up to some bytes.

    Calls each of `breaks` when a connection is cut, one a connection.
    """

    def __init__(self, target, breaks):
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
            left = [SHARE if self.breaks else float("inf")]
            for ends in ((client, server), (server, client)):
                threading.Thread(target=self.pass_on, args=(*ends, left),
                                 daemon=True).start()

    def pass_on(self, source, sink, left):
        try:
            while data := source.recv(65536):
                left[0] -= len(data)
                if left[0] < 0:
                    sink.sendall(data[:len(data) // 2])
                    # The server reads what came.
                    time.sleep(0.3)
                    break
                sink.sendall(data)
        except OSError:
            pass
        is_cut = left[0] < 0
        left[0] = float("inf")
        for end in (source, sink):
            try:
                # Without a farewell, as a network that breaks.
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER,
                               struct.pack("ii", 1, 0))
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            end.close()
        if is_cut:
            self.breaks.pop(0)()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.listener.close()


class Upload(ServedTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.scan = cls.work / "scan.las"
        mapsieve("simulate", cls.scan, "--points", POINTS)

    def check(self, name, report):
        info = self.mapsieve("info", name)
        self.assertEqual(info["raw_point_count"], POINTS)
        self.assertEqual(info["revision"], report["revision"])
        # The same file adds nothing.
        again, = self.mapsieve("upload", name, self.scan)["files"]
        self.assertTrue(again["already_there"])
        self.assertEqual(self.mapsieve("info", name), info)

    def test_goes_on_by_itself_where_the_network_or_the_server_breaks(self):
        self.mapsieve("create", "broken")

        def restart():
            self.assertEqual(self.server.stop(signal.SIGKILL), -signal.SIGKILL)
            time.sleep(0.5)
            self.server.start()
            relay.target = self.server.address

        def cut():
            pass

        with Relay(self.server.address, (cut, restart, cut)) as relay:
            report, = mapsieve("--server", relay.address, "upload", "broken",
                               self.scan)["files"]
            self.assertEqual(relay.breaks, [])
        self.assertFalse(report["already_there"])
        self.assertEqual(report["revision"], 2)
        self.check("broken", report)

    def test_without_patience_a_second_run_goes_on(self):
        self.mapsieve("create", "twice")
        with Relay(self.server.address, [lambda: None]) as relay:
            command = ("--server", relay.address, "upload", "twice", self.scan,
                       "--retry-for", 0)
            result = run_command(*command)
            self.assertEqual(result.returncode, 1, result.stderr)
            self.assertIn("went away", result.stderr)
            self.assertEqual(self.mapsieve("info", "twice")["revision"], 1)
            report, = mapsieve(*command)["files"]
        self.assertGreater(report["sent_bytes"], 0)
        self.assertLess(report["sent_bytes"], report["upload_bytes"])
        self.check("twice", report)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
