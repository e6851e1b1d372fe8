"""Whether a record is complete: what each writer says it sent = what is stored + what the recorder counted as lost.

python3 docs/record_complete.py RUN, the folder of a run that has ended; in an environment with tests/python/requirements.txt.
It believes nobody: what is stored is counted by the public MCAP reader, what was sent is told by each writer's last health, what was lost
by the recorder's, and gaps in the sequence numbers must say the same. Exit code 1 if something does not add up.
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
            says = json.loads(message.data)
            if "stamp" not in says:  # drawn for viewers, sent by nobody
                continue
            stamp = says["stamp"]
            key = (channel.topic, stamp["writer"], stamp["epoch"])
            if stamp["sequence"] <= last.get(key, 0):  # a restarted recorder is told the last one once more
                continue
            stored[key] += 1
            last[key] = stamp["sequence"]
            if channel.topic == "health":
                healths[stamp["writer"]] = says

wrong = []
gaps: Counter[str] = Counter()
print(f"{'topic':<9} {'writer':<11} {'epoch':>5} {'sent':>8} {'stored':>8} {'lost':>5}")
for key in sorted(stored):
    topic, writer, epoch = key
    who = healths.get(writer, {"participant": "unknown", "sent": {}, "stamp": {"epoch": None}})
    # A writer tells its counts of the present epoch; its last health is in them or, written while it was sent, not yet.
    told = who["sent"].get(topic, 0) if who["stamp"]["epoch"] == epoch else None
    sent = last[key] if topic == "health" or told is None else told
    lost = last[key] - stored[key]
    gaps[topic] += lost
    print(f"{topic:<9} {who['participant']:<11} {epoch:>5} {sent:>8} {stored[key]:>8} {lost:>5}")
    if sent != stored[key] + lost:
        wrong.append(f"{who['participant']} sent {sent} of {topic}, {stored[key]} are stored and {lost} lost")
    if topic == "health" and told is not None and last[key] - told not in (0, 1):
        wrong.append(f"{who['participant']} says that it sent {told} of health, and the last one stored is number {last[key]}")

counted: Counter[str] = Counter()
for health in healths.values():
    if health["participant"] == "recorder":
        counted.update(health["lost"])
summary = json.loads((folder / "summary.json").read_text())
for topic, lost in gaps.items():
    told = summary["losses"][topic]["recorder"]
    if not lost == told == counted[topic]:
        wrong.append(f"{topic}: {lost} missing, {told} in the summary, {counted[topic]} counted by the recorder")

size = sum(file.stat().st_size for file in files)
print(f"{sum(stored.values())} messages in {len(files)} file(s) of {size / 1e6:.0f} MB, {sum(gaps.values())} lost")
sys.exit("\n".join(wrong) or None)
