"""Measures the time from the launch command to the first movement of the robot in a browser.

Usage: python3 docs/first_movement.py [ROUNDS [COMMAND…]]
The default command is ./deploy/launch, after a build.
"""

import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time

from chromium import Browser


def seconds(command, out):
    browser = Browser()
    begin = time.monotonic()
    launch = subprocess.Popen([*command, "--duration", "20", "--out", out],
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    address = None
    for line in launch.stdout:
        if address := re.search(rb"live page: (\S+)", line):
            break
    if not address:
        sys.exit("the launch printed no address of a live page")
    browser.open(address[1].decode())
    first = ""
    while not first or browser.text("place") == first:
        first = first or browser.text("place")
        time.sleep(0.01)
    taken = time.monotonic() - begin
    launch.send_signal(signal.SIGTERM)
    launch.communicate()
    browser.close()
    return taken


rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
command = sys.argv[2:] or ["./deploy/launch"]
taken = []
for number in range(rounds):
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        taken.append(seconds(command, f"{folder}/run"))
        print(f"{taken[-1]:.2f} s", flush=True)
print(f"median {statistics.median(taken):.2f} s, longest {max(taken):.2f} s")
