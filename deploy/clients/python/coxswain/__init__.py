"""A driver for a robot of your own, that a Coxswain controller drives through a bridge.

    import coxswain

    class MyBase(coxswain.Base):
        def read(self) -> coxswain.Sensors:
            return coxswain.Sensors(pose=..., velocity=...)

        def move(self, velocity: coxswain.Vector, seconds: float) -> None:
            ...

    coxswain.main(lambda options: MyBase())

The driver keeps the duties of protocol/WIRE.md: it publishes states, checks commands, plays the
stored trajectory, brakes, and reports its health.
"""

from .base import Base, Sensors
from .driver import Driver, arguments, main
from .gate import Gate, Limits
from .wire import Vector

__all__ = ["Base", "Driver", "Gate", "Limits", "Sensors", "Vector", "arguments", "main"]
