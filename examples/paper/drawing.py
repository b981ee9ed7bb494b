"""Style of the experiments' figures, and a figure of two experiments."""

import numpy as np
from matplotlib.figure import Figure

from hamsym.paper.experiment import ARCHITECTURES

# Palette for colour-blind readers (Okabe and Ito).
BLUE, RED, GREEN, PINK, ORANGE, SKY = "#0072b2 #d55e00 #009e73 #cc79a7 #e69f00 #56b4e9".split()


def figure(rows, columns, width=10.0, height=4.2, **more):
    """Make a figure with a grid of axes."""
    drawn = Figure(figsize=(width, height), layout="constrained")
    axes = drawn.subplots(rows, columns, squeeze=False, **more)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
        axis.ticklabel_format(style="sci", scilimits=(-2, 5))
    return drawn, axes


def draw_losses(axis, solutions, colors=(BLUE, RED, GREEN, PINK, ORANGE, SKY)):
    """Draw losses at the training points against the epoch, averaged over 1/200 of the epochs."""
    for (label, solution), color in zip(solutions.items(), colors, strict=False):
        loss = solution.history.loss
        width = max(1, len(loss) // 200)
        blocks = np.exp(np.log(loss[: len(loss) // width * width]).reshape(-1, width).mean(axis=1))
        epochs = width * (np.arange(len(blocks)) + 0.5)
        axis.semilogy(epochs, blocks, color=color, linewidth=1.2, label=label)
    axis.set(xlabel="epoch", ylabel="loss")
    axis.legend(fontsize=8)


def draw_architectures(experiment, found):
    """Draw the paper's figure of four loss curves, for each way to train."""
    drawn, axes = figure(1, 2, sharey=True)
    recipes = {"as written": "Adam as written", "authors' code": "Adam as in the authors' code"}
    for axis, (recipe, title) in zip(axes[0], recipes.items(), strict=True):
        shown = {
            name: found.median(f"{recipe}: {name}", experiment.truth) for name in ARCHITECTURES
        }
        draw_losses(axis, shown)
        axis.set_title(title)
    experiment.add_figure(
        "loss", drawn, "Loss during training for the four architectures (median seed)."
    )
