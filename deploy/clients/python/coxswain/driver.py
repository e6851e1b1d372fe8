"""The driver of a robot: it keeps the duties of protocol/WIRE.md around a base.

The duties in the comments are the numbered duties there.
"""

import argparse
import math
import os
import secrets
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from . import body, map_file
from .base import Base
from .connection import Connection, configuration
from .gate import BAD_STATE, DISARMED, OPERATOR_STOP, STOPPED, STOPPING, ZERO, Gate, Limits
from .messages import Command, Credit, Health, Obstacles, PlantState, Stamp
from .planner import OBSTACLES_MAX, Planners
from .protection import Obstacle, Protection, Surroundings
from .shape import CORNERS_MAX
from .wire import Refused, Wire

TOPICS = 10
"""Number of topics: entries of each counter in Health."""

EachPeriod = Callable[[float, Gate], None]

READY, RUNNING, FINISHED = 1, 2, 4  # phases
STEP_S = 0.005  # interval between two commands to the wheels
WATCHDOG_S = 0.1  # after that the motors stop, unless another velocity follows
REPEAT_S = 1.0  # in lock step: the state is sent again after this time without an answer
WHEELS_MAX = 8  # in a message
VALID_PERIODS = 10.0  # time after which a list of the robot's own sensors is too old
OWN, PLANNER = 0, 1  # sources of a list
OBSTACLES = 9  # number of the topic


@dataclass(frozen=True)
class Ends:
    """What a driver is between: the base, the bridge and, if they may send lists, planners."""

    base: Base
    connection: Connection
    planners: Planners | None = None

    def close(self) -> None:
        if self.planners:
            self.planners.close()
        self.connection.close()


class Driver:
    """The loop: publishes a state per period, receives commands, moves the base.

    After each period it calls `each_period` with the time since the start [s] and the gate.
    """

    def __init__(
        self,
        ends: Ends,
        options: argparse.Namespace,
        limits: Limits,
        protection: Protection,
        each_period: EachPeriod,
    ) -> None:
        self.period, self.recorded = limits.period, options.recorded
        self.lock_step = options.pace == "lock-step"
        self.ticks, self.epoch = round(options.duration / self.period), options.epoch
        self.limits, self.connection = limits, ends.connection
        self.writer = secrets.randbelow((1 << 64) - 1) + 1
        delay = options.delay_ms / 1e3
        self.gate = Gate(limits, self.epoch, delay, not options.disarmed, protection)
        self.protection, self.planners = protection, ends.planners
        if self.planners:
            # No list is there yet: until the first one the robot is slow.
            protection.see_obstacles(PLANNER, [], -math.inf, 0.0)
        self.base, self.each_period = ends.base, each_period
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
                if start >= begin + (tick + 1) * self.period:
                    begin = start - tick * self.period  # the schedule begins again
                self._publish(tick, start)
                commanded = self._timed_period(start, begin + (tick + 1) * self.period)
            self.input = tuple(commanded)
            self.gate.end()
            self.each_period((tick + 1) * self.period, self.gate)

    def _publish(self, tick: int, now: float) -> None:
        """Duties 1, 2, 9 and 10."""
        sensors = self.base.read()
        if not all(map(math.isfinite, (*sensors.pose, *sensors.velocity))):
            self.gate.stop(BAD_STATE)
        self.gate.set_estop(sensors.estop)
        if self.ordered:
            self.ordered = False
            self.gate.order("arm" if self.gate.state == DISARMED else "resume")
        self.gate.begin(tick, now)
        self.gate.see_pose(sensors.pose, sensors.velocity, now)
        self._publish_obstacles(now)
        last = self.gate.stored
        epoch, accepted = (last.stamp.epoch, last.stamp.tick) if last else (0, 0)
        fallback_level, reason = self.gate.past
        state = PlantState(
            stamp=self._stamp("state"),
            pose=sensors.pose,
            velocity=sensors.velocity,
            wheel_speed=self._per_wheel(sensors.wheel_speed),
            current=self._per_wheel(sensors.current),
            input=self.input,
            input_delay_s=sensors.input_delay_s,
            controller_epoch=epoch,
            accepted_epoch=epoch,
            accepted_tick=accepted,
            refused=self.gate.refused,
            fallback_level=fallback_level,
            reason=reason,
            wheels=len(self.limits.wheels),
            wheel_speed_valid=int(sensors.wheel_speed is not None),
            current_valid=int(sensors.current is not None),
            estop=int(sensors.estop),
            gate=self.gate.state,
            stop=self.gate.stop_reason,
        )
        self.state = Wire.encode(state)
        self.connection.put("state", self.state)
        self.phase = RUNNING

    def _publish_obstacles(self, now: float) -> None:
        """Passes the lists to the gate, and publishes them before the state: the controller that
        receives the state has the lists as well. That of the robot itself is the last one.
        """
        planned = self.planners.due() if self.planners else None
        if planned:
            moved = [one.moved(planned.age) for one in planned.obstacles]
            self.protection.see_obstacles(PLANNER, moved, now, planned.valid)
            self._put_obstacles(PLANNER, planned.obstacles, planned.age, planned.valid)
        seen = self.base.obstacles()
        if seen is not None:
            known, valid = tuple(seen)[:OBSTACLES_MAX], VALID_PERIODS * self.period
            self.protection.see_obstacles(OWN, list(known), now, valid)
            self._put_obstacles(OWN, known, 0.0, valid)

    def _put_obstacles(
        self, source: int, known: tuple[Obstacle, ...], age: float, valid: float
    ) -> None:
        rows = tuple(row_of(one) for one in known)
        stamp = self._stamp("obstacles")
        message = Obstacles(stamp, self.epoch, age, valid, source, rows)
        self.connection.put("obstacles", Wire.encode(message))

    def _per_wheel(self, measured: tuple[float, ...] | None) -> tuple[float, ...]:
        """One number for each wheel that a message can have."""
        count, values = len(self.limits.wheels), measured or ()
        if measured is not None and len(values) != count:
            raise ValueError(f"{len(values)} numbers were measured: expected {count} wheels")
        return (*values, *(0.0,) * (WHEELS_MAX - len(values)))

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
        self.base.watchdog(WATCHDOG_S)
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
            message: Command | Credit = Wire.decode(kind, payload)
        except Refused:
            if kind is Command:
                self.gate.receive(None, now)
            return None
        source = (message.stamp.writer, message.stamp.epoch)
        if message.stamp.sequence <= self.last_sequence.get(source, 0):
            return None
        self.last_sequence[source] = message.stamp.sequence
        if isinstance(message, Credit):
            self.through_tick = message.through_tick
            return None
        self.received += 1
        self.gate.receive(message, now)
        return message

    def _stamp(self, topic: str) -> Stamp:
        self.sent[topic] += 1
        return Stamp(self.writer, self.epoch, self.sent[topic], self.gate.tick, time.monotonic_ns())

    def show_health(self, at_once: bool = False) -> None:
        """Duty 13: publishes health ten times a second."""
        now = time.monotonic()
        if now < self.next_health and not at_once:
            return
        self.next_health = now + 0.1
        stamp, none = self._stamp("health"), (0,) * TOPICS
        planners = self.planners

        def counted(state: int, command: int, obstacles: int) -> tuple[int, ...]:
            return (state, command, *none[2:OBSTACLES], obstacles)

        sent = counted(self.sent["state"], 0, self.sent["obstacles"])
        received = counted(0, self.received, planners.accepted if planners else 0)
        refused = counted(0, self.gate.refused, planners.rejected if planners else 0)
        counts = (sent, received, none, refused, none)
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


