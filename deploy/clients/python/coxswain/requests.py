"""operator or planner -> a process: requests as files of a launch, or over the network.

On the machine of the launch a request is a file in its run directory, and the process replies
beside it. From another machine it is a query to the bridge of a host, with a certificate
(protocol/WIRE.md, section *Requests*).
"""

import getpass
import json
import os
import ssl
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import zenoh

from .connection import configuration

REPLY_S = 15.0  # longest wait for a reply in a file
LOOK_S = 0.005  # interval between two looks for it
NETWORK_REPLY_S = 20.0  # longest wait for a reply over the network
KNOWN_S = 3.0  # how long a new session may take to know who replies
KNOWN_LOOK_S = 0.02  # interval between two looks in that time
CLOCK_S = 60.0  # how long the clock of the bridge is used
CLOCK_QUICK_S = 0.1  # a reply within this time is precise
CLOCK_SLOW_S = 1.0  # how long the clock of a slower reply is used
ROLES = ("operator", "planner")
COMMON_NAME = b"\x06\x03\x55\x04\x03"  # its identifier in a certificate


class RequestError(Exception):
    """A request was not applied, or a goal was not reached.

    `code` is the kind of a rejection by the process, as in WIRE.md; otherwise it is empty.
    """

    def __init__(self, text: str, code: str = "") -> None:
        super().__init__(text)
        self.code = code


class Way(Protocol):
    """A way to the processes of a robot."""

    def ask(self, process: str, text: str) -> dict[str, Any]:
        """Sends a request, and waits for the reply. Raises RequestError."""

    def close(self) -> None:
        """Ends the way."""


def applied(reply: dict[str, Any], process: str) -> dict[str, Any]:
    """The reply, if the request is in use. Raises RequestError."""
    if reply["outcome"] not in ("applied", "accepted"):
        raise RequestError(f"rejected by the {process}: {reply['reason']}", reply.get("code", ""))
    return reply


class Files:
    """Requests to a launch of this machine."""

    def __init__(self, run: Path) -> None:
        """`run` is its run directory."""
        self.folder = run / "set"

    def ask(self, process: str, text: str) -> dict[str, Any]:
        request = {"who": getpass.getuser(), "asked_unix_nanos": time.time_ns(), "change": text}
        try:
            with tempfile.NamedTemporaryFile("w", dir=self.folder, prefix=".request-") as whole:
                json.dump(request, whole)
                whole.flush()
                os.fchmod(whole.fileno(), 0o644)  # the process may belong to another user
                number = self._numbered(process, whole.name)
        except OSError as error:
            raise RequestError(f"the request cannot be written: {error}") from error
        return {"number": number, **self._reply(process, number)}

    def close(self) -> None:
        """There is nothing to end."""

    def _numbered(self, process: str, whole: str) -> int:
        """Links the complete file to the next name that no other request has."""
        names = [path.stem.rpartition("-")[2] for path in self.folder.glob(f"{process}-*.json")]
        number = max((int(name) for name in names if name.isdecimal()), default=0)
        while True:
            number += 1
            try:
                os.link(whole, self.folder / f"{process}-{number:06}.json")
                return number
            except FileExistsError:
                continue

    def _reply(self, process: str, number: int) -> dict[str, Any]:
        file, begin = self.folder / f"{process}-{number:06}.answer.json", time.monotonic()
        while not file.exists():
            if time.monotonic() > begin + REPLY_S:
                raise RequestError(f"the {process} has not replied to request {number}: {file}")
            time.sleep(LOOK_S)
        reply: dict[str, Any] = json.loads(file.read_text())
        return reply


@dataclass(frozen=True)
class Clock:
    """The clock of the bridge [ns] when its reply was received."""

    nanos: int
    received: float
    valid: float
    """How long it is used [s]."""

    def at(self, moment: float) -> int:
        return self.nanos + round((moment - self.received) * 1e9)


class Network:
    """A session of an operator or a planner with the bridge of one host."""

    def __init__(self, at: str, certificates: Path, roles: tuple[str, ...] = ROLES) -> None:
        """Connects to the host and port `at`, with the certificate of the first of `roles` below
        `certificates`. Raises RequestError within seconds.
        """
        folder = credentials(certificates, roles)
        self.role, self.robot = subject(folder / "certificate.pem")
        if self.role not in roles:
            raise RequestError(f"{folder}: expected the certificate of {' or '.join(roles)}")
        self.endpoint = f"tls/{at}"
        self.clock: Clock | None = None
        config = configuration(self.endpoint, folder)
        config.insert_json5("connect/timeout_ms", "0")
        try:
            self.session = zenoh.open(config)
        except zenoh.ZError as error:
            raise RequestError(f"no session at {self.endpoint}: {error}") from error

    def ask(self, process: str, text: str) -> dict[str, Any]:
        """A goal counts as made now, also if the network holds it up."""
        made = time.monotonic()
        if process != "controller":
            return self._query(process, text)
        nanos = self._clock().at(made)
        try:
            return self._query(process, text, nanos.to_bytes(8, "little"))
        except RequestError:
            self.clock = None  # a machine that was restarted has another clock
            raise

    def close(self) -> None:
        self.session.close()  # type: ignore[no-untyped-call]

    def _clock(self) -> Clock:
        sent, clock = time.monotonic(), self.clock
        if clock is None or sent > clock.received + clock.valid:
            nanos = self._query("bridge", "clock")["monotonic_nanos"]
            received = time.monotonic()
            valid = CLOCK_S if received <= sent + CLOCK_QUICK_S else CLOCK_SLOW_S
            self.clock = clock = Clock(nanos, received, valid)
        return clock

    def _query(self, process: str, text: str, made: bytes | None = None) -> dict[str, Any]:
        key = f"coxswain-request/{self.robot}/{self.role}/{process}"
        nobody = f"no reply from {self.endpoint}; {self.role} may have no access to {process}"
        try:
            with self.session.declare_querier(key, timeout=NETWORK_REPLY_S) as querier:
                # A request is sent once: one without a reply may have been processed.
                begin = time.monotonic()
                while not querier.matching_status:
                    if time.monotonic() > begin + KNOWN_S:
                        raise RequestError(nobody)
                    time.sleep(KNOWN_LOOK_S)
                reply = next(iter(querier.get(payload=text, attachment=made)), None)
        except zenoh.ZError as error:
            raise RequestError(f"no session at {self.endpoint}: {error}") from error
        if reply is None:
            raise RequestError(nobody)
        if reply.ok is None:
            reason = reply.err.payload.to_string() if reply.err else "no reason"
            raise RequestError(reason)
        read: dict[str, Any] = json.loads(reply.ok.payload.to_string())
        return read


def credentials(certificates: Path, roles: tuple[str, ...]) -> Path:
    """The folder of the first role that is there; a folder without any is that of a role itself."""
    found = [certificates / role for role in roles if (certificates / role).is_dir()]
    return found[0] if found else certificates


def subject(certificate: Path) -> tuple[str, str]:
    """Role and robot in the name of the holder of a certificate. Raises RequestError."""
    try:
        data = ssl.PEM_cert_to_DER_cert(certificate.read_text())
    except (OSError, ValueError) as error:
        raise RequestError(f"{certificate}: no certificate: {error}") from error
    # The name of the authority comes first.
    _, _, name = data.rpartition(COMMON_NAME)
    length = name[1] if len(name) > 1 else 0
    role, _, robot = name[2 : 2 + length].decode("utf-8", "replace").partition(".")
    if not robot:
        raise RequestError(f"{certificate}: its subject names no role and robot")
    return role, robot
