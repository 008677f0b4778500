#!/usr/bin/python3
"""`mapsieve upload` over a network that breaks, to a server that is killed.

usage: upload_test.py BIN_DIR
"""

import signal
import sys
import time
import unittest

from programs import Relay, ServedTest, mapsieve, run_command

POINTS = 600_000
# How long the server is away.
AWAY_S = 0.5


class Upload(ServedTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.scan = cls.work / "scan.las"
        mapsieve("simulate", cls.scan, "--points", POINTS)

    def wait_until_more_is_staged(self):
        """The server has taken in something of what the relay passed on."""
        folder = self.work / "data" / "uploads"

        def staged():
            return sum(file.stat().st_size for file in folder.glob("*"))

        deadline = time.monotonic() + 60
        while staged() <= self.staged:
            self.assertLess(time.monotonic(), deadline)
        self.staged = staged()

    def setUp(self):
        self.staged = 0

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
            time.sleep(AWAY_S)
            self.server.start()
            relay.target = self.server.address

        cut = self.wait_until_more_is_staged
        with Relay(self.server.address, (cut, restart, cut)) as relay:
            report, = mapsieve("--server", relay.address, "upload", "broken",
                               self.scan)["files"]
            self.assertEqual(relay.breaks, [])
        self.assertFalse(report["already_there"])
        self.assertEqual(report["revision"], 2)
        self.check("broken", report)

    def test_without_patience_a_second_run_goes_on(self):
        self.mapsieve("create", "twice")
        with Relay(self.server.address,
                   [self.wait_until_more_is_staged]) as relay:
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
