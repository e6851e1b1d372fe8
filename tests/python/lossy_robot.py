"""robot.py on links that lose some of its commands, states and credits without notice."""

import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "deploy/clients/python"))
import robot

LOST = {
    "command": lambda number: number % 50 == 25,
    "state": lambda number: number % 50 == 0,
    # All credits that the recorder sends before it waits for a state.
    "credit": lambda number: number in range(5, 9),
}


class Lossy(robot.Network):
    sent: Counter[str] = Counter()
    lost: Counter[str] = Counter()

    def loses(self, topic: str) -> bool:
        self.sent[topic] += 1
        lost = LOST[topic](self.sent[topic])
        self.lost[topic] += lost
        return lost

    def next(self, timeout: float) -> tuple[str, Any]:
        topic, what = super().next(timeout)
        is_lost = topic in ("command", "credit") and self.loses(topic)
        return ("nothing", None) if is_lost else (topic, what)

    def put_state(self, payload: bytes, number: bytes | None) -> None:
        if not self.loses("state"):
            super().put_state(payload, number)


signal.alarm(120)  # far longer than a run takes; ends a robot that waits forever
robot.Network = Lossy
code = robot.main()
missing = [topic for topic in LOST if not Lossy.lost[topic]]
sys.exit(code or (f"lost only {Lossy.lost}: expected also {missing}" if missing else 0))
