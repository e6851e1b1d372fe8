"""A stranger at a gateway: with each state that is heard, says well-formed messages on every key that a message could have.

stranger.py ENDPOINT VECTORS_DIR. Ends with an error if anybody would have heard it.
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
}


def join(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # else a killed client leaves a file in /dev/shm
    return zenoh.open(config)


endpoint, vectors = sys.argv[1], Path(sys.argv[2])
words = {topic: json.loads((vectors / f"{message}.json").read_text())["vectors"] for topic, message in TOPICS.items()}
with join(endpoint) as witness, join(endpoint) as forger, witness.declare_subscriber("coxswain/*/state/json") as states:
    for count, sample in enumerate(states, 1):
        state = json.loads(sample.payload.to_string())
        if "forged" in state:
            sys.exit("what a stranger says is heard")
        for topic, said in words.items():
            for word in said:
                for key in (f"coxswain/mecanum/{topic}", f"coxswain-link/mecanum/{topic}/data/1"):
                    forger.put(key, bytes.fromhex(word["bytes"]))
            forger.put(f"coxswain/mecanum/{topic}/json", '{"forged": true}')
            forger.delete(f"coxswain/mecanum/{topic}")
        print(f"round {count} at tick {state['stamp']['tick']}", flush=True)
