"""Tests of the footprint, the map, and the lists of planners."""

import contextlib
import json
import os
import socket
import tempfile
import time
import tomllib
import unittest
from collections.abc import Iterator
from pathlib import Path

from coxswain import (
    Base,
    Limits,
    Obstacle,
    Obstacles,
    RequestError,
    Sensors,
    Shape,
    Vector,
    arguments,
    body,
    driver,
    map_file,
    messages,
    planner,
)
from coxswain.protection import OBSTACLES_UNKNOWN, PROTECTIVE_STOP, Protection, Surroundings
from coxswain.wire import Wire

from .test_driver import Sent

ROOT = Path(__file__).parents[4]
VECTORS = json.loads((ROOT / "protocol/vectors/surroundings.json").read_text())


def listed(x: float, valid: float = 0.5) -> dict[str, object]:
    return {"valid_s": valid, "obstacles": [{"corners_m": [[x, 0.0]], "radius_m": 0.3}]}


class Vectors(unittest.TestCase):
    def test_the_vectors_are_those_of_this_version(self) -> None:
        self.assertEqual(VECTORS["version"], messages.VERSION)

    def test_robot_files_have_the_footprint_and_the_response_of_the_vectors(self) -> None:
        for case in VECTORS["robots"]:
            with self.subTest(case["file"]):
                file = ROOT / case["file"]
                found = body.footprint(tomllib.loads(file.read_text()))
                for value, expected in zip(found, case["footprint"]):
                    self.assertAlmostEqual(value, expected, 9)
                whole = body.read(file, 0.1)
                self.assertAlmostEqual(whole.response, case["response_s"], 9)
                self.assertEqual(whole.footprint.radius, found[2])

    def test_a_robot_file_may_have_a_footprint_and_a_list_of_wheels(self) -> None:
        wheels = [{"position_m": [0.25, -0.125], "radius_m": 0.0625}] * 3
        robot = {"wheels": {"list": wheels}}
        self.assertEqual(body.footprint(robot), (0.625, 0.375, 0.05))
        robot["footprint"] = {"length_m": 0.6, "width_m": 0.5, "clearance_m": 0.1}
        self.assertEqual(body.footprint(robot), (0.6, 0.5, 0.1))

    def test_maps_are_accepted_and_refused_as_in_the_vectors(self) -> None:
        for case in VECTORS["maps"]:
            with self.subTest(case["name"]):
                refused = case["refused"]
                if refused is None:
                    map_file.surroundings(case["map"])
                    continue
                with self.assertRaises(map_file.ImpossibleMap) as raised:
                    map_file.surroundings(case["map"])
                if refused:
                    self.assertEqual(raised.exception.key, refused)

    def test_lists_of_planners_are_accepted_and_rejected_as_in_the_vectors(self) -> None:
        for case in VECTORS["lists"]:
            with self.subTest(case["name"]):
                accepted = case["accepted"]
                if accepted is None:
                    with self.assertRaises(ValueError):
                        planner.PlannerList.parsed(case["line"])
                    continue
                found = planner.PlannerList.parsed(case["line"])
                self.assertEqual((found.age, found.valid), (accepted["age_s"], accepted["valid_s"]))
                rows = [list(driver.row_of(one)) for one in found.obstacles]
                self.assertEqual(rows, accepted["rows"])


