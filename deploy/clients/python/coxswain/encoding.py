"""Values of the messages <-> bytes. protocol/WIRE.md defines the encoding."""

import struct
from collections.abc import Callable
from typing import Any, NamedTuple, get_type_hints


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
        value: int = read_any(cursor)
        if value not in allowed:
            raise Refused("a code is not valid in its field")
        return value

    return Codec(write, read)


U32, U64 = varint(1 << 32), varint(1 << 64)
REAL = Codec(
    lambda value: struct.pack("<d", value),
    lambda cursor: struct.unpack("<d", cursor.take(8))[0],
)
