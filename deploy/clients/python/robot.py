"""A robot that is simulated here and driven over Zenoh: it takes the part of the plant, as protocol/WIRE.md describes it.

Needs Python 3.10 and the public package eclipse-zenoh. The duties in the comments are the numbered ones of WIRE.md. For a robot of your
own, put its motors and sensors in the place of `Base`; everything else stays.
"""
import argparse
import json
import math
import os
import queue
import random
import secrets
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import zenoh
from gate import BAD_STATE, DISARMED, NOTHING, STOPPED, STOPPING, Gate, Limits
from wire import Command, Credit, Health, PlantState, Refused, Stamp, Vector, Wire

READY, RUNNING, FINISHED = 1, 2, 4  # phases
GRAIN_S = 0.005  # how often the wheels get a new command
PATIENCE_S = 1.0  # how long a state may have no answer in lock step before it is said again


class Base:
    """How the robot moves: each axis follows its command with a lag, and not all the way. The controller believes otherwise."""

    GAIN = (0.8, 0.75, 0.8)
    LAG_S = (0.6, 0.6, 0.4)
    NOISE = 5e-4  # standard deviation of the sensors [m, rad, m/s, rad/s]

    def __init__(self, pose: Vector, seed: int) -> None:
        self.pose, self.velocity = pose, NOTHING
        self.random = random.Random(seed)

    def move(self, command: Vector, elapsed: float) -> None:
        gone = [1.0 - math.exp(-elapsed / lag) for lag in self.LAG_S]
        wanted = [gain * value for gain, value in zip(self.GAIN, command)]
        before, self.velocity = self.velocity, tuple(v + g * (w - v) for v, g, w in zip(self.velocity, gone, wanted))
        forward, left, turn = ((a + b) / 2 * elapsed for a, b in zip(before, self.velocity))
        (x, y, yaw), middle = self.pose, self.pose[2] + turn / 2
        cosine, sine = math.cos(middle), math.sin(middle)
        self.pose = (x + forward * cosine - left * sine, y + forward * sine + left * cosine, yaw + turn)

    def measure(self) -> tuple[Vector, Vector]:
        """Pose and velocity as the sensors see them."""
        noisy = [value + self.random.gauss(0.0, self.NOISE) for value in self.pose + self.velocity]
        return tuple(noisy[:3]), tuple(noisy[3:])


