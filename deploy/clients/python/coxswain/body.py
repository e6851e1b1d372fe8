"""The robot file -> footprint of the robot, and how it stops.

services/robot/src/robot.rs has the same rules.
"""

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

from .protection import Body
from .shape import Shape
from .wheels import rows

CLEARANCE_M = 0.05  # unless the robot file has another one


def read(file: Path, period: float) -> Body:
    """The body in a robot file. Raises OSError, KeyError or ValueError."""
    robot = tomllib.loads(file.read_text())
    limits = robot["limits"]
    length, width, clearance = footprint(robot)
    return Body(
        footprint=replace(Shape.rectangle(length, width), radius=clearance),
        brake=limits["brake_mps2"],
        yaw_brake=limits["yaw_brake_radps2"],
        response=response_time(robot),
        period=period,
    )


def footprint(robot: dict[str, Any]) -> tuple[float, float, float]:
    """Length, width and clearance [m]: by default the rectangle around the wheels."""
    if "footprint" in robot:
        found = robot["footprint"]
        return found["length_m"], found["width_m"], found.get("clearance_m", CLEARANCE_M)
    ahead, side = half_extent(robot["wheels"])
    radius = max(radii(robot["wheels"]), default=0.0)
    return 2.0 * (ahead + radius), 2.0 * (side + radius), CLEARANCE_M


def half_extent(wheels: dict[str, Any]) -> tuple[float, float]:
    """Largest distance of a wheel ahead and aside of the centre [m]."""
    match wheels:
        case {"mecanum": found}:
            return found["wheelbase_m"] / 2, found["track_m"] / 2
        case {"twist": found}:
            return found["length_m"] / 2, found["width_m"] / 2
        case {"omni": found}:
            lever, count = found["centre_to_wheel_m"], found["count"]
            angles = [2.0 * math.pi * wheel / count for wheel in range(count)]
            places = [(lever * math.cos(angle), lever * math.sin(angle)) for angle in angles]
        case _:
            places = [tuple(wheel["position_m"]) for wheel in wheels["list"]]
    return max(abs(x) for x, _ in places), max(abs(y) for _, y in places)


def radii(wheels: dict[str, Any]) -> list[float]:
    """Radius of each wheel [m]."""
    match wheels:
        case {"list": found}:
            return [wheel["radius_m"] for wheel in found]
        case {"twist": _}:
            return []
    [found] = wheels.values()
    return [found["radius_m"]] * len(rows(wheels))


def response_time(robot: dict[str, Any]) -> float:
    """Dead time plus the largest time constant of an axis [s].

    With motors, a time constant is lambda / (kappa + f): inertia of the axis, stiffness of the
    speed loop, and friction.
    """
    response = robot.get("response", {})
    dead_time: float = response.get("dead_time_s", 0.0)
    if "body" not in robot or "drive" not in robot:
        slowest: float = max(response.get("time_constant_s", (0.0,)))
        return dead_time + slowest
    body, drive = robot["body"], robot["drive"]
    stiffness = drive["pole_pairs"] * drive["torque_constant_nm_per_a"]
    stiffness *= drive["speed_loop_gain_a_s_per_rad"]
    wheels = radii(robot["wheels"])
    radius = sum(wheels) / len(wheels)
    constants: list[float] = []
    for axis, mass in enumerate((body["mass_kg"], body["mass_kg"], body["yaw_inertia_kg_m2"])):
        # A row of J/r, times the mean radius.
        squares = sum((row[axis] * radius) ** 2 for row in rows(robot["wheels"]))
        inertia = mass * radius**2 / squares + body["wheel_inertia_kg_m2"]
        constants.append(inertia / (stiffness + body["axle_friction_nms"]))
    return dead_time + max(constants)
