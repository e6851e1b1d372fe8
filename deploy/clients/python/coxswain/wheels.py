"""The wheels of a robot file -> wheel speeds per body velocity.

protocol/WIRE.md, duty 3, has the formulas.
"""

import math
from typing import Any

Row = tuple[float, float, float]  # of J/r: forward, left, yaw


def rows(wheels: dict[str, Any]) -> tuple[Row, ...]:
    """Rows of J/r, one for each wheel, of the table [wheels]. Raises ValueError for other keys."""
    match list(wheels.items()):
        case [("mecanum", found)]:
            return mecanum(found)
        case [("omni", found)]:
            return omni(found)
        case [("list", found)]:
            return tuple(listed(wheel) for wheel in found)
        case [("twist", _)]:
            return ()
    raise ValueError(f"wheels: expected one of mecanum, omni, list, twist, not {sorted(wheels)}")


def mecanum(found: dict[str, Any]) -> tuple[Row, ...]:
    """Front-right, front-left, rear-left, rear-right."""
    ahead, side, radius = found["wheelbase_m"] / 2, found["track_m"] / 2, found["radius_m"]
    sign, lever = (1.0, side + ahead) if found.get("rollers", "O") == "O" else (-1.0, side - ahead)
    signs = ((sign, lever), (-sign, -lever), (sign, -lever), (-sign, lever))
    return tuple((1.0 / radius, left / radius, turn / radius) for left, turn in signs)


def omni(found: dict[str, Any]) -> tuple[Row, ...]:
    """Counter-clockwise from the front."""
    count, radius = found["count"], found["radius_m"]
    angles = (2.0 * math.pi * wheel / count for wheel in range(count))
    lever = found["centre_to_wheel_m"] / radius
    return tuple((-math.sin(angle) / radius, math.cos(angle) / radius, lever) for angle in angles)


def listed(wheel: dict[str, Any]) -> Row:
    """One wheel of a list."""
    (x, y), radius = wheel["position_m"], wheel["radius_m"]
    direction = math.radians(wheel.get("direction_deg", 0.0))
    slope = math.tan(math.radians(wheel.get("roller_deg", 0.0)))
    forward = math.cos(direction) - slope * math.sin(direction)
    left = math.sin(direction) + slope * math.cos(direction)
    return (forward / radius, left / radius, (x * left - y * forward) / radius)
