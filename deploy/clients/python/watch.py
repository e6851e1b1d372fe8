"""Prints what a robot does: watch.py tcp/127.0.0.1:7448 [robot [FOLDER]]. Needs the public package eclipse-zenoh.

FOLDER holds a watcher's certificate, for a robot that asks for one: the endpoint is then tls/127.0.0.1:7448.
"""
import json
import signal
import sys
import zenoh

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # who reads no more ends this
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("transport/shared_memory/enabled", "false")  # else a killed client leaves a file in /dev/shm
robot = sys.argv[2] if len(sys.argv) > 2 else "*"
if len(sys.argv) > 3:
    files = {"root_ca_certificate": "authority", "connect_certificate": "certificate", "connect_private_key": "key"}
    for key, file in files.items():
        config.insert_json5(f"transport/link/tls/{key}", json.dumps(f"{sys.argv[3]}/{file}.pem"))
    config.insert_json5("transport/link/tls/enable_mtls", "true")
with zenoh.open(config) as session, session.declare_subscriber(f"coxswain/{robot}/state/json") as states:
    for sample in states:
        state = json.loads(sample.payload.to_string())
        x, y, yaw = state["pose"]
        print(f"tick {state['stamp']['tick']:6}  x {x:8.3f} m  y {y:8.3f} m  yaw {yaw:7.3f} rad  {state['rung']}", flush=True)
