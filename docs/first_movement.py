"""From ./deploy/launch, built, or another COMMAND, to the first moving robot in an open browser: python3 docs/first_movement.py [ROUNDS [COMMAND…]]"""

import json
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--remote-debugging-pipe"]
PIPE = 'exec "$@" 3<&0 4>&1 0</dev/null 1>/dev/null 2>&1'


class Browser:
    """One tab, spoken to in the DevTools protocol through a pipe."""

    def __init__(self, profile):
        program = shutil.which("chromium") or shutil.which("google-chrome")
        if not program:
            sys.exit("PATH has neither chromium nor google-chrome")
        command = ["sh", "-c", PIPE, "sh", program, *FLAGS, f"--user-data-dir={profile}"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.calls, self.session, self.rest = 0, None, b""
        tab = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=tab, flatten=True)["sessionId"]

    def call(self, method, **parameters):
        self.calls += 1
        message = {"id": self.calls, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        self.process.stdin.write(json.dumps(message).encode() + b"\0")
        self.process.stdin.flush()
        while True:
            while b"\0" not in self.rest:
                part = self.process.stdout.read1(65536)
                if not part:
                    sys.exit("the browser has ended")
                self.rest += part
            told, self.rest = self.rest.split(b"\0", 1)
            told = json.loads(told)
            if told.get("id") == self.calls:
                return told.get("result", {})

    def place(self):
        found = self.call("Runtime.evaluate", expression="document.getElementById('place')?.innerText || ''")
        return found.get("result", {}).get("value", "")

    def close(self):
        self.session = None
        self.call("Browser.close")
        self.process.wait()


def seconds(command, out, profile):
    browser = Browser(profile)
    begin = time.monotonic()
    launch = subprocess.Popen([*command, "--duration", "20", "--out", out], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    address = None
    for line in launch.stdout:
        if address := re.search(rb"live page: (\S+)", line):
            break
    if not address:
        sys.exit("the launch told no address")
    browser.call("Page.navigate", url=address[1].decode())
    first = ""
    while not first or browser.place() == first:
        first = first or browser.place()
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
        taken.append(seconds(command, f"{folder}/run", f"{folder}/profile"))
        print(f"{taken[-1]:.2f} s", flush=True)
print(f"median {statistics.median(taken):.2f} s, longest {max(taken):.2f} s")