class Network:
    """The links of a driver: it writes state and health, and reads command and, if the run is recorded, credit."""

    def __init__(self, endpoint: str, graph: str, lock_step: bool, recorded: bool) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/shared_memory/enabled", "false")  # else a killed client leaves a file in /dev/shm
        self.session = zenoh.open(config)
        self.graph, self.lock_step = f"coxswain-link/{graph}", lock_step
        self.writer = secrets.randbelow((1 << 64) - 1) + 1
        self.identity = f"robot.{self.writer:016x}"
        self.events: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self.readers: set[str] = set()
        self.last_state: tuple[bytes, bytes] | None = None
        delivery = "lossless" if lock_step else "newest-wins"
        congestion = zenoh.CongestionControl.BLOCK if lock_step else zenoh.CongestionControl.DROP
        self.quality = {"priority": zenoh.Priority.REAL_TIME, "congestion_control": congestion}
        state = f"{self.graph}/state"
        tokens = self.session.liveliness()
        self.kept = [tokens.declare_subscriber(f"{state}/reader/{Wire.VERSION}/PlantState/*/*", self._on_reader, history=True)]
        self.kept.append(self.session.declare_queryable(f"{state}/join/{self.identity}", lambda query: query.drop()))
        self.kept.append(tokens.declare_token(f"{state}/writer/{Wire.VERSION}/PlantState/{delivery}/{self.identity}"))
        self._read("command", Command)
        if recorded:
            self._read("credit", Credit)

    def _read(self, topic: str, kind: type) -> None:
        def hear(sample: zenoh.Sample) -> None:
            self.events.put((topic, sample.payload.to_bytes()))

        link = f"{self.graph}/{topic}"
        self.kept.append(self.session.declare_subscriber(f"{link}/data/*", hear))
        if self.lock_step:
            self.kept.append(self.session.declare_subscriber(f"{link}/history/{self.identity}/*", hear))
        self.kept.append(self.session.liveliness().declare_token(f"{link}/reader/{Wire.VERSION}/{kind.__name__}/unpaced/{self.identity}"))

    def _on_reader(self, sample: zenoh.Sample) -> None:
        self.events.put(("reader" if sample.kind == zenoh.SampleKind.PUT else "gone", str(sample.key_expr).rsplit("/", 1)[1]))

    def next(self, patience: float) -> tuple[str, Any]:
        """What was heard next, within `patience` seconds. A reader of states that comes late gets the last one at once."""
        try:
            topic, what = self.events.get(timeout=max(patience, 0.0))
        except queue.Empty:
            return "nothing", None
        if topic == "reader":
            self.readers.add(what)
            if self.last_state:
                payload, number = self.last_state
                key = f"{self.graph}/state/history/{what}/{self.identity}"
                self.session.put(key, payload, attachment=number, **self.quality)
        elif topic == "gone":
            self.readers.discard(what)
        return topic, what

    def send_state(self, state: PlantState) -> None:
        payload, number = Wire.encode(state), state.stamp.sequence.to_bytes(8, "little")
        self.last_state = payload, number
        self.put_state(payload, number)

    def repeat_state(self) -> None:
        """The same bytes. Without a number, by which it would be taken for one that has been heard."""
        if self.last_state:
            self.put_state(self.last_state[0], None)

    def put_state(self, payload: bytes, number: bytes | None) -> None:
        self.session.put(f"{self.graph}/state/data/{self.identity}", payload, attachment=number, **self.quality)

    def send_health(self, health: Health) -> None:
        self.session.put(f"{self.graph}/health/data/{self.identity}", Wire.encode(health), priority=zenoh.Priority.DATA_LOW)


