"""Orders to the gate of a robot: stop, resume and arm.

    with coxswain.Orders(at="10.0.0.1:7451", certificates=Path("certificates")) as orders:
        orders.stop()

The page docs/how-to/stop-and-resume.md explains them. This is no emergency stop: that belongs
between battery and wheels.
"""

from pathlib import Path
from typing import Self

from .launches import Launch, way_to
from .requests import applied


class Orders:
    """Orders to a launch of this machine or, with a certificate of an operator, of another one."""

    def __init__(
        self,
        launch: Launch | None = None,
        *,
        at: str | None = None,
        certificates: Path | None = None,
    ) -> None:
        """`at` is host and port where the plant's host accepts requests. Raises RequestError."""
        self.way = way_to(launch, at, certificates)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.way.close()

    def stop(self) -> int:
        """The gate brakes the robot, and keeps it standing. Returns the first tick of the stop."""
        return self._give("stop")

    def resume(self) -> int:
        """Lets a stopped robot drive again. Returns the first tick."""
        return self._give("resume")

    def arm(self) -> int:
        """Arms a robot that began disarmed. Returns the first tick."""
        return self._give("arm")

    def _give(self, order: str) -> int:
        tick: int = applied(self.way.ask("plant", order), "plant")["acts_from_tick"]
        return tick
