"""Experiment A-long: the nonlinear oscillator over [0, 20 pi], with and without energy penalty.

Section III.A of the paper, its last part: two layers of 80 neurons, 500 points, lambda = 1. The
text gives neither the noise nor the number of epochs; both are those of the short experiment, three
spacings of the points and 50,000 epochs.
"""

import math

import numpy as np

import hamsym
from hamsym.paper.drawing import BLUE, GREEN, RED, draw_losses, figure
from hamsym.paper.experiment import AS_WRITTEN, AUTHORS, CHAIN, COSINE, Experiment, parse
from hamsym.paper.judging import euler, judge_bound, judge_integrators
from hamsym.paper.tables import lower, short, spread

SPAN = (0.0, 20 * math.pi)
NETWORK = {"hidden": (80, 80), "points": 500, "epochs": 50_000}
PUBLISHED = AUTHORS | NETWORK | {"noise": 0.03 * SPAN[1] * SPAN[1] / 500}

SETTINGS = {
    "as written, lambda = 1": AS_WRITTEN | NETWORK | {"energy_weight": 1.0},
    "authors' code, lambda = 1": PUBLISHED | {"energy_weight": 1.0},
    "authors' code, lambda = 0": PUBLISHED,
    "cosine, lambda = 1": COSINE | NETWORK | {"tau": 0.5, "stages": 8, "energy_weight": 1.0},
    "Levenberg-Marquardt": {
        "method": "levenberg-marquardt",
        "hidden": (80, 80),
        "points": 500,
        "stages": 60,
        "tau": 2.0,
        "tol": 1e-6,
    },
    "Levenberg-Marquardt, chain": CHAIN,
    "features, tol = 1e-6": {"method": "features", "tol": 1e-6},
    "features, tol = 1e-11": {"method": "features", "tol": 1e-11},
}
PAPERS = "authors' code, lambda = 1"


def main(arguments=None):
    """Run the experiment, draw its figure, write its table."""
    experiment = Experiment(
        "oscillator-long",
        "A-long: nonlinear oscillator, 20 pi",
        hamsym.systems.nonlinear_oscillator(),
        SPAN,
        500,
        parse(__doc__, arguments),
    )
    found = experiment.sweep(SETTINGS)
    rows = experiment.add_networks(found)
    network = found.median(PAPERS, experiment.truth)
    comparison = experiment.add_integrators(network)
    draw(experiment, found, network, comparison)
    judge(experiment, found, rows, comparison)
    experiment.beside(
        "A-long, lambda = 1",
        6.4e-3,
        written="as written, lambda = 1",
        authors=PAPERS,
        cosine="cosine, lambda = 1",
        features="features, tol = 1e-11",
    )
    experiment.write()


def draw(experiment, found, network, comparison):
    """Draw the paper's figure: loss and energy on the left, errors on the right."""
    drawn, axes = figure(2, 2, height=7)
    draw_losses(
        axes[0, 0],
        {name: found.median(name, experiment.truth) for name in SETTINGS if "lambda" in name},
    )
    t = np.linspace(*experiment.span, 4_001)
    _, path = euler(comparison, 100)
    H = experiment.problem.H.compile("numpy")
    curves = [
        ("network", t, network(t), BLUE),
        (f"Euler, {path.steps:,} steps", path.t, path.z, RED),
    ]
    for label, times, z, color in reversed(curves):
        error = z - experiment.truth(times)
        axes[1, 0].plot(times, H.energy(z), color=color, linewidth=0.9, label=label)
        axes[0, 1].plot(*error.T, color=color, linewidth=0.8, label=label)
        size = np.linalg.norm(error, axis=-1)
        axes[1, 1].semilogy(times[1:], size[1:], color=color, linewidth=0.9, label=label)
    energy = float(H.energy(np.array(experiment.problem.z0)))
    axes[1, 0].axhline(energy, color=GREEN, linestyle="--", linewidth=1, label="exact")
    axes[1, 0].set(xlabel="t", ylabel="E")
    axes[1, 0].legend(fontsize=8)
    axes[0, 1].set(xlabel="error of x", ylabel="error of p")
    axes[0, 1].legend(fontsize=8)
    axes[1, 1].set(xlabel="t", ylabel="|error|")
    experiment.add_figure(
        "long",
        drawn,
        "Loss for each way to train (median seed); energy, error in phase space and its size for "
        "the network (authors' settings, lambda = 1, median seed) and symplectic Euler at 100 K.",
    )


def judge(experiment, found, rows, comparison):
    """Test the paper's claims about this experiment."""
    with_penalty, without = rows[PAPERS], rows["authors' code, lambda = 0"]
    row, path = euler(comparison, 100)
    t = np.linspace(*experiment.span, 4_001)
    increases = spread(increase(t, z(t), experiment.truth) for z in found.solutions[PAPERS])
    euler_increase = increase(path.t, path.z, experiment.truth)
    experiment.claim(
        "II.A, III.A",
        "the energy penalty improves long solutions",
        f"error with lambda = 1 {short(with_penalty['error'])}, with 0 {short(without['error'])}",
        lower(with_penalty["error"], without["error"]),
    )
    experiment.claim(
        "III.A",
        "the network conserves the energy slightly better than symplectic Euler at 100 K",
        f"max |dE| {short(with_penalty['energy error'])} of the network, "
        f"{row.energy_error:.1e} of Euler",
        lower(with_penalty["energy error"], [row.energy_error] * 3),
    )
    experiment.claim(
        "III.A",
        "Euler's error at 100 K increases much faster than the network's",
        f"max |dz| {short(with_penalty['error'])} of the network, {row.error:.1e} of Euler; from "
        f"the first half to the second it increases by {short(increases)} and {euler_increase:.1e}",
        lower(increases, [euler_increase / 3] * 3),
    )
    judge_bound(experiment, found)
    judge_integrators(experiment, comparison)


def increase(t, z, truth):
    """Increase of the largest error from the first half to the second."""
    size = np.linalg.norm(z - truth(t), axis=-1)
    middle = len(t) // 2
    return size[middle:].max() - size[:middle].max()


if __name__ == "__main__":
    main()
