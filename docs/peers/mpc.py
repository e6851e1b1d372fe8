"""CasADi and DAQP on the reference problem.

`cargo bench -p controller --bench reference_problem` measures ours on the same problem.

One real-time iteration per period: linearise every stage, eliminate the states (condensing), solve
the quadratic program in the inputs, predict the states. CasADi generates C for the first two steps.
DAQP is called through its C interface. It keeps its workspace and starts from the last active set,
moved by one stage. `mpc.c` closes the loop, so no Python runs between two clock readings.

Needs python3, gcc, and:
    pip install numpy casadi
    pip download --no-deps --no-binary daqp daqp==0.11.0
Usage: taskset -c 1 python3 docs/peers/mpc.py M N daqp-0.11.0.tar.gz
"""
import ctypes
import pathlib
import subprocess
import sys
import tarfile
import tempfile

import casadi as ca
import numpy as np
import problem as p

# -ffast-math lets gcc evaluate exp for several points at once.
FLAGS = ["-O3", "-march=native", "-ffast-math", "-fPIC"]
# What DAQP's own package is compiled with, and the machine's instructions.
DAQP_FLAGS = ["-O3", "-march=native", "-fPIC",
              "-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math"]


def slope(x, u):
    """Nominal model: the pose follows the body velocity, which lags behind the input."""
    sin, cos = ca.sin(x[2]), ca.cos(x[2])
    lag = (u - x[3:]) / ca.DM(p.TIME_CONSTANT)
    return ca.vertcat(cos * x[3] - sin * x[4], sin * x[3] + cos * x[4], x[5], lag)


def nominal():
    """x, u -> x+ by Runge-Kutta, and its Jacobians."""
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 3)
    after = p.runge_kutta(slope, x, u, p.PERIOD)
    return ca.Function("nominal", [x, u], [after, ca.jacobian(after, x), ca.jacobian(after, u)])


def processes(points):
    """z = (v, u) -> means of the three processes, and their gradients (3 x 6).

    With X and z divided by the length scales l, k = w s exp(X z - |X|^2 / 2 - |z|^2 / 2):
    mean = sum k, gradient = (X' k - mean z) / l. This form runs faster than one that CasADi
    differentiates.
    """
    inputs, targets = p.samples(points)
    z, means, gradients = ca.MX.sym("z", 6), [], []
    for scales, variance, weight in zip(p.LENGTH_SCALES, p.VARIANCES, p.weights(inputs, targets)):
        scaled, at = inputs / scales, z / ca.DM(scales)
        exponent = ca.mac(ca.DM(scaled), at, ca.DM(-0.5 * (scaled**2).sum(1)))
        kernel = ca.DM(variance * weight) * ca.exp(exponent - 0.5 * ca.sumsqr(at))
        mean = ca.sum1(kernel)
        means.append(mean)
        gradients.append(((ca.DM(scaled.T) @ kernel - mean * at) / ca.DM(scales)).T)
    return ca.Function("processes", [z], [ca.vertcat(*means), ca.vertcat(*gradients)])


def stage(points):
    """x, u -> x+ and its Jacobians, nominal model and processes."""
    x, u = ca.MX.sym("x", 6), ca.MX.sym("u", 3)
    after, by_state, by_input = nominal()(x, u)
    if points:
        none = ca.MX(3, 3)
        mean, gradient = processes(points)(ca.vertcat(x[3:], u))
        after += p.PERIOD * ca.vertcat(ca.MX(3, 1), mean)
        by_state += p.PERIOD * ca.blockcat([[none, none], [none, gradient[:, :3]]])
        by_input += p.PERIOD * ca.vertcat(none, gradient[:, 3:])
    return ca.Function("stage", [x, u], [after, by_state, by_input])


def program(by_state, by_input, horizon):
    """A, B, c, start and reference -> the quadratic program in the inputs.

    Outputs: H, g, the rows of the velocities (transposed), their lower and upper limits.

    | here        | in the equations | what                                  |
    |-------------|------------------|---------------------------------------|
    | `a` `b` `c` | A_k, B_k, c_k    | x_k+1 = A_k x_k + B_k u_k + c_k       |
    | `free`      | f_k              | x_k where all inputs are zero         |
    | `forward`   | G_k              | derivative of x_k by u_j, for one j   |
    | `back`      | W_k              | derivative of the cost from k on      |

    For each j, backwards from W_N = Q_N G_N:  H_k,j = B_k' W_k+1,  W_k = Q_k G_k + A_k' W_k+1.
    The cost is O(N^2). Reference: Frison, "Algorithms and methods for fast model predictive
    control", 2015.
    """
    a = [ca.SX.sym(f"a{k}", by_state) for k in range(horizon)]
    b = [ca.SX.sym(f"b{k}", by_input) for k in range(horizon)]
    c = [ca.SX.sym(f"c{k}", 6) for k in range(horizon)]
    start, reference = ca.SX.sym("start", 6), ca.SX.sym("reference", 6, horizon + 1)
    weights = [ca.diag(ca.DM(p.STATE_WEIGHT))] * horizon
    weights.append(ca.diag(ca.DM(p.TERMINAL_FACTOR * p.STATE_WEIGHT)))
    input_weight, limit = ca.diag(ca.DM(p.INPUT_WEIGHT)), ca.DM(p.LARGEST_VELOCITY)

    free = [start]
    for k in range(horizon):
        free.append(a[k] @ free[k] + c[k])
    hessian = [[None] * horizon for _ in range(horizon)]
    rows = [[ca.DM(3, 3)] * horizon for _ in range(horizon)]
    for j in range(horizon):
        forward = {j + 1: b[j]}
        for k in range(j + 1, horizon):
            forward[k + 1] = a[k] @ forward[k]
        back = weights[horizon] @ forward[horizon]
        for k in range(horizon - 1, j, -1):
            hessian[k][j] = b[k].T @ back
            hessian[j][k] = hessian[k][j].T
            back = weights[k] @ forward[k] + a[k].T @ back
        hessian[j][j] = b[j].T @ back + input_weight
        for k in range(j, horizon):
            rows[k][j] = forward[k + 1][3:, :]
    slopes, back = [None] * horizon, weights[horizon] @ (free[horizon] - reference[:, horizon])
    for k in range(horizon - 1, -1, -1):
        slopes[k] = b[k].T @ back - input_weight @ reference[3:, k]
        back = weights[k] @ (free[k] - reference[:, k]) + a[k].T @ back
    return ca.Function("program", [*a, *b, *c, start, reference], [
        ca.densify(ca.blockcat(hessian)), ca.vertcat(*slopes), ca.densify(ca.blockcat(rows).T),
        ca.vertcat(*[-limit - state[3:] for state in free[1:]]),
        ca.vertcat(*[limit - state[3:] for state in free[1:]])])


