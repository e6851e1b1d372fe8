"""Prints what a robot does: watch.py ENDPOINT [ROBOT [FOLDER of a watcher's certificate]]. Needs the public package eclipse-zenoh."""
import json
import os
import signal
import sys
import zenoh

os.environ["ZENOH_RUNTIME"] = "(rx:(handover:tx),acc:(handover:net))"  # else TLS damages zenoh's memory (its issue 2557)
signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # who reads no more ends this
settings = {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}
settings["transport/shared_memory/enabled"] = False  # else a killed client leaves a file in /dev/shm
if len(sys.argv) > 3:
    files = {"root_ca_certificate": "authority", "connect_certificate": "certificate", "connect_private_key": "key"}
    settings["transport/link/tls"] = {key: f"{sys.argv[3]}/{file}.pem" for key, file in files.items()} | {"enable_mtls": True}
config = zenoh.Config()
for key, value in settings.items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session, session.declare_subscriber(f"coxswain/{(sys.argv + ['*'])[2]}/state/json") as states:
    for s in (json.loads(sample.payload.to_string()) for sample in states):
        print("tick {:6}  x {:8.3f} m  y {:8.3f} m  yaw {:7.3f} rad  {}".format(s["stamp"]["tick"], *s["pose"], s["fallback_level"]), flush=True)
