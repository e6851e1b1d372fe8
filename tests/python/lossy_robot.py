"""robot.py on links that lose some of its commands, states and credits without notice."""

import signal
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "deploy/clients/python"))
import robot
from coxswain import driver

LOST = {
    "command": lambda number: number % 50 == 25,
    "state": lambda number: number % 50 == 0,
    # All credits that the recorder sends before it waits for a state.
    "credit": lambda number: number in range(5, 9),
}


class Lossy(driver.Connection):
    sent: Counter[str] = Counter()
    lost: Counter[str] = Counter()

    def loses(self, topic: str) -> bool:
        self.sent[topic] += 1
        lost = LOST[topic](self.sent[topic])
        self.lost[topic] += lost
        return lost

    def next(self, timeout: float) -> tuple[str, bytes]:
        topic, message = super().next(timeout)
        return ("", b"") if topic and self.loses(topic) else (topic, message)

    def put(self, topic: str, message: bytes) -> None:
        if topic not in LOST or not self.loses(topic):
            super().put(topic, message)


signal.alarm(120)  # far longer than a run takes; ends a robot that waits forever
driver.Connection = Lossy
code = robot.main()
missing = [topic for topic in LOST if not Lossy.lost[topic]]
sys.exit(code or (f"lost only {Lossy.lost}: expected also {missing}" if missing else 0))