def condensed(points, horizon):
    """Plan, start and reference -> the quadratic program, and A, B, c of every stage."""
    of_stage = stage(points)
    states, inputs = ca.MX.sym("states", 6, horizon), ca.MX.sym("inputs", 3, horizon)
    start, reference = ca.MX.sym("start", 6), ca.MX.sym("reference", 6, horizon + 1)
    after, by_state, by_input = of_stage.map(horizon)(states, inputs)
    a, b = ca.horzsplit(by_state, 6), ca.horzsplit(by_input, 3)
    c = [after[:, k] - a[k] @ states[:, k] - b[k] @ inputs[:, k] for k in range(horizon)]
    of_stages = program(of_stage.sparsity_out(1), of_stage.sparsity_out(2), horizon)
    return ca.Function("condensed", [states, inputs, start, reference], [
        *of_stages(*a, *b, *c, start, reference),
        ca.densify(by_state), ca.densify(by_input), ca.horzcat(*c)])


def plant():
    """x, u -> the true state one period later."""
    def truth(x, u):
        missed = p.missed(ca.vertsplit(x[3:]), ca.vertsplit(u), ca)
        return slope(x, u) + ca.vertcat(0, 0, 0, *missed)

    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 3)
    after = x
    for _ in range(20):
        after = p.runge_kutta(truth, after, u, p.PERIOD / 20)
    return ca.Function("plant", [x, u], [after])


def compiled(points, horizon, archive, folder):
    """Generated C, `mpc.c` and DAQP as one shared library in the folder."""
    folder = pathlib.Path(folder)
    with tarfile.open(archive) as sources:
        sources.extractall(folder, filter="data")
    daqp = next(folder.glob("daqp-*/csrc"))
    generator = ca.CodeGenerator("generated.c", {"with_header": True})
    generator.add(condensed(points, horizon))
    generator.add(plant())
    generator.generate(f"{folder}/")
    include = [f"-I{folder}", f"-I{daqp}/include", f"-DHORIZON={horizon}"]
    objects = []
    for source in [folder / "generated.c", pathlib.Path(__file__).with_name("mpc.c")]:
        objects.append(folder / f"{source.stem}.o")
        subprocess.run(["gcc", "-c", *FLAGS, *include, source, "-o", objects[-1]], check=True)
    library = folder / "peer.so"
    sources = sorted(daqp.glob("src/*.c"))
    subprocess.run(["gcc", "-shared", *DAQP_FLAGS, *include, *objects, *sources, "-o", library,
                    "-lm"], check=True)
    return library


def drive(library, horizon, periods=320):
    """Reference, states, inputs, and microseconds of each period by part."""
    reference, pushes = p.reference(periods + horizon + 2), p.pushes(periods)
    limits = np.r_[np.tile(p.LARGEST_INPUT, horizon), np.full(4 * horizon, p.RIM_SPEED)]
    wheels = np.kron(np.eye(horizon), p.WHEELS)
    states, inputs, micros = (np.zeros((periods, width)) for width in (6, 3, 4))
    arrays = [reference, pushes, limits, wheels, states, inputs, micros]
    failed = ctypes.CDLL(str(library)).drive(
        periods, *[array.ctypes.data_as(ctypes.c_void_p) for array in arrays])
    if failed:
        sys.exit(f"period {failed - 1}: DAQP has no solution")
    return reference, states, inputs, micros


def main():
    points, horizon, archive = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    with tempfile.TemporaryDirectory() as folder:
        library = compiled(points, horizon, archive, folder)
        reference, states, inputs, micros = drive(library, horizon)
    times = dict(zip(["step", "linearise", "qp", "predict"], micros.T))
    figures = p.figures(reference, states, inputs, times)
    p.report(peer="CasADi, condensed, generated C, DAQP", M=points, N=horizon, **figures)


if __name__ == "__main__":
    main()
