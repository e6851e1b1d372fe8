"""A whole message <-> bytes: the header of version, kind and checksum, then the fields.

protocol/WIRE.md defines the encoding.
"""

import struct
from typing import Any

from .encoding import Cursor, Refused, record
from .messages import ALL, VERSION, Command, Credit, Health, PlantState, Stamp

Vector = tuple[float, ...]  # forward, left, yaw, or x, y, yaw

__all__ = ["Command", "Credit", "Health", "PlantState", "Refused", "Stamp", "Vector", "Wire"]


class Wire:
    """Encodes and decodes messages: a header of version, kind and checksum, then the fields."""

    HEADER = struct.Struct("<HHI")
    BODY = {kind: record(kind) for kind in ALL}
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
        return cls.HEADER.pack(VERSION, message.KIND, cls.crc32c(body)) + body

    @classmethod
    def decode(cls, kind: Any, data: bytes) -> Any:
        """Decodes `data` as a message of `kind`. Raises Refused if it is not one."""
        cursor = Cursor(data)
        version, number, checksum = cls.HEADER.unpack(cursor.take(cls.HEADER.size))
        if (version, number) != (VERSION, kind.KIND):
            raise Refused(f"unexpected version {version} or kind {number}")
        if cls.crc32c(data[cursor.at :]) != checksum:
            raise Refused("wrong checksum")
        message = cls.BODY[kind].read(cursor)
        if cursor.at != len(data):
            raise Refused("the message is too long")
        return message