class Socket(unittest.TestCase):
    @contextlib.contextmanager
    def planners(self, lock_step: bool = False) -> Iterator[planner.Planners]:
        with tempfile.TemporaryDirectory() as folder:
            found = planner.Planners(Path(folder) / "lists", lock_step)
            try:
                yield found
            finally:
                found.close()

    def test_the_newest_list_acts_once_and_its_wait_counts(self) -> None:
        with self.planners() as planners, Obstacles(socket_file=planners.path) as obstacles:
            self.assertIsNone(planners.due())
            obstacles.send(listed(1.0))
            obstacles.send(listed(2.0))
            time.sleep(0.01)
            found = planners.due()
            assert found is not None
            self.assertEqual(found.obstacles[0].shape.corners, ((2.0, 0.0),))
            self.assertGreater(found.age, 0.005)
            self.assertIsNone(planners.due())
            self.assertEqual((planners.accepted, planners.rejected), (2, 0))

    def test_a_bad_list_is_rejected_and_the_connection_stays(self) -> None:
        with self.planners() as planners, Obstacles(socket_file=planners.path) as obstacles:
            for bad in (listed(1e9), listed(1.0, -1.0), {}):
                with self.assertRaises(RequestError):
                    obstacles.send(bad)
            self.assertIsNone(planners.due())
            obstacles.send(listed(1.0))
            self.assertEqual((planners.accepted, planners.rejected), (1, 3))

    def test_a_line_without_end_is_rejected_and_ends_its_connection(self) -> None:
        with self.planners() as planners, socket.socket(socket.AF_UNIX) as stream:
            stream.connect(str(planners.path))
            stream.sendall(b" " * planner.LINE_BYTES_MAX)
            reply = b""
            while part := stream.recv(4096):
                reply += part
            self.assertEqual(json.loads(reply)["outcome"], "rejected")

    def test_in_lock_step_no_list_is_accepted(self) -> None:
        with self.planners(lock_step=True) as planners:
            with Obstacles(socket_file=planners.path) as obstacles:
                with self.assertRaises(RequestError):
                    obstacles.send(listed(1.0))

    def test_only_its_user_can_open_the_socket_and_a_dead_one_is_replaced(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "lists"
            with socket.socket(socket.AF_UNIX) as dead:
                dead.bind(str(path))
            planners = planner.Planners(path, False)
            self.assertEqual(os.stat(path).st_mode & 0o077, 0)
            planners.close()
            self.assertFalse(path.exists())

    def test_planners_beyond_the_eighth_are_refused(self) -> None:
        with self.planners() as planners, contextlib.ExitStack() as stack:
            many = [
                stack.enter_context(Obstacles(socket_file=planners.path))
                for _ in range(planner.PLANNERS_MAX)
            ]
            for one in many:
                one.send(listed(1.0))
            with self.assertRaises(RequestError), Obstacles(socket_file=planners.path) as ninth:
                ninth.send(listed(1.0))


class SeesDisc(Base):
    """A robot at rest that sees a disc ahead."""

    def read(self) -> Sensors:
        return Sensors((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def move(self, velocity: Vector, seconds: float) -> None:
        pass

    def obstacles(self) -> list[Obstacle]:
        return [Obstacle(Shape.hull([(1.0, 0.0)], 0.2), (-0.1, 0.0))]


class OwnObstacles(unittest.TestCase):
    def test_the_driver_publishes_what_its_base_sees_before_the_state_and_obeys_it(self) -> None:
        file, sent = ROOT / "deploy/robots/mecanum.toml", Sent()
        options = arguments("a driver").parse_args(["--connect", "tcp/127.0.0.1:1"])
        protection = Protection(body.read(file, 0.1), Surroundings())
        ends = driver.Ends(SeesDisc(), sent)
        tried = driver.Driver(ends, options, Limits.read(file, 0.1), protection, lambda *_: None)
        tried._publish(0, 0.0)
        self.assertEqual([topic for topic, _ in sent.messages], ["obstacles", "state"])
        message = Wire.decode(messages.Obstacles, sent.messages[0][1])
        self.assertEqual((message.source, message.valid_s, len(message.obstacles)), (0, 1.0, 1))
        self.assertEqual(message.obstacles[0][:5], (-0.1, 0.0, 0.2, 1.0, 0.0))
        share, reason = protection.share((5.0, 0.0, 0.0), 0.0)
        self.assertEqual(reason, PROTECTIVE_STOP)
        self.assertLess(share, 0.5)
        # A list of its own that gets too old slows the robot too.
        self.assertEqual(protection.share((-5.0, 0.0, 0.0), 1.1), (0.0, OBSTACLES_UNKNOWN))


if __name__ == "__main__":
    unittest.main()
