"""Checks that a record is complete: sent = stored + lost, for each topic and writer.

| count  | source                                                         |
|--------|----------------------------------------------------------------|
| stored | messages that the public MCAP reader finds                     |
| sent   | last health of each writer                                     |
| lost   | gaps in the sequence numbers; the recorder must count the same |

Usage: python3 docs/record_complete.py RUN
RUN is the run directory of a run that has ended. Needs tests/python/requirements.txt.
Exit code 1 if the counts differ.
"""

import json
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader

folder = Path(sys.argv[1])
stored: Counter[tuple[str, int, int]] = Counter()
last: dict[tuple[str, int, int], int] = {}
healths: dict[int, dict] = {}
files = sorted(folder.glob("record*.mcap"), key=lambda file: (len(file.name), file.name))
for file in files:
    with open(file, "rb") as opened:
        for _, channel, message in make_reader(opened).iter_messages():
            fields = json.loads(message.data)
            if "stamp" not in fields:  # a drawing for viewers, which the recorder made
                continue
            stamp = fields["stamp"]
            key = (channel.topic, stamp["writer"], stamp["epoch"])
            if stamp["sequence"] <= last.get(key, 0):  # a restarted recorder receives it again
                continue
            stored[key] += 1
            last[key] = stamp["sequence"]
            if channel.topic == "health":
                healths[stamp["writer"]] = fields

wrong = []
gaps: Counter[str] = Counter()
print(f"{'topic':<9} {'writer':<11} {'epoch':>5} {'sent':>8} {'stored':>8} {'lost':>5}")
for key in sorted(stored):
    topic, writer, epoch = key
    health = healths.get(writer, {"participant": "unknown", "sent": {}, "stamp": {"epoch": None}})
    participant = health["participant"]
    # A writer reports the counts of its current epoch. They may or may not include the health
    # message that reports them.
    reported = health["sent"].get(topic, 0) if health["stamp"]["epoch"] == epoch else None
    sent = last[key] if topic == "health" or reported is None else reported
    lost = last[key] - stored[key]
    gaps[topic] += lost
    print(f"{topic:<9} {participant:<11} {epoch:>5} {sent:>8} {stored[key]:>8} {lost:>5}")
    if sent != stored[key] + lost:
        wrong.append(f"{topic} of {participant}: {sent} sent, {stored[key]} stored, {lost} lost")
    if topic == "health" and reported is not None and last[key] - reported not in (0, 1):
        wrong.append(f"health of {participant}: {reported} sent, last stored number {last[key]}")

counted: Counter[str] = Counter()
for health in healths.values():
    if health["participant"] == "recorder":
        counted.update(health["lost"])
summary = json.loads((folder / "summary.json").read_text())
for topic, lost in gaps.items():
    reported = summary["losses"][topic]["recorder"]
    if not lost == reported == counted[topic]:
        wrong.append(f"{topic}: {lost} missing, {reported} in the summary, "
                     f"{counted[topic]} counted by the recorder")

size = sum(file.stat().st_size for file in files)
print(f"{sum(stored.values())} messages in {len(files)} file(s) of {size / 1e6:.0f} MB, "
      f"{sum(gaps.values())} lost")
sys.exit("\n".join(wrong) or None)
