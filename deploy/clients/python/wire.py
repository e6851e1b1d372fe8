"""The encoding of the messages of a robot driver: state, command, credit and health.

protocol/WIRE.md defines the encoding.
"""

import json
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, get_type_hints

Vector = tuple[float, float, float]  # forward, left, yaw, or x, y, yaw


class Refused(Exception):
    """The bytes are not a valid message of the expected kind."""


class Cursor:
    """Bytes, and the position of the next one to read."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        self.at += count
        if self.at > len(self.data):
            raise Refused("the message is too short")
        return self.data[self.at - count : self.at]


class Codec(NamedTuple):
    """Encoder and decoder of the values of one type."""

    write: Callable[[Any], bytes]
    read: Callable[[Cursor], Any]


def varint(limit: int) -> Codec:
    """Integers below `limit`, seven bits per byte."""

    def write(value: int) -> bytes:
        low, high = value & 0x7F, value >> 7
        return bytes([low | 0x80]) + write(high) if high else bytes([low])

    def read(cursor: Cursor) -> int:
        value, shift, more = 0, 0, True
        while more:
            byte = cursor.take(1)[0]
            value, shift, more = value | (byte & 0x7F) << shift, shift + 7, byte >= 0x80
            if value >= limit or shift > 70:
                raise Refused("an integer is too large for its field")
        return value

    return Codec(write, read)


def numbers(count: int) -> Codec:
    """`count` numbers of 64 bits."""
    form = struct.Struct(f"<{count}d")
    return Codec(
        lambda values: form.pack(*values), lambda cursor: form.unpack(cursor.take(form.size))
    )


def several(item: Codec, count: int) -> Codec:
    """`count` items."""
    return Codec(
        lambda values: b"".join(map(item.write, values)),
        lambda cursor: tuple(item.read(cursor) for _ in range(count)),
    )


def sequence(item: Codec, longest: int) -> Codec:
    """Up to `longest` items, after their count."""
    length = varint(longest + 1)
    return Codec(
        lambda values: length.write(len(values)) + several(item, len(values)).write(values),
        lambda cursor: several(item, length.read(cursor)).read(cursor),
    )


def record(kind: type) -> Codec:
    """The fields of a dataclass in their order."""
    hints = get_type_hints(kind, include_extras=True)
    fields = {name: hint.__metadata__[0] for name, hint in hints.items() if name != "KIND"}
    return Codec(
        lambda value: b"".join(codec.write(getattr(value, name)) for name, codec in fields.items()),
        lambda cursor: kind(**{name: codec.read(cursor) for name, codec in fields.items()}),
    )


def text(longest: int) -> Codec:
    """Text of up to `longest` bytes."""
    byte = Codec(lambda value: bytes([value]), lambda cursor: cursor.take(1)[0])
    raw = sequence(byte, longest)

    def read(cursor: Cursor) -> str:
        try:
            return bytes(raw.read(cursor)).decode()
        except UnicodeDecodeError as error:
            raise Refused("a text is not UTF-8") from error

    return Codec(lambda value: raw.write(value.encode()), read)


def one_of(allowed: tuple[int, ...]) -> Codec:
    """Integers from a list of allowed values."""
    write, read_any = varint(1 << 32)

    def read(cursor: Cursor) -> int:
        value = read_any(cursor)
        if value not in allowed:
            raise Refused("a code is not valid in its field")
        return value

    return Codec(write, read)


U32, U64, FALLBACK_LEVEL, REASON = varint(1 << 32), varint(1 << 64), varint(7), varint(21)
FLAG, WHEELS, GATE_STATE, PARTICIPANT = varint(2), varint(9), varint(4), varint(6)
ROW, EIGHT, COUNTS = numbers(3), numbers(8), several(U64, 8)
ONE = Codec(
    lambda value: struct.pack("<d", value),
    lambda cursor: struct.unpack("<d", cursor.take(8))[0],
)
STOPS = (0, 17, 18)  # reasons for which a controller may request a stop


@dataclass(frozen=True)
class Stamp:
    writer: Annotated[int, U64]
    epoch: Annotated[int, U64]
    sequence: Annotated[int, U64]
    tick: Annotated[int, U64]
    sent_nanos: Annotated[int, U64]


STAMP = record(Stamp)


@dataclass(frozen=True)
class PlantState:
    KIND: ClassVar[int] = 1
    stamp: Annotated[Stamp, STAMP]
    pose: Annotated[Vector, ROW]
    velocity: Annotated[Vector, ROW]
    wheel_speed: Annotated[tuple[float, ...], EIGHT]
    current: Annotated[tuple[float, ...], EIGHT]
    input: Annotated[Vector, ROW]
    input_delay_s: Annotated[float, ONE]
    controller_epoch: Annotated[int, U64]
    accepted_epoch: Annotated[int, U64]
    accepted_tick: Annotated[int, U64]
    refused: Annotated[int, U64]
    fallback_level: Annotated[int, FALLBACK_LEVEL]
    reason: Annotated[int, REASON]
    wheels: Annotated[int, WHEELS]
    wheel_speed_valid: Annotated[int, FLAG]
    current_valid: Annotated[int, FLAG]
    estop: Annotated[int, FLAG]
    gate: Annotated[int, GATE_STATE]
    stop: Annotated[int, REASON]


@dataclass(frozen=True)
class Command:
    KIND: ClassVar[int] = 2
    stamp: Annotated[Stamp, STAMP]
    plant_epoch: Annotated[int, U64]
    model_version: Annotated[int, U64]
    input: Annotated[Vector, ROW]
    tail: Annotated[tuple[Vector, ...], sequence(ROW, 4)]
    fallback_level: Annotated[int, FALLBACK_LEVEL]
    stop: Annotated[int, one_of(STOPS)] = 0


@dataclass(frozen=True)
class Credit:
    KIND: ClassVar[int] = 4
    stamp: Annotated[Stamp, STAMP]
    through_tick: Annotated[int, U64]
    participant: Annotated[int, PARTICIPANT]


@dataclass(frozen=True)
class Health:
    KIND: ClassVar[int] = 7
    stamp: Annotated[Stamp, STAMP]
    participant: Annotated[int, PARTICIPANT]
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
    sent: Annotated[tuple[int, ...], COUNTS]
    received: Annotated[tuple[int, ...], COUNTS]
    lost: Annotated[tuple[int, ...], COUNTS]
    refused: Annotated[tuple[int, ...], COUNTS]
    dropped: Annotated[tuple[int, ...], COUNTS]
    error: Annotated[str, text(120)]


class Wire:
    """Encodes and decodes messages: a header of version, kind and checksum, then the fields."""

    VERSION = 6
    HEADER = struct.Struct("<HHI")
    BODY = {kind: record(kind) for kind in (PlantState, Command, Credit, Health)}
    TABLE: list[int] = []  # checksum table, one entry per byte value
    for _byte in range(256):
        for _ in range(8):
            _byte = _byte >> 1 ^ (0x82F63B78 if _byte & 1 else 0)
        TABLE.append(_byte)

    @classmethod
    def crc32c(cls, data: bytes) -> int:
        remainder = 0xFFFFFFFF
        for byte in data:
            remainder = remainder >> 8 ^ cls.TABLE[(remainder ^ byte) & 0xFF]
        return remainder ^ 0xFFFFFFFF

    @classmethod
    def encode(cls, message: Any) -> bytes:
        body = cls.BODY[type(message)].write(message)
        return cls.HEADER.pack(cls.VERSION, message.KIND, cls.crc32c(body)) + body

    @classmethod
    def decode(cls, kind: type, data: bytes) -> Any:
        """Decodes `data` as a message of `kind`. Raises Refused if it is not one."""
        cursor = Cursor(data)
        version, number, checksum = cls.HEADER.unpack(cursor.take(cls.HEADER.size))
        if (version, number) != (cls.VERSION, kind.KIND):
            raise Refused(f"unexpected version {version} or kind {number}")
        if cls.crc32c(data[cursor.at :]) != checksum:
            raise Refused("wrong checksum")
        message = cls.BODY[kind].read(cursor)
        if cursor.at != len(data):
            raise Refused("the message is too long")
        return message

    @classmethod
    def check(cls, folder: Path) -> int:
        """Checks the test vectors in `folder` and returns their count.

        Raises AssertionError if one does not hold.
        """
        assert cls.crc32c(b"123456789") == 0xE3069283, "CRC-32C"
        count = 0
        for kind in cls.BODY:
            file = json.loads((folder / f"{kind.__name__}.json").read_text())
            for vector in file["vectors"]:
                data, name = bytes.fromhex(vector["bytes"]), f"{kind.__name__}, {vector['name']}"
                message = cls.decode(kind, data)
                fields = json.loads(json.dumps(asdict(message)))
                assert fields == vector["fields"], f"{name}: wrong decoding"
                assert cls.encode(message) == data, f"{name}: wrong encoding"
                damaged = (
                    data[:-1],
                    data + b"\0",
                    data[:8] + bytes([data[8] ^ 1]) + data[9:],
                    bytes([data[0] ^ 1]) + data[1:],
                    data[:2] + b"\3" + data[3:],
                )
                for damaged_data in damaged:
                    try:
                        cls.decode(kind, damaged_data)
                    except Refused:
                        continue
                    raise AssertionError(f"{name}: damaged bytes were accepted")
                count += 1
        return count
