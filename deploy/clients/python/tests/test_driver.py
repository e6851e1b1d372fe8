"""Tests of the loop of the driver, without a bridge."""

import time
import unittest
from pathlib import Path

from coxswain import Base, Limits, Sensors, Vector, arguments, body, driver
from coxswain.messages import PlantState
from coxswain.protection import Protection, Surroundings
from coxswain.wire import Wire

ROBOT = Path(__file__).parents[4] / "deploy/robots/mecanum.toml"


class Sent:
    """In place of a connection: the messages that the driver puts."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, bytes]] = []

    def put(self, topic: str, message: bytes) -> None:
        self.messages.append((topic, message))

    def next(self, timeout: float) -> tuple[str, bytes]:
        """No message arrives."""
        time.sleep(timeout)
        return "", b""


class Slow(Base):
    """A robot whose third measurement takes several periods."""

    def __init__(self) -> None:
        self.reads = 0

    def read(self) -> Sensors:
        self.reads += 1
        if self.reads == 3:
            time.sleep(0.05)
        return Sensors((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def move(self, velocity: Vector, seconds: float) -> None:
        pass


class Watched(Base):
    """A robot that notes what the driver calls."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def read(self) -> Sensors:
        return Sensors((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def watchdog(self, valid_s: float) -> None:
        self.calls.append(f"watchdog for {valid_s} s")

    def move(self, velocity: Vector, seconds: float) -> None:
        self.calls.append("move")


def drive(base: Base) -> Sent:
    """Ten periods of 10 ms in real time, without commands."""
    given = ["--connect", "tcp/127.0.0.1:1", "--period-ms", "10", "--duration", "0.1"]
    options, sent = arguments("a driver").parse_args(given), Sent()
    protection = Protection(body.read(ROBOT, 0.01), Surroundings())
    limits = Limits.read(ROBOT, 0.01)
    ends = driver.Ends(base, sent)
    driver.Driver(ends, options, limits, protection, lambda *_: None).run()
    return sent


class RealTime(unittest.TestCase):
    def test_the_watchdog_is_restarted_before_each_move(self) -> None:
        base = Watched()
        drive(base)
        self.assertGreaterEqual(len(base.calls), 20)
        self.assertEqual(set(base.calls[::2]), {"watchdog for 0.1 s"})
        self.assertEqual(set(base.calls[1::2]), {"move"})

    def test_after_a_long_delay_the_schedule_begins_again(self) -> None:
        begin = time.monotonic()
        sent = drive(Slow())
        states = [message for topic, message in sent.messages if topic == "state"]
        ticks = [Wire.decode(PlantState, state).stamp.tick for state in states]
        self.assertEqual(ticks, list(range(10)))
        # The periods after the delay are not shorter.
        self.assertGreater(time.monotonic() - begin, 0.12)


if __name__ == "__main__":
    unittest.main()
