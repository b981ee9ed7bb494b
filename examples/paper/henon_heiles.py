"""Experiment B: the Henon-Heiles system over [0, 6 pi], four architectures.

Section III.B of the paper: from (x, y, p_x, p_y) = (0.3, -0.3, 0.3, 0.15), two layers of 50
neurons, 100 points moved by Gaussian noise of 0.18 pi in each of 30,000 epochs of Adam.
"""

import math

import numpy as np

import hamsym
from hamsym.paper.drawing import BLUE, GREEN, RED, draw_architectures, figure
from hamsym.paper.experiment import (
    ARCHITECTURES,
    AS_WRITTEN,
    AUTHORS,
    CHAIN,
    COSINE,
    Experiment,
    parse,
)
from hamsym.paper.judging import (
    euler,
    judge_architectures,
    judge_bound,
    judge_estimate,
    judge_integrators,
    judge_steps,
)
from hamsym.paper.tables import lower, short

SPAN = (0.0, 6 * math.pi)
NETWORK = {"hidden": (50, 50), "points": 100, "epochs": 30_000}
WRITTEN = AS_WRITTEN | NETWORK | {"noise": 0.18 * math.pi}
# The noise of the authors' code is 0.3 T spacings of the points.
PUBLISHED = AUTHORS | NETWORK | {"noise": 0.3 * SPAN[1] * SPAN[1] / 100}

SETTINGS = {
    **{f"as written: {name}": WRITTEN | options for name, options in ARCHITECTURES.items()},
    **{f"authors' code: {name}": PUBLISHED | options for name, options in ARCHITECTURES.items()},
    "cosine": COSINE | NETWORK | {"tau": 0.5},
    "SSBroyden": {"method": "ssbroyden"},
    "Levenberg-Marquardt": {"method": "levenberg-marquardt", "tol": 2e-7},
    "Levenberg-Marquardt, chain": CHAIN,
    "features, tol = 1e-6": {"method": "features", "tol": 1e-6},
    "features, tol = 1e-12": {"method": "features", "tol": 1e-12},
}
PAPERS = "authors' code: sin, 1 - exp(-t)"


def main(arguments=None):
    """Run the experiment, draw its figures, write its table."""
    experiment = Experiment(
        "henon-heiles",
        "B: Henon-Heiles, 6 pi",
        hamsym.systems.henon_heiles(),
        SPAN,
        100,
        parse(__doc__, arguments),
    )
    found = experiment.sweep(SETTINGS)
    rows = experiment.add_networks(found)
    network = found.median(PAPERS, experiment.truth)
    comparison = experiment.add_integrators(network)
    draw_architectures(experiment, found)
    draw(experiment, network, comparison)
    judge_architectures(experiment, rows)
    judge(experiment, rows[PAPERS], comparison)
    judge_steps(experiment, comparison, rows[PAPERS], "abstract", 100)
    judge_steps(experiment, comparison, rows[PAPERS], "III.B", 10)
    judge_bound(experiment, found)
    judge_estimate(experiment, rows)
    judge_integrators(experiment, comparison)
    experiment.beside(
        "B, lambda = 0",
        2.7e-3,
        written="as written: sin, 1 - exp(-t)",
        authors=PAPERS,
        cosine="cosine",
        ssbroyden="SSBroyden",
        features="features, tol = 1e-12",
    )
    experiment.write()


def draw(experiment, network, comparison):
    """Draw the paper's figure: the orbit on the left, the energy on the right."""
    drawn, axes = figure(1, 2, height=4.6)
    t = np.linspace(*experiment.span, 2_001)
    (_, coarse), (_, fine) = euler(comparison, 1), euler(comparison, 10)
    H = experiment.problem.H.compile("numpy")
    curves = [
        (f"Euler, {coarse.steps:,} steps", coarse.t, coarse.z, "0.6", "-"),
        (f"Euler, {fine.steps:,} steps", fine.t, fine.z, RED, "-"),
        ("network", t, network(t), BLUE, "-"),
        ("reference", t, experiment.truth(t), GREEN, "--"),
    ]
    for label, times, z, color, style in curves:
        axes[0, 0].plot(z[:, 0], z[:, 1], style, color=color, linewidth=1, label=label)
        axes[0, 1].plot(times, H.energy(z), style, color=color, linewidth=1, label=label)
    axes[0, 0].set(xlabel="x", ylabel="y", aspect="equal")
    axes[0, 1].set(xlabel="t", ylabel="E")
    axes[0, 1].legend(fontsize=8)
    experiment.add_figure(
        "orbit",
        drawn,
        "Orbit and energy: the network (authors' settings, median seed), symplectic Euler at K and "
        "10 K, and the reference, which the network hides.",
    )


def judge(experiment, row, comparison):
    """Test the claim about the energy."""
    fine, _ = euler(comparison, 10)
    experiment.claim(
        "III.B",
        "the network conserves the energy better than symplectic Euler, also at 10 K",
        f"max |dE| {short(row['energy error'])} of the network, {fine.energy_error:.1e} of Euler",
        lower(row["energy error"], [fine.energy_error] * 3),
    )


if __name__ == "__main__":
    main()
