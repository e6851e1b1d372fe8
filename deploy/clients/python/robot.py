"""A robot driver with a simulated robot. It is the plant of protocol/WIRE.md, over zenoh.

Needs Python 3.10 and the public package eclipse-zenoh. The duties in the comments are the numbered
duties of WIRE.md. For a robot of your own, replace `Base` with its motors and sensors. Everything
else stays.
"""

import argparse
import json
import math
import os
import random
import secrets
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import zenoh
from connection import Connection, configuration
from gate import BAD_STATE, DISARMED, STOPPED, STOPPING, ZERO, Gate, Limits
from wire import Command, Credit, Health, PlantState, Refused, Stamp, Vector, Wire

READY, RUNNING, FINISHED = 1, 2, 4  # phases
STEP_S = 0.005  # interval between two commands to the wheels
REPEAT_S = 1.0  # in lock step: the state is sent again after this time without an answer


class Base:
    """The simulated robot: each axis follows its command with a gain and a lag.

    The model of the controller has other values.
    """

    GAIN = (0.8, 0.75, 0.8)
    LAG_S = (0.6, 0.6, 0.4)
    NOISE = 5e-4  # standard deviation of the sensors [m, rad, m/s, rad/s]

    def __init__(self, pose: Vector, seed: int) -> None:
        self.pose, self.velocity = pose, ZERO
        self.random = random.Random(seed)

    def move(self, command: Vector, elapsed: float) -> None:
        shares = [1.0 - math.exp(-elapsed / lag) for lag in self.LAG_S]
        targets = [gain * value for gain, value in zip(self.GAIN, command)]
        before, axes = self.velocity, zip(self.velocity, shares, targets)
        self.velocity = tuple(v + share * (target - v) for v, share, target in axes)
        forward, left, turn = ((a + b) / 2 * elapsed for a, b in zip(before, self.velocity))
        (x, y, yaw), middle = self.pose, self.pose[2] + turn / 2
        cosine, sine = math.cos(middle), math.sin(middle)
        x, y = x + forward * cosine - left * sine, y + forward * sine + left * cosine
        self.pose = (x, y, yaw + turn)

    def measure(self) -> tuple[Vector, Vector]:
        """Pose and velocity with sensor noise."""
        truth = self.pose + self.velocity
        noisy = [value + self.random.gauss(0.0, self.NOISE) for value in truth]
        return tuple(noisy[:3]), tuple(noisy[3:])


