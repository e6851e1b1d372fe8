"""Draws robots at random, and writes a world of them into a new folder.

The folder gets what this one has, with other robots. Each robot has its own size, mass, motors,
speed loop, floor and speed. Its believed robot has errors as a data sheet has. The conditions are
some of those here and some pairs of them.
"""

import argparse
import json
import math
import random
import re
import shutil
from pathlib import Path

HERE = Path(__file__).parent
REFERENCES = ["circle", "eight", "square", "slalom"]
# As their file here has them.
KNOWN = ["nominal", "slippery", "patches", "boards", "worn", "lagging", "late-60"]
# Setting by setting.
PAIRS = {
    "late-and-worn": {"drive": "command_delay_s = 0.04", "wheels": "worn = 2"},
    "soft-play": {"drive": "gain_factor = 0.45\nbacklash_rad = 0.02\ncoupling_hz = 20.0"},
    "loaded-slippery": {
        "load": "mass_share = 0.5\nat_s = 8.0\nplace = [-0.5, 0.5]",
        "floor": "friction = 0.25",
    },
    "lag-ramp": {
        "drive": "current_lag_s = 0.02\ncommand_delay_s = 0.03",
        "floor": "ramp_rad = 0.07",
    },
    "stiff": {"drive": "gain_factor = 2.0"},
    "heavy": {"load": "mass_share = 0.8\nat_s = 0.0\nplace = [0.0, -0.3]"},
}
BELIEVED = """# What a data sheet would say of {name}.

[wheels.mecanum]
radius_m = {radius:.5f}
wheelbase_m = {wheelbase:.4f}
track_m = {track:.4f}

[body]
mass_kg = {mass:.3f}
yaw_inertia_kg_m2 = {yaw_inertia:.5f}
wheel_inertia_kg_m2 = {wheel_inertia:.7f}
axle_friction_nms = {axle_friction:.6f}

[drive]
pole_pairs = 1
torque_constant_nm_per_a = {torque_constant:.4f}
speed_loop_gain_a_s_per_rad = {gain:.5f}
current_limit_a = {current_limit:.4f}
wheel_speed_limit_radps = {speed_limit:.3f}

[limits]
input_mps = {top:.3f}
yaw_input_radps = {yaw_top:.3f}
input_rate_mps2 = 20.0
yaw_input_rate_radps2 = 50.0
brake_mps2 = {brake:.2f}
yaw_brake_radps2 = 8.0
"""


