"""Experiment B-long: the Henon-Heiles system over [0, 12 pi], with and without sequential training.

Section III.B of the paper, its last part: two layers of 80 neurons, 500 points, lambda = 0.5. First
20,000 epochs on [0, 6 pi] at a learning rate of 8e-3, then 50,000 on [0, 12 pi] at 5e-3, beginning
with the weights of the first stage. Without sequential training, all 70,000 epochs on [0, 12 pi].
The text does not give the noise (three spacings of the points here, as in the short experiment). A
further run trains sequentially in 24 small steps, with the network's input scaled by tau.
"""

import math

import numpy as np

import hamsym
from hamsym.paper.drawing import BLUE, GREEN, RED, draw_losses, figure
from hamsym.paper.experiment import AS_WRITTEN, AUTHORS, CHAIN, COSINE, Experiment, parse
from hamsym.paper.judging import euler, judge_integrators
from hamsym.paper.tables import lower, short

HALF, SPAN = (0.0, 6 * math.pi), (0.0, 12 * math.pi)
NETWORK = {"hidden": (80, 80), "points": 500, "energy_weight": 0.5}
FIRST = NETWORK | {"epochs": 20_000}
SECOND = NETWORK | {"epochs": 50_000, "learning_rate": 5e-3}


def noise(span):
    """Noise of the authors' code: 0.3 T spacings of the points."""
    return {"noise": 0.3 * span[1] * span[1] / 500}


PAPERS, WITHOUT = "authors' code, sequential", "authors' code, not sequential"
DRAWN = "cosine, 24 spans"  # the most reliable way to train with Adam


def main(arguments=None):
    """Run the experiment, draw its figure, write its table."""
    experiment = Experiment(
        "henon-heiles-long",
        "B-long: Henon-Heiles, 12 pi",
        hamsym.systems.henon_heiles(),
        SPAN,
        500,
        parse(__doc__, arguments),
    )
    halves = experiment.sweep(
        {
            "as written, [0, 6 pi]": AS_WRITTEN | FIRST,
            "authors' code, [0, 6 pi]": AUTHORS | FIRST | noise(HALF),
        },
        span=HALF,
    )

    def go_on(name, settings):
        begun = dict(zip(experiment.seeds, halves.solutions[name], strict=True))
        return lambda seed: settings | {"initial": begun[seed]}

    settings = {
        "as written, sequential": go_on("as written, [0, 6 pi]", AS_WRITTEN | SECOND),
        PAPERS: go_on("authors' code, [0, 6 pi]", AUTHORS | SECOND | noise(SPAN)),
        WITHOUT: AUTHORS | SECOND | noise(SPAN) | {"epochs": 70_000},
        DRAWN: COSINE | NETWORK | {"tau": 3.0, "frequency": 3.0, "stages": 24, "epochs": 70_000},
        "Levenberg-Marquardt": {
            "method": "levenberg-marquardt",
            "hidden": (80, 80),
            "stages": 24,
            "tol": 2e-7,
        },
        "Levenberg-Marquardt, chain": CHAIN,
        "features, tol = 1e-6": {"method": "features", "tol": 1e-6},
        "features, tol = 1e-12": {"method": "features", "tol": 1e-12},
    }
    found = experiment.sweep(settings)
    begun = {
        "as written, sequential": halves.solutions["as written, [0, 6 pi]"],
        PAPERS: halves.solutions["authors' code, [0, 6 pi]"],
    }
    rows = experiment.add_networks(found, begun)
    network = found.median(DRAWN, experiment.truth)
    comparison = experiment.add_integrators(network)
    draw(experiment, found, network, comparison)
    judge(experiment, rows, comparison)
    experiment.beside(
        "B-long, lambda = 0.5",
        3.7e-3,
        written="as written, sequential",
        authors=PAPERS,
        cosine="cosine, 24 spans",
        features="features, tol = 1e-12",
    )
    experiment.write()


def draw(experiment, found, network, comparison):
    """Draw the paper's figure: loss and energy, x and y, and their errors."""
    drawn, axes = figure(2, 3, width=13, height=7)
    shown = [name for name, solutions in found.solutions.items() if solutions[0].method == "adam"]
    draw_losses(axes[0, 0], {name: found.median(name, experiment.truth) for name in shown})
    t = np.linspace(*experiment.span, 4_001)
    _, path = euler(comparison, 10)
    H = experiment.problem.H.compile("numpy")
    curves = [
        (f"Euler, {path.steps:,} steps", path.t, path.z, RED, "-"),
        ("network", t, network(t), BLUE, "-"),
        ("reference", t, experiment.truth(t), GREEN, "--"),
    ]
    for label, times, z, color, style in curves:
        axes[1, 0].plot(times, H.energy(z), style, color=color, linewidth=0.9, label=label)
        error = z - experiment.truth(times)
        for k, name in enumerate(("x", "y")):
            axes[k, 1].plot(times, z[:, k], style, color=color, linewidth=0.9, label=label)
            axes[k, 1].set(xlabel="t", ylabel=name)
            axes[k, 2].set(xlabel="t", ylabel=f"error of {name}")
            if label != "reference":
                axes[k, 2].plot(times, error[:, k], style, color=color, linewidth=0.9, label=label)
    axes[1, 0].set(xlabel="t", ylabel="E")
    axes[1, 0].legend(fontsize=8)
    axes[0, 2].legend(fontsize=8)
    experiment.add_figure(
        "long",
        drawn,
        "Loss for each way to train (median seed; of sequential training the second stage); "
        "energy, x, y and their errors for the network "
        "(cosine, 24 spans, median seed) and symplectic Euler at 10 K.",
    )


def judge(experiment, rows, comparison):
    """Test the paper's claims about this experiment."""
    row, without = rows[PAPERS], rows[WITHOUT]
    experiment.claim(
        "III.B",
        "sequential training converges faster than training from random weights",
        f"after 70,000 epochs: loss {short(row['loss'])}, error {short(row['error'])}; without it "
        f"loss {short(without['loss'])}, error {short(without['error'])}",
        lower(row["error"], without["error"]),
    )
    fine, _ = euler(comparison, 10)
    ratio = row["energy error"][0] / fine.energy_error
    experiment.claim(
        "III.B",
        "the energy errors of the network and of symplectic Euler at 10 K are of the same order",
        f"max |dE| {short(row['energy error'])} of the network, {fine.energy_error:.1e} of Euler",
        0.1 <= ratio <= 10,
    )
    experiment.claim(
        "III.B",
        "the network's solution has a lower error than symplectic Euler's at 10 K",
        f"max |dz| {short(row['error'])} of the network, {fine.error:.1e} of Euler",
        lower(row["error"], [fine.error] * 3),
    )
    judge_integrators(experiment, comparison)


if __name__ == "__main__":
    main()
