"""Tests of the duties of a robot driver: python -m unittest discover, in deploy/clients/python."""

import json
import math
import unittest
from dataclasses import replace
from pathlib import Path

from coxswain import gate
from coxswain.gate import ZERO, Gate, Limits
from coxswain.protection import Body, Obstacle, Protection, Surroundings
from coxswain.shape import Shape
from coxswain.wheels import rows
from coxswain.wire import Command, Stamp

T = 0.1
WHEELS = rows({"mecanum": {"radius_m": 0.05, "wheelbase_m": 0.25, "track_m": 0.3}})
LIMITS = Limits(T, (5.0, 5.0, 6.0), (10.0, 10.0, 20.0), (8.0, 8.0, 16.0), 120.0, WHEELS)
AHEAD = (1.0, 0.0, 0.0)
TAIL = ((0.8, 0.0, 0.0), (0.6, 0.0, 0.0), (0.4, 0.0, 0.0))


def command(
    tick: int, value=AHEAD, tail=TAIL, epoch=1, writer=7, plant=3, fallback_level=1, stop=0
) -> Command:
    stamp = Stamp(writer, epoch, tick + 1, tick, 0)
    return Command(stamp, plant, 0, value, tail, fallback_level, stop)


class Duties(unittest.TestCase):
    def setUp(self) -> None:
        self.gate = Gate(LIMITS, 3, 0.0)

    def period(self, tick: int, answer: Command | None) -> tuple[tuple[float, ...], int, int]:
        """One period in ten steps: the acting command at its end, fallback level and reason."""
        self.gate.begin(tick, tick * T)
        if answer:
            self.gate.receive(answer, tick * T)
        for step in range(10):
            acting = self.gate.play(tick * T + step * T / 10, T / 10)
        self.gate.end()
        return acting, *self.gate.past

    def reason(self, answer: Command | None, now: float = 0.0) -> int:
        return self.gate.receive(answer, now)

    def test_1_the_wheels_stand_before_the_first_command(self) -> None:
        self.assertEqual(self.period(0, None), ((0.0, 0.0, 0.0), gate.WAITING, gate.NO_COMMAND_YET))

    def test_3_a_command_is_rejected_for_each_reason(self) -> None:
        self.gate.begin(0, 0.0)
        for answer, reason in [
            (None, gate.MALFORMED),
            (command(0, (float("nan"), 0.0, 0.0)), gate.NOT_FINITE),
            (command(0, tail=((0.0, float("inf"), 0.0),)), gate.NOT_FINITE),
            (command(0, (5.1, 0.0, 0.0)), gate.OUT_OF_BOUNDS),
            (command(0, (4.0, 4.0, 0.0)), gate.OUT_OF_BOUNDS),  # a wheel at 160 rad/s
            (command(0, plant=2), gate.OLD_PLANT_EPOCH),
            (command(1), gate.FROM_THE_FUTURE),
            (command(0, (2.3, 0.0, 0.0), tail=()), gate.RATE_TOO_HIGH),
            (command(0, AHEAD, tail=((-1.3, 0.0, 0.0),)), gate.RATE_TOO_HIGH),
        ]:
            self.assertEqual(self.reason(answer), reason, answer)
        self.assertEqual(self.gate.refused, 9)
        self.assertEqual(self.reason(command(0), 0.151), gate.TOO_OLD)
        self.assertEqual(self.reason(command(0, epoch=2), 0.149), gate.NONE)
        self.assertEqual(self.reason(command(0, epoch=2)), gate.NOT_NEWER)
        # A new controller may answer an old state.
        self.assertEqual(self.reason(command(0, epoch=3), 0.149), gate.NONE)
        self.gate.begin(1, 0.2)
        self.assertEqual(self.reason(command(0, epoch=4), 0.2), gate.TOO_OLD)
        self.assertEqual(self.reason(command(1, epoch=3), 0.2), gate.NONE)
        self.assertEqual(self.reason(command(0, epoch=4), 0.2), gate.NOT_NEWER)
        self.gate.begin(2, 0.3)
        self.assertEqual(self.reason(command(2, epoch=1), 0.3), gate.OLD_CONTROLLER_EPOCH)
        self.assertEqual(self.reason(command(2, epoch=3, writer=8), 0.3), gate.SECOND_WRITER)
        self.gate.begin(3, 0.7)
        self.assertEqual(self.reason(command(3, epoch=3, writer=8), 0.7), gate.NONE)

    def test_3_the_tolerance_of_a_limit_is_one_millionth(self) -> None:
        agile = replace(LIMITS, rate=(100.0, 100.0, 100.0))
        for limits, limit, reason in [
            (agile, (5.0, 0.0, 0.0), gate.OUT_OF_BOUNDS),
            (agile, (0.0, -5.0, 0.0), gate.OUT_OF_BOUNDS),
            (agile, (0.0, 0.0, 6.0), gate.OUT_OF_BOUNDS),
            (agile, (3.0, -3.0, 0.0), gate.OUT_OF_BOUNDS),  # a wheel at 120 rad/s
            (LIMITS, (-2.2, 0.0, 0.0), gate.RATE_TOO_HIGH),
            (LIMITS, (0.0, 2.2, 0.0), gate.RATE_TOO_HIGH),
            (LIMITS, (0.0, 0.0, -4.4), gate.RATE_TOO_HIGH),
        ]:
            for beyond, expected in [(-1e-9, gate.NONE), (0.9e-6, gate.NONE), (1.1e-6, reason)]:
                value = tuple(axis * (1 + beyond) for axis in limit)
                for answer in [command(0, value, tail=()), command(0, ZERO, tail=(value,))]:
                    self.gate = Gate(limits, 3, 0.0)
                    self.gate.begin(0, 0.0)
                    self.assertEqual(self.reason(answer), expected, answer)

    def test_3_the_rate_limit_applies_to_a_tail_step_and_a_command_together(self) -> None:
        self.period(0, command(0, AHEAD, tail=((-1.0, 0.0, 0.0),)))
        self.gate.begin(1, T)
        self.gate.play(T, 0.01)  # the tail acts
        self.assertEqual(self.reason(command(1, (-1.3, 0.0, 0.0), tail=()), T), gate.RATE_TOO_HIGH)
        self.assertEqual(self.reason(command(1, (-1.2, 0.0, 0.0), tail=()), T), gate.NONE)

    def test_4_a_rejected_command_proves_that_its_writer_is_alive(self) -> None:
        self.period(0, command(0))
        for tick in range(1, 6):
            self.period(tick, command(tick, (9.0, 0.0, 0.0)))
        self.gate.begin(6, 0.6)
        self.assertEqual(self.reason(command(6, writer=8), 0.6), gate.SECOND_WRITER)

    def test_6_and_7_the_tail_acts_and_after_3_periods_the_brake(self) -> None:
        self.assertEqual(self.period(0, command(0)), (AHEAD, 1, gate.NONE))
        self.assertEqual(self.period(1, None), ((0.8, 0.0, 0.0), gate.TAIL, gate.MISSING))
        self.assertEqual(self.period(2, None), ((0.6, 0.0, 0.0), gate.TAIL, gate.MISSING))
        acting, *rest = self.period(3, None)
        self.assertEqual(acting, (0.0, 0.0, 0.0))
        self.assertEqual(rest, [gate.BRAKE, gate.MISSING])

    def test_7_the_brake_ramp_has_the_limits_of_the_robot(self) -> None:
        self.period(0, command(0, (2.0, -1.0, 0.0), tail=()))
        acting, fallback_level, _ = self.period(1, None)
        self.assertEqual(fallback_level, gate.BRAKE)
        for value, expected in zip(acting, (1.2, -0.2, 0.0)):
            self.assertAlmostEqual(value, expected)

    def test_8_braking_ends_after_three_good_periods_in_a_row(self) -> None:
        self.period(0, command(0, tail=()))
        answered = (2, 3, 5, 6, 7, 8)
        past = [
            self.period(tick, command(tick) if tick in answered else None)[1:]
            for tick in range(1, 9)
        ]
        missing, recovering = (gate.BRAKE, gate.MISSING), (gate.BRAKE, gate.RECOVERING)
        self.assertEqual(past[:3], [missing, recovering, recovering])
        self.assertEqual([fallback_level for fallback_level, _ in past], [gate.BRAKE] * 7 + [1])

    def test_9_the_last_rejection_is_the_reason(self) -> None:
        self.period(0, command(0))
        self.assertEqual(self.period(1, command(1, plant=9))[1:], (gate.TAIL, gate.OLD_PLANT_EPOCH))

    def test_9_a_fallback_level_of_the_controller_has_its_reason(self) -> None:
        failed, bad = gate.SOLVER_FAILED, gate.BAD_STATE
        reasons = [gate.NONE, gate.NONE, failed, gate.NO_PLAN, failed, bad, bad]
        for fallback_level, reason in enumerate(reasons):
            self.gate = Gate(LIMITS, 3, 0.0)
            answered = self.period(0, command(0, fallback_level=fallback_level))
            self.assertEqual(answered, (AHEAD, fallback_level, reason))
            message = "the reason applies to the answered period only"
            self.assertEqual(self.period(1, None)[1:], (gate.TAIL, gate.MISSING), message)

    def test_9_a_rejection_has_priority_over_the_reason_of_the_controller(self) -> None:
        self.gate.begin(0, 0.0)
        self.reason(command(0, fallback_level=2))
        self.reason(command(0, writer=8, fallback_level=2))
        self.gate.play(0.0, T)
        self.gate.end()
        self.assertEqual(self.gate.past, (2, gate.SECOND_WRITER))

    def test_10_a_stopped_robot_stands_until_it_is_resumed(self) -> None:
        for requested in (False, True):
            with self.subTest(requested=requested):
                self.gate = Gate(LIMITS, 3, 0.0)
                self.assertFalse(self.gate.order("resume"))
                self.period(0, command(0))
                reason = gate.HEADING_ERROR if requested else gate.BAD_STATE
                if not requested:
                    self.gate.stop(gate.BAD_STATE)
                for tick in range(1, 6):
                    stop = gate.HEADING_ERROR if requested and tick == 1 else 0
                    acting, *past = self.period(tick, command(tick, stop=stop))
                    self.assertEqual(past, [gate.LATCHED, reason])
                self.assertEqual(acting, ZERO)
                self.assertTrue(self.gate.order("resume"))
                fallback_levels = [self.period(tick, command(tick))[1] for tick in range(6, 10)]
                self.assertEqual(fallback_levels, [gate.BRAKE] * 3 + [1])
                self.assertEqual(self.gate.state, gate.DRIVING)

    def test_the_vectors_of_the_gate_hold(self) -> None:
        file = json.loads((Path(__file__).parents[4] / "protocol/vectors/gate.json").read_text())
        period, robot = file["period_ms"] / 1e3, file["robot"]
        vectors = (tuple(robot[key]) for key in ("input", "rate", "brake"))
        limits = Limits(period, *vectors, robot["wheel_speed"], rows(robot["wheels"]))
        for case in file["cases"]:
            with self.subTest(case["name"]):
                wheels = rows(case.get("wheels", robot["wheels"]))
                limits = replace(limits, wheels=wheels)
                protection = self.protection_of(limits, robot, case.get("map"))
                armed = case.get("armed", True)
                tried = Gate(limits, file["plant_epoch"], 0.0, armed, protection)
                self.run_case(tried, case["events"])

    def run_case(self, tried: Gate, events: list[dict]) -> None:
        total, since, now = [0.0, 0.0, 0.0], 0, 0
        for event in events:
            while now < event["at_ms"]:
                acting = tried.play(now / 1e3, 1e-3)
                total = [sum_ + value * 1e-3 for sum_, value in zip(total, acting)]
                now += 1
            at = now / 1e3
            if "publish" in event:
                if event["publish"] > 0:
                    tried.end()
                    found = {
                        "fallback_level": tried.past[0],
                        "reason": tried.past[1],
                        "gate": tried.state,
                        "stop": tried.stop_reason,
                        "refused": tried.refused,
                    }
                    self.assertEqual(found, {key: event[key] for key in found}, event)
                    for sum_, mean in zip(total, event["input"]):
                        found_mean = sum_ / (now - since) * 1e3
                        self.assertAlmostEqual(found_mean, mean, delta=0.01, msg=str(event))
                total, since = [0.0, 0.0, 0.0], now
                tried.begin(event["publish"], at)
                if "pose" in event:
                    tried.see_pose(tuple(event["pose"]), tuple(event["velocity"]), at)
            elif "command" in event:
                reason = tried.receive(self.command_of(event["command"]), at)
                self.assertEqual(reason, event["verdict"], event)
            elif "obstacles" in event:
                found = [
                    Obstacle(self.shape_of(one), tuple(one["velocity_mps"]))
                    for one in event["obstacles"]
                ]
                valid = event["valid_ms"] / 1e3
                tried.protection.see_obstacles(event["source"], found, at, valid)
            elif "order" in event:
                self.assertEqual(tried.order(event["order"]), event["followed"], event)
            elif "estop" in event:
                tried.set_estop(event["estop"])
            elif "not_finite" in event:
                tried.stop(gate.BAD_STATE)
            else:
                for found, value in zip(tried.play(at, 0.0), event["output"]):
                    self.assertAlmostEqual(found, value, delta=0.02, msg=str(event))

    def shape_of(self, fields: dict) -> Shape:
        return Shape.hull([tuple(corner) for corner in fields["corners_m"]], fields["radius_m"])

    def protection_of(self, limits: Limits, robot: dict, map_: dict | None) -> Protection | None:
        """The map of a test case, around the footprint of its robot."""
        if map_ is None:
            return None
        length, width, clearance = robot["footprint"]
        footprint = replace(Shape.rectangle(length, width), radius=clearance)
        body = Body(footprint, limits.brake[0], limits.brake[2], robot["response"], limits.period)
        fence = Shape.hull(map_["fence_m"], 0.0) if "fence_m" in map_ else None
        around = Surroundings(
            tuple(Obstacle(self.shape_of(one)) for one in map_.get("obstacles", [])),
            tuple((self.shape_of(one), one["speed_mps"]) for one in map_.get("zones", [])),
            fence,
            map_.get("speed_without_obstacles_mps", 0.0),
        )
        return Protection(body, around)

    def command_of(self, fields: dict) -> Command:
        """The command of a test vector; null stands for NaN."""
        rows = [fields["input"], *fields["tail"]]
        numbers = [tuple(math.nan if value is None else value for value in row) for row in rows]
        stamp = Stamp(fields["writer"], fields["epoch"], 0, fields["tick"], 0)
        return Command(
            stamp,
            fields["plant_epoch"],
            0,
            numbers[0],
            tuple(numbers[1:]),
            fields["fallback_level"],
            fields["stop"],
        )


if __name__ == "__main__":
    unittest.main()
