"""A Chromium without a window, for what is measured with browsers: one tab, spoken to in the DevTools protocol through a pipe."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--disable-background-networking"]
PIPE = 'exec "$@" 3<&0 4>&1 0</dev/null 1>/dev/null 2>&1'


class Browser:
    """Processes of their own group, with a profile of their own."""

    def __init__(self):
        program = shutil.which("chromium") or shutil.which("google-chrome")
        if not program:
            sys.exit("PATH has neither chromium nor google-chrome")
        self.profile = tempfile.TemporaryDirectory(prefix="cx", dir="/tmp", ignore_cleanup_errors=True)
        command = ["sh", "-c", PIPE, "sh", program, *FLAGS, "--remote-debugging-pipe", f"--user-data-dir={self.profile.name}"]
        here = {**os.environ, "HOME": self.profile.name, "TMPDIR": self.profile.name}
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=here, start_new_session=True)
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

    def open(self, address):
        self.call("Page.navigate", url=address)

    def text(self, element):
        """What the element with this id shows; nothing if there is none."""
        found = self.call("Runtime.evaluate", expression=f"document.getElementById({element!r})?.innerText || ''")
        return found.get("result", {}).get("value", "")

    def signal(self, number):
        """To all of its processes."""
        os.killpg(self.process.pid, number)

    def close(self):
        self.signal(signal.SIGKILL)
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()
        self.profile.cleanup()