class Draw:
    """A robot drawn with `rng`: what it is, and what is believed of it."""

    def __init__(self, rng: random.Random) -> None:
        def within(low: float, high: float) -> float:
            return rng.uniform(low, high)

        def scale(low: float, high: float) -> float:
            return math.exp(rng.uniform(math.log(low), math.log(high)))

        def about(value: float, error: float) -> float:
            return value * within(1 - error, 1 + error)

        mass = scale(4, 120)
        size = (mass / 6) ** 0.37  # sizes grow with the mass
        radius = 0.04 * size * within(0.85, 1.2)
        half_wheelbase = 0.09 * size * within(0.8, 1.4)
        half_track = 0.1 * size * within(0.8, 1.3)
        wheel_mass = 0.03 * mass
        top = within(0.9, 2.2)
        speed_limit = 1.15 * top / radius
        acceleration = within(2.5, 8)  # at the limit of the currents
        torque = mass * acceleration * radius / 4
        constant = scale(0.1, 2.0)
        limit = torque / constant
        gain = mass * radius**2 / 4 / (constant * scale(0.03, 0.25))
        integral = 0.0 if rng.random() < 0.4 else gain * within(2, 12)
        # The voltage reaches the largest current until six tenths of the largest speed.
        volts = 24.0
        ohm = (volts - 0.6 * constant * speed_limit) / (1.6 * limit)
        while ohm <= 0 or constant * speed_limit > 0.8 * volts:
            volts *= 1.5
            ohm = (volts - 0.6 * constant * speed_limit) / (1.6 * limit)
        friction = within(0.45, 0.9)
        length, width = 2.8 * half_wheelbase, 2 * half_track
        speed_factor = within(0.4, 0.8) * min(1.0, top / 1.8)
        centre = [within(-0.1, 0.1) * half_wheelbase, within(-0.1, 0.1) * half_track]
        centre.append(within(0.3, 0.6) * radius)
        #: Of the body and of a wheel.
        self.masses = [f"{mass - 4 * wheel_mass:.3f}", f"{wheel_mass:.4f}"]
        self.settings = {
            "speed_factor": f"{speed_factor:.3f}",
            "centre_of_mass_m": "[" + ", ".join(f"{value:.4f}" for value in centre) + "]",
            "size_m": f"[{length:.4f}, {width:.4f}, {1.8 * radius:.4f}]",
            "radius_m": f"{radius:.5f}",
            "half_wheelbase_m": f"{half_wheelbase:.4f}",
            "half_track_m": f"{half_track:.4f}",
            "axle_friction_nm": f"{torque * within(0.005, 0.04):.5f}",
            "axle_damping_nms": f"{torque * within(0.0005, 0.003):.6f}",
            "roller_friction_nm": f"{torque * within(0.0001, 0.0008):.6f}",
            "torque_constant_nm_per_a": f"{constant:.4f}",
            "gain_a_s_per_rad": f"{gain:.5f}",
            "integral_a_per_rad": f"{integral:.5f}",
            "current_limit_a": f"{limit:.4f}",
            "supply_v": f"{volts:.2f}",
            "resistance_ohm": f"{ohm:.5f}",
            "back_emf_v_s_per_rad": f"{constant:.4f}",
            "rotor_inertia_kg_m2": f"{0.1 * mass * radius**2 / 4:.7f}",
            "wheel_speed_limit_radps": f"{speed_limit:.3f}",
            "friction": f"{friction:.3f}",
        }
        self.believed = {
            "radius": about(radius, 0.01),
            "wheelbase": 2 * half_wheelbase,
            "track": 2 * half_track,
            "mass": about(mass, 0.1),
            "yaw_inertia": about(mass * (length**2 + width**2) / 12, 0.2),
            "wheel_inertia": about(0.5 * wheel_mass * radius**2, 0.3),
            "axle_friction": 0.002 * torque,
            "torque_constant": about(constant, 0.1),
            "gain": about(gain, 0.2),
            "current_limit": limit,
            "speed_limit": speed_limit,
            "top": top,
            "yaw_top": min(10, top / (half_wheelbase + half_track)),
            "brake": min(3, 0.6 * acceleration),
        }

    def scenario(self, text: str) -> str:
        """The scenario `text` of a robot, with the settings of this one."""
        masses = iter(self.masses)
        text = re.sub(r"(?m)^mass_kg = .*$", lambda _: f"mass_kg = {next(masses)}", text)
        for key, value in self.settings.items():
            text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
            if count != 1:
                raise SystemExit(f"draw.py: {key}: expected once in courier.toml, found {count}")
        return re.sub('^description = ".*"', 'description = "A robot drawn at random."', text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the world is written; it must not exist")
    parser.add_argument("--seed", type=int, required=True, help="the seed of the robots")
    parser.add_argument("--count", type=int, default=16, help="number of robots")
    parser.add_argument(
        "--cells",
        type=int,
        default=8,
        choices=range(1, len(REFERENCES) * len(KNOWN + [*PAIRS]) + 1),
        metavar="N",
        help="print so many cells of each robot, drawn at random, for `--scenarios`",
    )
    options = parser.parse_args()
    folder = options.folder
    if folder.exists():
        parser.error(f"{folder}: expected a folder that does not exist yet")
    shutil.copytree(HERE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(HERE / "../../scenarios/profiles", folder / "profiles")
    courier = (HERE / "courier.toml").read_text()
    graph = (HERE / "graphs/courier.toml").read_text()
    names = [f"drawn-{number}" for number in range(options.count)]
    rng = random.Random(options.seed)
    for name in names:
        robot = Draw(rng)
        (folder / f"{name}.toml").write_text(robot.scenario(courier))
        (folder / f"robots/{name}.toml").write_text(BELIEVED.format(name=name, **robot.believed))
        (folder / f"graphs/{name}.toml").write_text(graph.replace("courier", name))
    for name, settings in PAIRS.items():
        tables = [f"[world.settings.{table}]\n{lines}\n" for table, lines in settings.items()]
        (folder / f"variants/{name}.toml").write_text("\n".join(tables))
    grid = {"robots": names, "references": REFERENCES, "conditions": [*KNOWN, *PAIRS]}
    lines = [f"{key} = {json.dumps(value)}\n" for key, value in grid.items()]
    (folder / "grid.toml").write_text("".join(lines))
    chosen = random.Random(1)
    ways = [f"{way}+{condition}" for way in REFERENCES for condition in grid["conditions"]]
    cells = [f"{name}+{pair}" for name in names for pair in chosen.sample(ways, options.cells)]
    print(",".join(cells))


if __name__ == "__main__":
    main()
