"""The paper's nonlinear oscillator: neural trajectories compared with integrators.

Mattheakis, Sondak, Dogra & Protopapas, "Hamiltonian neural networks for solving equations of
motion", section III.A: H = p^2/2 + x^2/2 + x^4/4 from (1.3, 1) over [0, 4 pi]. The script first
solves to a tolerance. Then it trains one network over the whole span, as the paper does, to a
tolerance too: by Levenberg-Marquardt, with more sines in the second layer than the paper's 50; or
with `--method adam` the paper's network as in the paper (with an input scaled by tau = 1/4 and a
cosine schedule of the learning rate, which has a lower error after 30,000 epochs than the paper's
constant rate after 50,000).

Run `python examples/oscillator.py`; `--help` lists the options.
"""

import argparse
from pathlib import Path

import numpy as np

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--method", choices=["network-chain", "adam"])
parser.add_argument("--epochs", type=int, default=30_000, help="epochs of adam")
parser.set_defaults(method="network-chain")
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

problem = hamsym.systems.nonlinear_oscillator()
H = problem.H
print(f"H = {H}\n")
for name, rate in zip(H.names, H.vector_field, strict=True):
    print(f"d{name}/dt = {H.notation.text(rate)}")
print(f"\nsigma_min = {H.sigma_min}\n")
print(H.source("torch", part="loss"))

marched = hamsym.solve(H, problem.z0, problem.span, tol=1e-10)
t = np.linspace(*problem.span, 4_001)
error = np.abs(marched(t) - problem.exact(t)).max()
print(f"\nTo a tolerance of 1e-10: {marched.message}")
print(f"true error {error:.1e}, {1e3 * marched.record.seconds:.0f} ms\n")

print(f"Training one network by {arguments.method} ...")
if arguments.method == "adam":
    tol = None
    method = hamsym.Adam(
        epochs=arguments.epochs,
        tau=0.25,
        betas=(0.99, 0.999),
        schedule="cosine",
        energy_weight=1.0,
    )
else:
    tol, method = 1e-11, hamsym.NetworkChain(windows=1)
solution = hamsym.solve(H, problem.z0, problem.span, tol=tol, method=method, seed=0)
print(solution.message)
print(f"ell_max / sigma_min = {solution.error_bound:.2e} (the paper's bound, a heuristic)\n")

rivals = ("symplectic_euler", "stormer_verlet", "yoshida4", "gauss6", "dop853")
comparison = hamsym.compare(solution, rivals)  # against an enclosure of the exact solution
print(comparison)

arguments.out.mkdir(parents=True, exist_ok=True)
for name, figure in (("solution", solution.plot()), ("comparison", comparison.plot())):
    path = arguments.out / f"oscillator-{name}.png"
    figure.savefig(path, dpi=110)
    print(f"wrote {path}")
