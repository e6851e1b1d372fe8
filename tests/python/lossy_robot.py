"""robot.py on a link that loses some of its commands, and some of its states, without anybody being told."""
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "deploy/clients/python"))
import robot

EVERY = 50  # of so many messages one is lost


class Lossy(robot.Network):
    commands = states = lost = 0

    def next(self, patience: float) -> tuple[str, Any]:
        topic, what = super().next(patience)
        if topic == "command":
            Lossy.commands += 1
            if Lossy.commands % EVERY == EVERY // 2:
                Lossy.lost += 1
                return "nothing", None
        return topic, what

    def put_state(self, payload: bytes, number: bytes | None) -> None:
        Lossy.states += 1
        if Lossy.states % EVERY == 0:
            Lossy.lost += 1
        else:
            super().put_state(payload, number)


robot.Network = Lossy
sys.exit(robot.main() or ("nothing was lost" if Lossy.lost == 0 else 0))
