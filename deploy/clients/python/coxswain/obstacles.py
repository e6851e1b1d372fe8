"""Lists of obstacles for the gate of a robot.

On its machine the plant takes them from a socket: one line of JSON for each list, and one for the
reply. From another machine they are requests of a planner (requests.py). The page
docs/how-to/keep-clear-of-obstacles.md explains them.

    disc = {"corners_m": [[2.0, 0.5]], "radius_m": 0.3, "velocity_mps": [0.0, 0.0]}
    with coxswain.Obstacles(coxswain.running_launch()) as obstacles:
        obstacles.send({"valid_s": 0.5, "obstacles": [disc]})
"""

import json
import socket
from pathlib import Path
from typing import Any, Self

from .launches import Launch
from .requests import Network, RequestError, applied

REPLY_S = 5.0  # longest wait for the reply of the plant


class Obstacles:
    """Sends lists of obstacles to the plant of a launch.

    Send one several times within its validity `valid_s`: when the newest list is too old, the robot
    slows down, also if the program has ended.
    """

    def __init__(
        self,
        launch: Launch | None = None,
        *,
        socket_file: Path | None = None,
        at: str | None = None,
        certificates: Path | None = None,
    ) -> None:
        """To the plant of a launch on this machine, to a driver with this socket (its option
        `--lists`), or with the certificate of a planner to the plant's host `at` host and port.
        Raises RequestError.
        """
        if [launch, socket_file, at].count(None) != 2 or (at is None) != (certificates is None):
            raise TypeError("expected a launch, a socket, or an address with certificates")
        self.way: Socket | Network
        if at and certificates:
            self.way = Network(at, certificates, ("planner",))
        else:
            self.way = Socket(socket_file or (launch.links / "lists" if launch else Path()))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection. The last list acts until it is too old."""
        self.way.close()

    def send(self, planned: dict[str, Any]) -> None:
        """Sends a list, and waits until the plant has accepted it. Raises RequestError.

        A list has `valid_s`, perhaps `age_s` [s], and `obstacles`: each has `corners_m` [m], and
        perhaps `radius_m` [m] and `velocity_mps` [m/s].
        """
        applied(self.way.ask("plant", json.dumps(planned)), "plant")


class Socket:
    """The socket of a plant or a driver. It connects when it needs to."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        self.stream: socket.socket | None = None

    def close(self) -> None:
        """Closes the connection."""
        if self.stream is not None:
            self.stream.close()
            self.stream = None

    def ask(self, process: str, text: str) -> dict[str, Any]:
        """Sends a line, and waits for the reply. Raises RequestError."""
        was_open = self.stream is not None
        try:
            return self._exchange(text.encode() + b"\n")
        except OSError as error:
            self.close()
            if not was_open:
                text = f"no {process} accepts lists at {self.path}: {error}"
                raise RequestError(text) from error
            return self.ask(process, text)  # the plant was restarted

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
