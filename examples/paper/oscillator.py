"""Experiment A: the nonlinear oscillator over two periods and more, four architectures.

Section III.A of the paper: H = p^2/2 + x^2/2 + x^4/4 from (1.3, 1) over [0, 4 pi], two layers of 50
neurons, 200 points moved by Gaussian noise of 0.06 pi in each of 50,000 epochs of Adam.
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

SPAN = (0.0, 4 * math.pi)
NETWORK = {"hidden": (50, 50), "points": 200, "epochs": 50_000}
WRITTEN = AS_WRITTEN | NETWORK | {"noise": 0.06 * math.pi}
# The noise of the authors' code is 0.03 T spacings of the points.
PUBLISHED = AUTHORS | NETWORK | {"noise": 0.03 * SPAN[1] * SPAN[1] / 200}

SETTINGS = {
    **{f"as written: {name}": WRITTEN | options for name, options in ARCHITECTURES.items()},
    "as written, lambda = 1": WRITTEN | {"energy_weight": 1.0},
    **{f"authors' code: {name}": PUBLISHED | options for name, options in ARCHITECTURES.items()},
    "authors' code, lambda = 1": PUBLISHED | {"energy_weight": 1.0},
    "cosine, lambda = 1": COSINE | NETWORK | {"tau": 0.25, "energy_weight": 1.0, "epochs": 30_000},
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
        "oscillator",
        "A: nonlinear oscillator, 4 pi",
        hamsym.systems.nonlinear_oscillator(),
        SPAN,
        200,
        parse(__doc__, arguments),
    )
    found = experiment.sweep(SETTINGS)
    rows = experiment.add_networks(found)
    network = found.median(PAPERS, experiment.truth)
    comparison = experiment.add_integrators(network)
    draw_architectures(experiment, found)
    draw_errors(experiment, network, comparison)
    judge_architectures(experiment, rows)
    judge(experiment, rows, comparison)
    judge_steps(experiment, comparison, rows[PAPERS], "III.A, abstract", 100)
    judge_bound(experiment, found)
    judge_estimate(experiment, rows)
    judge_integrators(experiment, comparison)
    experiment.beside(
        "A, lambda = 0",
        4.2e-3,
        written="as written: sin, 1 - exp(-t)",
        authors=PAPERS,
        ssbroyden="SSBroyden",
        features="features, tol = 1e-12",
    )
    experiment.beside(
        "A, lambda = 1",
        5.8e-4,
        written="as written, lambda = 1",
        authors="authors' code, lambda = 1",
        cosine="cosine, lambda = 1",
        ssbroyden="SSBroyden",
        features="features, tol = 1e-12",
    )
    experiment.write()


def draw_errors(experiment, network, comparison):
    """Draw errors in phase space and over time, and the energy: network, Euler at K and 100 K."""
    drawn, axes = figure(2, 2, height=7)
    t = np.linspace(*experiment.span, 2_001)
    (_, coarse), (_, fine) = euler(comparison, 1), euler(comparison, 100)
    curves = [
        ("network", t, network(t), BLUE, "-"),
        (f"Euler, {coarse.steps:,} steps", coarse.t, coarse.z, "0.75", "-"),
        (f"Euler, {fine.steps:,} steps", fine.t, fine.z, RED, "-"),
    ]
    H = experiment.problem.H.compile("numpy")
    zoom = 1.5 * max(np.abs(z - experiment.truth(t)).max() for _, t, z, *_ in curves[::2])
    for label, times, z, color, style in curves:
        error = z - experiment.truth(times)
        axes[0, 0].plot(*error.T, style, color=color, label=label, linewidth=1)
        axes[0, 1].plot(times, error[:, 0], style, color=color, label=label, linewidth=1)
        axes[1, 0].plot(times, error[:, 1], style, color=color, label=label, linewidth=1)
        axes[1, 1].plot(times, H.energy(z), style, color=color, label=label, linewidth=1)
    energy = float(H.energy(np.array(experiment.problem.z0)))
    axes[1, 1].axhline(energy, color=GREEN, linestyle="--", linewidth=1, label="exact")
    axes[0, 0].set(xlabel="error of x", ylabel="error of p", xlim=(-zoom, zoom), ylim=(-zoom, zoom))
    axes[0, 1].set(xlabel="t", ylabel="error of x", ylim=(-zoom, zoom))
    axes[1, 0].set(xlabel="t", ylabel="error of p", ylim=(-zoom, zoom))
    axes[1, 1].set(xlabel="t", ylabel="E", ylim=(energy - zoom, energy + zoom))
    axes[1, 1].legend(fontsize=8, loc="upper right")
    experiment.add_figure(
        "errors",
        drawn,
        "Errors and energy of the network (authors' settings, median seed) and of symplectic "
        "Euler; with K = 200 steps its errors are far outside the frames.",
    )


def judge(experiment, rows, comparison):
    """Test the paper's claims about this experiment only."""
    row, weighted = rows[PAPERS], rows["authors' code, lambda = 1"]
    fine, _ = euler(comparison, 100)
    experiment.claim(
        "III.A",
        "the network conserves the energy locally, better than symplectic Euler at 100 K",
        f"max |dE| {short(row['energy error'])} of the network, {fine.energy_error:.1e} of Euler",
        lower(row["energy error"], [fine.energy_error] * 3),
    )
    written = rows["as written: sin, 1 - exp(-t)"]
    experiment.claim(
        "III.A",
        "ell_max = 3.3e-3 after training as written",
        f"{short(written['ell_max'])}; with the authors' code {short(row['ell_max'])}",
        lower(written["ell_max"], [1.5 * 3.3e-3] * 3),
    )
    experiment.claim(
        "II.A",
        "the energy penalty can result in faster convergence",
        f"error after as many epochs: lambda = 0 {short(row['error'])}, "
        f"lambda = 1 {short(weighted['error'])}",
        lower(weighted["error"], row["error"]),
    )


if __name__ == "__main__":
    main()
