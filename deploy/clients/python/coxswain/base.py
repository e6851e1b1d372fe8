"""What the author of a robot writes: sensors out, body velocity in."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from .protection import Obstacle
from .wire import Vector


@dataclass(frozen=True)
class Sensors:
    """Measurements of one moment. Units and frames are those of protocol/WIRE.md."""

    pose: Vector
    """x, y and yaw in the world [m, m, rad]; the yaw angle is not wrapped."""
    velocity: Vector
    """Body velocity (forward, left, yaw) [m/s, m/s, rad/s]."""
    wheel_speed: tuple[float, ...] | None = None
    """Of each wheel in the order of the robot file, if it is measured [rad/s]."""
    current: tuple[float, ...] | None = None
    """Of each motor in the same order, if it is measured [A]."""
    input_delay_s: float = 0.0
    """Dead time from a velocity to the motors, if it is known [s]."""
    estop: bool = False
    """Whether the robot's own emergency stop is pressed."""


class Base(ABC):
    """The motors and sensors of a robot. The driver calls it from one thread."""

    @abstractmethod
    def read(self) -> Sensors:
        """The measurements now, once per period."""

    @abstractmethod
    def move(self, velocity: Vector, seconds: float) -> None:
        """Moves with this body velocity (forward, left, yaw) [m/s, m/s, rad/s].

        In real time the driver calls it every few milliseconds, and `seconds` have passed since
        the last call. In lock step a simulated robot moves for `seconds`.
        """

    def watchdog(self, valid_s: float) -> None:
        """Restarts the watchdog of the motors: the velocity of the next `move` may act for this
        time [s], unless another one follows.

        The driver calls it before each `move`. A process that has died or hangs does not call it:
        then the hardware must stop the motors by itself. Without this method that does not happen.
        """

    def obstacles(self) -> Sequence[Obstacle] | None:
        """All obstacles that the robot's own sensors know now, in the world frame, at most 64.

        None if it has no such sensors. The driver calls it once per period, after `read`. The gate
        slows the robot before them, and the controller plans around them.
        """
        return None
