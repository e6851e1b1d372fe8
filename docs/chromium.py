"""A headless Chromium for measurements: one tab, controlled over a pipe.

The pipe carries the DevTools protocol.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
         "--no-first-run", "--disable-background-networking"]
PIPE = 'exec "$@" 3<&0 4>&1 0</dev/null 1>/dev/null 2>&1'


class Browser:
    """A browser in its own process group, with a temporary profile."""

    def __init__(self):
        program = shutil.which("chromium") or shutil.which("google-chrome")
        if not program:
            sys.exit("PATH has neither chromium nor google-chrome")
        self.profile = tempfile.TemporaryDirectory(prefix="cx", dir="/tmp",
                                                   ignore_cleanup_errors=True)
        command = ["sh", "-c", PIPE, "sh", program, *FLAGS, "--remote-debugging-pipe",
                   f"--user-data-dir={self.profile.name}"]
        environment = {**os.environ, "HOME": self.profile.name, "TMPDIR": self.profile.name}
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                        env=environment, start_new_session=True)
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
            line, self.rest = self.rest.split(b"\0", 1)
            answer = json.loads(line)
            if answer.get("id") == self.calls:
                return answer.get("result", {})

    def open(self, address):
        self.call("Page.navigate", url=address)

    def text(self, element):
        """The text of the element with this id; empty if there is none."""
        expression = f"document.getElementById({element!r})?.innerText || ''"
        found = self.call("Runtime.evaluate", expression=expression)
        return found.get("result", {}).get("value", "")

    def signal(self, number):
        """Sends a signal to all processes of the browser."""
        os.killpg(self.process.pid, number)

    def close(self):
        self.signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()
        self.profile.cleanup()