class Driver:
    """The loop: publishes a state per period, receives commands, moves the base."""

    def __init__(
        self, options: argparse.Namespace, limits: Limits, connection: Connection
    ) -> None:
        self.period, self.recorded = limits.period, options.recorded
        self.lock_step = options.pace == "lock-step"
        self.ticks, self.epoch = round(options.duration / self.period), options.epoch
        self.limits, self.connection = limits, connection
        self.writer = secrets.randbelow((1 << 64) - 1) + 1
        self.gate = Gate(limits, self.epoch, options.delay_ms / 1e3, not options.disarmed)
        self.base = Base(tuple(options.start), options.seed)
        self.report = Report(self.period, options.circle)
        self.last_sequence: dict[tuple[int, int], int] = {}
        self.sent: Counter[str] = Counter()
        self.received, self.through_tick = 0, -1
        self.phase, self.next_health = READY, 0.0
        self.input = ZERO  # mean over the last period
        self.ordered = False  # an operator has requested arm or resume

    def run(self) -> None:
        begin = time.monotonic()
        for tick in range(self.ticks):
            while self.lock_step and self.recorded and self.through_tick < tick:
                self._serve(0.1)
            if self.lock_step:
                start = tick * self.period
                self._publish(tick, start)
                commanded = self._answered_period(tick, start)
            else:
                start = time.monotonic()
                # After a long delay the schedule begins again.
                begin = max(begin, start - (tick + 1) * self.period)
                self._publish(tick, start)
                commanded = self._timed_period(start, begin + (tick + 1) * self.period)
            self.input = tuple(commanded)
            self.gate.end()
            self.report.add((tick + 1) * self.period, self.base.pose, self.gate)

    def _publish(self, tick: int, now: float) -> None:
        """Duties 1, 2, 9 and 10."""
        pose, velocity = self.base.measure()
        if not all(map(math.isfinite, pose + velocity)):
            self.gate.stop(BAD_STATE)
        if self.ordered:
            self.ordered = False
            self.gate.order("arm" if self.gate.state == DISARMED else "resume")
        self.gate.begin(tick, now)
        last = self.gate.stored
        accepted = (last.stamp.epoch, last.stamp.epoch, last.stamp.tick) if last else (0, 0, 0)
        wheels, none = (*self.limits.wheel_speeds(velocity), 0.0, 0.0, 0.0, 0.0), (0.0,) * 8
        # Four wheels; their speeds are valid, their currents are not.
        measured, valid = (pose, velocity, wheels, none), (len(wheels) - 4, 1, 0)
        gate = (
            self.gate.refused,
            *self.gate.past,
            *valid,
            0,
            self.gate.state,
            self.gate.stop_reason,
        )
        fields = (*measured, self.input, 0.0, *accepted, *gate)
        self.state = Wire.encode(PlantState(self._stamp("state"), *fields))
        self.connection.put("state", self.state)
        self.phase = RUNNING

    def _answered_period(self, tick: int, start: float) -> list[float]:
        """Duty 12: waits for the answer, then simulates one period. Returns the mean command."""
        answered, sent = False, time.monotonic()
        while not answered:
            command = self._serve(0.1, start)
            if command is not None:
                answered = (command.plant_epoch, command.stamp.tick) == (self.epoch, tick)
            if not answered and time.monotonic() - sent >= REPEAT_S:
                self.connection.put("state", self.state)
                sent = time.monotonic()
        total, steps = [0.0, 0.0, 0.0], max(round(self.period / STEP_S), 1)
        for step in range(steps):
            self._move(total, start + step * self.period / steps, self.period / steps)
        return [value / self.period for value in total]

    def _timed_period(self, start: float, end: float) -> list[float]:
        """Moves until `end`, and receives commands meanwhile. Returns the mean command."""
        total, now = [0.0, 0.0, 0.0], start
        while now < end:
            self._serve(min(STEP_S, end - now))
            before, now = now, time.monotonic()
            self._move(total, now, now - before)
        return [value / (now - start) for value in total]

    def _move(self, total: list[float], now: float, elapsed: float) -> None:
        command = self.gate.play(now, elapsed)
        self.base.move(command, elapsed)
        total[:] = [sum_ + value * elapsed for sum_, value in zip(total, command)]

    def _serve(self, timeout: float, now: float | None = None) -> Command | None:
        """Processes the next event and publishes health if it is due.

        Returns a command, accepted or not, unless it is stale.
        """
        topic, payload = self.connection.next(timeout)
        self.show_health()
        kind = {"command": Command, "credit": Credit}.get(topic)
        if kind is None:
            return None
        now = time.monotonic() if now is None else now
        try:
            message = Wire.decode(kind, payload)
        except Refused:
            if kind is Command:
                self.gate.hear(None, now)
            return None
        source = (message.stamp.writer, message.stamp.epoch)
        if message.stamp.sequence <= self.last_sequence.get(source, 0):
            return None
        self.last_sequence[source] = message.stamp.sequence
        if kind is Credit:
            self.through_tick = message.through_tick
            return None
        self.received += 1
        self.gate.hear(message, now)
        return message

    def _stamp(self, topic: str) -> Stamp:
        self.sent[topic] += 1
        return Stamp(
            self.writer, self.epoch, self.sent[topic], self.gate.tick, time.monotonic_ns()
        )

    def show_health(self, at_once: bool = False) -> None:
        """Duty 13: publishes health ten times a second."""
        now = time.monotonic()
        if now < self.next_health and not at_once:
            return
        self.next_health = now + 0.1
        stamp, none = self._stamp("health"), (0,) * 8
        sent, received = (self.sent["state"], *none[1:]), (0, self.received, *none[2:])
        counts = (sent, received, none, (0, self.gate.refused, *none[2:]), none)
        pid = os.getpid()
        errors = {
            DISARMED: f"disarmed: kill -USR1 {pid} arms the robot",
            STOPPED: f"stopped: kill -USR1 {pid} resumes the robot",
        }
        error = errors.get(self.gate.state, "") if self.phase != FINISHED else ""
        process = (0, self.phase, pid, 0)
        health = Health(stamp, *process, stamp.sequence, *(0,) * 8, *counts, error)
        self.connection.put("health", Wire.encode(health))

    def obey(self) -> None:
        """Duty 10: an operator requests arm or resume. It acts from the next period on."""
        self.ordered = True

    def rest(self) -> None:
        """Duty 14: brakes to standstill."""
        self.gate.stop(STOPPING)
        while any(self.gate.acting):
            time.sleep(0.0 if self.lock_step else STEP_S)
            self._move([0.0, 0.0, 0.0], 0.0, STEP_S)

    def finish(self) -> None:
        """Duty 13: reports the end of the run for one second."""
        self.rest()
        self.phase, begin = FINISHED, time.monotonic()
        self.show_health(at_once=True)
        while time.monotonic() < begin + 1.0:
            self._serve(0.1)


