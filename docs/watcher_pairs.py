"""The control tick with a watcher beside it that looks on, is stopped or is killed: interleaved pairs with none.

python3 docs/watcher_pairs.py target/release [PAIRS [SECONDS]]. Each run is the local graph in real time.
"""
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

WATCHING = {"on": None, "stopped": signal.SIGSTOP, "killed": signal.SIGKILL}
GRAPH = Path(__file__).parents[1] / "deploy/graphs/local.toml"

coxswain = Path(sys.argv[1]) / "coxswain"
pairs = int(sys.argv[2]) if len(sys.argv) > 2 else 10
seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 6.0


def half_of_all_ticks(watching: str) -> float:
    """Median of the control tick in one run [us]."""
    with tempfile.TemporaryDirectory(prefix="cx", dir="/tmp") as home:
        quiet = {"env": {**os.environ, "TMPDIR": home}, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        launch = subprocess.Popen([coxswain, "launch", GRAPH, "--duration", str(seconds), "--out", f"{home}/run"], **quiet)
        time.sleep(1.5)
        watcher = subprocess.Popen([coxswain, "watch", "--plain"], **quiet) if watching != "off" else None
        if watcher and WATCHING[watching]:
            time.sleep(seconds / 4)
            watcher.send_signal(WATCHING[watching])
        launch.wait()
        if watcher:
            watcher.kill()
            watcher.wait()
        summary = json.loads(Path(home, "run/summary.json").read_text())
        missed.append(summary["periods_missed"])
        return summary["tick_p50_us"]


for watching in WATCHING:
    missed: list[int] = []
    ratios = [half_of_all_ticks(watching) / half_of_all_ticks("off") for _ in range(pairs)]
    listed = " ".join(f"{ratio:.2f}" for ratio in ratios)
    print(f"{watching:8} median {statistics.median(ratios):.3f} of {listed}, {sum(missed)} periods missed", flush=True)
