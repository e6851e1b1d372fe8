"""Settings -> MuJoCo model: a base on four mecanum wheels. Each roller is a body.

A roller turns freely about an axis at 45 degrees to the axis of the wheel. It is an ellipsoid. With
the half-length sqrt(2 r0 d), the wheel of radius d + r0 is round to second order under each roller.
Here r0 is the radius of a roller at its middle, and d is the distance between its axis and the axis
of the wheel. With twelve rollers, the radius between two rollers is 0.4 % smaller.

Frame: x forward, y left, z up. Wheels: front-right, front-left, rear-left, rear-right.
"""

import math

import mujoco

from settings import Settings

ROLLER_SHARE = 0.2  # share of the radius of the wheel
HUB_SHARE = 0.6
LOAD_SIDE_M = 0.16
GRAVITY = 9.81  # default of MuJoCo [m/s2]
SIGNS = (1, -1, 1, -1)  # the roller axis below each wheel is (1, sign) / sqrt(2)
FLOOR, ROLLERS = 1, 2  # collision bits: rollers touch only the floor

# Rubber on concrete, well damped: it yields about 0.5 mm under a quarter of 20 kg.
CONTACT = 'solref="0.01 1" solimp="0.9 0.95 0.001"'


def places(settings: Settings) -> list[tuple[float, float]]:
    """Positions of the wheels, relative to the centre between them [m]."""
    b, a = settings.wheels.half_wheelbase_m, settings.wheels.half_track_m
    return [(b, -a), (b, a), (-b, a), (-b, -a)]


def model(settings: Settings) -> mujoco.MjModel:
    """The compiled model. Each joint `wheel0` to `wheel3` has a motor. Body `load` is the load."""
    floor, body = settings.floor, settings.body
    low, high = zip(*((c - s / 2, c + s / 2) for c, s in zip(body.centre_of_mass_m, body.size_m)))
    centre = [0.5 * (a + b) for a, b in zip(low, high)]
    half = [0.5 * s for s in body.size_m]
    parts = [
        f'<mujoco><compiler angle="radian" inertiafromgeom="auto"/>'
        f'<option timestep="{settings.step_s}" cone="elliptic" integrator="implicitfast"'
        f' impratio="10"/>'
        f'<default><geom contype="0" conaffinity="0" condim="3" {CONTACT}/></default><worldbody>',
        plane(floor.friction, "0 0 0", "0 0 1"),
    ]
    if floor.ramp_rad > 0.0:
        normal = f"{-math.sin(floor.ramp_rad)} 0 {math.cos(floor.ramp_rad)}"
        parts.append(plane(floor.friction, f"{floor.ramp_from_m} 0 0", normal))
    parts += planks(settings)
    parts.append(
        f'<body name="base" pos="0 0 {settings.wheels.radius_m}"><freejoint/>'
        f'<geom type="box" size="{triple(half)}" pos="{triple(centre)}" mass="{body.mass_kg}"/>'
    )
    wheels = [wheel(settings, index, place) for index, place in enumerate(places(settings))]
    parts += front_axle(settings, wheels[:2])
    parts += wheels[2:]
    parts.append(load(settings))
    motors = "".join(f'<motor joint="wheel{index}"/>' for index in range(4))
    parts.append(f"</body></worldbody><actuator>{motors}</actuator></mujoco>")
    return mujoco.MjModel.from_xml_string("".join(parts))


def plane(friction: float, place: str, normal: str) -> str:
    return (
        f'<geom type="plane" size="100 100 1" pos="{place}" zaxis="{normal}" friction="{friction}"'
        f' contype="{FLOOR}" conaffinity="{ROLLERS}"/>'
    )


def planks(settings: Settings) -> list[str]:
    """Planks across the path, each at a different angle."""
    floor, parts = settings.floor, []
    for index in range(floor.planks):
        x = (index - (floor.planks - 1) / 2) * floor.plank_pitch_m
        turn = 0.5 * math.sin(2.4 * index)
        parts.append(
            f'<geom type="box" size="{floor.plank_width_m / 2} 20 {floor.plank_height_m}"'
            f' pos="{x} 0 0" euler="0 0 {turn}" friction="{floor.friction}"'
            f' contype="{FLOOR}" conaffinity="{ROLLERS}"/>'
        )
    return parts


