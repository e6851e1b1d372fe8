"""planner -> gate: the lists of obstacles that planners send to the driver.

Each line of a stream socket is a list as JSON, and has a line of JSON as reply. The section *Lists
of a planner* of protocol/WIRE.md defines both. Threads check the lists; the driver takes the newest
one at the begin of a period.
"""

import contextlib
import json
import math
import os
import socketserver
import stat
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .protection import Obstacle
from .shape import Shape

LINE_BYTES_MAX = 65536
OBSTACLES_MAX = 64
PLANNERS_MAX = 8
LARGEST_MPS = 1e3
LARGEST_S = 1e3


@dataclass(frozen=True)
class PlannerList:
    """All obstacles that planners know, at the time at which the list was sent."""

    obstacles: tuple[Obstacle, ...]
    age: float
    """Age of what it shows when it is sent [s]."""
    valid: float
    """Time after its arrival from which it is too old [s]."""

    @classmethod
    def parsed(cls, line: bytes | str) -> "PlannerList":
        """The list in one line of JSON. Raises ValueError with the first value that is wrong."""
        found = json.loads(line, object_pairs_hook=unique, parse_constant=refuse_constant)
        fields = fields_of(found, {"valid_s", "obstacles"}, {"age_s"})
        listed = fields["obstacles"]
        if not isinstance(listed, list):
            raise ValueError("obstacles: expected a list")
        if len(listed) > OBSTACLES_MAX:
            raise ValueError(f"expected at most {OBSTACLES_MAX} obstacles, not {len(listed)}")
        times = [number(key, fields.get(key, 0.0)) for key in ("age_s", "valid_s")]
        if not all(0.0 <= value <= LARGEST_S for value in times):
            raise ValueError("age_s, valid_s: expected 0 to 1000 s")
        return cls(tuple(obstacle(one) for one in listed), *times)


def obstacle(found: object) -> Obstacle:
    """One obstacle of a list."""
    fields = fields_of(found, {"corners_m"}, {"radius_m", "velocity_mps"})
    shape = Shape.checked(fields["corners_m"], fields.get("radius_m", 0.0))
    velocity = fields.get("velocity_mps", [0.0, 0.0])
    if not isinstance(velocity, list) or len(velocity) != 2:
        raise ValueError("velocity_mps: expected two numbers")
    x, y = (number("velocity_mps", value) for value in velocity)
    if not max(abs(x), abs(y)) <= LARGEST_MPS:
        raise ValueError("velocity_mps: expected -1000 to 1000 m/s")
    return Obstacle(shape, (x, y))


def fields_of(found: object, needed: set[str], optional: set[str]) -> dict[str, Any]:
    """An object with all keys of `needed`, and no other ones than those of `optional`."""
    if not isinstance(found, dict):
        raise ValueError("expected an object")
    if not needed <= found.keys() <= needed | optional:
        expected = f"{sorted(needed)} and perhaps {sorted(optional)}"
        raise ValueError(f"expected the keys {expected}, not {sorted(found)}")
    return found


def number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{key}: expected a finite number")
    return float(value)


def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON without a key that is there twice."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key is there twice")
    return found


def refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


class Planners:
    """The socket of planners. In lock step it rejects all lists."""

    def __init__(self, path: Path, lock_step: bool) -> None:
        """Listens at `path`, which only this user can open. Raises OSError."""
        self.lock_step = lock_step
        self.newest: tuple[PlannerList, float] | None = None
        self.accepted = self.rejected = self.connected = 0
        self.lock = threading.Lock()
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(path.stat().st_mode):
                path.unlink()  # of a driver that was killed
        before = os.umask(0o077)
        try:
            self.server = Server(str(path), self)
        finally:
            os.umask(before)
        self.path = path
        threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True).start()

    def due(self) -> PlannerList | None:
        """The newest list, if there is a new one. The wait for this call counts as its age."""
        with self.lock:
            newest, self.newest = self.newest, None
        if newest is None:
            return None
        planned, arrived = newest
        return PlannerList(
            planned.obstacles, planned.age + time.monotonic() - arrived, planned.valid
        )

    def judge(self, line: bytes) -> dict[str, str]:
        """The reply to a line."""
        try:
            if self.lock_step:
                raise ValueError("in lock step no planner takes part")
            if not line.endswith(b"\n"):
                raise ValueError(f"expected lines of at most {LINE_BYTES_MAX} bytes")
            planned = PlannerList.parsed(line)
        except (ValueError, RecursionError) as error:
            with self.lock:
                self.rejected += 1
            return {"outcome": "rejected", "reason": str(error)}
        with self.lock:
            self.accepted += 1
            self.newest = planned, time.monotonic()
        return {"outcome": "accepted"}

    def close(self) -> None:
        """Closes the socket and all connections."""
        self.server.shutdown()
        self.server.server_close()
        self.path.unlink(missing_ok=True)


class Server(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    """A thread for each planner."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, path: str, planners: Planners) -> None:
        self.planners = planners
        super().__init__(path, Connection)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        with self.planners.lock:
            return self.planners.connected < PLANNERS_MAX

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A planner that has gone is no error."""


class Connection(socketserver.StreamRequestHandler):
    """The connection with one planner."""

    server: Server
    timeout = 1.0  # for a planner that does not read its replies

    def handle(self) -> None:
        planners = self.server.planners
        with planners.lock:
            planners.connected += 1
        try:
            while line := self.line():
                self.wfile.write(json.dumps(planners.judge(line)).encode() + b"\n")
                if not line.endswith(b"\n"):
                    return
        finally:
            with planners.lock:
                planners.connected -= 1

    def line(self) -> bytes:
        """The next line; what has arrived of it if it is too long."""
        self.connection.settimeout(None)
        line = self.rfile.readline(LINE_BYTES_MAX)
        self.connection.settimeout(self.timeout)
        return line if line.endswith(b"\n") or len(line) == LINE_BYTES_MAX else b""
