"""Draws the position error of a robot live. Needs the public package eclipse-zenoh.

Usage: error_live.py tcp/127.0.0.1:7448 [robot]
"""
import json
import math
import os
import queue
import signal
import sys
import zenoh

TIMEOUT_S = 5.0  # longest time without a plan
MIN_M, MAX_M, BAR = 1e-4, 10.0, 40  # range and length of the bar; the scale is logarithmic


def bar(error: float) -> str:
    share = math.log(max(error, MIN_M) / MIN_M) / math.log(MAX_M / MIN_M)
    return "█" * round(min(share, 1.0) * BAR)


def draw(plans: queue.Queue) -> None:
    while True:
        plan = json.loads(plans.get(timeout=TIMEOUT_S))
        (x, y, *_), (x_ref, y_ref, *_) = plan["predicted"][0], plan["reference"][0]
        error = math.hypot(x - x_ref, y - y_ref)
        print(f"tick {plan['stamp']['tick']:6}  error {error:8.4f} m  {bar(error)}", flush=True)


def main() -> None:
    if len(sys.argv) not in (2, 3):
        print(__doc__, file=sys.stderr)
        sys.exit(2)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores SIGINT
    endpoint, robot = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "*"
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("connect/timeout_ms", "0")  # one attempt
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # no files in /dev/shm
    plans = queue.Queue()
    try:
        key = f"coxswain/{robot}/plan/json"
        receive = lambda sample: plans.put(sample.payload.to_string())
        with zenoh.open(config) as session, session.declare_subscriber(key, receive):
            draw(plans)
    except zenoh.ZError:
        sys.exit(f"no router answers at {endpoint}")
    except queue.Empty:
        sys.exit(f"no plan from a robot at {endpoint} for {TIMEOUT_S:.0f} s")
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:  # Python must not flush again when it exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