class Driver:
    """The loop: publishes a state per period, hears commands, moves the base."""

    def __init__(self, options: argparse.Namespace, limits: Limits, network: Network) -> None:
        self.period, self.lock_step, self.recorded = limits.period, options.pace == "lock-step", options.recorded
        self.ticks, self.epoch = round(options.duration / self.period), options.epoch
        self.limits, self.network = limits, network
        self.gate = Gate(limits, self.epoch, options.delay_ms / 1e3, not options.disarmed)
        self.base = Base(tuple(options.start), options.seed)
        self.report = Report(self.period, options.circle)
        self.last_sequence: dict[tuple[int, int], int] = {}
        self.sent: Counter[str] = Counter()
        self.heard, self.through_tick = 0, -1
        self.phase, self.next_health = READY, 0.0
        self.input = NOTHING  # mean over the past period
        self.ordered = False  # a person wants the robot to drive

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
                begin = max(begin, start - (tick + 1) * self.period)  # who was held up for long begins a new schedule
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
        wheels, none = (*self.limits.wheels(velocity), 0.0, 0.0, 0.0, 0.0), (0.0,) * 8
        measured, valid = (pose, velocity, wheels, none), (len(wheels) - 4, 1, 0)  # four wheels, speeds but no currents
        gate = (self.gate.refused, *self.gate.past, *valid, 0, self.gate.state, self.gate.stop_reason)
        said = (*measured, self.input, 0.0, *accepted, *gate)
        self.network.send_state(PlantState(self._stamp("state"), *said))
        self.phase = RUNNING

    def _answered_period(self, tick: int, start: float) -> list[float]:
        """Duty 12: waits for the answer, then lets one period pass. The mean command."""
        answered, said = False, time.monotonic()
        while not answered:
            command = self._serve(0.1, start)
            answered = command is not None and (command.plant_epoch, command.stamp.tick) == (self.epoch, tick)
            if not answered and time.monotonic() - said >= PATIENCE_S:
                self.network.repeat_state()
                said = time.monotonic()
        total, grains = [0.0, 0.0, 0.0], max(round(self.period / GRAIN_S), 1)
        for grain in range(grains):
            self._move(total, start + grain * self.period / grains, self.period / grains)
        return [value / self.period for value in total]

    def _timed_period(self, start: float, end: float) -> list[float]:
        """Moves until `end`, and hears commands meanwhile. The mean command."""
        total, now = [0.0, 0.0, 0.0], start
        while now < end:
            self._serve(min(GRAIN_S, end - now))
            before, now = now, time.monotonic()
            self._move(total, now, now - before)
        return [value / (now - start) for value in total]

    def _move(self, total: list[float], now: float, elapsed: float) -> None:
        command = self.gate.play(now, elapsed)
        self.base.move(command, elapsed)
        total[:] = [sum_ + value * elapsed for sum_, value in zip(total, command)]

    def _serve(self, patience: float, now: float | None = None) -> Command | None:
        """Takes in what is heard next, and shows that it lives. A command, acceptable or not, unless it is stale."""
        topic, payload = self.network.next(patience)
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
            self.through_tick = message.through_tick  # the last one counts
            return None
        self.heard += 1
        self.gate.hear(message, now)
        return message

    def _stamp(self, topic: str) -> Stamp:
        self.sent[topic] += 1
        return Stamp(self.network.writer, self.epoch, self.sent[topic], self.gate.tick, time.monotonic_ns())

    def show_health(self, at_once: bool = False) -> None:
        """Duty 13, ten times a second."""
        now = time.monotonic()
        if now < self.next_health and not at_once:
            return
        self.next_health = now + 0.1
        stamp, none = self._stamp("health"), (0,) * 8
        sent, received = (self.sent["state"], *none[1:]), (0, self.heard, *none[2:])
        counts = (sent, received, none, (0, self.gate.refused, *none[2:]), none)
        shut = {DISARMED: f"disarmed: kill -USR1 {os.getpid()} arms the robot", STOPPED: f"stopped: kill -USR1 {os.getpid()} resumes the robot"}
        error = shut.get(self.gate.state, "")
        self.network.send_health(Health(stamp, 0, self.phase, os.getpid(), 0, stamp.sequence, *(0,) * 8, *counts, error))

    def obey(self) -> None:
        """A person's order, duty 10, which acts from the next period on."""
        self.ordered = True

    def rest(self) -> None:
        """Duty 14: brakes."""
        self.gate.stop(STOPPING)
        while any(self.gate.acting):
            time.sleep(0.0 if self.lock_step else GRAIN_S)
            self._move([0.0, 0.0, 0.0], 0.0, GRAIN_S)

    def finish(self) -> None:
        """Says that the run is over, until nobody listens any more or a second has passed."""
        self.rest()
        self.phase, begin = FINISHED, time.monotonic()
        self.show_health(at_once=True)
        while self.network.readers and time.monotonic() < begin + 1.0:
            self._serve(0.1)


class Report:
    """What a person sees: a line per second, and in the end how well a circle was followed, if one was to be."""

    SETTLED_S = 3.0

    def __init__(self, period: float, circle: list[float] | None) -> None:
        self.period, self.circle = period, circle
        self.error = 0.0
        self.squares: list[float] = []
        self.fallback_levels: Counter[int] = Counter()
        self.refused = self.model_version = 0

    def add(self, seconds: float, pose: Vector, gate: Gate) -> None:
        """A period ends at `seconds` in `pose`."""
        x, y, yaw = pose
        if self.circle:
            radius, speed = self.circle
            angle = speed * seconds / radius
            self.error = math.hypot(x - radius * math.sin(angle), y - radius * (1.0 - math.cos(angle)))
        if seconds >= self.SETTLED_S:
            self.squares.append(self.error**2)
        self.fallback_levels[gate.past[0]] += 1
        self.refused, self.model_version = gate.refused, gate.stored.model_version if gate.stored else 0
        if math.floor(seconds + 1e-9) > math.floor(seconds - self.period + 1e-9):
            error = f"  error {self.error:.3f} m" if self.circle else ""
            at = f"{seconds:6.1f} s  x {x:8.3f} m  y {y:8.3f} m  yaw {yaw:7.3f} rad"
            print(f"{at}{error}  fallback level {gate.past[0]}, reason {gate.past[1]}, model {self.model_version}", flush=True)

    def close(self) -> None:
        errors = {"final_error_m": self.error, "rmse_m": math.sqrt(sum(self.squares) / max(len(self.squares), 1))} if self.circle else {}
        fallback_levels = {str(fallback_level): periods for fallback_level, periods in sorted(self.fallback_levels.items())}
        print(json.dumps({**errors, "model_version": self.model_version, "refused": self.refused, "periods_on_fallback_level": fallback_levels}), flush=True)


