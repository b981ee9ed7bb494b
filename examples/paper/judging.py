"""Tests of claims of the paper, for several experiments."""

import math

import numpy as np

from hamsym.paper.experiment import ARCHITECTURES
from hamsym.paper.tables import lower, short
from hamsym.solving.methods import METHODS


def euler(comparison, factor):
    """Row and trajectory of symplectic Euler with ``factor`` K steps."""
    pairs = [
        pair
        for pair in zip(comparison.rows[1:], comparison.trajectories, strict=True)
        if pair[0].label == "symplectic_euler"
    ]
    return pairs[(1, 10, 100).index(factor)]


def judge_architectures(experiment, rows):
    """Test whether sin with 1 - exp(-t) has the lowest loss of the four architectures."""
    for recipe in ("as written", "authors' code"):
        of = {name: rows[f"{recipe}: {name}"] for name in ARCHITECTURES}
        listed = "; ".join(
            f"{name}: loss {short(row['loss'])}, error {short(row['error'])}"
            for name, row in of.items()
        )
        verdicts = [
            lower(of["sin, 1 - exp(-t)"]["loss"], row["loss"])
            for name, row in of.items()
            if name != "sin, 1 - exp(-t)"
        ]
        undecided = [verdict for verdict in verdicts if isinstance(verdict, str)]
        experiment.claim(
            "III",
            f"sin with 1 - exp(-t) converges best of the four (Adam, {recipe})",
            listed,
            False if False in verdicts else undecided[0] if undecided else True,
        )


def judge_steps(experiment, comparison, row, where, factor):
    """Test whether symplectic Euler needs about ``factor`` K points or more for the same error.

    Its error is inversely proportional to the number of steps, so that one run gives the number
    for every seed.
    """
    fine, _ = euler(comparison, 100)
    needed = [fine.error * fine.points / error / experiment.points for error in row["error"]]
    experiment.claim(
        where,
        f"symplectic Euler needs about {factor} K = {factor * experiment.points:,} points for the "
        "network's error",
        f"{needed[0]:,.0f} K ({needed[2]:,.0f} K to {needed[1]:,.0f} K) for {short(row['error'])}",
        lower([factor / math.sqrt(10)] * 3, [needed[0], needed[2], needed[1]])
        if needed[0] <= factor * math.sqrt(10)
        else f"held, and more: {needed[0] / factor:,.0f} times as many",
    )


def judge_bound(experiment, found):
    """Test whether |dz_i| <= ell_max / sigma_min in every run that trained a network."""
    t = np.linspace(*experiment.span, 4_001)
    trained = [
        solution
        for solutions in found.solutions.values()
        for solution in solutions
        if not METHODS[solution.method].marches
    ]
    ratios = [np.abs(experiment.truth(t) - z(t)).max() / z.analysis.bound for z in trained]
    broken, vacuous = sum(ratio > 1 for ratio in ratios), sum(z.sigma_min == 0 for z in trained)
    measured = f"largest error over bound {max(ratios):.2g}, above 1 in {broken} of {len(ratios)}"
    verdict = broken == 0
    if vacuous:
        measured += f"; the Hessian is singular on the way, and the bound infinite, in {vacuous}"
        verdict = "says nothing" if not broken else False
    experiment.claim("II.B", "no component's error exceeds ell_max / sigma_min", measured, verdict)


def judge_estimate(experiment, rows):
    """Whether the equation of the error, integrated, gives the error."""
    known = [row for row in rows.values() if row["estimate"]]
    ratios = [row["estimate"][0] / row["error"][0] for row in known if row["error"][0] > 1e-9]
    experiment.claim(
        "II.B",
        "the equation of the error (eq. ell, here with all orders) gives the error of a trained "
        "network",
        f"estimated over true error from {min(ratios, default=math.nan):.3f} to "
        f"{max(ratios, default=math.nan):.3f} in {len(ratios)} rows",
        bool(ratios) and min(ratios) >= 0.9 and max(ratios) <= 1.1,
    )


def judge_integrators(experiment, comparison):
    """Test the paper's statements on integrators that it does not run."""
    of = comparison.matches
    experiment.claim(
        "IV",
        "higher-order symplectic integrators have a larger computational cost than Euler's",
        "evaluations for the network's error: "
        + "; ".join(
            f"{name} {of[name].evaluations:,}" if of[name].evaluations else f"{name} {of[name]}"
            for name in of
        ),
        not 0 < of["forest_ruth"].evaluations < (of["symplectic_euler"].evaluations or math.inf),
    )
    network = comparison.rows[0]
    best = min(
        (row for row in comparison.rows[1:] if row.points == 10 * experiment.points),
        key=lambda row: row.energy_error,
    )
    experiment.claim(
        "IV",
        "where conserving the energy is crucial the network performs better than symplectic "
        "integrators",
        f"max |dE| {network.energy_error:.1e} of the network, {best.energy_error:.1e} of "
        f"{best.label} with 10 K steps",
        network.energy_error < best.energy_error,
    )
