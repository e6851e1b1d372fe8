"""Sends requests over the network with the Python package: over_network.py AT CERTIFICATES.

Prints one line of JSON: the outcome of each step. A rejection has its code, or true.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import coxswain

FAR = {"valid_s": 600, "obstacles": [{"corners_m": [[50.0, 0.0]]}]}
VELOCITY = "[goal.velocity]\nvelocity = [0.1, 0.0, 0.0]\nvalid_s = 1.0\n"


def rejected(request: Callable[[], object]) -> str | bool:
    """Code of the rejection of a request, true without one; false if it was applied."""
    try:
        request()
    except coxswain.RequestError as error:
        return error.code or True
    return False


def main() -> None:
    at, certificates = sys.argv[1], Path(sys.argv[2])
    operator, planner = certificates / "operator", certificates / "planner"
    found: dict[str, object] = {}
    with (
        coxswain.Goals(at=at, certificates=certificates) as goals,
        coxswain.Orders(at=at, certificates=certificates) as orders,
    ):
        found["pose"] = goals.give_pose(9.0, 0.0, 0.0)
        found["absurd"] = rejected(lambda: goals.give("[goal.absurd]\n"))
        found["stop"] = orders.stop() > 0
        found["goal of a stopped robot"] = rejected(lambda: goals.give_pose(1.0, 0.0, 0.0))
        found["resume"] = orders.resume() > 0
        found["resume again"] = rejected(orders.resume)
        found["hold"] = goals.give("[goal.hold]\n")
        # As if the network had held it up for two seconds: it is older than the present goal.
        goals.way.clock = replace(goals.way.clock, nanos=goals.way.clock.nanos - 2_000_000_000)
        found["late velocity"] = rejected(lambda: goals.give(VELOCITY))
        found["progress"] = rejected(lambda: next(goals.until_reached(1)))
    with coxswain.Orders(at=at, certificates=planner) as orders:
        found["stop of a planner"] = rejected(orders.stop)
    with coxswain.Goals(at=at, certificates=planner) as goals:
        found["hold of a planner"] = goals.give("[goal.hold]\n")
    with coxswain.Obstacles(at=at, certificates=certificates) as obstacles:
        obstacles.send(FAR)
        found["bad list"] = rejected(lambda: obstacles.send({**FAR, "valid_s": -1}))
    found["list of an operator"] = rejected(
        lambda: coxswain.Obstacles(at=at, certificates=operator)
    )
    found["watcher"] = rejected(
        lambda: coxswain.Goals(at=at, certificates=certificates / "watcher")
    )
    found["nobody there"] = rejected(
        lambda: coxswain.Goals(at="127.0.0.1:1", certificates=certificates)
    )
    print(json.dumps(found))


if __name__ == "__main__":
    main()
