"""The map file: known obstacles, zones and the border of the area.

The page docs/how-to/keep-clear-of-obstacles.md explains it.
"""

import tomllib
from pathlib import Path
from typing import Any

from .protection import Obstacle, Surroundings
from .shape import Shape

MOST = 1000  # obstacles, and zones
LARGEST_MPS = 1e3


class ImpossibleMap(ValueError):
    """A map that does not exist. `key` is the dotted path of the first key that is wrong."""

    def __init__(self, key: str, expected: str) -> None:
        super().__init__(f"{key}: {expected}")
        self.key = key


def read(file: Path) -> Surroundings:
    """The surroundings in a map file. Raises OSError or ValueError."""
    return surroundings(tomllib.loads(file.read_text()))


def surroundings(found: dict[str, Any]) -> Surroundings:
    """The content of a map file as shapes. Raises ImpossibleMap."""
    known = {"speed_without_obstacles_mps", "fence_m", "obstacles", "zones"}
    refuse_others("", found, known)
    for key in ("obstacles", "zones"):
        if len(found.get(key, [])) > MOST:
            raise ImpossibleMap(key, f"expected at most {MOST}")
    obstacles = tuple(
        Obstacle(shape(f"obstacles.{index}", one, {"corners_m", "radius_m"}))
        for index, one in enumerate(found.get("obstacles", []))
    )
    zones = tuple(zone(f"zones.{index}", one) for index, one in enumerate(found.get("zones", [])))
    corners, fence = found.get("fence_m", []), None
    if corners:
        fence = shape("fence_m", {"corners_m": corners}, {"corners_m"})
        if len(fence.corners) < 3:
            raise ImpossibleMap("fence_m", "expected 3 to 8 corners that are not on one line")
    key = "speed_without_obstacles_mps"
    return Surroundings(obstacles, zones, fence, speed(key, found.get(key, 0.0)))


def zone(key: str, found: dict[str, Any]) -> tuple[Shape, float]:
    """The area and the speed limit of a zone [m/s]."""
    limit = speed(f"{key}.speed_mps", found.get("speed_mps"))
    return shape(key, found, {"corners_m", "radius_m", "speed_mps"}), limit


def shape(key: str, found: dict[str, Any], known: set[str]) -> Shape:
    """The hull of `corners_m`, grown by `radius_m`."""
    refuse_others(f"{key}.", found, known)
    try:
        return Shape.checked(found.get("corners_m"), found.get("radius_m", 0.0))
    except ValueError as error:
        raise ImpossibleMap(key, str(error)) from error


def speed(key: str, value: object) -> float:
    """A speed limit [m/s]."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ImpossibleMap(key, "expected a number")
    if not 0.0 <= value <= LARGEST_MPS:
        raise ImpossibleMap(key, "expected 0 to 1000 m/s")
    return float(value)


def refuse_others(prefix: str, found: dict[str, Any], known: set[str]) -> None:
    """Raises ImpossibleMap for a key that is not known."""
    for key in found:
        if key not in known:
            raise ImpossibleMap(f"{prefix}{key}", f"expected one of {sorted(known)}")
