"""A mecanum robot in a contact simulator (MuJoCo), driven over standard input and output.

The peer is the `driver` of Coxswain. services/driver/src/piped.rs defines the protocol: one JSON
object per line, the settings first. The sources are textbooks and the manual of MuJoCo. The code
shares nothing with `plant-sim`, so an error there is not repeated here.
"""

import json
import math
import random
import sys
from typing import Any

import mujoco
import numpy

import robot
from drive import Wheel
from settings import Refused, Settings, read

SETTLE_S = 0.5  # time for the robot to come to rest before the clock starts


class World:
    """A robot, its floor and the clock."""

    def __init__(self, settings: Settings, start: dict, seed: int) -> None:
        self.settings = settings
        self.model = robot.model(settings)
        self.data = mujoco.MjData(self.model)
        self.random = random.Random(seed)
        radius, step = settings.wheels.radius_m, settings.step_s
        self.drives = [Wheel(settings.drive, radius, step) for _ in range(4)]
        joints = [self.model.joint(f"wheel{index}") for index in range(4)]
        self.speeds_at = [int(joint.dofadr[0]) for joint in joints]
        self.load = self.model.body("load").id
        self.load_pending = settings.load.mass_share > 0.0
        self.rollers = [self.rollers_of(wheel) for wheel in range(4)]
        self.grip = [0.0] * 4
        lever = settings.wheels.half_wheelbase_m + settings.wheels.half_track_m
        self.wheels_of = lambda v: (
            (v[0] + v[1] + lever * v[2]) / radius,
            (v[0] - v[1] - lever * v[2]) / radius,
            (v[0] + v[1] - lever * v[2]) / radius,
            (v[0] - v[1] + lever * v[2]) / radius,
        )
        self.steps = self.owed_nanos = self.turns = 0
        self.step_nanos = round(settings.step_s * 1e9)
        self.place(start, joints)

    def rollers_of(self, wheel: int) -> numpy.ndarray:
        """Indices of the geoms of the rollers of a wheel."""
        names = ((geom, self.model.geom(geom).name) for geom in range(self.model.ngeom))
        return numpy.array([geom for geom, name in names if name.startswith(f"roller{wheel}-")])

    def place(self, start: dict, joints: list) -> None:
        """Places the robot on the floor at its start, at rest, and resets the clock."""
        x, y, yaw = start["pose"]
        qpos = self.data.qpos
        qpos[0:2] = x, y
        floor = self.settings.floor
        rise = max(x - floor.ramp_from_m, 0.0) * math.tan(floor.ramp_rad)
        qpos[2] = self.settings.wheels.radius_m + rise
        qpos[3:7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        for joint in joints:
            qpos[int(joint.qposadr[0])] = self.random.uniform(0.0, 2.0 * math.pi)
        self.yaw = yaw
        for _ in range(round(SETTLE_S / self.settings.step_s)):
            self.step((0.0, 0.0, 0.0, 0.0))
        self.steps = 0

    def drive(self, velocity: list, nanos: int) -> None:
        """Simulates `nanos` with this body velocity as the command of the drives.

        The rest of a step is carried over to the next call.
        """
        due = self.owed_nanos + nanos
        wheels = self.wheels_of(velocity)
        for _ in range(due // self.step_nanos):
            self.step(wheels)
        self.owed_nanos = due % self.step_nanos

    def step(self, wheels: tuple) -> None:
        data = self.data
        if self.load_pending and self.time() >= self.settings.load.at_s:
            self.apply_load()
        self.update_grip()
        for index, (drive, at) in enumerate(zip(self.drives, self.speeds_at)):
            data.ctrl[index] = drive.torque(wheels[index], float(data.qvel[at]))
        mujoco.mj_step(self.model, data)
        self.steps += 1
        turned = self.heading() - self.yaw
        self.yaw += turned - 2.0 * math.pi * round(turned / (2.0 * math.pi))

    def apply_load(self) -> None:
        mass = self.settings.load.mass_share * self.settings.body.mass_kg
        self.model.body_mass[self.load] = mass
        self.model.body_inertia[self.load] = mass * robot.LOAD_SIDE_M**2 / 6.0  # of a cube
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
        self.load_pending = False

    def update_grip(self) -> None:
        """Sets the friction between the floor and each wheel."""
        floor, wheels = self.settings.floor, self.settings.wheels
        for index, place in enumerate(robot.places(self.settings)):
            friction = floor.friction
            if floor.patch_friction > 0.0:
                cos, sin = math.cos(self.yaw), math.sin(self.yaw)
                x = float(self.data.qpos[0]) + cos * place[0] - sin * place[1]
                y = float(self.data.qpos[1]) + sin * place[0] + cos * place[1]
                if (math.floor(x / floor.patch_size_m) + math.floor(y / floor.patch_size_m)) % 2:
                    friction = floor.patch_friction
            if index == wheels.worn:
                friction *= wheels.worn_grip_factor
            if friction != self.grip[index]:
                self.grip[index] = friction
                self.model.geom_friction[self.rollers[index], 0] = friction

    def heading(self) -> float:
        w, x, y, z = (float(value) for value in self.data.qpos[3:7])
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def time(self) -> float:
        return self.steps * self.settings.step_s

    def state(self) -> dict:
        """True pose and body velocity, in the plane."""
        data = self.data
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        along, across = float(data.qvel[0]), float(data.qvel[1])
        turning = data.xmat[1].reshape(3, 3) @ data.qvel[3:6]
        return {
            "pose": [float(data.qpos[0]), float(data.qpos[1]), self.yaw],
            "velocity": [cos * along + sin * across, cos * across - sin * along, float(turning[2])],
        }

    def measure(self) -> dict:
        """Sensor readings, and the truth."""
        truth, sensor = self.state(), self.settings.sensor
        noise = self.random.gauss
        planar, turning = sensor.position_noise_m, sensor.heading_noise_rad
        speed, rate = sensor.velocity_noise_mps, sensor.yaw_rate_noise_radps
        wheels = zip(self.drives, self.speeds_at)
        speeds = [drive.measured_speed(float(self.data.qvel[at])) for drive, at in wheels]
        of_pose, of_velocity = (planar, planar, turning), (speed, speed, rate)
        return {
            "pose": [value + noise(0.0, by) for value, by in zip(truth["pose"], of_pose)],
            "velocity": [v + noise(0.0, by) for v, by in zip(truth["velocity"], of_velocity)],
            "wheel_speed": [value + noise(0.0, sensor.wheel_speed_noise_radps) for value in speeds],
            "current": [
                drive.current + noise(0.0, sensor.current_noise_a) for drive in self.drives
            ],
            "input_delay_s": self.settings.drive.reported_delay_s,
            "truth": truth,
        }


def send(message: dict) -> None:
    sys.stdout.write(json.dumps(message, allow_nan=False) + "\n")
    sys.stdout.flush()


def begin(first: dict) -> World | None:
    """Creates the world from the first line. Reports an invalid setting and returns None."""
    try:
        return World(read(first["settings"]), first["start"], first["seed"])
    except Refused as refused:
        send({"refused": {"key": refused.key, "expected": refused.expected}})
        return None


def main() -> int:
    world = begin(json.loads(sys.stdin.readline()))
    if world is None:
        return 2
    send({"ready": {"wheels": 4}})
    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        if "drive" in request:
            world.drive(request["drive"], request["nanos"])
        else:
            send(world.measure())
    return 0


if __name__ == "__main__":
    sys.exit(main())
