"""What a reader would see of a figure: its texts with their places, and its empty panels."""

from __future__ import annotations

import io
from itertools import combinations
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.legend import Legend

from hamsym.plotting.figure import Figure


def drawn_texts(figure: Figure) -> list[Any]:
    """Visible texts of a drawn figure."""
    found = [*figure.texts]
    legends = [child for child in figure.get_children() if isinstance(child, Legend)]
    for axes in figure.axes:
        legends += [child for child in axes.get_children() if isinstance(child, Legend)]
        found += axes.texts
        if not axes.axison:
            continue
        found += [axes.title, axes._left_title, axes._right_title]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            found += [axis.label, axis.offsetText]
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if low <= tick.get_loc() <= high:
                    found += [tick.label1, tick.label2]
    for legend in legends:
        found += [*legend.get_texts(), legend.get_title()]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


def check_layout(figure: Figure) -> None:
    """Assert that no text leaves the canvas or overlaps another, and that no panel is empty."""
    figure.set_dpi(100)
    canvas = FigureCanvasAgg(figure)
    figure.savefig(io.BytesIO(), format="png", dpi=100)
    renderer = canvas.get_renderer()  # places are those of the saved picture
    boxes = [(text, text.get_window_extent(renderer)) for text in drawn_texts(figure)]
    frame = figure.bbox.padded(1)
    for text, box in boxes:
        inside = frame.x0 <= box.x0 and box.x1 <= frame.x1
        inside = inside and frame.y0 <= box.y0 and box.y1 <= frame.y1
        assert inside, f"{text.get_text()!r} at {box.extents.round()} leaves {frame.extents}"
    for (text, box), (other, second) in combinations(boxes, 2):
        # Boxes of rotated texts are larger than the texts.
        straight = all(item.get_rotation() % 90 == 0 for item in (text, other))
        assert not straight or not box.padded(-1.5).overlaps(second), (
            f"{text.get_text()!r} overlaps {other.get_text()!r}"
        )
    for axes in figure.axes:
        filled = axes.lines or axes.collections or axes.images or axes.patches or axes.texts
        assert filled or not axes.axison, f"the panel {axes.get_title('left')!r} is empty"
