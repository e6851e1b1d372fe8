"""Prints a robot's state: watch.py ENDPOINT [ROBOT [CERTIFICATE_FOLDER]]. Needs eclipse-zenoh."""
import json, os, signal, sys
import zenoh
os.environ["ZENOH_RUNTIME"] = "(rx:(handover:tx),acc:(handover:net))"  # for TLS: zenoh issue 2557
signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end when the output is closed
off = ["scouting/multicast/enabled", "transport/shared_memory/enabled"]  # no files in /dev/shm
settings = {"mode": "client", "connect/endpoints": [sys.argv[1]]} | dict.fromkeys(off, False)
if len(sys.argv) > 3:
    files = {"root_ca_certificate": "authority", "connect_certificate": "certificate",
             "connect_private_key": "key"}
    tls = {key: f"{sys.argv[3]}/{file}.pem" for key, file in files.items()}
    settings["transport/link/tls"] = tls | {"enable_mtls": True}
config = zenoh.Config()
for key, value in settings.items():
    config.insert_json5(key, json.dumps(value))
topic = f"coxswain/{(sys.argv + ['*'])[2]}/state/json"
with zenoh.open(config) as session, session.declare_subscriber(topic) as states:
    for s in (json.loads(sample.payload.to_string()) for sample in states):
        line = "tick {:6}  x {:8.3f} m  y {:8.3f} m  yaw {:7.3f} rad  {}"
        print(line.format(s["stamp"]["tick"], *s["pose"], s["fallback_level"]), flush=True)
