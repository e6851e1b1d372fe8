"""The messages of WIRE.md, except ModelSnapshot.

Written from the definitions in protocol/src/message by
`cargo test --workspace --test vectors -- --ignored`.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from .encoding import REAL, U32, U64, numbers, one_of, record, sequence, several, text, varint

VERSION = 11


@dataclass(frozen=True)
class Stamp:
    """The writer and time of a message."""

    writer: Annotated[int, U64]
    epoch: Annotated[int, U64]
    sequence: Annotated[int, U64]
    tick: Annotated[int, U64]
    sent_nanos: Annotated[int, U64]


STAMP = record(Stamp)


@dataclass(frozen=True)
class PlantState:
    """The message on the topic state."""

    KIND: ClassVar[int] = 1
    stamp: Annotated[Stamp, STAMP]
    pose: Annotated[tuple[float, ...], numbers(3)]
    velocity: Annotated[tuple[float, ...], numbers(3)]
    wheel_speed: Annotated[tuple[float, ...], numbers(8)]
    current: Annotated[tuple[float, ...], numbers(8)]
    input: Annotated[tuple[float, ...], numbers(3)]
    input_delay_s: Annotated[float, REAL]
    controller_epoch: Annotated[int, U64]
    accepted_epoch: Annotated[int, U64]
    accepted_tick: Annotated[int, U64]
    refused: Annotated[int, U64]
    fallback_level: Annotated[int, varint(7)]
    reason: Annotated[int, varint(27)]
    wheels: Annotated[int, varint(9)]
    wheel_speed_valid: Annotated[int, varint(2)]
    current_valid: Annotated[int, varint(2)]
    estop: Annotated[int, varint(2)]
    gate: Annotated[int, varint(4)]
    stop: Annotated[int, varint(27)]


@dataclass(frozen=True)
class Command:
    """The message on the topic command."""

    KIND: ClassVar[int] = 2
    stamp: Annotated[Stamp, STAMP]
    plant_epoch: Annotated[int, U64]
    model_version: Annotated[int, U64]
    input: Annotated[tuple[float, ...], numbers(3)]
    tail: Annotated[tuple[tuple[float, ...], ...], sequence(numbers(3), 4)]
    fallback_level: Annotated[int, varint(7)]
    stop: Annotated[int, one_of([0, 17, 18])]


@dataclass(frozen=True)
class ResidualSample:
    """The message on the topic residual."""

    KIND: ClassVar[int] = 3
    stamp: Annotated[Stamp, STAMP]
    plant_epoch: Annotated[int, U64]
    fingerprint: Annotated[int, U64]
    pose: Annotated[tuple[float, ...], numbers(3)]
    velocity: Annotated[tuple[float, ...], numbers(3)]
    input: Annotated[tuple[float, ...], numbers(3)]
    input_before: Annotated[tuple[float, ...], numbers(3)]
    dead_time_s: Annotated[float, REAL]
    residual: Annotated[tuple[float, ...], numbers(3)]
    usable: Annotated[int, varint(2)]


@dataclass(frozen=True)
class Plan:
    """The message on the topic plan."""

    KIND: ClassVar[int] = 6
    stamp: Annotated[Stamp, STAMP]
    plant_epoch: Annotated[int, U64]
    model_version: Annotated[int, U64]
    status: Annotated[int, varint(6)]
    iterations: Annotated[int, U32]
    fallback_level: Annotated[int, varint(7)]
    learned_axes: Annotated[int, varint(8)]
    delay_micros: Annotated[int, U32]
    tick_nanos: Annotated[int, U64]
    linearise_nanos: Annotated[int, U64]
    solve_nanos: Annotated[int, U64]
    disturbance: Annotated[tuple[float, ...], numbers(3)]
    innovation: Annotated[tuple[float, ...], numbers(3)]
    residual: Annotated[tuple[float, ...], numbers(3)]
    predicted: Annotated[tuple[tuple[float, ...], ...], sequence(numbers(6), 41)]
    reference: Annotated[tuple[tuple[float, ...], ...], sequence(numbers(6), 41)]
    variance: Annotated[tuple[tuple[float, ...], ...], sequence(numbers(3), 41)]
    input: Annotated[tuple[tuple[float, ...], ...], sequence(numbers(3), 40)]


@dataclass(frozen=True)
class Health:
    """The message on the topic health."""

    KIND: ClassVar[int] = 7
    stamp: Annotated[Stamp, STAMP]
    participant: Annotated[int, varint(6)]
    phase: Annotated[int, varint(5)]
    pid: Annotated[int, U32]
    exposure: Annotated[int, varint(3)]
    heartbeat: Annotated[int, U64]
    deadlines_met: Annotated[int, U64]
    deadlines_missed: Annotated[int, U64]
    stalled_nanos: Annotated[int, U64]
    model_version: Annotated[int, U64]
    learned_axes: Annotated[int, U64]
    models_left: Annotated[int, U64]
    snapshots: Annotated[int, U64]
    snapshots_refused: Annotated[int, U64]
    sent: Annotated[tuple[int, ...], several(U64, 10)]
    received: Annotated[tuple[int, ...], several(U64, 10)]
    lost: Annotated[tuple[int, ...], several(U64, 10)]
    refused: Annotated[tuple[int, ...], several(U64, 10)]
    dropped: Annotated[tuple[int, ...], several(U64, 10)]
    last_error: Annotated[str, text(120)]


@dataclass(frozen=True)
class Truth:
    """The message on the topic truth."""

    KIND: ClassVar[int] = 5
    stamp: Annotated[Stamp, STAMP]
    pose: Annotated[tuple[float, ...], numbers(3)]
    velocity: Annotated[tuple[float, ...], numbers(3)]
    force: Annotated[tuple[float, ...], numbers(3)]
    wheel_command: Annotated[tuple[float, ...], numbers(8)]
    wheel_peak: Annotated[tuple[float, ...], numbers(8)]
    acting_epoch: Annotated[int, U64]
    acting_writer: Annotated[int, U64]
    acting_tick: Annotated[int, U64]
    acting_age_nanos: Annotated[int, U64]
    takeovers: Annotated[int, U32]
    takeovers_back: Annotated[int, U32]
    fallback_level: Annotated[int, varint(7)]
    reason: Annotated[int, varint(27)]
    wheels: Annotated[int, varint(9)]


@dataclass(frozen=True)
class Credit:
    """The message on the topic credit."""

    KIND: ClassVar[int] = 4
    stamp: Annotated[Stamp, STAMP]
    through_tick: Annotated[int, U64]
    participant: Annotated[int, varint(6)]


@dataclass(frozen=True)
class Goal:
    """The message on the topic goal."""

    KIND: ClassVar[int] = 9
    stamp: Annotated[Stamp, STAMP]
    id: Annotated[int, U64]
    plant_epoch: Annotated[int, U64]
    begins_at_tick: Annotated[int, U64]
    ends_at_tick: Annotated[int, U64]
    target: Annotated[tuple[float, ...], numbers(3)]
    progress: Annotated[float, REAL]
    left_m: Annotated[float, REAL]
    left_s: Annotated[float, REAL]
    kind: Annotated[int, varint(4)]
    phase: Annotated[int, varint(4)]


@dataclass(frozen=True)
class Obstacles:
    """The message on the topic obstacles."""

    KIND: ClassVar[int] = 10
    stamp: Annotated[Stamp, STAMP]
    plant_epoch: Annotated[int, U64]
    age_s: Annotated[float, REAL]
    valid_s: Annotated[float, REAL]
    source: Annotated[int, varint(2)]
    obstacles: Annotated[tuple[tuple[float, ...], ...], sequence(numbers(19), 64)]


ALL = (PlantState, Command, ResidualSample, Plan, Health, Truth, Credit, Goal, Obstacles)
