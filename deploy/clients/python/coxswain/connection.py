"""The connection of a robot driver with the bridge of another host: keys and zenoh session.

protocol/WIRE.md defines the keys.
"""

import json
import os
import queue
import sys
import time
from pathlib import Path

import zenoh

# One thread reads and writes all connections. Else zenoh may damage its memory with TLS
# (https://github.com/eclipse-zenoh/zenoh/issues/2557). It reads this before the first session.
os.environ["ZENOH_RUNTIME"] = "(rx:(handover:tx),acc:(handover:net))"

WAITS_S = 60.0  # for the bridge, at the start
PRIORITIES = {
    "state": zenoh.Priority.REAL_TIME,
    "obstacles": zenoh.Priority.REAL_TIME,
    "health": zenoh.Priority.DATA_LOW,
}
RECEIVED = ("command", "credit")


def configuration(endpoint: str, folder: Path | None) -> zenoh.Config:
    """A client of `endpoint`; with the `folder` of a certificate over TLS alone."""
    config = zenoh.Config()
    settings = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,  # a killed client would leave files in /dev/shm
        # The bridge accepts a restarted driver after this silence of the one before it [ms].
        "transport/link/tx/lease": 2000,
    }
    if folder:
        settings["transport/link/protocols"] = ["tls"]
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(folder / "authority.pem"),
            "connect_certificate": str(folder / "certificate.pem"),
            "connect_private_key": str(folder / "key.pem"),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def open_session(config: zenoh.Config) -> zenoh.Session:
    """A session, as soon as the bridge accepts it."""
    begin, is_told = time.monotonic(), False
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as failed:
            if time.monotonic() >= begin + WAITS_S:
                raise
            if not is_told:
                print(f"waiting for the bridge: {failed}", file=sys.stderr)
            is_told = True
            time.sleep(0.2)


class Connection:
    """Publishes the messages of a driver, and receives commands and credit."""

    def __init__(self, config: zenoh.Config, graph: str, host: str, to: str, wait: bool) -> None:
        """`host` is the driver, `to` the host of the bridge. With `wait`, a put waits for room."""
        self.received: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        self.keys = f"coxswain-link/{graph}/{host}/{to}"
        control = zenoh.CongestionControl
        self.congestion = control.BLOCK if wait else control.DROP
        self.session = open_session(config)
        incoming = f"coxswain-link/{graph}/{to}/{host}"
        self.subscribers = [self._subscribe(incoming, topic) for topic in RECEIVED]

    def _subscribe(self, keys: str, topic: str) -> zenoh.Subscriber[None]:
        def receive(sample: zenoh.Sample) -> None:
            self.received.put((topic, sample.payload.to_bytes()))

        return self.session.declare_subscriber(f"{keys}/{topic}", receive)

    def next(self, timeout: float) -> tuple[str, bytes]:
        """Topic and bytes of the next message; an empty topic after `timeout` seconds."""
        try:
            return self.received.get(timeout=max(timeout, 0.0))
        except queue.Empty:
            return "", b""

    def put(self, topic: str, message: bytes) -> None:
        """Sends a message if the bridge is connected; else it is lost."""
        self.session.put(
            f"{self.keys}/{topic}",
            message,
            priority=PRIORITIES[topic],
            congestion_control=self.congestion,
            express=topic != "health",
        )

    def close(self) -> None:
        self.session.close()  # type: ignore[no-untyped-call]