class Report:
    """The printed report: one line per second, and a summary at the end.

    Both have the position error if `circle` is given.
    """

    SETTLED_S = 3.0

    def __init__(self, period: float, circle: list[float] | None) -> None:
        self.period, self.circle = period, circle
        self.error = 0.0
        self.squares: list[float] = []
        self.fallback_levels: Counter[int] = Counter()
        self.refused = self.model_version = 0

    def add(self, seconds: float, pose: Vector, gate: Gate) -> None:
        """Adds the period that ends at `seconds` in `pose`."""
        x, y, yaw = pose
        if self.circle:
            radius, speed = self.circle
            angle = speed * seconds / radius
            x_ref, y_ref = radius * math.sin(angle), radius * (1.0 - math.cos(angle))
            self.error = math.hypot(x - x_ref, y - y_ref)
        if seconds >= self.SETTLED_S:
            self.squares.append(self.error**2)
        self.fallback_levels[gate.past[0]] += 1
        self.refused = gate.refused
        self.model_version = gate.stored.model_version if gate.stored else 0
        if math.floor(seconds + 1e-9) > math.floor(seconds - self.period + 1e-9):
            error = f"  error {self.error:.3f} m" if self.circle else ""
            at = f"{seconds:6.1f} s  x {x:8.3f} m  y {y:8.3f} m  yaw {yaw:7.3f} rad"
            fallback = f"fallback level {gate.past[0]}, reason {gate.past[1]}"
            print(f"{at}{error}  {fallback}, model {self.model_version}", flush=True)

    def close(self) -> None:
        errors = {}
        if self.circle:
            rmse = math.sqrt(sum(self.squares) / max(len(self.squares), 1))
            errors = {"final_error_m": self.error, "rmse_m": rmse}
        levels = {str(level): periods for level, periods in sorted(self.fallback_levels.items())}
        summary = {
            **errors,
            "model_version": self.model_version,
            "refused": self.refused,
            "periods_on_fallback_level": levels,
        }
        print(json.dumps(summary), flush=True)


def new_epoch() -> int:
    """Duty 11: an epoch that no earlier run has used. No recorded command answers it."""
    return int(time.time()) << 21 | secrets.randbelow(1 << 21)


