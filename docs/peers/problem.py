"""The reference problem, for peers in Python.

The same numbers as services/controller/tests/reference_problem/problem.rs.
Needs numpy.
"""
import json
import math

import numpy as np

PERIOD = 0.1
TIME_CONSTANT = np.array([0.25, 0.25, 0.2])
LARGEST_INPUT = np.array([3.2, 3.2, 1.05])
LARGEST_VELOCITY = np.array([3.4, 3.4, 1.2])
WHEELS = np.array([[1, 1, 0.275], [1, -1, -0.275], [1, 1, -0.275], [1, -1, 0.275]])
RIM_SPEED = 4.0
STATE_WEIGHT = np.array([20.0, 20.0, 10.0, 1.0, 1.0, 1.0])
INPUT_WEIGHT = np.full(3, 0.5)
TERMINAL_FACTOR = 5.0
SPEED = 2.7
LENGTH_SCALES = np.outer([1.0, 1.1, 0.9], [2.0, 2.0, 1.0, 2.5, 2.5, 1.2])
VARIANCES = [1.0, 1.2, 0.8]
NOISE = 0.05


class SplitMix64:
    """The same numbers for the same seed in every language."""

    MASK = 2**64 - 1

    def __init__(self, seed):
        self.state = seed

    def bits(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & self.MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & self.MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & self.MASK
        return z ^ (z >> 31)

    def uniform(self):
        return (self.bits() >> 11) / 2**53

    def normal(self):
        radius, angle = 1.0 - self.uniform(), self.uniform()
        return math.sqrt(-2.0 * math.log(radius)) * math.cos(2.0 * math.pi * angle)


def missed(v, u, functions=math):
    """The acceleration that the nominal model misses, per axis."""
    (vx, vy, w), (ux, uy, uw) = v, u
    tanh, sin = functions.tanh, functions.sin
    return [
        -0.6 * tanh(1.5 * vx) - 0.15 * vx + 0.25 * vy * w - 0.2 * sin(ux - vx),
        -tanh(1.5 * vy) - 0.25 * vy - 0.25 * vx * w - 0.12 * uy * sin(vx),
        -0.5 * tanh(2.0 * w) + 0.05 * vx * vy + 0.1 * (ux - vx)
        - 0.1 * uw * functions.fabs(vx) / 3.0,
    ]


def samples(count, seed=7):
    """Inputs (v, u) and noisy observations of the missed acceleration."""
    random = SplitMix64(seed)
    inputs, targets = np.zeros((count, 6)), np.zeros((count, 3))
    for i in range(count):
        v = np.array([(2.0 * random.uniform() - 1.0) * limit for limit in LARGEST_INPUT])
        spreads = [0.6, 0.6, 0.3]
        u = np.array([v[axis] + spreads[axis] * random.normal() for axis in range(3)])
        u = np.clip(u, -LARGEST_INPUT, LARGEST_INPUT)
        noise = np.array([random.normal() for _ in range(3)])
        inputs[i], targets[i] = np.r_[v, u], np.array(missed(v, u)) + NOISE * noise
    return inputs, targets


def weights(inputs, targets):
    """(K + sigma^2 I)^-1 y of each output."""
    columns = []
    for scales, variance, observed in zip(LENGTH_SCALES, VARIANCES, targets.T):
        scaled = inputs / scales
        squares = ((scaled[:, None] - scaled[None]) ** 2).sum(-1)
        covariance = variance * np.exp(-0.5 * squares) + NOISE**2 * np.eye(len(inputs))
        columns.append(np.linalg.solve(covariance, observed))
    return columns


def runge_kutta(slope, x, u, step):
    first = slope(x, u)
    second = slope(x + step / 2 * first, u)
    third = slope(x + step / 2 * second, u)
    return x + step / 6 * (first + 2 * second + 2 * third + slope(x + step * third, u))


def reference(periods):
    """Pose and velocity per period along y = -x/2 sin(x/20)."""
    def along(x):
        return 1.0 / math.sqrt(1.0 + steep(x) ** 2)

    def steep(x):
        return -0.5 * math.sin(x / 20) - x / 40 * math.cos(x / 20)

    points, x, step = [], 0.0, SPEED * PERIOD / 20
    for _ in range(periods):
        bend = -0.05 * math.cos(x / 20) + x / 800 * math.sin(x / 20)
        curvature = bend / (1.0 + steep(x) ** 2) ** 1.5
        y, heading = -0.5 * x * math.sin(x / 20), math.atan(steep(x))
        points.append([x, y, heading, SPEED, 0.0, SPEED * curvature])
        for _ in range(20):
            first = along(x)
            second = along(x + step / 2 * first)
            third = along(x + step / 2 * second)
            x += step / 6 * (first + 2 * second + 2 * third + along(x + step * third))
    return np.array(points)


def pushes(periods):
    """Disturbances, added to the state before each period: the pose jumps every forty periods."""
    added = np.zeros((periods, 6))
    for number, period in enumerate(range(0, periods, 40)):
        added[period] = np.array([0.0, 0.8, 0.25, 0.0, 0.0, 0.0]) * (-1) ** number
    return added


def figures(points, states, inputs, times, warm_up=20):
    """Percentiles of the times (microseconds by name), position error and input effort."""
    answer = {"steps": len(states) - warm_up}
    for name, micros in times.items():
        tail = np.percentile(micros[warm_up:], [50, 99]).round(1).tolist()
        answer[f"{name}_p50_us"], answer[f"{name}_p99_us"] = tail
    apart = ((states[:, :2] - points[:len(states), :2]) ** 2).sum(1)
    usum = np.abs(inputs).sum()
    return answer | {"rms_pos_err": round(math.sqrt(apart.mean()), 6), "usum": round(usum, 4)}


def report(**figures):
    print(json.dumps(figures), flush=True)