def row_of(obstacle: Obstacle) -> tuple[float, ...]:
    """An obstacle in a message: velocity, radius, and eight corners, of which the last repeats."""
    shape = obstacle.shape
    corners = [*shape.corners, *[shape.corners[-1]] * (CORNERS_MAX - len(shape.corners))]
    places = (place for corner in corners for place in corner)
    return (*obstacle.velocity, shape.radius, *places)


def new_epoch() -> int:
    """Duty 11: an epoch that no earlier run has used. No recorded command answers it."""
    return int(time.time()) << 21 | secrets.randbelow(1 << 21)


def arguments(description: str) -> argparse.ArgumentParser:
    """The arguments of every driver."""
    exit_codes = (
        "Exit code 0 at the end of the run, 1 if it failed, 2 if an argument is invalid, "
        "130 or 143 if a signal ended it."
    )
    parser = argparse.ArgumentParser(description=description, epilog=exit_codes)

    def option(name: str, description: str, **details: Any) -> None:
        parser.add_argument(name, help=description, **details)

    option(
        "--connect",
        "endpoint of the bridge, such as tcp/127.0.0.1:7447, or tls/… with certificates",
        metavar="ENDPOINT",
        required=True,
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
        "--map",
        "map file with obstacles, zones and a fence, which the gate keeps",
        type=Path,
        metavar="FILE",
    )
    option(
        "--lists",
        "path of a socket for the lists of obstacles of planners; without a list the robot is slow",
        type=Path,
        metavar="SOCKET",
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
    return parser


def parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The arguments of this process. Ends it if one is not valid."""
    options = parser.parse_args()
    positive = (options.period_ms, options.duration, options.epoch)
    if not (all(value > 0 for value in positive) and options.delay_ms >= 0.0):
        parser.error("expected --period-ms, --duration, --epoch > 0 and --delay-ms >= 0")
    return options


def main(
    make_base: Callable[[argparse.Namespace], Base],
    parser: argparse.ArgumentParser | None = None,
    each_period: EachPeriod = lambda _seconds, _gate: None,
) -> int:
    """Drives the base that `make_base` returns for the arguments. Returns the exit code."""
    options = parsed(parser or arguments("The driver of a robot, over zenoh."))
    program, period = Path(sys.argv[0]).name, options.period_ms / 1e3
    try:
        limits = Limits.read(options.robot, period)
        shape = body.read(options.robot, period)
    except (OSError, KeyError, ValueError) as error:
        print(f"{program}: {options.robot}: not a robot file: {error!r}", file=sys.stderr)
        return 2
    try:
        around = map_file.read(options.map) if options.map else Surroundings()
    except (OSError, ValueError) as error:
        print(f"{program}: --map {options.map}: not a map file: {error}", file=sys.stderr)
        return 2
    try:
        certificates: Path | None = options.certificates
        folder = certificates / "driver" if certificates else None
        config = configuration(options.connect, folder)
        ends = (options.graph, options.host, options.to)
        connection = Connection(config, *ends, wait=options.pace == "lock-step")
    except zenoh.ZError as error:
        print(f"{program}: no bridge at {options.connect}: {error}", file=sys.stderr)
        return 1
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        planners = Planners(options.lists, options.pace == "lock-step") if options.lists else None
    except OSError as error:
        print(f"{program}: --lists {options.lists}: no socket: {error}", file=sys.stderr)
        connection.close()
        return 2
    driver_ends = Ends(make_base(options), connection, planners)
    driver = Driver(driver_ends, options, limits, Protection(shape, around), each_period)
    signal.signal(signal.SIGUSR1, lambda *_: driver.obey())
    signal.signal(signal.SIGUSR2, lambda *_: driver.gate.stop(OPERATOR_STOP))
    try:
        driver.run()
        driver.finish()
    except KeyboardInterrupt:
        return 130
    finally:
        driver.rest()
        driver_ends.close()
    return 0
