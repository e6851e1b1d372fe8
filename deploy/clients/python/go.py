"""Sends a pose to the launch on this machine, and waits until the robot stands there.

Usage: go.py X Y [YAW], in metres and radians. Needs the public package eclipse-zenoh.
"""
import sys
import coxswain


def main() -> None:
    try:
        x, y, *turn = map(float, sys.argv[1:])
        [yaw] = turn or [0.0]
    except ValueError:
        print(__doc__, file=sys.stderr)
        sys.exit(2)
    try:
        with coxswain.Goals(coxswain.running_launch()) as goals:
            number = goals.give_pose(x, y, yaw)
            print(f"goal {number} accepted", flush=True)
            for goal in goals.until_reached(number):
                print(f"left {goal['left_m']:.2f} m, {goal['left_s']:.1f} s", flush=True)
            print(f"goal {number} reached at tick {goal['stamp']['tick']}")
    except coxswain.RequestError as error:
        sys.exit(f"go.py: {error}")


if __name__ == "__main__":
    main()