def arguments() -> argparse.Namespace:
    exit_codes = (
        "Exit code 0 at the end of the run, 1 if it failed, 2 if an argument is invalid, "
        "130 or 143 if a signal ended it."
    )
    parser = argparse.ArgumentParser(
        description="A simulated robot, driven over zenoh.", epilog=exit_codes
    )

    def option(name: str, description: str, **details: Any) -> None:
        parser.add_argument(name, help=description, **details)

    option(
        "--connect",
        "endpoint of the bridge, such as tcp/127.0.0.1:7447, or tls/… with certificates",
        metavar="ENDPOINT",
    )
    option("--graph", "name of the graph (%(default)s)", default="mecanum")
    option("--host", "host of the graph file that this driver is (%(default)s)", default="driver")
    option("--to", "host of the graph file with the bridge (%(default)s)", default="control")
    option(
        "--certificates",
        "folder of certificates with that of the role driver",
        type=Path,
        metavar="DIR",
    )
    option(
        "--robot",
        "robot file with the limits (%(default)s)",
        type=Path,
        default=Path("deploy/robots/mecanum.toml"),
    )
    option(
        "--pace",
        "pace of the launch (%(default)s)",
        choices=["lock-step", "real-time"],
        default="real-time",
    )
    option(
        "--period-ms",
        "control period of the scenario (%(default)s)",
        type=float,
        default=100.0,
    )
    option(
        "--duration",
        "length of the run (%(default)s)",
        type=float,
        default=15.0,
        metavar="SECONDS",
    )
    option(
        "--start",
        "pose at the start [m, m, rad]",
        type=float,
        nargs=3,
        default=ZERO,
        metavar=("X", "Y", "YAW"),
    )
    option(
        "--circle",
        "print the position error from this circle [m, m/s]",
        type=float,
        nargs=2,
        metavar=("RADIUS", "SPEED"),
    )
    option(
        "--recorded",
        "a recorder takes part: in lock step, wait for its credit",
        action="store_true",
    )
    option(
        "--disarmed",
        "stand until an operator arms the robot: kill -USR1 PID",
        action="store_true",
    )
    option(
        "--delay-ms",
        "delay of the link, allowed in addition to the age of an answer",
        type=float,
        default=0.0,
    )
    option(
        "--epoch",
        "epoch of this run; greater than that of every earlier run",
        type=int,
        default=new_epoch(),
    )
    option("--seed", "seed of the sensor noise (%(default)s)", type=int, default=1)
    option(
        "--check",
        "only check the test vectors in this folder, such as protocol/vectors",
        type=Path,
        metavar="VECTORS_DIR",
    )
    options = parser.parse_args()
    if not options.check and not options.connect:
        parser.error("--connect is missing: expected the endpoint of a bridge")
    positive = (options.period_ms, options.duration, options.epoch)
    if not (all(value > 0 for value in positive) and options.delay_ms >= 0.0):
        parser.error("expected --period-ms, --duration, --epoch > 0 and --delay-ms >= 0")
    return options


def drive(options: argparse.Namespace) -> int:
    try:
        limits = Limits.read(options.robot, options.period_ms / 1e3)
    except (OSError, KeyError) as error:
        print(f"robot.py: {options.robot}: not a robot file: {error!r}", file=sys.stderr)
        return 2
    try:
        config = configuration(options.connect, options.certificates)
        ends = (options.graph, options.host, options.to)
        connection = Connection(config, *ends, wait=options.pace == "lock-step")
    except zenoh.ZError as error:
        print(f"robot.py: no bridge at {options.connect}: {error}", file=sys.stderr)
        return 1
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    driver = Driver(options, limits, connection)
    signal.signal(signal.SIGUSR1, lambda *_: driver.obey())
    try:
        driver.run()
        driver.finish()
        driver.report.close()
    except KeyboardInterrupt:
        return 130
    finally:
        driver.rest()
        connection.close()
    return 0


def main() -> int:
    options = arguments()
    if not options.check:
        return drive(options)
    try:
        print(f"{Wire.check(options.check)} test vectors hold")
    except (AssertionError, Refused, OSError, ValueError, KeyError) as error:
        print(f"robot.py: {options.check}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
