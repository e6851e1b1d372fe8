"""What a robot driver does with commands: the limits of the robot, and which command acts on its wheels, by the duties of protocol/WIRE.md."""
import math
import re
from dataclasses import dataclass
from pathlib import Path

from wire import Command, Vector

NOTHING: Vector = (0.0, 0.0, 0.0)
ROUNDING = 1 + 1e-6  # a command at a limit may be beyond it by so much
WAITING, TAIL, BRAKE, LATCHED = 0, 4, 5, 6  # fallback levels
NONE, NO_COMMAND_YET, MISSING, MALFORMED, NOT_FINITE, OUT_OF_BOUNDS, RATE_TOO_HIGH, OLD_PLANT_EPOCH = range(8)  # reasons
OLD_CONTROLLER_EPOCH, SECOND_WRITER, TOO_OLD, NOT_NEWER, FROM_THE_FUTURE, SOLVER_FAILED, BAD_STATE, STOPPING, RECOVERING = range(8, 17)
POSITION_ERROR, HEADING_ERROR, EMERGENCY_STOP, IS_DISARMED, NO_PLAN = range(17, 22)
DISARMED, ARMED, DRIVING, STOPPED = range(4)  # states of the gate
OWN_REASONS = {0: NONE, 1: NONE, 2: SOLVER_FAILED, 3: NO_PLAN, 4: SOLVER_FAILED, 5: BAD_STATE, 6: BAD_STATE}  # of a controller's fallback level


@dataclass(frozen=True)
class Limits:
    """What the robot may be asked, from its file, and the control period."""

    period: float
    input: Vector
    rate: Vector
    brake: Vector
    wheel_speed: float
    wheel_radius: float
    lever: float

    @classmethod
    def read(cls, file: Path, period: float) -> "Limits":
        found = {key: float(value) for key, value in re.findall(r"^(\w+)\s*=\s*([-+.\deE]+)", file.read_text(), re.MULTILINE)}

        def plane_and_yaw(plane: str, yaw: str) -> Vector:
            return (found[plane], found[plane], found[yaw])

        return cls(
            period=period,
            input=plane_and_yaw("input_mps", "yaw_input_radps"),
            rate=plane_and_yaw("input_rate_mps2", "yaw_input_rate_radps2"),
            brake=plane_and_yaw("brake_mps2", "yaw_brake_radps2"),
            wheel_speed=found["wheel_speed_limit_radps"],
            wheel_radius=found["wheel_radius_m"],
            lever=found["half_wheelbase_m"] + found["half_track_m"],
        )

    def wheels(self, velocity: Vector) -> tuple[float, ...]:
        """Wheel speeds of a body velocity [rad/s]: front-right, front-left, rear-left, rear-right."""
        forward, left, turn = velocity[0], velocity[1], self.lever * velocity[2]
        rims = (forward + left + turn, forward - left - turn, forward + left - turn, forward - left + turn)
        return tuple(rim / self.wheel_radius for rim in rims)

    def allow(self, velocity: Vector) -> bool:
        within = all(abs(value) <= most * ROUNDING for value, most in zip(velocity, self.input))
        return within and all(abs(wheel) <= self.wheel_speed * ROUNDING for wheel in self.wheels(velocity))

    def allow_step(self, before: Vector, after: Vector) -> bool:
        return all(abs(b - a) <= 2.2 * rate * self.period * ROUNDING for a, b, rate in zip(before, after, self.rate))


