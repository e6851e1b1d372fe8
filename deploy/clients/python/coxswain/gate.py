"""Commands -> wheels: the limits of the robot, and the gate that selects the acting command.

The duties in the comments are the numbered duties of protocol/WIRE.md.
"""

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

from .protection import Protection
from .wheels import Row, rows
from .wire import Command, Vector

ZERO: Vector = (0.0, 0.0, 0.0)
ROUNDING = 1 + 1e-6  # tolerance of a limit, as a factor
WAITING, TAIL, BRAKE, LATCHED = 0, 4, 5, 6  # fallback levels
# Reasons.
NONE, NO_COMMAND_YET, MISSING, MALFORMED = range(4)
NOT_FINITE, OUT_OF_BOUNDS, RATE_TOO_HIGH, OLD_PLANT_EPOCH = range(4, 8)
OLD_CONTROLLER_EPOCH, SECOND_WRITER, TOO_OLD, NOT_NEWER = range(8, 12)
FROM_THE_FUTURE, SOLVER_FAILED, BAD_STATE, STOPPING, RECOVERING = range(12, 17)
POSITION_ERROR, HEADING_ERROR, EMERGENCY_STOP, IS_DISARMED, NO_PLAN = range(17, 22)
OPERATOR_STOP = 22
DISARMED, ARMED, DRIVING, STOPPED = range(4)  # states of the gate
# Reason for each fallback level of a controller.
OWN_REASONS = {
    0: NONE,
    1: NONE,
    2: SOLVER_FAILED,
    3: NO_PLAN,
    4: SOLVER_FAILED,
    5: BAD_STATE,
    6: BAD_STATE,
}


@dataclass(frozen=True)
class Limits:
    """Limits of the robot, from the robot file, and the control period. SI units."""

    period: float
    input: Vector
    rate: Vector
    brake: Vector
    wheel_speed: float
    wheels: tuple[Row, ...]

    @classmethod
    def read(cls, file: Path, period: float) -> "Limits":
        robot = tomllib.loads(file.read_text())
        found = robot["limits"]
        motors = robot.get("drive", {}) | robot.get("response", {})

        def plane_and_yaw(plane: str, yaw: str) -> Vector:
            return (found[plane], found[plane], found[yaw])

        return cls(
            period=period,
            input=plane_and_yaw("input_mps", "yaw_input_radps"),
            rate=plane_and_yaw("input_rate_mps2", "yaw_input_rate_radps2"),
            brake=plane_and_yaw("brake_mps2", "yaw_brake_radps2"),
            wheel_speed=motors.get("wheel_speed_limit_radps", math.inf),
            wheels=rows(robot["wheels"]),
        )

    def wheel_speeds(self, velocity: Vector) -> tuple[float, ...]:
        """Wheel speeds for a body velocity, in the order of the robot file [rad/s]."""
        return tuple(sum(by * part for by, part in zip(row, velocity)) for row in self.wheels)

    def allow(self, velocity: Vector) -> bool:
        within = all(abs(value) <= limit * ROUNDING for value, limit in zip(velocity, self.input))
        wheel_limit = self.wheel_speed * ROUNDING
        return within and all(abs(wheel) <= wheel_limit for wheel in self.wheel_speeds(velocity))

    def allow_step(self, before: Vector, after: Vector) -> bool:
        steps = zip(before, after, self.rate)
        return all(abs(b - a) <= 2.2 * rate * self.period * ROUNDING for a, b, rate in steps)

    def reach(self, before: Vector, after: Vector) -> tuple[float, Vector]:
        """Duty 6: the largest share of `after` whose axes get faster than `before` by 1.1 changes,
        and `after` with each axis at most 1.1 changes from `before`.
        """
        axes = [(a, b, rate * self.period * 1.1) for a, b, rate in zip(before, after, self.rate)]
        along = [(math.copysign(abs(a), a * b or 1.0), abs(b), c) for a, b, c in axes if b]
        shares = [max(c + a, 0.0) / b for a, b, c in along]
        return min([1.0, *shares]), tuple(min(max(b, a - c), a + c) for a, b, c in axes)


