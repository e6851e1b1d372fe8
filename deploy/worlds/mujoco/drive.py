"""Drive of one wheel: command -> delay and slew -> speed loop -> current -> torque at the wheel.

    i* = sat(k_p (w* - w) + z)     z' = k_i (w* - w), held while i* is at its limit
    i' = (i* - i) / tau            |R i + K_e w| <= U      torque = K_T i

Optionally, backlash and a spring couple motor and wheel. Then the rotor has its own speed.
"""

import math
from collections import deque

from settings import Drive

DAMPING_RATIO = 0.3  # of the coupling between rotor and wheel


class Wheel:
    """The drive of one wheel. Speeds are the wheel's [rad/s]."""

    def __init__(self, drive: Drive, radius_m: float, step_s: float) -> None:
        self.drive, self.step = drive, step_s
        self.gain = drive.gain_a_s_per_rad * drive.gain_factor
        self.integral_gain = drive.integral_a_per_rad * drive.gain_factor
        self.delayed = deque([0.0] * round(drive.command_delay_s / step_s))
        self.largest_change = drive.command_slew_mps2 / radius_m * step_s or None
        self.target = self.integral = self.current = 0.0
        self.rigid = drive.coupling_hz <= 0.0
        self.stiffness = drive.rotor_inertia_kg_m2 * (2.0 * math.pi * drive.coupling_hz) ** 2
        self.damping = 2.0 * DAMPING_RATIO * math.sqrt(self.stiffness * drive.rotor_inertia_kg_m2)
        self.supply = drive.supply_v * drive.supply_factor
        self.twist = self.rotor_speed = 0.0  # rotor against wheel; rotor

    def torque(self, command: float, wheel_speed: float) -> float:
        """Torque on the wheel for the coming step [N m]."""
        drive, step = self.drive, self.step
        self.delayed.append(command)
        target = self.delayed.popleft()
        fastest = drive.wheel_speed_limit_radps
        target = min(max(target, -fastest), fastest)
        if self.largest_change is not None:
            change = self.largest_change
            target = min(max(target, self.target - change), self.target + change)
        self.target = target
        speed = wheel_speed if self.rigid else self.rotor_speed
        error = target - speed
        current = self.gain * error + self.integral
        limit = drive.current_limit_a
        if abs(current) < limit or current * error < 0.0:
            self.integral += self.integral_gain * error * step
        current = min(max(current, -limit), limit)
        lag = drive.current_lag_s
        self.current += (current - self.current) * step / (lag + step)
        emf = drive.back_emf_v_s_per_rad * speed
        low, high = (side * self.supply - emf for side in (-1.0, 1.0))
        low, high = low / drive.resistance_ohm, high / drive.resistance_ohm
        self.current = min(max(self.current, low), high)
        torque = drive.torque_constant_nm_per_a * self.current
        return torque if self.rigid else self.transmitted(torque, wheel_speed)

    def transmitted(self, torque: float, wheel_speed: float) -> float:
        """Torque through a gear with backlash and a spring. Moves the rotor by one step."""
        drive, step = self.drive, self.step
        play = 0.5 * drive.backlash_rad
        stretch = self.twist - min(max(self.twist, -play), play)
        passed = 0.0
        if stretch != 0.0:
            passed = self.stiffness * stretch + self.damping * (self.rotor_speed - wheel_speed)
            # Gear teeth push but do not pull.
            passed = max(passed, 0.0) if stretch > 0.0 else min(passed, 0.0)
        self.rotor_speed += (torque - passed) / drive.rotor_inertia_kg_m2 * step
        self.twist += (self.rotor_speed - wheel_speed) * step
        return passed

    def measured_speed(self, wheel_speed: float) -> float:
        """Speed from the encoder, which is on the motor."""
        return wheel_speed if self.rigid else self.rotor_speed
