"""The paper's nonlinear oscillator: from the formula to a trained network beside symplectic Euler.

Mattheakis, Sondak, Dogra & Protopapas, "Hamiltonian neural networks for solving equations of
motion", section III.A: H = p^2/2 + x^2/2 + x^4/4 from (1.3, 1) over [0, 4 pi], two layers of 50
sines. The network, the points and their noise are the paper's; its input is scaled by tau = 1/4
and the learning rate falls along a cosine, which reaches in 30,000 epochs what the paper's
constant rate does not in 50,000.

Run it with `python examples/oscillator.py`; `--epochs` and `--out` change its length and folder.
"""

import argparse
from pathlib import Path

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--epochs", type=int, default=30_000)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

problem = hamsym.systems.nonlinear_oscillator()
H = problem.H
print(f"H = {H}\n")
for name, rate in zip(H.names, H.vector_field, strict=True):
    print(f"d{name}/dt = {rate}")
print(f"\nsigma_min = {H.sigma_min}\n")
print(H.source("torch", part="loss"))

print(f"\nTraining, {arguments.epochs:,} epochs ...")
solution = hamsym.solve(
    H,
    problem.z0,
    problem.span,
    method="adam",
    epochs=arguments.epochs,
    tau=0.25,
    betas=(0.99, 0.999),
    schedule="cosine",
    energy_weight=1.0,
    seed=0,
)
print(solution.message)
print(f"ell_max / sigma_min = {solution.error_bound:.2e} (the paper's bound, a heuristic)\n")

comparison = hamsym.compare(solution, exact=problem.exact)
print(comparison)

arguments.out.mkdir(parents=True, exist_ok=True)
for name, figure in (("solution", solution.plot()), ("comparison", comparison.plot())):
    path = arguments.out / f"oscillator-{name}.png"
    figure.savefig(path, dpi=110)
    print(f"wrote {path}")
