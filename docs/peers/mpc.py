"""CasADi on the reference problem, to stand beside `cargo bench -p controller --bench reference_problem`.

One real-time iteration per period: every stage linearised in one call, of which CasADi generates C that gcc compiles
(-O3 -march=native), and one quadratic program, solved by DAQP. Times are taken around those two calls, without the conversion of their
arguments from and to Python but what they do themselves.

Needs python3, gcc, and: pip install numpy casadi daqp
Usage: taskset -c 1 python3 docs/peers/mpc.py M N
"""
import os
import pathlib
import subprocess
import sys
import tempfile
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
import casadi as ca
import numpy as np
import problem as p


def step_function(points):
    """x, u -> x+: the nominal model by Runge-Kutta, and the mean of the processes at the end of the period."""
    x, u = ca.MX.sym("x", 6), ca.MX.sym("u", 3)

    def slope(x, u):
        sin, cos = ca.sin(x[2]), ca.cos(x[2])
        return ca.vertcat(cos * x[3] - sin * x[4], sin * x[3] + cos * x[4], x[5], (u - x[3:]) / ca.DM(p.TIME_CONSTANT))

    after = p.runge_kutta(slope, x, u, p.PERIOD)
    if points:
        inputs, targets = p.samples(points)
        z, means = ca.vertcat(x[3:], u).T, []
        for scales, variance, weight in zip(p.LENGTH_SCALES, p.VARIANCES, p.weights(inputs, targets)):
            apart = (ca.DM(inputs) - ca.repmat(z, points, 1)) / ca.repmat(ca.DM(scales).T, points, 1)
            means.append(ca.dot(ca.DM(weight), variance * ca.exp(-0.5 * ca.sum2(apart * apart))))
        after += p.PERIOD * ca.vertcat(0, 0, 0, *means)
    return ca.Function("step", [x, u], [after, ca.densify(ca.jacobian(after, x)), ca.densify(ca.jacobian(after, u))])


def compiled(function, folder):
    """The same function from its generated C."""
    name, here = function.name(), os.getcwd()
    os.chdir(folder)
    function.generate(f"{name}.c")
    subprocess.run(["gcc", "-O3", "-march=native", "-fPIC", "-shared", f"{name}.c", "-o", f"{name}.so", "-lm"], check=True)
    os.chdir(here)
    return ca.external(name, str(pathlib.Path(folder) / f"{name}.so"))


class RealTimeIteration:
    """Unknowns stage by stage: x_0 u_0 x_1 u_1 .. x_N; rows: the start, then per stage the dynamics and the wheels."""

    def __init__(self, points, horizon, folder):
        self.horizon, self.plan = horizon, None
        states, inputs = ca.MX.sym("states", 6, horizon), ca.MX.sym("inputs", 3, horizon)
        start, reference = ca.MX.sym("start", 6), ca.MX.sym("reference", 6, horizon + 1)
        after, by_state, by_input = step_function(points).map(horizon)(states, inputs)
        unknowns = 9 * horizon + 6
        rows = [ca.horzcat(ca.MX(ca.DM.eye(6)), ca.MX(6, unknowns - 6))]
        low, high = [start], [start]
        for k in range(horizon):
            a, b = by_state[:, 6 * k:6 * k + 6], by_input[:, 3 * k:3 * k + 3]
            rows.append(ca.horzcat(ca.MX(6, 9 * k), a, b, ca.MX(-ca.DM.eye(6)), ca.MX(6, unknowns - 9 * k - 15)))
            known = a @ states[:, k] + b @ inputs[:, k] - after[:, k]
            rows.append(ca.horzcat(ca.MX(4, 9 * k + 6), ca.MX(ca.DM(p.WHEELS)), ca.MX(4, unknowns - 9 * k - 9)))
            low += [known, -p.RIM_SPEED * ca.DM.ones(4)]
            high += [known, p.RIM_SPEED * ca.DM.ones(4)]
        weights, slopes = [], []
        for k in range(horizon + 1):
            of_state = p.STATE_WEIGHT * (p.TERMINAL_FACTOR if k == horizon else 1.0)
            weights.append(of_state)
            slopes.append(-ca.DM(of_state) * reference[:, k])
            if k < horizon:
                weights.append(p.INPUT_WEIGHT)
                slopes.append(-ca.DM(p.INPUT_WEIGHT) * reference[3:, k])
        matrix = ca.vertcat(*rows)
        linearised = ca.Function(
            "linearised", [states, inputs, start, reference], [matrix, ca.vertcat(*low), ca.vertcat(*high), ca.vertcat(*slopes)])
        self.linearised = compiled(linearised, folder)
        self.hessian = ca.diag(ca.DM(np.concatenate(weights)))
        shape = {"h": self.hessian.sparsity(), "a": linearised.sparsity_out(0)}
        self.solver = ca.conic("solver", "daqp", shape, {"error_on_fail": True})
        free = np.full(3, np.inf)
        bounds = [np.full(6, np.inf), p.LARGEST_INPUT] + [np.r_[free, p.LARGEST_VELOCITY], p.LARGEST_INPUT] * (horizon - 1)
        self.bounds = np.concatenate(bounds + [np.r_[free, p.LARGEST_VELOCITY]])

    def __call__(self, x, reference):
        if self.plan is None:
            self.plan = reference[:-1].T.copy(), reference[:-1, 3:].T.copy()
            self.known = (0, 0, 0)
        begin = time.perf_counter()
        matrix, low, high, slope = self.linearised(*self.plan, x, reference.T)
        linearised = time.perf_counter()
        guess, of_bounds, of_rows = self.known
        found = self.solver(h=self.hessian, g=slope, a=matrix, lba=low, uba=high, lbx=-self.bounds, ubx=self.bounds,
                            x0=guess, lam_x0=of_bounds, lam_a0=of_rows)
        end = time.perf_counter()
        self.known = found["x"], found["lam_x"], found["lam_a"]
        unknowns = np.array(found["x"]).ravel()
        stages, last = unknowns[:-6].reshape(self.horizon, 9), unknowns[-6:]
        self.plan = np.vstack([stages[1:, :6], last]).T.copy(), np.vstack([stages[1:, 6:], stages[-1:, 6:]]).T.copy()
        return stages[0, 6:], {"step": end - begin, "linearise": linearised - begin, "qp": end - linearised}


if __name__ == "__main__":
    points, horizon = (int(argument) for argument in sys.argv[1:3])
    with tempfile.TemporaryDirectory() as folder:
        figures = p.drive(RealTimeIteration(points, horizon, folder), horizon)
    p.say(peer="CasADi, generated C, DAQP", M=points, N=horizon, **figures)
