"""Measures how a viewer affects the control tick.

A viewer watches, is stopped, or is killed and starts again. Runs without a viewer are interleaved.

Usage: python3 docs/watcher_pairs.py VIEWER [--rounds N] [--seconds S] [--rows FILE]
       [LAUNCH OPTIONS…]

| VIEWER   | what watches                                                               |
|----------|----------------------------------------------------------------------------|
| `page`   | a Chromium with the live page                                              |
| `events` | a client that reads the events of the live page and draws nothing; the     |
|          | load is that of a browser on another machine                               |
| `watch`  | `coxswain watch --plain`                                                   |

Each run is the local graph in real time. A round has one run of each kind, in rotating order. The
viewer is stopped or killed after a quarter of the run. A killed viewer starts again at half of it.
With --rows, the rounds are kept in a file, and the medians cover all rounds in it. So a long series
can be measured in parts.
"""

import argparse
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from chromium import Browser

ROOT = Path(__file__).parents[1]
KINDS = ["off", "on", "stopped", "killed"]

parser = argparse.ArgumentParser()
parser.add_argument("viewer", choices=["page", "events", "watch"])
parser.add_argument("--rounds", type=int, default=10)
parser.add_argument("--seconds", type=float, default=6.0)
parser.add_argument("--rows", type=Path)
parser.add_argument("--binaries", type=Path, default=ROOT / "target/release")
arguments, options = parser.parse_known_args()
coxswain = arguments.binaries / "coxswain"


class Page:
    """A browser on the live page, which is already open."""

    def __init__(self, home):
        self.home, self.browser = home, Browser()

    def connect(self, address):
        self.address = address
        self.browser.open(address)

    def has_content(self):
        return self.browser.text("place") != ""

    def signal(self, number):
        self.browser.signal(number)

    def restart(self):
        self.browser.close()
        self.browser = Browser()
        self.connect(self.address)

    def close(self):
        self.browser.close()


class Watch:
    """`coxswain watch`, started after the launch."""

    def __init__(self, home):
        self.home = home

    def command(self):
        return [coxswain, "watch", "--plain"]

    def connect(self, address):
        self.address = address
        environment = {**os.environ, "TMPDIR": self.home}
        self.lines = open(f"{self.home}/lines", "ab")
        self.process = subprocess.Popen(self.command(), env=environment, stdout=self.lines,
                                        stderr=subprocess.DEVNULL)

    def has_content(self):
        return os.path.getsize(f"{self.home}/lines") > 0

    def signal(self, number):
        self.process.send_signal(number)

    def restart(self):
        self.close()
        self.connect(self.address)

    def close(self):
        self.process.kill()
        self.process.wait()
        self.lines.close()


class Events(Watch):
    """A client that reads the events of the live page and draws nothing."""

    def command(self):
        read = ("import sys, urllib.request as web\n"
                "for line in web.urlopen(sys.argv[1]): print(len(line), flush=True)")
        return [sys.executable, "-c", read, self.address + "events"]


def run(kind):
    """One run. Returns the median time of a tick [us] and the number of missed periods."""
    with tempfile.TemporaryDirectory(prefix="cx", dir="/tmp") as home:
        viewers = {"page": Page, "events": Events, "watch": Watch}
        viewer = None if kind == "off" else viewers[arguments.viewer](home)
        time.sleep(1.0)  # lets starting and ending processes settle
        command = [coxswain, "launch", ROOT / "deploy/graphs/local.toml"]
        command += ["--duration", str(arguments.seconds), "--out", f"{home}/run", *options]
        environment = {**os.environ, "TMPDIR": home}
        launch = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT)
        address = None
        for line in launch.stdout:
            if address := re.search(rb"live page: (\S+)", line):
                break
        begin = time.monotonic()

        def wait_until(share):
            """Sleeps until this share of the run is over."""
            time.sleep(max(0.0, begin + share * arguments.seconds - time.monotonic()))

        if viewer:
            viewer.connect(address[1].decode())
            wait_until(0.25)
            if not viewer.has_content():
                raise SystemExit("the viewer received nothing in the first quarter of the run")
            if kind == "stopped":
                viewer.signal(signal.SIGSTOP)
            if kind == "killed":
                viewer.signal(signal.SIGKILL)
                wait_until(0.5)
                viewer.restart()
        launch.communicate()
        if viewer:
            viewer.close()
        summary = json.loads(Path(home, "run/summary.json").read_text())
        return summary["tick_p50_us"], summary["periods_missed"]


def report(rounds):
    medians = " ".join(f"{row['off'][0]:.0f}" for row in rounds)
    print(f"{arguments.viewer}, {len(rounds)} rounds; median tick without a viewer: {medians} µs")
    for kind in KINDS:
        ratios = [row[kind][0] / row["off"][0] for row in rounds]
        missed = sum(row[kind][1] for row in rounds)
        listed = " ".join(f"{ratio:.2f}" for ratio in ratios)
        print(f"{kind:8} median {statistics.median(ratios):.3f} of {listed}, "
              f"{missed} periods missed")


has_rows = arguments.rows and arguments.rows.exists()
earlier = arguments.rows.read_text().splitlines() if has_rows else []
rounds = [json.loads(line) for line in earlier]
for _ in range(arguments.rounds):
    first = len(rounds) % len(KINDS)
    rounds.append({kind: run(kind) for kind in KINDS[first:] + KINDS[:first]})
    if arguments.rows:
        with arguments.rows.open("a") as file:
            print(json.dumps(rounds[-1]), file=file)
report(rounds)
