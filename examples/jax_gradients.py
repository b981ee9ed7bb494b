"""Gradients of many trajectories in jax: diffrax integrates the generated vector field.

Diffrax solves the oscillator H = p^2/2 + x^2/2 + k x^4/4 for many k in one call and differentiates
the state at the end in k; both are compiled. The solution of hamsym and its sensitivity, in numpy,
check some of them.

Run `pip install 'hamsym[jax]' diffrax` and `python examples/jax_gradients.py`; `--count` and
`--out` set the number of values of k and the output folder.
"""

import argparse
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import hamsym

jax.config.update("jax_enable_x64", True)
parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--count", type=int, default=200)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

H = hamsym.Hamiltonian("p**2/2 + x**2/2 + k*x**4/4")
z0, T = jnp.array([1.3, 1.0]), 10.0
vector_field = H.compile("jax").vector_field


def end(k):
    """State at time T, differentiable in k."""
    term = diffrax.ODETerm(lambda t, z, k: vector_field(z, k=k))
    steps = diffrax.PIDController(rtol=1e-11, atol=1e-11)
    solution = diffrax.diffeqsolve(
        term, diffrax.Dopri8(), 0.0, T, 0.01, z0, args=k, stepsize_controller=steps
    )
    return solution.ys[0]


values = jnp.linspace(0.5, 1.5, arguments.count)
states = jax.jit(jax.vmap(end))(values)
slopes = jax.jit(jax.vmap(jax.jacrev(end)))(values)

largest = 0.0
for i in range(0, arguments.count, max(1, arguments.count // 3)):
    solution = hamsym.solve(H.with_parameters(k=values[i].item()), z0.tolist(), (0, T), tol=1e-10)
    in_k = solution.sensitivity(T, parameters=["k"])[:, -1]
    largest = max(largest, np.abs(solution(T) - states[i]).max(), np.abs(in_k - slopes[i]).max())
print(f"states and slopes agree with those of hamsym within {largest:.0e}")

figure, axes = plt.subplots(layout="constrained")
axes.plot(values, states[:, 0], label="x(10)")
axes.plot(values, slopes[:, 0], label="dx(10)/dk")
axes.set(xlabel="k", title="end of a trajectory and its gradient")
axes.legend()

arguments.out.mkdir(parents=True, exist_ok=True)
path = arguments.out / "jax-gradients.png"
figure.savefig(path, dpi=150)
print(f"wrote {path}")
