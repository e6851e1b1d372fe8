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

`Goals` sends a robot to poses, `Orders` stops it, and `Obstacles` tells what is in its way, from
the machine of its launch or from another one (goals.py, orders.py, obstacles.py).
"""

from .base import Base, Sensors
from .driver import Driver, arguments, main
from .gate import Gate, Limits
from .goals import Goals
from .launches import Launch, running_launch, running_launches
from .obstacles import Obstacles
from .orders import Orders
from .protection import Obstacle
from .requests import RequestError
from .shape import Shape
from .wire import Vector

__all__ = [
    "Base",
    "Driver",
    "Gate",
    "Goals",
    "Launch",
    "Limits",
    "Obstacle",
    "Obstacles",
    "Orders",
    "RequestError",
    "Sensors",
    "Shape",
    "Vector",
    "arguments",
    "main",
    "running_launch",
    "running_launches",
]
