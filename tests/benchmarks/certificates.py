"""Certified bounds over true errors, and what the proofs take.

The true error is the largest distance at 4,001 times from the exact solution, where there is one,
or from DOP853 at 1e-13. Below 1e-10 neither is a hundred times better than what it judges: a dash
stands for it, and the proven lower bound is what the upper one is compared with.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import hamsym
from hamsym import systems
from hamsym.integrators.integrate import reference

HEADER = f"{'problem':<22}{'solution':<16}{'true error':>11}{'bound':>10}{'ratio':>7}"
HEADER += f"{'/lower':>7}{'time s':>8}"


def cases(quick: bool):
    """(label, problem, span, label of the options, options)."""
    oscillator, henon = systems.nonlinear_oscillator(), systems.henon_heiles()
    kepler, double = systems.kepler(), systems.double_pendulum()
    networks = [
        ("adam 1,000", {"method": "adam", "epochs": 1_000, "tau": 0.25, "points": 100}),
        ("LM 1e-3", {"method": "levenberg-marquardt", "target_error": 1e-3}),
        ("LM 1e-5", {"method": "levenberg-marquardt", "target_error": 1e-5}),
        ("LM 2e-7", {"method": "levenberg-marquardt", "target_error": 2e-7}),
    ]
    for name, problem in (("A, oscillator", oscillator), ("B, Henon-Heiles", henon)):
        for label, options in networks[2:3] if quick else networks:
            yield name, problem, problem.span, label, options
        for tol in (1e-9, 1e-12):
            yield name, problem, problem.span, f"features {tol:.0e}", {"tol": tol}
    if quick:
        return
    others = [
        ("harmonic oscillator", systems.harmonic_oscillator(), None),
        ("pendulum", systems.pendulum(), None),
        ("double pendulum", double, (0.0, 10.0)),
        ("Kepler, 2 periods", kepler, (0.0, 2 * kepler.period)),
        ("Henon-Heiles, t = 100", henon, (0.0, 100.0)),
        ("charged particle", systems.charged_particle(), None),
        ("driven oscillator", systems.driven_oscillator(), None),
    ]
    for name, problem, span in others:
        yield name, problem, span or problem.span, "features 1e-09", {"tol": 1e-9}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    print(HEADER)
    for name, problem, span, label, options in cases(quick):
        solution = hamsym.solve(problem.H, problem.z0, span, **options)
        t = np.linspace(*solution.span, 4_001)
        exact = problem.exact or reference(problem.H, problem.z0, span)
        error = float(np.linalg.norm(solution(t) - exact(t), axis=-1).max())
        began = time.perf_counter()
        try:
            found = solution.certify()
        except hamsym.CertificationError as refusal:
            print(f"{name:<22}{label:<16}{error:>11.2e}  refused: {refusal}")
            continue
        seconds = time.perf_counter() - began
        known = error > 1e-10
        print(
            f"{name:<22}{label:<16}{f'{error:.3e}' if known else '-':>11}{found.bound:>10.3e}"
            f"{f'{found.bound / error:.3f}' if known else '-':>7}"
            f"{found.bound / found.lower:>7.3f}{seconds:>8.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
