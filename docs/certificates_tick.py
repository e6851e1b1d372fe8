"""Measures the control tick on two hosts, alternately with certificates and without them.

Usage: python3 docs/certificates_tick.py [ROUNDS [SECONDS [COXSWAIN]]]
"""

import json
import pathlib
import statistics
import subprocess
import sys
import tempfile

rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 8
seconds = sys.argv[2] if len(sys.argv) > 2 else "10"
coxswain = sys.argv[3] if len(sys.argv) > 3 else "target/release/coxswain"
graph = str(pathlib.Path(__file__).parent.parent / "deploy/graphs/two-hosts.toml")
measured = {"without": [], "with": []}
with tempfile.TemporaryDirectory() as folder:
    certificates = f"{folder}/certificates"
    issue = [coxswain, "certificates", "--robot", "mecanum", "--out", certificates]
    subprocess.run(issue, check=True, stdout=subprocess.DEVNULL)
    kinds = {"without": [], "with": ["--certificates", certificates]}
    for number in range(rounds):
        for kind, options in sorted(kinds.items(), reverse=number % 2 == 1):
            out = f"{folder}/{number}-{kind}"
            launch = [coxswain, "launch", graph, "--scenario", "paper-20ms"]
            launch += ["--duration", seconds, "--out", out, *options]
            subprocess.run(launch, check=True, capture_output=True)
            summary = json.loads(pathlib.Path(f"{out}/robot/summary.json").read_text())
            p50, p99 = summary["tick_p50_us"], summary["tick_p99_us"]
            measured[kind].append(p50)
            missed = summary["periods_missed"]
            print(f"{kind:8} p50 {p50:.0f} us, p99 {p99:.0f} us, missed {missed}", flush=True)
without, with_ = (statistics.median(measured[kind]) for kind in ("without", "with"))
ratio = with_ / without
print(f"median of p50: without {without:.1f} us, with {with_:.1f} us, ratio {ratio:.3f}")