class Gate:
    """Which command acts on the wheels: duties 1 and 3 to 10. Times are seconds of one clock."""

    def __init__(self, limits: Limits, epoch: int, delay: float, armed: bool = True) -> None:
        self.limits, self.epoch, self.delay = limits, epoch, delay
        self.tick = 0
        self.published: dict[int, float] = {}
        self.stored: Command | None = None
        self.since = 0.0  # publication of the state that the stored command answers
        self.last_heard = 0.0  # of the present writer
        self.refused = 0
        self.acting = self.begun_with = NOTHING
        self.state, self.stop_reason = ARMED if armed else DISARMED, NONE
        self.estop = self.braking = False
        self.good_periods = 0
        self.past = (WAITING, NO_COMMAND_YET)  # fallback level and reason of the past period
        self.worst = (WAITING, NONE)  # of the present one
        self.last_refusal = NONE

    def begin(self, tick: int, now: float) -> None:
        """A period begins with the publication of `tick`."""
        self.tick = tick
        self.published[tick] = now
        self.published.pop(tick - 8, None)
        self.worst, self.last_refusal = (WAITING, NONE), NONE
        self.begun_with = self.acting

    def end(self) -> None:
        """A period is over: duties 8 and 9."""
        answered = self.stored is not None and self.stored.stamp.tick == self.tick
        fallback_level, why = self.worst
        if self.state == STOPPED:
            fallback_level, why = LATCHED, self.stop_reason
        elif self.state == DISARMED:
            fallback_level, why = WAITING, IS_DISARMED
        elif self.stored is None:
            fallback_level, why = WAITING, NO_COMMAND_YET
        elif self.braking:
            fallback_level, why = BRAKE, RECOVERING if answered else MISSING
        elif answered:
            fallback_level, why = self.stored.fallback_level, OWN_REASONS[self.stored.fallback_level]
        self.past = (fallback_level, self.last_refusal or why)
        self.good_periods = self.good_periods + 1 if answered and self.braking else 0

    def stop(self, reason: int) -> None:
        """Duty 10: brakes and stands until it is resumed."""
        if self.state != STOPPED:
            self.state, self.stop_reason = STOPPED, reason

    def set_estop(self, pressed: bool) -> None:
        """Duty 10: the robot's own emergency stop."""
        self.estop = pressed
        if pressed:
            self.stop(EMERGENCY_STOP)

    def order(self, order: str) -> bool:
        """Duty 10, what a person orders, "arm" or "resume": whether it had a meaning."""
        if self.state != {"arm": DISARMED, "resume": STOPPED}[order] or self.estop:
            return False
        if order == "resume":
            self.braking, self.good_periods = self.stored is not None, 0
        self.state, self.stop_reason = ARMED, NONE
        return True

    def hear(self, command: Command | None, now: float) -> int:
        """Stores a command, or says why not; None stands for bytes that are none."""
        reason = self._judge(command, now) if command else MALFORMED
        if command and self.stored and command.stamp.writer == self.stored.stamp.writer:
            self.last_heard = now
        if reason == NONE:
            self.stored, self.since, self.last_heard = command, self.published[command.stamp.tick], now
            self.braking = self.braking and (self.good_periods < 3 or command.stamp.tick != self.tick)
            if command.stop != NONE:
                self.stop(command.stop)
            elif self.state == ARMED and not self.braking:
                self.state = DRIVING
        else:
            self.refused, self.last_refusal = self.refused + 1, reason
        return reason

    def _judge(self, command: Command, now: float) -> int:
        """Duty 3, in its order."""
        inputs, stamp, present, period = (command.input, *command.tail), command.stamp, self.stored, self.limits.period
        if not all(math.isfinite(value) for row in inputs for value in row):
            return NOT_FINITE
        if not all(map(self.limits.allow, inputs)):
            return OUT_OF_BOUNDS
        if command.plant_epoch != self.epoch:
            return OLD_PLANT_EPOCH
        if present and stamp.epoch < present.stamp.epoch:
            return OLD_CONTROLLER_EPOCH
        second = present and stamp.epoch == present.stamp.epoch and stamp.writer != present.stamp.writer
        if second and now - self.last_heard < 3 * period:
            return SECOND_WRITER
        if stamp.tick > self.tick:
            return FROM_THE_FUTURE
        last = present and (present.stamp.epoch, present.stamp.tick)
        if last and (stamp.tick < last[1] or (stamp.epoch, stamp.tick) == last):
            return NOT_NEWER
        published = self.published.get(stamp.tick)
        if published is None or now - published > 1.5 * period + self.delay:
            return TOO_OLD
        age = int((now - published) / period + 1e-9)
        first = inputs[age : age + 1]  # what acts first, if anything does
        steps = [*zip(inputs, command.tail), *((before, after) for before in (self.begun_with, self.acting) for after in first)]
        if not all(self.limits.allow_step(*step) for step in steps):
            return RATE_TOO_HIGH
        return NONE

    def play(self, now: float, elapsed: float) -> Vector:
        """Body velocity for the wheels from `now` on, `elapsed` seconds after the last: duties 6 and 7."""
        chosen, fallback_level, why = self._choose(now)
        self.worst = max(self.worst, (fallback_level, why))
        if chosen is None:
            ramp = (math.copysign(max(abs(v) - b * elapsed, 0.0), v) for v, b in zip(self.acting, self.limits.brake))
            chosen = tuple(ramp)
        self.acting = chosen
        return chosen

    def _choose(self, now: float) -> tuple[Vector | None, int, int]:
        if self.state == STOPPED:
            self.braking = True
            return None, LATCHED, self.stop_reason
        if self.state == DISARMED:
            return NOTHING, WAITING, IS_DISARMED
        if self.stored is None:
            return NOTHING, WAITING, NO_COMMAND_YET
        age = int((now - self.since) / self.limits.period + 1e-9)
        missing = age >= 3 or age > len(self.stored.tail)
        self.braking |= missing
        if self.braking:
            return None, BRAKE, MISSING if missing else RECOVERING
        return (self.stored.tail[age - 1], TAIL, MISSING) if age else (self.stored.input, self.stored.fallback_level, OWN_REASONS[self.stored.fallback_level])
