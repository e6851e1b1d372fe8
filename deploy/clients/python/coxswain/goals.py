"""Goals for a robot while it drives.

The launch runs on this machine, or on another one that accepts requests (requests.py). The topic
`goal` of the gateway says when the robot stands there. The page docs/how-to/give-goals.md explains
goals.

    with coxswain.Goals(coxswain.running_launch()) as goals:
        number = goals.give_pose(2.0, 1.0, 0.0)
        for message in goals.until_reached(number):
            print(message["left_m"])

    with coxswain.Goals(at="10.0.0.1:7451", certificates=Path("certificates")) as goals:
        goals.give_pose(2.0, 1.0, 0.0)
"""

import json
import queue
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import zenoh

from .connection import configuration
from .launches import Launch, way_to
from .requests import RequestError, applied

MESSAGE_S = 5.0  # longest wait for a message of the topic `goal`


class Goals:
    """Gives goals to a launch of this machine or, with a certificate, of another one."""

    def __init__(
        self,
        launch: Launch | None = None,
        *,
        at: str | None = None,
        certificates: Path | None = None,
    ) -> None:
        """`at` is host and port where the controller's host accepts requests, and `certificates`
        the folder with the certificate of an operator or a planner. Raises RequestError.
        """
        self.way = way_to(launch, at, certificates)
        self.messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.session = self._watch(launch) if launch else None

    def _watch(self, launch: Launch) -> zenoh.Session:
        def receive(sample: zenoh.Sample) -> None:
            self.messages.put(json.loads(sample.payload.to_string()))

        if not launch.endpoints:
            text = f"{launch.run}: expected a launch with a gateway, for the topic goal"
            raise RequestError(text)
        try:
            session = zenoh.open(configuration(launch.endpoints[0], None))
        except zenoh.ZError as error:
            text = f"no gateway replies at {launch.endpoints[0]}: {error}"
            raise RequestError(text) from error
        self.subscriber = session.declare_subscriber("coxswain/*/goal/json", receive)
        return session

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.way.close()
        if self.session:
            self.session.close()  # type: ignore[no-untyped-call]

    def give_pose(self, x: float, y: float, yaw: float) -> int:
        """Gives a pose in the world [m, m, rad]. Returns the number of the goal."""
        return self.give(f"[goal.pose]\nto = [{float(x)}, {float(y)}, {float(yaw)}]\n")

    def give(self, goal: str) -> int:
        """Gives a goal as lines of TOML, and waits until it is accepted. Returns its number.

        Raises RequestError if it is rejected.
        """
        reply = self.way.ask("controller", f"# goal\n{goal}")
        number: int = applied(reply, "controller")["number"]
        return number

    def until_reached(self, number: int) -> Iterator[dict[str, Any]]:
        """The messages of this goal, until the robot stands there: on the machine of the launch.

        A goal that ends in another way raises a RequestError.
        """
        if self.session is None:
            raise RequestError("the progress of a goal is known on the machine of the launch alone")
        while True:
            try:
                message = self.messages.get(timeout=MESSAGE_S)
            except queue.Empty:
                raise RequestError(f"no message of goal {number} for {MESSAGE_S:.0f} s") from None
            if message["id"] > number:
                raise RequestError(f"goal {number} is preempted by goal {message['id']}")
            if message["id"] < number:
                continue
            if message["phase"] not in ("active", "reached"):
                raise RequestError(f"goal {number} is {message['phase']}")
            yield message
            if message["phase"] == "reached":
                return
