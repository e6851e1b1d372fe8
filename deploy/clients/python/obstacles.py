"""Streams obstacles to the launch on this machine, ten lists per second.

Usage: obstacles.py FILE [SECONDS], with a list as JSON. Ends with Ctrl-C, or after the seconds.
"""
import json
import sys
import time
from pathlib import Path

import coxswain

PAUSE_S = 0.1


def main() -> None:
    try:
        file, *given = sys.argv[1:]
        [seconds] = map(float, given or ["inf"])
    except ValueError:
        print(__doc__, file=sys.stderr)
        sys.exit(2)
    try:
        planned, begin = json.loads(Path(file).read_text()), time.monotonic()
        with coxswain.Obstacles(coxswain.running_launch()) as obstacles:
            while time.monotonic() < begin + seconds:
                obstacles.send(planned)
                time.sleep(PAUSE_S)
                for obstacle in planned["obstacles"]:
                    by = [PAUSE_S * speed for speed in obstacle.get("velocity_mps", (0, 0))]
                    corners = obstacle["corners_m"]
                    obstacle["corners_m"] = [[x + by[0], y + by[1]] for x, y in corners]
    except (coxswain.RequestError, OSError, ValueError) as error:
        sys.exit(f"obstacles.py: {error}")


if __name__ == "__main__":
    main()
