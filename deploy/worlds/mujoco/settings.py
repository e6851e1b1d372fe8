"""A scenario's `[world.settings]` -> checked dataclasses. SI units; the unit is in each name."""

import math
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any


class Refused(Exception):
    """An invalid setting: its key, and what was expected."""

    def __init__(self, key: str, expected: str) -> None:
        super().__init__(f"{key}: expected {expected}")
        self.key, self.expected = key, expected


def number(default: Any, low: float = -math.inf, high: float = math.inf) -> Any:
    """A field for a finite number, or for a list of them with the length of the default."""
    make = (
        {"default_factory": lambda: list(default)}
        if isinstance(default, list)
        else {"default": default}
    )
    return field(metadata={"range": (low, high)}, **make)


@dataclass
class Body:
    """The base without its wheels: a uniform box with a given centre of mass."""

    mass_kg: float = number(16.0, 0.1, 1e4)
    size_m: list = number([0.5, 0.4, 0.15], 0.01, 10.0)
    centre_of_mass_m: list = number([0.0, 0.0, 0.03], -5.0, 5.0)  # relative to the centre
    rocker_rad: float = number(0.0, 0.0, 0.5)  # tilt of the front axle; 0 is rigid


@dataclass
class Wheels:
    """Four mecanum wheels in O arrangement, each with free rollers at 45 degrees."""

    radius_m: float = number(0.076, 0.01, 1.0)
    half_wheelbase_m: float = number(0.19, 0.01, 5.0)
    half_track_m: float = number(0.22, 0.01, 5.0)
    mass_kg: float = number(1.0, 0.01, 100.0)  # one wheel with its rollers
    rollers: int = number(12, 6, 24)
    axle_friction_nm: float = number(0.05, 0.0, 10.0)  # dry
    axle_damping_nms: float = number(0.005, 0.0, 10.0)
    roller_friction_nm: float = number(0.001, 0.0, 1.0)
    worn: int = number(-1, -1, 3)  # index of the worn wheel; -1 is none
    worn_grip_factor: float = number(0.45, 0.01, 1.0)  # on the friction of its rollers on the floor
    worn_radius_m: float = number(0.001, 0.0, 0.01)  # wear of its rollers
    worn_roller_friction_factor: float = number(5.0, 0.0, 100.0)


@dataclass
class Drive:
    """Motors, gears and speed loops. All values refer to the wheel."""

    torque_constant_nm_per_a: float = number(0.9, 1e-3, 100.0)
    gain_a_s_per_rad: float = number(0.5, 0.0, 1e3)
    gain_factor: float = number(1.0, 0.0, 100.0)  # on both gains of the loop
    integral_a_per_rad: float = number(0.0, 0.0, 1e4)
    current_limit_a: float = number(4.0, 0.01, 1e3)
    supply_v: float = number(24.0, 0.1, 1e3)
    supply_factor: float = number(1.0, 0.01, 10.0)  # on the voltage
    resistance_ohm: float = number(1.0, 1e-3, 1e3)
    back_emf_v_s_per_rad: float = number(0.9, 0.0, 100.0)
    rotor_inertia_kg_m2: float = number(0.004, 1e-6, 10.0)
    wheel_speed_limit_radps: float = number(30.0, 0.1, 1e3)
    command_delay_s: float = number(0.0, 0.0, 1.0)  # dead time between command and speed loop
    reported_delay_s: float = number(0.0, 0.0, 1.0)  # what the driver knows of it
    current_lag_s: float = number(0.0, 0.0, 1.0)  # first-order lag of the current
    command_slew_mps2: float = number(0.0, 0.0, 1e3)  # limit of the commanded rim speed; 0 is none
    backlash_rad: float = number(0.0, 0.0, 0.5)  # total backlash of the gear, at the wheel
    coupling_hz: float = number(0.0, 0.0, 40.0)  # rotor against a held wheel; 0 is rigid


@dataclass
class Floor:
    """A plane, optionally with patches, a ramp and planks."""

    friction: float = number(0.7, 0.01, 3.0)
    patch_friction: float = number(0.0, 0.0, 3.0)  # of every second square; 0 is none
    patch_size_m: float = number(0.6, 0.05, 10.0)
    ramp_rad: float = number(0.0, 0.0, 0.3)  # slope of the floor beyond `ramp_from_m` in x
    ramp_from_m: float = number(0.3, -100.0, 100.0)
    planks: int = number(0, 0, 40)  # flat planks, one every `plank_pitch_m` in x
    plank_height_m: float = number(0.003, 0.0, 0.05)
    plank_width_m: float = number(0.12, 0.01, 10.0)
    plank_pitch_m: float = number(0.4, 0.05, 10.0)


@dataclass
class Load:
    """A load on the base from `at_s` on. It may slide to either side."""

    mass_share: float = number(0.0, 0.0, 10.0)  # share of the mass of the base
    at_s: float = number(0.0, 0.0, 1e5)
    place: list = number([0.0, 0.0], -3.0, 3.0)  # in half wheelbases and half tracks
    play_m: float = number(0.0, 0.0, 5.0)  # how far it slides; 0 is fixed
    friction: float = number(0.1, 0.0, 3.0)  # sliding friction


@dataclass
class Sensor:
    """Standard deviations of the Gaussian noise."""

    position_noise_m: float = number(0.0, 0.0, 1.0)
    heading_noise_rad: float = number(0.0, 0.0, 1.0)
    velocity_noise_mps: float = number(0.0, 0.0, 10.0)
    yaw_rate_noise_radps: float = number(0.0, 0.0, 10.0)
    wheel_speed_noise_radps: float = number(0.0, 0.0, 100.0)
    current_noise_a: float = number(0.0, 0.0, 100.0)


@dataclass
class Settings:
    """All settings of a world."""

    step_s: float = number(0.002, 1e-4, 0.01)
    body: Body = field(default_factory=Body)
    wheels: Wheels = field(default_factory=Wheels)
    drive: Drive = field(default_factory=Drive)
    floor: Floor = field(default_factory=Floor)
    load: Load = field(default_factory=Load)
    sensor: Sensor = field(default_factory=Sensor)


def read(table: dict, kind: type = Settings, path: str = "") -> Any:
    """Reads the settings from `table`. Missing keys have their defaults. Raises `Refused`."""
    known = {entry.name: entry for entry in fields(kind)}
    values = {}
    for key, value in table.items():
        place = f"{path}{key}"
        entry = known.get(key)
        if entry is None:
            raise Refused(place, f"one of {', '.join(known)}")
        if is_dataclass(entry.type):
            if not isinstance(value, dict):
                raise Refused(place, "a table")
            values[key] = read(value, entry.type, f"{place}.")
        else:
            values[key] = checked(entry, value, place)
    return kind(**values)


def checked(entry: Any, value: Any, place: str) -> Any:
    """Returns `value` if it has the type, length and range of `entry`. Raises `Refused`."""
    low, high = entry.metadata["range"]
    if entry.type is list:
        count = len(entry.default_factory())
        good = (
            isinstance(value, list)
            and len(value) == count
            and all(is_within(v, low, high) for v in value)
        )
        expected = f"{count} numbers from {low} to {high}"
    elif entry.type is int:
        good = isinstance(value, int) and not isinstance(value, bool) and low <= value <= high
        expected = f"a whole number from {low} to {high}"
    else:
        good, expected = is_within(value, low, high), f"a number from {low} to {high}"
    if not good:
        raise Refused(place, expected)
    return value


def is_within(value: Any, low: float, high: float) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and low <= value <= high
