"""Convex shapes in the plane, and the distance between two of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

Point = tuple[float, float]
Pose = tuple[float, ...]

CORNERS_MAX = 8
LARGEST_M = 1e6


def dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1]


def less(a: Point, b: Point) -> Point:
    return (a[0] - b[0], a[1] - b[1])


def turned(point: Point, yaw: float) -> Point:
    sin, cos = math.sin(yaw), math.cos(yaw)
    return (cos * point[0] - sin * point[1], sin * point[0] + cos * point[1])


@dataclass(frozen=True)
class Shape:
    """A hull, counter-clockwise, grown by a radius [m]."""

    corners: tuple[Point, ...]
    radius: float = 0.0

    @classmethod
    def hull(cls, corners: list[Point], radius: float) -> "Shape":
        """The convex hull of `corners` in any order, grown by `radius`."""
        points = sorted({(float(x), float(y)) for x, y in corners})
        return cls(tuple(chain(points) + chain(points[::-1])) or tuple(points), radius)

    @classmethod
    def checked(cls, corners: object, radius: object) -> "Shape":
        """The hull of what a file or a message has. Raises ValueError if there is no such shape."""
        if not isinstance(corners, list) or not 1 <= len(corners) <= CORNERS_MAX:
            raise ValueError(f"expected 1 to {CORNERS_MAX} corners")
        if not all(isinstance(corner, list) and len(corner) == 2 for corner in corners):
            raise ValueError("expected x and y of each corner")
        numbers = [value for corner in corners for value in corner] + [radius]
        if not all(type(value) in (int, float) and abs(value) <= LARGEST_M for value in numbers):
            raise ValueError("expected coordinates and a radius of at most 1e6 m")
        if not isinstance(radius, (int, float)) or radius < 0.0:
            raise ValueError(f"expected a radius of at least 0, not {radius}")
        return cls.hull([(x, y) for x, y in corners], float(radius))

    @classmethod
    def rectangle(cls, length: float, width: float) -> "Shape":
        x, y = 0.5 * length, 0.5 * width
        return cls(((-x, -y), (x, -y), (x, y), (-x, y)))

    def moved(self, by: Point) -> "Shape":
        return replace(self, corners=tuple((x + by[0], y + by[1]) for x, y in self.corners))

    def placed(self, pose: Pose) -> "Shape":
        """A shape of the body frame, in the world, at the pose (x, y, yaw)."""
        corners = tuple(turned(corner, pose[2]) for corner in self.corners)
        return replace(self, corners=corners).moved((pose[0], pose[1]))

    def edges(self) -> Iterator[tuple[Point, Point]]:
        return zip(self.corners, self.corners[1:] + self.corners[:1])

    def outer_edges(self) -> Iterator[tuple[Point, Point]]:
        """Outer normal and first corner of each edge that has a length."""
        for start, end in self.edges():
            x, y = less(end, start)
            long = math.hypot(x, y)
            if long > 0.0:
                yield (y / long, -x / long), start

    def separation(self, other: "Shape") -> tuple[float, Point]:
        """Distance to another shape, and the unit vector from this one to it.

        Where the shapes overlap, the distance is minus the way that parts them.
        """
        gap, axis = max(self._gap(other, 1.0), other._gap(self, -1.0))
        if -math.inf < gap < 0.0:
            return gap - self.radius - other.radius, axis
        ways = [
            less(nearest(corner, edge), corner) for corner in self.corners for edge in other.edges()
        ] + [
            less(corner, nearest(corner, edge)) for corner in other.corners for edge in self.edges()
        ]
        way = min(ways, key=lambda way: math.hypot(*way))
        distance = math.hypot(*way)
        normal = (way[0] / distance, way[1] / distance) if distance > 0.0 else axis
        return distance - self.radius - other.radius, normal

    def _gap(self, other: "Shape", sign: float) -> tuple[float, Point]:
        """The widest gap beyond an edge of this hull, and its normal times `sign`."""
        found = [
            (
                min(dot(normal, less(corner, start)) for corner in other.corners),
                (sign * normal[0], sign * normal[1]),
            )
            for normal, start in self.outer_edges()
        ]
        return max(found, default=(-math.inf, (1.0, 0.0)))  # a point has no edge


def chain(points: list[Point]) -> list[Point]:
    """Half of a hull, without its last corner."""
    found: list[Point] = []
    for point in points:
        while len(found) > 1:
            (x, y), (u, v) = less(found[-1], found[-2]), less(point, found[-2])
            if x * v - y * u > 0.0:
                break
            found.pop()
        found.append(point)
    return found[:-1]


def nearest(point: Point, edge: tuple[Point, Point]) -> Point:
    """The point of an edge that is nearest to `point`."""
    start, along = edge[0], less(edge[1], edge[0])
    squared = dot(along, along)
    share = dot(less(point, start), along) / squared if squared > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return (start[0] + share * along[0], start[1] + share * along[1])
