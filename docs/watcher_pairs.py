"""The control tick with a viewer beside it that looks on, is stopped, or is killed and comes back: interleaved with runs that nobody looks at.

python3 docs/watcher_pairs.py VIEWER [--rounds N] [--seconds S] [--rows FILE] [LAUNCH OPTIONS…], where VIEWER is `page`, a Chromium on the live
page, `events`, a client that reads what the page is told and draws nothing, as if the browser were on another machine, or `watch`,
`coxswain watch --plain`. Each run is the local graph in real time; a round has one of each kind, another one first every
time. After a quarter of the run the stopped one is stopped and the killed one killed, which comes back at half of it. With --rows, rounds are
kept in a file and the medians are of all of them, so that a long series can be taken in parts.
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
    """A browser, already open."""

    def __init__(self, home):
        self.home, self.browser = home, Browser()

    def look(self, address):
        self.address = address
        self.browser.open(address)

    def saw(self):
        return self.browser.text("place") != ""

    def signal(self, number):
        self.browser.signal(number)

    def come_back(self):
        self.browser.close()
        self.browser = Browser()
        self.look(self.address)

    def close(self):
        self.browser.close()


class Watch:
    """`coxswain watch`, started once there is something to watch."""

    def __init__(self, home):
        self.home = home

    def command(self):
        return [coxswain, "watch", "--plain"]

    def look(self, address):
        self.address = address
        here = {**os.environ, "TMPDIR": self.home}
        self.lines = open(f"{self.home}/lines", "ab")
        self.process = subprocess.Popen(self.command(), env=here, stdout=self.lines, stderr=subprocess.DEVNULL)

    def saw(self):
        return os.path.getsize(f"{self.home}/lines") > 0

    def signal(self, number):
        self.process.send_signal(number)

    def come_back(self):
        self.close()
        self.look(self.address)

    def close(self):
        self.process.kill()
        self.process.wait()
        self.lines.close()


class Events(Watch):
    """Reads the stream of the live page."""

    def command(self):
        read = "import sys, urllib.request as web\nfor line in web.urlopen(sys.argv[1]): print(len(line), flush=True)"
        return [sys.executable, "-c", read, self.address + "events"]


def run(kind):
    """One run: half of all ticks took no longer [us], and periods missed."""
    with tempfile.TemporaryDirectory(prefix="cx", dir="/tmp") as home:
        viewer = None if kind == "off" else {"page": Page, "events": Events, "watch": Watch}[arguments.viewer](home)
        time.sleep(1.0)  # whatever has just started or ended is done with it
        command = [coxswain, "launch", ROOT / "deploy/graphs/local.toml", "--duration", str(arguments.seconds), "--out", f"{home}/run"]
        here = {**os.environ, "TMPDIR": home}
        launch = subprocess.Popen([*command, *options], env=here, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        address = None
        for line in launch.stdout:
            if address := re.search(rb"live page: (\S+)", line):
                break
        begin = time.monotonic()
        until = lambda share: time.sleep(max(0.0, begin + share * arguments.seconds - time.monotonic()))
        if viewer:
            viewer.look(address[1].decode())
            until(0.25)
            if not viewer.saw():
                raise SystemExit("the viewer saw nothing in a quarter of the run")
            if kind == "stopped":
                viewer.signal(signal.SIGSTOP)
            if kind == "killed":
                viewer.signal(signal.SIGKILL)
                until(0.5)
                viewer.come_back()
        launch.communicate()
        if viewer:
            viewer.close()
        summary = json.loads(Path(home, "run/summary.json").read_text())
        return summary["tick_p50_us"], summary["periods_missed"]


def told(rounds):
    print(f"{arguments.viewer}, {len(rounds)} rounds; half of all ticks of the runs that nobody looked at: "
          + " ".join(f"{row['off'][0]:.0f}" for row in rounds) + " µs")
    for kind in KINDS:
        ratios = [row[kind][0] / row["off"][0] for row in rounds]
        missed = sum(row[kind][1] for row in rounds)
        print(f"{kind:8} median {statistics.median(ratios):.3f} of {' '.join(f'{ratio:.2f}' for ratio in ratios)}, {missed} periods missed")


before = arguments.rows.read_text().splitlines() if arguments.rows and arguments.rows.exists() else []
rounds = [json.loads(line) for line in before]
for _ in range(arguments.rounds):
    first = len(rounds) % len(KINDS)
    rounds.append({kind: run(kind) for kind in KINDS[first:] + KINDS[:first]})
    if arguments.rows:
        with arguments.rows.open("a") as file:
            print(json.dumps(rounds[-1]), file=file)
told(rounds)
