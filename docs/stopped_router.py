"""Counts the periods without a fresh plan while the router of the network is stopped repeatedly.

The period is 20 ms, with certificates. The router stops two to four times per second, each time for
0.5 to 1.5 times MILLIS.

Usage: python3 docs/stopped_router.py [ROUNDS [MILLIS [COXSWAIN]]]
"""

import json
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time

rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
stopped_s = float(sys.argv[2]) / 1000 if len(sys.argv) > 2 else 0.03
coxswain = sys.argv[3] if len(sys.argv) > 3 else "target/release/coxswain"
graph = str(pathlib.Path(__file__).parent.parent / "deploy/graphs/network.toml")
with tempfile.TemporaryDirectory() as folder:
    certificates = f"{folder}/certificates"
    issue = [coxswain, "certificates", "--robot", "mecanum", "--out", certificates]
    subprocess.run(issue, check=True, stdout=subprocess.DEVNULL)
    for number in range(rounds):
        out, generator, stops = f"{folder}/{number}", random.Random(number), 0
        command = [coxswain, "launch", graph, "--scenario", "paper-20ms"]
        command += ["--certificates", certificates, "--out", out]
        # The launch itself is the router.
        launch = subprocess.Popen(command, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL)
        end = time.monotonic() + 24
        try:
            time.sleep(3)
            while launch.poll() is None and time.monotonic() < end:
                launch.send_signal(signal.SIGSTOP)
                time.sleep(stopped_s * generator.uniform(0.5, 1.5))
                launch.send_signal(signal.SIGCONT)
                stops += 1
                time.sleep(generator.uniform(0.2, 0.4))
        except BaseException:
            launch.send_signal(signal.SIGCONT)
            launch.terminate()
            raise
        finally:
            launch.wait()
        assert launch.returncode == 0, f"the launch ended with {launch.returncode}"
        summary = json.loads(pathlib.Path(f"{out}/summary.json").read_text())
        missed, periods = summary["periods_missed"], summary["periods"]
        print(f"stopped {stops} times: {missed} of {periods} periods without a fresh plan",
              flush=True)
