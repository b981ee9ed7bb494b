"""One network, any accuracy: error against CPU time for every way to find the weights.

Experiments A and B of the paper without energy penalty. Each point is a training of its own with a
number of epochs or iterations, or a tolerance, for each seed.
"""

import numpy as np

import hamsym
from hamsym.integrators.adaptive import reference
from hamsym.paper import henon_heiles, oscillator
from hamsym.paper.drawing import BLUE, GREEN, ORANGE, PINK, RED, SKY, figure
from hamsym.paper.experiment import CHAIN, COSINE, Cost, Experiment, parse

EPOCHS = (500, 2_500, 10_000, 50_000)
ITERATIONS = (100, 300, 1_000, 3_000)
NEWTON_ITERATIONS = (20, 50, 150, 450)
TOLERANCES = (1e-3, 1e-6, 1e-9, 1e-12)


def courses(script, tau):
    """Settings of all methods in order of their cost, for the problem of a script."""
    adam = {
        "Adam, as written": script.WRITTEN,
        "Adam, authors' settings": script.PUBLISHED,
        "Adam, cosine": COSINE | script.NETWORK | {"tau": tau},
    }
    second_order = {
        "L-BFGS": ("lbfgs", ITERATIONS),
        "SSBroyden": ("ssbroyden", ITERATIONS),
        "Levenberg-Marquardt, jointly": ("levenberg-marquardt", NEWTON_ITERATIONS),
    }
    return {
        **{name: [options | {"epochs": n} for n in EPOCHS] for name, options in adam.items()},
        **{
            name: [{"method": method, "iterations": n} for n in numbers]
            for name, (method, numbers) in second_order.items()
        },
        "Levenberg-Marquardt, one network": [
            CHAIN | {"windows": 1, "tol": tol} for tol in (1e-4, 1e-11)
        ],
        "Levenberg-Marquardt, chain": [CHAIN],
        "features": [{"method": "features", "tol": tol} for tol in TOLERANCES],
    }


COURSES = {
    "A: oscillator, 4 pi": courses(oscillator, 0.25),
    "B: Henon-Heiles, 6 pi": courses(henon_heiles, 0.5),
}
PROBLEMS = {
    "A: oscillator, 4 pi": (hamsym.systems.nonlinear_oscillator, oscillator),
    "B: Henon-Heiles, 6 pi": (hamsym.systems.henon_heiles, henon_heiles),
}
# Colour, marker and style: each tells the methods apart without the others.
STYLES = {
    "Adam, as written": ("0.55", "v", ":"),
    "Adam, authors' settings": (ORANGE, "^", ":"),
    "Adam, cosine": (RED, "s", "-."),
    "L-BFGS": (SKY, "D", "--"),
    "SSBroyden": (BLUE, "o", "--"),
    "Levenberg-Marquardt, jointly": (PINK, "P", "--"),
    "Levenberg-Marquardt, one network": ("#882255", "p", "-"),
    "Levenberg-Marquardt, chain": (GREEN, "*", "-"),
    "features": ("black", "X", "-"),
}


def main(arguments=None):
    """Run all trainings, draw the figure, write the table."""
    experiment = Experiment(
        "accuracy",
        "One network, any accuracy",
        hamsym.systems.nonlinear_oscillator(),
        oscillator.SPAN,
        200,
        parse(__doc__, arguments),
    )
    drawn, axes = figure(1, len(COURSES), width=12, height=6, sharex=True, sharey=True)
    for axis, (title, methods) in zip(axes[0], COURSES.items(), strict=True):
        make, script = PROBLEMS[title]
        problem = make()
        truth = problem.exact or reference(problem.H, problem.z0, script.SPAN)
        names = {
            name: [f"{title[0]}: {short_name(name)}{amount(options)}" for options in several]
            for name, several in methods.items()
        }
        settings = {
            label: options
            for name, several in methods.items()
            for label, options in zip(names[name], several, strict=True)
        }
        found = experiment.sweep(settings, problem=problem, span=script.SPAN)
        experiment.add_networks(found, truth=truth, prove=False)
        draw(axis, measured(found, names, truth))
        axis.set_title(title)
    axes[0, 0].set_ylabel("largest error |z^(t) - z(t)|")
    lines, labels = axes[0, 0].get_legend_handles_labels()
    drawn.legend(lines, labels, loc="outside lower center", ncols=4, fontsize=9)
    experiment.add_figure(
        "accuracy",
        drawn,
        "One network, any accuracy: largest error over CPU time of the training. Thin lines are "
        "single seeds and thick lines their medians; every point is a run of its own. Networks "
        "have two layers of 50 sines, one network or a chain of them; features are marched in "
        "windows.",
    )
    experiment.write()


def short_name(method):
    """Name of a method in the table, for a terminal of 80 columns."""
    return method.removesuffix(", one network")


def amount(options):
    """Epochs, iterations or tolerance of settings as the end of a label, if they are given."""
    for name in ("epochs", "iterations"):
        if name in options:
            return f", {options[name]:,} {name}"
    return f", tol = {options['tol']:.0e}" if "tol" in options else ""


def measured(found, names, truth):
    """CPU seconds and error of each method, shape (points, seeds, 2)."""
    rows = found.rows(truth)
    return {
        method: np.array(
            [
                [
                    (Cost.of(solution).cpu_seconds, row.error)
                    for solution, row in zip(found.solutions[label], rows[label], strict=True)
                ]
                for label in labels
            ]
        )
        for method, labels in names.items()
    }


def draw(axis, values):
    """Draw errors against CPU seconds: every seed thin, their median thick."""
    for method, points in values.items():
        color, marker, style = STYLES[method]
        for seed in range(points.shape[1]):
            axis.plot(
                *points[:, seed].T,
                style,
                color=color,
                linewidth=0.7,
                alpha=0.6,
                marker=marker,
                markersize=3,
            )
        middle = np.sort(points, axis=1)[:, (points.shape[1] - 1) // 2]
        axis.plot(
            *middle.T, style, color=color, marker=marker, markersize=7, linewidth=2.2, label=method
        )
    axis.set(xscale="log", yscale="log", xlabel="CPU seconds")


if __name__ == "__main__":
    main()
