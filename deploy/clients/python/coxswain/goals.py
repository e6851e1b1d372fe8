"""Goals for a robot whose launch runs on this machine.

A goal is a request file in the run directory. The controller replies beside it. The topic `goal`
says when the robot stands there. The page docs/how-to/give-goals.md explains goals.

    with coxswain.Goals(coxswain.running_launch()) as goals:
        number = goals.give_pose(2.0, 1.0, 0.0)
        for message in goals.until_reached(number):
            print(message["left_m"])
"""

import getpass
import json
import os
import queue
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import zenoh

from .connection import configuration

REPLY_S = 15.0  # longest wait for the reply of the controller
MESSAGE_S = 5.0  # longest wait for a message of the topic `goal`
LOOK_S = 0.005  # interval between two looks for the reply


class GoalError(Exception):
    """A goal was not given, or not reached.

    `code` is the kind of a rejection by the controller, as in WIRE.md; otherwise it is empty.
    """

    def __init__(self, text: str, code: str = "") -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Launch:
    """A launch that runs on this machine."""

    run: Path
    """Its run directory."""
    endpoints: tuple[str, ...]
    """Of its gateway; empty without one."""
    links: Path
    """The directory of its links."""


def running_launches() -> list[Launch]:
    """The launches of this user that run on this machine."""
    base = Path(os.environ.get("TMPDIR", "/tmp")) / f"coxswain-{os.getuid()}"
    found = []
    for entry in sorted(base.glob("*.toml")):
        graph = entry.with_suffix("")
        try:
            launcher = tomllib.loads(entry.read_text())
            run = Path(os.fsdecode((graph / "run").read_bytes()))
        except (OSError, tomllib.TOMLDecodeError):
            continue  # it ends or begins at this moment
        if _start_ticks(launcher.get("pid")) != launcher.get("start_ticks"):
            continue
        telemetry = graph / "telemetry"
        endpoints = telemetry.read_text().split() if telemetry.exists() else []
        found.append(Launch(run, tuple(endpoints), graph))
    return found


def running_launch(run: Path | None = None) -> Launch:
    """The launch with this run directory, or the only one that runs."""
    found = running_launches()
    if run is not None:
        found = [launch for launch in found if launch.run == run.resolve()]
    if len(found) != 1:
        names = ", ".join(str(launch.run) for launch in found) or "none"
        raise GoalError(f"expected one launch that runs on this machine, found {names}")
    return found[0]


def _start_ticks(pid: object) -> int | None:
    """Start time of a process that runs: with its id it is unique."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    state, *fields = stat.rpartition(")")[2].split()
    return None if state in "ZX" else int(fields[18])


class Goals:
    """Gives goals to a launch, and receives the topic `goal` of its gateway."""

    def __init__(self, launch: Launch) -> None:
        if not launch.endpoints:
            raise GoalError(f"{launch.run}: expected a launch with a gateway, for the topic goal")
        self.folder = launch.run / "set"
        self.messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

        def receive(sample: zenoh.Sample) -> None:
            self.messages.put(json.loads(sample.payload.to_string()))

        try:
            self.session = zenoh.open(configuration(launch.endpoints[0], None))
        except zenoh.ZError as error:
            raise GoalError(f"no gateway replies at {launch.endpoints[0]}: {error}") from error
        self.subscriber = self.session.declare_subscriber("coxswain/*/goal/json", receive)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()  # type: ignore[no-untyped-call]

    def give_pose(self, x: float, y: float, yaw: float) -> int:
        """Gives a pose in the world [m, m, rad]. Returns the number of the goal."""
        return self.give(f"[goal.pose]\nto = [{float(x)}, {float(y)}, {float(yaw)}]\n")

    def give(self, goal: str) -> int:
        """Gives a goal as lines of TOML, and waits until it is accepted. Returns its number."""
        who, now = getpass.getuser(), time.time_ns()
        request = {"who": who, "asked_unix_nanos": now, "change": f"# goal\n{goal}"}
        try:
            with tempfile.NamedTemporaryFile("w", dir=self.folder, prefix=".request-") as whole:
                json.dump(request, whole)
                whole.flush()
                os.fchmod(whole.fileno(), 0o644)  # the controller may belong to another user
                number = self._numbered(whole.name)
        except OSError as error:
            raise GoalError(f"the request cannot be written: {error}") from error
        reply = self._reply(number)
        if reply["outcome"] != "applied":
            code = reply.get("code", "")
            raise GoalError(f"goal {number} was rejected: {reply['reason']}", code)
        return number

    def _numbered(self, whole: str) -> int:
        """Links the complete file to the next name that no other request has."""
        names = [path.stem.removeprefix("controller-") for path in self.folder.glob("controller-*")]
        number = max((int(name) for name in names if name.isdecimal()), default=0)
        while True:
            number += 1
            try:
                os.link(whole, self.folder / f"controller-{number:06}.json")
                return number
            except FileExistsError:
                continue

    def _reply(self, number: int) -> dict[str, Any]:
        file, begin = self.folder / f"controller-{number:06}.answer.json", time.monotonic()
        while not file.exists():
            if time.monotonic() > begin + REPLY_S:
                raise GoalError(f"the controller has not replied to goal {number}: {file}")
            time.sleep(LOOK_S)
        reply: dict[str, Any] = json.loads(file.read_text())
        return reply

    def until_reached(self, number: int) -> Iterator[dict[str, Any]]:
        """The messages of this goal, until the robot stands there.

        A goal that ends in another way raises a GoalError.
        """
        while True:
            try:
                message = self.messages.get(timeout=MESSAGE_S)
            except queue.Empty:
                raise GoalError(f"no message of goal {number} for {MESSAGE_S:.0f} s") from None
            if message["id"] > number:
                raise GoalError(f"goal {number} is preempted by goal {message['id']}")
            if message["id"] < number:
                continue
            if message["phase"] not in ("active", "reached"):
                raise GoalError(f"goal {number} is {message['phase']}")
            yield message
            if message["phase"] == "reached":
                return
