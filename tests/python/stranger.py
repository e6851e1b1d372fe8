"""An unauthenticated peer at a gateway, which publishes forged messages.

For each state that it receives, it publishes well-formed messages on every key of a message.

Usage: stranger.py ENDPOINT VECTORS_DIR. Fails if a subscriber receives a forged message.
"""

import json
import sys
from pathlib import Path

import zenoh

TOPICS = {
    "state": "PlantState",
    "command": "Command",
    "residual": "ResidualSample",
    "snapshot": "ModelSnapshot",
    "plan": "Plan",
    "health": "Health",
    "truth": "Truth",
    "credit": "Credit",
    "goal": "Goal",
    "obstacles": "Obstacles",
}


def join(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    # Otherwise a killed client leaves a file in /dev/shm.
    config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


endpoint, vectors = sys.argv[1], Path(sys.argv[2])
forged = {
    topic: json.loads((vectors / f"{message}.json").read_text())["vectors"]
    for topic, message in TOPICS.items()
}
with (
    join(endpoint) as witness,
    join(endpoint) as forger,
    witness.declare_subscriber("coxswain/*/state/json") as states,
):
    for count, sample in enumerate(states, 1):
        state = json.loads(sample.payload.to_string())
        if "forged" in state:
            sys.exit("a subscriber received a forged message")
        for topic, messages in forged.items():
            for message in messages:
                for key in (f"coxswain/mecanum/{topic}", f"coxswain-link/mecanum/{topic}/data/1"):
                    forger.put(key, bytes.fromhex(message["bytes"]))
            forger.put(f"coxswain/mecanum/{topic}/json", '{"forged": true}')
            forger.delete(f"coxswain/mecanum/{topic}")
        print(f"round {count} at tick {state['stamp']['tick']}", flush=True)
