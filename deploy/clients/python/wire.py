"""A whole message <-> bytes: the header of version, kind and checksum, then the fields.

protocol/WIRE.md defines the encoding.
"""

import json
import struct
from dataclasses import asdict
from pathlib import Path
from typing import Any

from encoding import Cursor, Refused, record
from messages import ALL, VERSION, Command, Credit, Health, PlantState, Stamp

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
    def decode(cls, kind: type, data: bytes) -> Any:
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
                    data[:2] + b"\x63" + data[3:],
                )
                for damaged_data in damaged:
                    try:
                        cls.decode(kind, damaged_data)
                    except Refused:
                        continue
                    raise AssertionError(f"{name}: damaged bytes were accepted")
                count += 1
        return count
