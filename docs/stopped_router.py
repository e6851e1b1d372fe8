"""Periods without a fresh plan when the network's router stands still again and again, at a period of 20 ms, with certificates:
python3 docs/stopped_router.py [ROUNDS [MILLIS [COXSWAIN]]]; it is stopped for half to one and a half times MILLIS, two to four times a second"""

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
    given = f"{folder}/certificates"
    subprocess.run([coxswain, "certificates", "--robot", "mecanum", "--out", given], check=True, stdout=subprocess.DEVNULL)
    for number in range(rounds):
        out, draw, stops = f"{folder}/{number}", random.Random(number), 0
        command = [coxswain, "launch", graph, "--scenario", "paper-20ms", "--certificates", given, "--out", out]
        # The launch itself is the router.
        launch = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 24
        try:
            time.sleep(3)
            while launch.poll() is None and time.monotonic() < end:
                launch.send_signal(signal.SIGSTOP)
                time.sleep(stopped_s * draw.uniform(0.5, 1.5))
                launch.send_signal(signal.SIGCONT)
                stops += 1
                time.sleep(draw.uniform(0.2, 0.4))
        except BaseException:
            launch.send_signal(signal.SIGCONT)
            launch.terminate()
            raise
        finally:
            launch.wait()
        assert launch.returncode == 0, f"the launch ended with {launch.returncode}"
        summary = json.loads(pathlib.Path(f"{out}/summary.json").read_text())
        print(f"stopped {stops} times: {summary['periods_missed']} of {summary['periods']} periods without a fresh plan", flush=True)
