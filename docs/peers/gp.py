"""Fits of Gaussian processes by peers.

`cargo bench -p model --bench learner` measures ours on the same problem.

Three outputs over six inputs; squared-exponential kernel with a length scale per input, and noise.
L-BFGS-B starts from length scales 1, variance 1 and noise 0.1, within [1e-3, 1e3] (noise: from
1e-6). At most 100 iterations, no restarts. Seconds are processor time of one thread.

| peer       | likelihood and gradient                              |
|------------|------------------------------------------------------|
| `scipy`    | written by hand, through LAPACK                      |
| `gpytorch` | exact inference of GPyTorch, with a Cholesky factor  |

Needs python3 and: pip install numpy scipy            (gpytorch: also torch gpytorch)
Usage: taskset -c 1 python3 docs/peers/gp.py scipy|gpytorch N
"""
import os
import sys
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
import numpy as np
import problem as p
from scipy.linalg import lapack
from scipy.optimize import minimize

LOW = np.log([1e-3] * 7 + [1e-6])
HIGH = np.log([1e3] * 8)
START = np.log([1.0] * 7 + [0.1])


class ByHand:
    """Negative log likelihood of one output, and its gradient.

    The variables are the logarithms of length scales, variance and noise.
    """

    def __init__(self, inputs, target):
        self.inputs, self.target = inputs, target

    def __call__(self, logarithms):
        scales = np.exp(logarithms[:6])
        variance, noise = np.exp(logarithms[6]), np.exp(logarithms[7])
        count, scaled = len(self.target), self.inputs / scales
        squares = (scaled**2).sum(1)
        distances = squares[:, None] + squares - 2 * scaled @ scaled.T
        kernel = variance * np.exp(-0.5 * np.maximum(distances, 0.0))
        covariance = kernel.copy()
        covariance.flat[::count + 1] += noise
        factor, failed = lapack.dpotrf(covariance, lower=1, overwrite_a=1)
        if failed:
            return 1e25, np.zeros(8)
        weights, _ = lapack.dpotrs(factor, self.target, lower=1)
        value = 0.5 * self.target @ weights + np.log(factor.diagonal()).sum()
        value += 0.5 * count * np.log(2 * np.pi)
        inverse, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
        slope = np.tril(inverse) + np.tril(inverse, -1).T - np.outer(weights, weights)
        by_noise = 0.5 * noise * np.trace(slope)
        slope *= kernel
        sums = slope.sum(1)
        by_scales = sums @ scaled**2 - (scaled * (slope @ scaled)).sum(0)
        return value, np.r_[by_scales, 0.5 * sums.sum(), by_noise]


class ByGpytorch:
    """The same function, computed by GPyTorch."""

    def __init__(self, inputs, target):
        import gpytorch
        import torch

        torch.set_num_threads(1)
        torch.set_default_dtype(torch.float64)
        self.torch, self.count = torch, len(target)
        self.inputs, self.target = torch.tensor(inputs), torch.tensor(target.copy())
        kernel = gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernel(ard_num_dims=6))
        constraint = gpytorch.constraints.GreaterThan(1e-7)
        likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=constraint)

        class Exact(gpytorch.models.ExactGP):
            def __init__(self, inputs, target):
                super().__init__(inputs, target, likelihood)
                self.mean, self.kernel = gpytorch.means.ZeroMean(), kernel

            def forward(self, x):
                return gpytorch.distributions.MultivariateNormal(self.mean(x), self.kernel(x))

        self.model = Exact(self.inputs, self.target)
        self.model.train()
        self.objective = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, self.model)
        self.parts = [(kernel.base_kernel, "lengthscale"), (kernel, "outputscale"),
                      (likelihood.noise_covar, "noise")]
        gpytorch.settings.fast_computations.covar_root_decomposition._set_state(False)
        gpytorch.settings.fast_computations.log_prob._set_state(False)
        gpytorch.settings.fast_computations.solves._set_state(False)

    def __call__(self, logarithms):
        values = np.split(np.exp(logarithms), [6, 7])
        for (module, name), value in zip(self.parts, values):
            setattr(module, name, self.torch.tensor(value if len(value) > 1 else value[0]))
        self.model.zero_grad()
        loss = -self.objective(self.model(self.inputs), self.target) * self.count
        loss.backward()
        slopes = []
        for (module, name), value in zip(self.parts, values):
            raw = getattr(module, f"raw_{name}")
            # Each parameter is softplus(raw), and the derivative of softplus is the sigmoid.
            slopes.append((raw.grad / self.torch.sigmoid(raw.detach())).numpy().ravel() * value)
        return loss.item(), np.concatenate(slopes)


if __name__ == "__main__":
    peer, count = sys.argv[1], int(sys.argv[2])
    method = {"scipy": ByHand, "gpytorch": ByGpytorch}[peer]
    inputs, targets = p.samples(count)
    seconds, likelihoods, evaluations = 0.0, [], 0
    for target in targets.T:
        objective = method(inputs, target)
        objective(START)
        begin = time.process_time()
        found = minimize(objective, START, jac=True, method="L-BFGS-B",
                         bounds=list(zip(LOW, HIGH)), options={"maxiter": 100})
        seconds += time.process_time() - begin
        likelihoods.append(round(-found.fun, 3))
        evaluations += found.nfev
    p.report(peer=peer, n=count, fit_s=round(seconds, 4), lml_each=likelihoods,
             evaluations=evaluations)
