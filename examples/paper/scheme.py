"""The paper's first figure: time, network and loss.

Run `python examples/paper/scheme.py`; `--out` sets the output folder.
"""

import argparse
import itertools
from pathlib import Path

from hamsym.paper.drawing import BLUE, GREEN, ORANGE, figure

CAPTION = (
    "The network's scheme: N(t) has as many outputs as there are components, f(t) imposes the "
    "initial state, and the loss compares both sides of Hamilton's equations."
)


def main(arguments=None):
    """Draw the scheme and write it as scheme.png."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("output/paper"))
    out = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)
    draw().savefig(out / "scheme.png", dpi=110)
    print(f"wrote {out / 'scheme.png'}")


def draw():
    """Make the figure of the scheme."""
    drawn, axes = figure(1, 1, width=12, height=4.2)
    axis = axes[0, 0]
    axis.set(xlim=(0, 11.7), ylim=(-2, 2), aspect="equal")
    axis.set_axis_off()
    # Layers of neurons: one input, two fully connected hidden layers, the outputs.
    layers = [(0.5, [0.0]), (1.7, _column(5)), (2.9, _column(5)), (4.1, _column(3))]
    for (x, heights), (right, others) in itertools.pairwise(layers):
        for y in heights:
            for other in others:
                axis.plot([x, right], [y, other], color="0.8", linewidth=0.8, zorder=1)
    for place, (x, heights) in enumerate(layers):
        color = (GREEN, BLUE, BLUE, ORANGE)[place]
        axis.scatter([x] * len(heights), heights, s=260, color=color, edgecolor="white", zorder=2)
    axis.text(0.5, 0, "$t_n$", color="white", ha="center", va="center", fontsize=9)
    for y, label in zip(layers[-1][1], ("$N_D$", "$\\ldots$", "$N_1$"), strict=True):
        axis.text(4.1, y, label, color="white", ha="center", va="center", fontsize=8)
    axis.text(2.3, 1.62, r"shared hidden layers, $\sin$", ha="center", fontsize=10, color=BLUE)
    boxes = [
        (5.9, "$\\hat z(t) = z(0) + f(t)\\,N(t)$\n\n$f(t) = 1 - e^{-t}$"),
        (8.1, "$d\\hat z/dt$ in forward mode\n\n$J\\,\\nabla H(\\hat z)$, generated"),
        (
            10.5,
            "$L = \\frac{1}{K}\\,\\sum_n\\,|d\\hat z/dt - J\\,\\nabla H|^2$\n\n"
            "$+\\ \\frac{\\lambda}{K}\\,\\sum_n\\,(H - E_0)^2$",
        ),
    ]
    style = {"boxstyle": "round,pad=0.5", "facecolor": "white", "edgecolor": "0.4"}
    for x, text in boxes:
        axis.text(x, 0, text, ha="center", va="center", fontsize=9.5, bbox=style)
    arrow = {"arrowstyle": "->", "color": "0.3"}
    for start, end in ((4.35, 5.02), (6.75, 7.17), (8.99, 9.4)):
        axis.annotate("", (end, 0), (start, 0), arrowprops=arrow)
    axis.plot([10.5, 10.5, 2.3], [-0.55, -1.8, -1.8], color="0.3", linewidth=1)
    axis.annotate("", (2.3, -1.4), (2.3, -1.82), arrowprops=arrow)
    axis.text(6.4, -1.68, "the weights are changed until $L$ is small", ha="center", fontsize=10)
    return drawn


def _column(count):
    return [1.25 * (2 * k / (count - 1) - 1) for k in range(count)]


if __name__ == "__main__":
    main()
