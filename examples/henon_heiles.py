"""Henon-Heiles system: a network in four dimensions, its energy and the limits of the bound.

Mattheakis et al., section III.B: the paper's start over [0, 6 pi], 100 points. The Hessian is
singular on the circle x^2 + y^2 = 1/4, which the orbit crosses. The paper's bound
ell_max/sigma_min is infinite there, and the solution issues a warning.

Run `python examples/henon_heiles.py`; `--epochs` and `--out` set the number of epochs and the
output folder.
"""

import argparse
import warnings
from pathlib import Path

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--epochs", type=int, default=30_000)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

problem = hamsym.systems.henon_heiles()
H = problem.H
print(f"H = {H}\n")
for name, rate in zip(H.names, H.vector_field, strict=True):
    print(f"d{name}/dt = {H.notation.text(rate)}")
print(f"\nsigma_min = {H.sigma_min}")
print(f"x*p_y - y*p_x conserved: {H.is_conserved('x*p_y - y*p_x')}")

print(f"\nTraining, {arguments.epochs:,} epochs ...")
adam = hamsym.Adam(
    points=100, epochs=arguments.epochs, tau=0.5, betas=(0.99, 0.999), schedule="cosine"
)
solution = hamsym.solve(H, problem.z0, problem.span, method=adam, seed=0)
print(solution.message)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    print(f"ell_max / sigma_min = {solution.error_bound:.2e}")
for warning in caught:
    print(f"warning: {warning.message}")

comparison = hamsym.compare(solution, "symplectic_euler")  # as in the paper
print(f"\n{comparison}")

arguments.out.mkdir(parents=True, exist_ok=True)
path = arguments.out / "henon-heiles-comparison.png"
comparison.plot().savefig(path, dpi=110)
print(f"wrote {path}")
