"""Style of all figures: colours, lines, sizes and fonts.

Nothing here changes matplotlib's settings outside ``with styled():``, and nothing uses pyplot.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
from cycler import cycler
from matplotlib.colors import to_hex

#: Colours of Okabe and Ito that are visible on white, distinct for the colour-blind.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
DASHES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "P")
SEQUENTIAL = "viridis"
WARNING = "#b00020"
GREY = "0.45"
#: Lines with a legend entry each; more lines take colours from a sequential map.
MAX_LINES = 12
SAMPLES = 2_001
#: Widths in centimetres of a figure of one column of a journal, and of a page.
COLUMN, PAGE = 9.0, 18.0

DISPLAY_DPI = 120

STYLE: dict[str, Any] = {
    "figure.dpi": DISPLAY_DPI,
    "savefig.dpi": 200,
    "font.family": ["DejaVu Sans"],
    "font.size": 8,
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=COLORS),
    "axes.xmargin": 0.02,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "lines.markersize": 4,
    "legend.fontsize": 7,
    "legend.framealpha": 0.85,
    "legend.handlelength": 1.8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "image.cmap": SEQUENTIAL,
    # Files: text of PDF is TrueType, which journals ask for; text of SVG is drawn as paths, which
    # look the same without the font. Files do not depend on the run.
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "hamsym",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of hamsym, whatever settings the user has made."""
    with matplotlib.style.context(["default", STYLE]):
        yield


def color_of(index: int) -> str:
    return COLORS[index % len(COLORS)]


def line_style(index: int) -> dict[str, Any]:
    """Return colour and dashes; dashes change before a colour is repeated."""
    return {"color": color_of(index), "linestyle": DASHES[index // len(COLORS) % len(DASHES)]}


def marker_style(index: int) -> dict[str, Any]:
    """Return colour and marker of points without lines; both change, then their pairs."""
    marker = MARKERS[(index + index // len(MARKERS)) % len(MARKERS)]
    return {"color": color_of(index), "marker": marker, "linestyle": "none"}


def shades(count: int) -> np.ndarray:
    """Return colours of the sequential map, without the lightest, shape (count, 4)."""
    return np.asarray(matplotlib.colormaps[SEQUENTIAL](np.linspace(0, 0.92, count)))


def line_styles(count: int) -> list[dict[str, Any]]:
    """Return a style for each of some lines: distinct ones, or a sequence of colours for many."""
    if count <= MAX_LINES:
        return [line_style(index) for index in range(count)]
    return [{"color": to_hex(color), "linestyle": "-"} for color in shades(count)]


def positive(values: np.ndarray) -> np.ndarray:
    """Return values for a logarithmic axis: nan where they are not positive and finite."""
    return np.where((values > 0) & np.isfinite(values), values, np.nan)
