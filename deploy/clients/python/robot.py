"""A robot driver with a simulated robot. It is the plant of protocol/WIRE.md, over zenoh.

For a robot of your own, replace `Simulated` with its motors and sensors.
"""

import argparse
import json
import math
import random
import sys
from collections import Counter

import coxswain


class Simulated(coxswain.Base):
    """A simulated robot: each axis follows its command with a gain and a lag.

    The model of the controller has other values.
    """

    GAIN = (0.8, 0.75, 0.8)
    LAG_S = (0.6, 0.6, 0.4)
    NOISE = 5e-4  # standard deviation of the sensors [m, rad, m/s, rad/s]

    def __init__(self, pose: coxswain.Vector, seed: int, limits: coxswain.Limits) -> None:
        self.pose = pose
        self.velocity: coxswain.Vector = (0.0, 0.0, 0.0)
        self.random, self.limits = random.Random(seed), limits

    def move(self, velocity: coxswain.Vector, seconds: float) -> None:
        shares = [1.0 - math.exp(-seconds / lag) for lag in self.LAG_S]
        targets = [gain * value for gain, value in zip(self.GAIN, velocity)]
        before, axes = self.velocity, zip(self.velocity, shares, targets)
        self.velocity = tuple(v + share * (target - v) for v, share, target in axes)
        forward, left, turn = ((a + b) / 2 * seconds for a, b in zip(before, self.velocity))
        (x, y, yaw), middle = self.pose, self.pose[2] + turn / 2
        cosine, sine = math.cos(middle), math.sin(middle)
        x, y = x + forward * cosine - left * sine, y + forward * sine + left * cosine
        self.pose = (x, y, yaw + turn)

    def read(self) -> coxswain.Sensors:
        """Pose and velocity with sensor noise, and the wheel speeds of that velocity."""
        noisy = [value + self.random.gauss(0.0, self.NOISE) for value in self.pose + self.velocity]
        pose, velocity = tuple(noisy[:3]), tuple(noisy[3:])
        wheels = self.limits.wheel_speeds(velocity)
        return coxswain.Sensors(pose, velocity, wheel_speed=wheels)


class Report:
    """The printed report: one line per second, and a summary at the end.

    Both have the position error if `circle` is given.
    """

    SETTLED_S = 3.0

    def __init__(self, period: float, circle: list[float] | None, robot: Simulated) -> None:
        self.period, self.circle, self.robot = period, circle, robot
        self.error = 0.0
        self.squares: list[float] = []
        self.fallback_levels: Counter[int] = Counter()
        self.refused = self.model_version = 0

    def add(self, seconds: float, gate: coxswain.Gate) -> None:
        """Adds the period that ends at `seconds`."""
        x, y, yaw = self.robot.pose
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


def arguments() -> argparse.ArgumentParser:
    """The arguments of a driver, and those of the simulated robot."""
    parser = coxswain.arguments("A simulated robot, driven over zenoh.")
    parser.add_argument(
        "--start",
        help="pose at the start [m, m, rad]",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("X", "Y", "YAW"),
    )
    parser.add_argument(
        "--circle",
        help="print the position error from this circle [m, m/s]",
        type=float,
        nargs=2,
        metavar=("RADIUS", "SPEED"),
    )
    parser.add_argument(
        "--seed", help="seed of the sensor noise (%(default)s)", type=int, default=1
    )
    return parser


def main() -> int:
    reports: list[Report] = []

    def simulated(options: argparse.Namespace) -> Simulated:
        period = options.period_ms / 1e3
        robot = Simulated(
            tuple(options.start), options.seed, coxswain.Limits.read(options.robot, period)
        )
        reports.append(Report(period, options.circle, robot))
        return robot

    code = coxswain.main(simulated, arguments(), lambda at, gate: reports[0].add(at, gate))
    if code == 0:
        reports[0].close()
    return code


if __name__ == "__main__":
    sys.exit(main())
