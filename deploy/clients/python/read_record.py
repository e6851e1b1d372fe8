"""Figures of a record, with the public MCAP reader alone. Needs the package mcap.

Usage: read_record.py RUN
RUN is a run directory of `coxswain launch`. Prints the number of messages of each topic, and the
RMS of the position error from 3 s on, as each plan knew it.
"""
import collections
import json
import math
import pathlib
import sys

from mcap.exceptions import McapError
from mcap.reader import make_reader

SETTLED_S = 3.0  # figures begin here


def errors(run: pathlib.Path, counts: collections.Counter) -> list[tuple[float, float]]:
    """(time [s], position error [m]) of each plan; counts the messages of each topic."""
    found = []
    for file in sorted(run.glob("record*.mcap")):
        with open(file, "rb") as opened:
            reader = make_reader(opened)
            of_run = next((m.metadata for m in reader.iter_metadata() if m.name == "coxswain"), {})
            if "period_nanos" not in of_run:
                sys.exit(f"{file}: expected a record of Coxswain, with its control period")
            period_s = 1e-9 * int(of_run["period_nanos"])
            for _, channel, message in reader.iter_messages():
                counts[channel.topic] += 1
                if channel.topic == "plan":
                    plan = json.loads(message.data)
                    (x, y, *_), (x_ref, y_ref, *_) = plan["predicted"][0], plan["reference"][0]
                    time = period_s * plan["stamp"]["tick"]
                    found.append((time, math.hypot(x - x_ref, y - y_ref)))
    return found


def main() -> None:
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        sys.exit(2)
    counts: collections.Counter = collections.Counter()
    try:
        found = errors(pathlib.Path(sys.argv[1]), counts)
    except McapError as error:
        sys.exit(f"{sys.argv[1]}: the record cannot be read: {error!r}")
    if not found:
        sys.exit(f"no plan in a record of {sys.argv[1]}")
    for topic, count in sorted(counts.items()):
        print(f"topic {topic} messages {count}")
    settled = [error for time, error in found if time >= SETTLED_S]
    if settled:
        print(f"position_rmse_m {math.sqrt(sum(e * e for e in settled) / len(settled))}")


if __name__ == "__main__":
    main()