def unheard_of() -> int:
    """An epoch that no run of before has had, so that no command that was recorded answers this one (duty 11)."""
    return int(time.time()) << 21 | secrets.randbelow(1 << 21)


def arguments() -> argparse.Namespace:
    ended = "Exit code 0 at the end of the run, 1 if it failed, 2 if it was asked for the impossible, 130 or 143 if somebody ended it."
    parser = argparse.ArgumentParser(description="A simulated robot, driven over Zenoh.", epilog=ended)
    parser.add_argument("--connect", metavar="ENDPOINT", help="router of the launch with the controller, such as tcp/127.0.0.1:7447")
    parser.add_argument("--graph", default="mecanum", help="name of the graph (%(default)s)")
    parser.add_argument("--robot", type=Path, default=Path("deploy/robots/mecanum.toml"), help="file with its limits (%(default)s)")
    parser.add_argument("--pace", choices=["lock-step", "real-time"], default="real-time", help="as the launch's (%(default)s)")
    parser.add_argument("--period-ms", type=float, default=100.0, help="T, as the scenario's (%(default)s)")
    parser.add_argument("--duration", type=float, default=15.0, metavar="SECONDS", help="(%(default)s)")
    parser.add_argument("--start", type=float, nargs=3, default=NOTHING, metavar=("X", "Y", "YAW"), help="pose [m, m, rad]")
    parser.add_argument("--circle", type=float, nargs=2, metavar=("RADIUS", "SPEED"), help="tell the error from this circle [m, m/s]")
    parser.add_argument("--recorded", action="store_true", help="a recorder takes part: in lock step, wait for its credit")
    parser.add_argument("--disarmed", action="store_true", help="stand until a person arms the robot: kill -USR1 PID")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="delay of the link, allowed on top of the age of an answer")
    parser.add_argument("--epoch", type=int, default=unheard_of(), help="greater than that of the last start, and one that nobody has heard of")
    parser.add_argument("--seed", type=int, default=1, help="of the sensors' noise (%(default)s)")
    parser.add_argument("--check", type=Path, metavar="VECTORS_DIR", help="only try protocol/vectors, and say whether they hold")
    options = parser.parse_args()
    if not options.check and not options.connect:
        parser.error("--connect is missing: expected the endpoint of the controller's router")
    if not (options.period_ms > 0.0 and options.duration > 0.0 and options.delay_ms >= 0.0 and options.epoch > 0):
        parser.error("--period-ms, --duration and --epoch must be greater than 0, --delay-ms not less")
    return options


def drive(options: argparse.Namespace) -> int:
    try:
        limits = Limits.read(options.robot, options.period_ms / 1e3)
    except (OSError, KeyError) as error:
        print(f"robot.py: {options.robot}: no robot file, {error!r}", file=sys.stderr)
        return 2
    try:
        network = Network(options.connect, options.graph, options.pace == "lock-step", options.recorded)
    except zenoh.ZError as error:
        print(f"robot.py: no router at {options.connect}: {error}", file=sys.stderr)
        return 1
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    driver = Driver(options, limits, network)
    signal.signal(signal.SIGUSR1, lambda *_: driver.obey())
    try:
        driver.run()
        driver.finish()
        driver.report.close()
    except KeyboardInterrupt:
        return 130
    finally:
        driver.rest()
        network.session.close()
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
