"""robot.py on links that lose some of its commands, states and credits, without anybody being told."""
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
    "credit": lambda number: number in range(5, 9),  # in a row: all that the recorder grants before it waits for a state
}


class Lossy(robot.Network):
    said: Counter[str] = Counter()
    lost: Counter[str] = Counter()

    def loses(self, topic: str) -> bool:
        self.said[topic] += 1
        lost = LOST[topic](self.said[topic])
        self.lost[topic] += lost
        return lost

    def next(self, patience: float) -> tuple[str, Any]:
        topic, what = super().next(patience)
        return ("nothing", None) if topic in ("command", "credit") and self.loses(topic) else (topic, what)

    def put_state(self, payload: bytes, number: bytes | None) -> None:
        if not self.loses("state"):
            super().put_state(payload, number)


signal.alarm(120)  # far longer than it takes: a robot that waits for ever has failed
robot.Network = Lossy
sys.exit(robot.main() or (0 if all(Lossy.lost[topic] for topic in LOST) else f"lost were only {Lossy.lost}"))