def front_axle(settings: Settings, wheels: list[str]) -> list[str]:
    """The front wheels. On a rocker, all wheels keep contact with an uneven floor."""
    tilt = settings.body.rocker_rad
    if tilt <= 0.0:
        return wheels
    joint = (
        f'<joint type="hinge" axis="1 0 0" limited="true" range="{-tilt} {tilt}" damping="0.5"/>'
    )
    # The joint needs some inertia besides that of the wheels.
    beam = f'<geom type="box" size="0.02 {settings.wheels.half_track_m} 0.01" mass="0.2"/>'
    return [f'<body name="front">{joint}{beam}', *wheels, "</body>"]


def wheel(settings: Settings, index: int, place: tuple[float, float]) -> str:
    """One wheel with its rollers."""
    wheels, drive = settings.wheels, settings.drive
    rigid = drive.coupling_hz <= 0.0
    armature = drive.rotor_inertia_kg_m2 if rigid else 0.0
    worn = index == wheels.worn
    radius = ROLLER_SHARE * wheels.radius_m
    arm = wheels.radius_m - radius
    half_length = math.sqrt(2.0 * radius * arm)
    radius -= wheels.worn_radius_m if worn else 0.0
    friction = wheels.roller_friction_nm * (wheels.worn_roller_friction_factor if worn else 1.0)
    parts = [
        f'<body name="wheel{index}" pos="{place[0]} {place[1]} 0">'
        f'<joint name="wheel{index}" type="hinge" axis="0 1 0" armature="{armature}"'
        f' damping="{wheels.axle_damping_nms}" frictionloss="{wheels.axle_friction_nm}"/>'
        f'<geom type="cylinder" zaxis="0 1 0" size="{HUB_SHARE * wheels.radius_m} 0.02"'
        f' mass="{0.5 * wheels.mass_kg}"/>'
    ]
    for roller in range(wheels.rollers):
        angle = 2.0 * math.pi * roller / wheels.rollers
        sin, cos = math.sin(angle), math.cos(angle)
        axis = triple([cos / math.sqrt(2), SIGNS[index] / math.sqrt(2), sin / math.sqrt(2)])
        parts.append(
            f'<body pos="{arm * sin} 0 {-arm * cos}">'
            f'<joint type="hinge" axis="{axis}" armature="1e-6" damping="1e-5"'
            f' frictionloss="{friction}"/>'
            f'<geom name="roller{index}-{roller}" type="ellipsoid" zaxis="{axis}"'
            f' size="{radius} {radius} {half_length}" priority="1"'
            f' mass="{0.5 * wheels.mass_kg / wheels.rollers}"'
            f' contype="{ROLLERS}" conaffinity="{FLOOR}"/></body>'
        )
    return "".join(parts) + "</body>"


def load(settings: Settings) -> str:
    """A box on the base, with almost no mass until the load is applied."""
    load, wheels, body = settings.load, settings.wheels, settings.body
    x, y = load.place[0] * wheels.half_wheelbase_m, load.place[1] * wheels.half_track_m
    z = body.centre_of_mass_m[2] + body.size_m[2] / 2 + LOAD_SIDE_M / 2
    joint = ""
    if load.play_m > 0.0:
        friction = load.friction * load.mass_share * body.mass_kg * GRAVITY
        joint = (
            f'<joint name="load" type="slide" axis="0 1 0" limited="true"'
            f' range="{-load.play_m} {load.play_m}" frictionloss="{friction}"/>'
        )
    side = LOAD_SIDE_M / 2
    return (
        f'<body name="load" pos="{x} {y} {z}">{joint}'
        f'<geom type="box" size="{side} {side} {side}" mass="1e-3"/></body>'
    )


def triple(values: list[float]) -> str:
    return " ".join(str(value) for value in values)
