"""The test vectors of protocol/vectors: python -m coxswain.vectors protocol/vectors."""

import json
import sys
from dataclasses import asdict
from pathlib import Path

from .wire import Refused, Wire


def check(folder: Path) -> int:
    """Checks the test vectors in `folder` and returns their count.

    Raises AssertionError if one does not hold.
    """
    assert Wire.crc32c(b"123456789") == 0xE3069283, "CRC-32C"
    count = 0
    for kind in Wire.BODY:
        file = json.loads((folder / f"{kind.__name__}.json").read_text())
        for vector in file["vectors"]:
            data, name = bytes.fromhex(vector["bytes"]), f"{kind.__name__}, {vector['name']}"
            message = Wire.decode(kind, data)
            fields = json.loads(json.dumps(asdict(message)))
            assert fields == vector["fields"], f"{name}: wrong decoding"
            assert Wire.encode(message) == data, f"{name}: wrong encoding"
            damaged = (
                data[:-1],
                data + b"\0",
                data[:8] + bytes([data[8] ^ 1]) + data[9:],
                bytes([data[0] ^ 1]) + data[1:],
                data[:2] + b"\x63" + data[3:],
            )
            for damaged_data in damaged:
                try:
                    Wire.decode(kind, damaged_data)
                except Refused:
                    continue
                raise AssertionError(f"{name}: damaged bytes were accepted")
            count += 1
    return count


def main() -> int:
    """Checks the test vectors in the folder that the argument names."""
    if len(sys.argv) != 2:
        print("usage: python -m coxswain.vectors protocol/vectors", file=sys.stderr)
        return 2
    try:
        print(f"{check(Path(sys.argv[1]))} test vectors hold")
    except (AssertionError, Refused, OSError, ValueError, KeyError) as error:
        print(f"{sys.argv[1]}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
