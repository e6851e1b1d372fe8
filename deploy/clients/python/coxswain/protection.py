"""Obstacles -> commands: the largest share of a twist with which the robot stops in time.

The rule is the section *Protective stop* of protocol/WIRE.md.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from .shape import Point, Pose, Shape, dot, turned
from .wire import Vector

ZERO: Vector = (0.0, 0.0, 0.0)
NONE = 0
PROTECTIVE_STOP, OBSTACLES_UNKNOWN, SPEED_ZONE, GEOFENCE = range(23, 27)  # reasons
DECISION_PERIODS = 0.1  # time until the next output, at most
HALVINGS = 20
AT_REST = 0.01  # rest of an earlier motion that does not keep a robot from leaving [m]


@dataclass(frozen=True)
class Obstacle:
    """A shape in the world, with a constant velocity [m/s]."""

    shape: Shape
    velocity: Point = (0.0, 0.0)

    def after(self, seconds: float) -> Shape:
        return self.shape.moved((seconds * self.velocity[0], seconds * self.velocity[1]))

    def moved(self, seconds: float) -> "Obstacle":
        """The obstacle after this time."""
        return Obstacle(self.after(seconds), self.velocity)


@dataclass(frozen=True)
class Surroundings:
    """What a map has: obstacles, zones with their speed limits, and the border of the area."""

    obstacles: tuple[Obstacle, ...] = ()
    zones: tuple[tuple[Shape, float], ...] = ()
    fence: Shape | None = None
    speed_without_obstacles: float = 0.0


@dataclass(frozen=True)
class Body:
    """Footprint with its clearance in the body frame, and how the robot stops. SI units."""

    footprint: Shape
    brake: float
    yaw_brake: float
    response: float
    period: float


@dataclass(frozen=True)
class Border:
    """A straight border: distance and normal from the footprint, and its own approach."""

    distance: float
    normal: Point
    approach: float = 0.0


class Stopping:
    """The way to standstill of one twist at one pose."""

    def __init__(self, body: Body, pose: Pose, twist: Vector, left_over: Sequence[Vector]) -> None:
        def motion(velocity: Vector) -> tuple[Point, float]:
            return turned((velocity[0], velocity[1]), pose[2]), velocity[2]

        self.body, self.yaw = body, twist[2]
        self.arms = [turned(corner, pose[2]) for corner in body.footprint.corners]
        self.velocity, _ = motion(twist)
        self.speed = math.hypot(twist[0], twist[1])
        way = [0.5 * value * abs(value) / body.brake for value in twist]
        self.stop, _ = motion((way[0], way[1], 0.0))
        self.ramp_angle = 0.5 * self.yaw**2 / body.yaw_brake
        self.short_ramp_time = min(abs(twist[0]), abs(twist[1])) / body.brake
        planar = max(abs(twist[0]), abs(twist[1])) / body.brake
        self.ramp_time = max(planar, abs(self.yaw) / body.yaw_brake)
        self.left_over = [motion(velocity) for velocity in left_over]

    def _turn(self, share: float) -> float:
        """The angle that the body can still turn."""
        yaw = share * abs(self.yaw)
        rest = max([yaw] + [abs(yaw) for _, yaw in self.left_over])
        return yaw * self.body.period + rest * self.body.response + share**2 * self.ramp_angle

    def _closing(self, motion: tuple[Point, float], normal: Point, turn: float) -> float:
        """Largest part of a motion along `normal`, of any corner, while the body turns."""
        velocity, yaw = motion
        sweeps = [most((-yaw * y, yaw * x), normal, turn) for x, y in self.arms]
        return most(velocity, normal, turn) + max(sweeps)

    def stops_before(self, border: Border, share: float) -> bool:
        body, turn = self.body, self._turn(share)
        speed = share * self._closing((self.velocity, self.yaw), border.normal, turn)
        straight = most(self.stop, border.normal, turn)
        crest = 0.5 * self.short_ramp_time * most(self.velocity, border.normal, turn)
        ramp_yaw = math.copysign(self.ramp_angle, self.yaw)
        swept = self._closing(((0.0, 0.0), ramp_yaw), border.normal, turn)
        rest = max(self._closing(motion, border.normal, turn) for motion in self.left_over)
        soon = DECISION_PERIODS * body.period
        if speed <= 0.0 and speed * soon + share**2 * (straight + swept) <= 0.0:
            return rest * body.response <= max(border.distance, AT_REST)
        ramp, speed = share**2 * (max(straight, crest, 0.0) + max(swept, 0.0)), max(speed, 0.0)

        def stands_in(wait: float, way: float) -> bool:
            duration = wait + body.response + share * self.ramp_time
            return way + ramp + border.approach * duration <= border.distance

        return stands_in(body.period, speed * (body.period + body.response)) and stands_in(
            soon, speed * soon + max(rest, 0.0) * body.response
        )

    def slows_before(self, border: Border, limit: float, share: float) -> bool:
        body, speed = self.body, share * self.speed
        if speed <= limit:
            return True
        closing = self._closing((self.velocity, self.yaw), border.normal, self._turn(share))
        if border.distance <= 0.0 or closing <= 0.0:
            return border.distance > 0.0
        rest = max([speed, *(math.hypot(*velocity) for velocity, _ in self.left_over)])
        wait = speed * body.period + rest * body.response
        path = border.distance * self.speed / closing - wait
        return speed**2 <= limit**2 + 2.0 * body.brake * path


def most(vector: Point, normal: Point, turn: float) -> float:
    """Largest part of `vector` along `normal` while it turns by at most `turn` to either side."""
    along = dot(vector, normal)
    across = abs(vector[0] * normal[1] - vector[1] * normal[0])
    long = math.hypot(along, across)
    if turn >= math.pi or along >= math.cos(turn) * long:
        return long
    return along * math.cos(turn) + across * math.sin(turn)


def largest_share(high: float, condition: Callable[[float], bool]) -> float:
    """The largest share up to `high` that fulfils the condition; 0 if none does."""
    if condition(high):
        return high
    low = 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if condition(middle) else (low, middle)
    return low


@dataclass
class Protection:
    """What the gate knows of the surroundings of one robot."""

    body: Body
    surroundings: Surroundings
    lists: dict[int, tuple[list[Obstacle], float, float]] = field(default_factory=dict)
    """Of each source: its newest list, time of arrival and validity [s]."""
    pose: Pose | None = None
    seen_at: float = 0.0
    left_over: tuple[Vector, Vector] = (ZERO, ZERO)

    def see_pose(self, pose: Pose, velocity: Vector, acting: Vector, now: float) -> None:
        """Pose and velocity, as measured at `now`, when `acting` was the output."""
        if all(map(math.isfinite, (*pose, *velocity))):
            self.pose, self.seen_at, self.left_over = pose, now, (velocity, acting)

    def see_obstacles(
        self, source: int, obstacles: list[Obstacle], now: float, valid: float
    ) -> None:
        """A list that arrived at `now`. It replaces the one before it."""
        self.lists[source] = (obstacles, now, valid)

    def predict(self, acting: Vector, now: float) -> None:
        """Moves the pose until `now`."""
        if self.pose is not None and now > self.seen_at:
            ahead, left, yaw = (value * (now - self.seen_at) for value in acting)
            x, y = turned((ahead, left), self.pose[2] + 0.5 * yaw)
            self.pose = (self.pose[0] + x, self.pose[1] + y, self.pose[2] + yaw)
            self.seen_at = now

    def share(self, twist: Vector, now: float) -> tuple[float, int]:
        """The largest allowed share of a twist, and the reason that bounds it, or NONE."""
        if self.pose is None:
            return (0.0, PROTECTIVE_STOP) if any(twist) else (1.0, NONE)
        stopping = Stopping(self.body, self.pose, twist, self.left_over)
        footprint = self.body.footprint.placed(self.pose)
        found = (1.0, NONE)

        def bound(reason: int, condition: Callable[[float], bool]) -> None:
            nonlocal found
            share = largest_share(found[0], condition)
            if share < found[0]:
                found = (share, reason)

        around = self.surroundings
        if any(now - at > valid + 1e-9 for _, at, valid in self.lists.values()):
            limit = around.speed_without_obstacles
            bound(OBSTACLES_UNKNOWN, lambda share: share * stopping.speed <= limit)
        for normal, corner in around.fence.outer_edges() if around.fence else ():
            farthest = max(dot(normal, point) for point in footprint.corners) + footprint.radius
            edge = Border(dot(normal, corner) - farthest, normal)
            bound(GEOFENCE, partial(stopping.stops_before, edge))
        for zone, limit in around.zones:
            edge = Border(*footprint.separation(zone))
            bound(SPEED_ZONE, partial(stopping.slows_before, edge, limit))
        listed = [(obstacle, 0.0) for obstacle in around.obstacles]
        for obstacles, at, valid in self.lists.values():
            listed += [(obstacle, min(now - at, valid)) for obstacle in obstacles]
        for obstacle, age in listed:
            distance, normal = footprint.separation(obstacle.after(age))
            edge = Border(distance, normal, max(-dot(obstacle.velocity, normal), 0.0))
            bound(PROTECTIVE_STOP, partial(stopping.stops_before, edge))
        return found