class Gate:
    """Selects the command that acts on the wheels: duties 1 and 3 to 10.

    All times are seconds of one clock.
    """

    def __init__(
        self,
        limits: Limits,
        epoch: int,
        delay: float,
        armed: bool = True,
        protection: Protection | None = None,
    ) -> None:
        self.limits, self.epoch, self.delay = limits, epoch, delay
        self.protection = protection  # None: the gate knows no obstacles
        self.slowed = NONE  # why the last command of the current period was slowed
        self.slows = NONE  # why the last output is slower than the command
        self.asked = ZERO  # that command
        self.tick = 0
        self.published: dict[int, float] = {}
        self.stored: Command | None = None
        self.since = 0.0  # publication time of the state that the stored command answers
        self.last_received = 0.0  # time of the last command of the current writer
        self.refused = 0
        self.acting = self.acting_at_begin = ZERO
        self.state, self.stop_reason = ARMED if armed else DISARMED, NONE
        self.estop = self.braking = False
        self.good_periods = 0
        self.past = (WAITING, NO_COMMAND_YET)  # fallback level and reason of the last period
        self.worst = (WAITING, NONE)  # fallback level and reason of the current period
        self.last_refusal = NONE

    def begin(self, tick: int, now: float) -> None:
        """Begins a period: the driver publishes the state of `tick` now."""
        self.tick = tick
        self.published[tick] = now
        self.published.pop(tick - 8, None)
        self.worst, self.last_refusal = (WAITING, NONE), NONE
        self.acting_at_begin, self.slowed = self.acting, NONE

    def see_pose(self, pose: Vector, velocity: Vector, now: float) -> None:
        """Duty 7: pose and body velocity, as measured when the period began."""
        if self.protection:
            self.protection.see_pose(pose, velocity, self.acting_at_begin, now)

    def end(self) -> None:
        """Ends a period: duties 8 and 9."""
        answered = self.stored is not None and self.stored.stamp.tick == self.tick
        fallback_level, reason = self.worst
        if self.state == STOPPED:
            fallback_level, reason = LATCHED, self.stop_reason
        elif self.state == DISARMED:
            fallback_level, reason = WAITING, IS_DISARMED
        elif self.stored is None:
            fallback_level, reason = WAITING, NO_COMMAND_YET
        elif self.braking:
            fallback_level, reason = BRAKE, RECOVERING if answered else MISSING
        elif answered:
            fallback_level = self.stored.fallback_level
            reason = OWN_REASONS[fallback_level]
        self.past = (fallback_level, self.last_refusal or reason)
        if self.slowed and fallback_level not in (WAITING, BRAKE, LATCHED):
            self.past = (fallback_level, self.slowed)
        self.good_periods = self.good_periods + 1 if answered and self.braking else 0

    def stop(self, reason: int) -> None:
        """Duty 10: the robot brakes, and stands until an operator resumes it."""
        if self.state != STOPPED:
            self.state, self.stop_reason = STOPPED, reason

    def set_estop(self, pressed: bool) -> None:
        """Duty 10: reports the state of the robot's own emergency stop."""
        self.estop = pressed
        if pressed:
            self.stop(EMERGENCY_STOP)

    def order(self, order: str) -> bool:
        """Duty 10: follows "arm", "resume" or "stop" of an operator. False if it is invalid."""
        if order == "stop":
            self.stop(OPERATOR_STOP)
            return True
        if self.state != {"arm": DISARMED, "resume": STOPPED}[order] or self.estop:
            return False
        if order == "resume":
            self.braking, self.good_periods = self.stored is not None, 0
        self.state, self.stop_reason = ARMED, NONE
        return True

    def receive(self, command: Command | None, now: float) -> int:
        """Stores a command if it is valid. Returns the reason of a rejection, or NONE.

        `command` is None for bytes that do not decode.
        """
        reason = self._judge(command, now) if command else MALFORMED
        if command and self.stored and command.stamp.writer == self.stored.stamp.writer:
            self.last_received = now
        if command and reason == NONE:
            tick = command.stamp.tick
            self.stored, self.since, self.last_received = command, self.published[tick], now
            self.braking = self.braking and (self.good_periods < 3 or tick != self.tick)
            if command.stop != NONE:
                self.stop(command.stop)
            elif self.state == ARMED and not self.braking:
                self.state = DRIVING
        else:
            self.refused, self.last_refusal = self.refused + 1, reason
        return reason

    def _judge(self, command: Command, now: float) -> int:
        """Duty 3: the checks, in the order of WIRE.md."""
        inputs, stamp = (command.input, *command.tail), command.stamp
        current, period = self.stored, self.limits.period
        if not all(math.isfinite(value) for row in inputs for value in row):
            return NOT_FINITE
        if not all(map(self.limits.allow, inputs)):
            return OUT_OF_BOUNDS
        if command.plant_epoch != self.epoch:
            return OLD_PLANT_EPOCH
        if current and stamp.epoch < current.stamp.epoch:
            return OLD_CONTROLLER_EPOCH
        same_epoch = current is not None and stamp.epoch == current.stamp.epoch
        second = current is not None and same_epoch and stamp.writer != current.stamp.writer
        if second and now - self.last_received < 3 * period:
            return SECOND_WRITER
        if stamp.tick > self.tick:
            return FROM_THE_FUTURE
        last = current and (current.stamp.epoch, current.stamp.tick)
        if last and (stamp.tick < last[1] or (stamp.epoch, stamp.tick) == last):
            return NOT_NEWER
        published = self.published.get(stamp.tick)
        if published is None or now - published > 1.5 * period + self.delay:
            return TOO_OLD
        age = int((now - published) / period + 1e-9)
        first = inputs[age : age + 1]  # the first input that acts, if any
        earlier = (self.acting_at_begin, self.acting)
        steps = [*zip(inputs, command.tail)]
        if self.slows:  # each axis begins within the range of the command and the slowed output
            ranges = [sorted(axis) for axis in zip(self.asked, *earlier)]
            steps += [
                (tuple(min(max(v, r[0]), r[-1]) for v, r in zip(b, ranges)), b) for b in first
            ]
        else:
            steps += [(a, b) for a in earlier for b in first]
        if not all(self.limits.allow_step(*step) for step in steps):
            return RATE_TOO_HIGH
        return NONE

    def play(self, now: float, elapsed: float) -> Vector:
        """Body velocity for the wheels from `now` on: duties 6 and 7.

        `elapsed` is the time since the last call [s].
        """
        chosen, fallback_level, reason = self._choose(now)
        self.worst = max(self.worst, (fallback_level, reason))
        if self.protection:
            self.protection.predict(self.acting, now)
        slowed_before, self.slows = self.slows, NONE
        if chosen is None:
            chosen = self._braked(elapsed)
        elif self.protection and self.stored and self.state != DISARMED:
            self.asked = chosen
            chosen = self._slow(self.protection, chosen, slowed_before, now, elapsed)
        self.acting = chosen
        return chosen

    def _braked(self, elapsed: float) -> Vector:
        axes = zip(self.acting, self.limits.brake)
        return tuple(math.copysign(max(abs(v) - b * elapsed, 0.0), v) for v, b in axes)

    def _slow(
        self, protection: Protection, asked: Vector, before: int, now: float, elapsed: float
    ) -> Vector:
        """Protective stop: the command as far as the surroundings allow it.

        On the way to its share it falls no faster than the ramp of the brake. After `before`, the
        reason of a slower output, no axis changes by more than a change per period, or the ramp.
        """
        share, reason = protection.share(asked, now)
        reached, near = self.limits.reach(self.acting_at_begin, asked)
        if before != NONE:
            if reason == NONE and (reached < share or near != tuple(asked)):
                reason = before
            share = min(share, reached)
        if reason == NONE:
            return asked
        self.slowed = self.slows = reason
        braked, goal = self._braked(elapsed), tuple(share * value for value in asked)
        axes = zip(self.acting, braked, near, goal)
        slowed = tuple(
            max(g, min(b, a)) if v > 0.0 else min(g, max(b, a)) if v < 0.0 else g
            for v, b, a, g in axes
        )
        allowed = slowed == goal or (
            self.limits.allow(slowed) and protection.share(slowed, now)[1] == NONE
        )
        return slowed if allowed else braked

    def _choose(self, now: float) -> tuple[Vector | None, int, int]:
        """Velocity (None: the brake ramp), fallback level and reason."""
        if self.state == STOPPED:
            self.braking = True
            return None, LATCHED, self.stop_reason
        if self.state == DISARMED:
            return ZERO, WAITING, IS_DISARMED
        if self.stored is None:
            return ZERO, WAITING, NO_COMMAND_YET
        age = int((now - self.since) / self.limits.period + 1e-9)
        missing = age >= 3 or age > len(self.stored.tail)
        self.braking |= missing
        if self.braking:
            return None, BRAKE, MISSING if missing else RECOVERING
        if age:
            return self.stored.tail[age - 1], TAIL, MISSING
        fallback_level = self.stored.fallback_level
        return self.stored.input, fallback_level, OWN_REASONS[fallback_level]
