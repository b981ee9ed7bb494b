"""
Your own network and loss
=========================

Any module of torch may be the network, with terms of your own in the loss. The solution is judged
as any other, at times that were not trained on.
"""

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import nn

import hamsym

torch.manual_seed(0)
torch.set_num_threads(1)
problem = hamsym.systems.nonlinear_oscillator()
H, span = problem.H, (0, 4)


class Fourier(nn.Module):
    """Sines and cosines of fixed frequencies, with a layer behind them."""

    def __init__(self):
        super().__init__()
        self.register_buffer("k", torch.arange(1, 7) / 3)
        self.layers = nn.Sequential(nn.Linear(12, 20), nn.Tanh(), nn.Linear(20, 2))

    def forward(self, s):
        return self.layers(torch.cat((torch.sin(self.k * s), torch.cos(self.k * s)), -1))


method = hamsym.LevenbergMarquardt(trial=Fourier(), points=60, iterations=30, stages=3)
solution = hamsym.solve(H, problem.z0, span, method=method)
print(solution.message)

# %%
# A term of your own in the loss, here the change of the energy, which L-BFGS minimises too.

energy = H.compile("torch").energy
start_energy = float(H.compile("numpy").energy(np.array(problem.z0)))
term = hamsym.Regularizer(0.5, lambda t, z, dz: (energy(z) - start_energy) ** 2)
lbfgs = hamsym.LBFGS(regularizers=[term], iterations=600, points=60, hidden=(30, 30))
trained = hamsym.solve(H, problem.z0, span, method=lbfgs)
print(trained.message)

# %%
# The true errors of both, and their estimates.

t = np.linspace(*span, 401)
figure = Figure(figsize=(8, 4), layout="constrained")
axis = figure.subplots()
for label, found, color in (
    ("own network, Levenberg-Marquardt", solution, "#0072b2"),
    ("own term, L-BFGS", trained, "#d55e00"),
):
    true = np.linalg.norm(found(t) - problem.exact(t), axis=1)
    estimate = np.linalg.norm(found.error_estimate(t), axis=1)
    axis.semilogy(t[1:], true[1:], color=color, label=label)
    axis.semilogy(t[1:], estimate[1:], ":", color=color, label="its estimate")
    print(f"{label}: true error {true.max():.1e}, estimate {estimate.max():.1e}")
axis.set(xlabel="t", ylabel="2-norm of the error")
axis.legend()
