"""Lists of obstacles for a robot on this machine.

Its plant takes them from a socket: one line of JSON for each list, and one for the reply. The page
docs/how-to/keep-clear-of-obstacles.md explains them.

    disc = {"corners_m": [[2.0, 0.5]], "radius_m": 0.3, "velocity_mps": [0.0, 0.0]}
    with coxswain.Obstacles(coxswain.running_launch()) as obstacles:
        obstacles.send({"valid_s": 0.5, "obstacles": [disc]})
"""

import json
import socket
from pathlib import Path
from typing import Any, Self

from .goals import Launch

REPLY_S = 5.0  # longest wait for the reply of the plant


class ObstaclesError(Exception):
    """A list does not act."""


class Obstacles:
    """Sends lists of obstacles to the plant of a launch.

    Send one several times within its validity `valid_s`: when the newest list is too old, the robot
    slows down, also if the program has ended.
    """

    def __init__(self, launch: Launch | None = None, *, socket_file: Path | None = None) -> None:
        """To the plant of a launch, or to a driver with this socket (its option `--lists`)."""
        if (launch is None) == (socket_file is None):
            raise TypeError("expected a launch or a socket")
        self.path = str(socket_file if launch is None else launch.links / "lists")
        self.stream: socket.socket | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection. The last list acts until it is too old."""
        if self.stream is not None:
            self.stream.close()
            self.stream = None

    def send(self, planned: dict[str, Any]) -> None:
        """Sends a list, and waits until the plant has accepted it.

        A list has `valid_s`, perhaps `age_s` [s], and `obstacles`: each has `corners_m` [m], and
        perhaps `radius_m` [m] and `velocity_mps` [m/s].
        """
        line = json.dumps(planned).encode() + b"\n"
        was_open = self.stream is not None
        try:
            reply = self._exchange(line)
        except OSError as error:
            self.close()
            if not was_open:
                raise ObstaclesError(f"no plant accepts lists at {self.path}: {error}") from error
            return self.send(planned)  # the plant was restarted
        if reply["outcome"] != "accepted":
            raise ObstaclesError(f"rejected by the plant: {reply['reason']}")
        return None

    def _exchange(self, line: bytes) -> dict[str, Any]:
        if self.stream is None:
            self.stream = socket.socket(socket.AF_UNIX)
            self.stream.settimeout(REPLY_S)
            self.stream.connect(self.path)
        self.stream.sendall(line)
        reply = b""
        while not reply.endswith(b"\n"):
            part = self.stream.recv(4096)
            if not part:
                raise ConnectionError("the plant has closed the connection")
            reply += part
        read: dict[str, Any] = json.loads(reply)
        return read
