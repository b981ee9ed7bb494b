"""Figures that notebooks show, with captions wrapped to their width, and their axes."""

from __future__ import annotations

import base64
import functools
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.figure
import numpy as np
from matplotlib import cbook
from matplotlib.axes import Axes
from matplotlib.axis import Axis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from hamsym.errors import InputError
from hamsym.plotting.names import number, sentence_words, shortened, with_unit, words_of
from hamsym.plotting.style import COLUMN, DISPLAY_DPI, STYLE, WARNING, shades, styled

_CM = 1 / 2.54
_PAD = 0.25 * _CM  # inches around captions
CAPTION_SIZE = 7.5
_OVERHANG = 0.06  # inches by which the label of an axis may be longer
_LEADING = 0.035  # inches between lines


class Figure(matplotlib.figure.Figure):
    """A matplotlib figure that notebooks show, with a caption wrapped to its width.

    It does not belong to pyplot. ``savefig`` writes PNG, SVG, PDF and what else matplotlib has.
    """

    _words: tuple[str, ...] = ()
    _warning: tuple[str, ...] = ()
    _lines: tuple[Text, ...] = ()
    _optional: tuple[Text, ...] = ()

    @classmethod
    def of_size(
        cls, width: float, height: float, caption: Sequence[str] = (), warning: str = ""
    ) -> Figure:
        """Return an empty figure with room for axes of this size in centimetres, and a caption.

        - caption: Words, between which lines may be broken; drawn below the axes.
        - warning: Drawn in red above the axes.
        """
        figure = cls(figsize=(width * _CM, height * _CM), layout="constrained")
        FigureCanvasAgg(figure)
        figure.set_caption(caption, warning)
        return figure

    def set_caption(self, caption: Sequence[str] = (), warning: str = "") -> None:
        """Replace caption and warning; the figure grows or shrinks by their height."""
        self._replace(caption, words_of(warning))

    def add_to_caption(self, sentences: Sequence[str | Sequence[str]]) -> None:
        """Add sentences, plain text or words, to the caption."""
        self._replace([*self._words, *sentence_words(sentences)], self._warning)

    def _replace(self, words: Sequence[str], warning: Sequence[str]) -> None:
        before = sum(self._captions_height())
        self._words, self._warning = tuple(words), tuple(warning)
        width, height = self.get_size_inches()
        self.set_size_inches(width, height - before + sum(self._captions_height()))

    @property
    def caption(self) -> str:
        """The text of the caption, with the breaks of its lines."""
        self._captions_height()
        own = [line.get_text() for line in self._lines if line.get_color() != WARNING]
        return "\n".join(own)

    @property
    def warning(self) -> str:
        """What the figure says in red, "" if nothing."""
        return " ".join(self._warning)

    def thin_out(self, texts: Sequence[Text]) -> None:
        """Hide those of these texts that would overlap another, or leave their axes, when drawn."""
        self._optional = (*self._optional, *texts)

    def draw(self, renderer: Any) -> None:
        engine = self.get_layout_engine()
        with styled():
            self._arrange(renderer)
            if engine is None:
                super().draw(renderer)
                return
            if isinstance(engine, ConstrainedLayoutEngine) and self.canvas.is_saving():
                return  # matplotlib draws once more, without the engine
            self.set_layout_engine("none")  # which matplotlib would execute once more
            try:
                super().draw(renderer)
            finally:
                self.set_layout_engine(engine)

    def savefig(self, fname: Any, **options: Any) -> None:
        with styled():
            kind = options.get("format") or str(fname).rpartition(".")[2]
            undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(str(kind).lower())
            if undated:
                options["metadata"] = {**undated, **(options.get("metadata") or {})}
            super().savefig(fname, **options)

    def _png(self, dpi: int) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=dpi)
        return buffer.getvalue()

    def _repr_png_(self) -> bytes:
        return self._png(DISPLAY_DPI)

    def _repr_mimebundle_(self, **_: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the picture at twice the pixels in which it is shown, for sharp screens."""
        width, height = (round(size * DISPLAY_DPI) for size in self.get_size_inches())
        data = base64.b64encode(self._png(2 * DISPLAY_DPI)).decode()
        return {"image/png": data}, {"image/png": {"width": width, "height": height}}

    # -- layout --------------------------------------------------------------------------------

    def _captions_height(self) -> tuple[float, float]:
        """Break the lines of caption and warning; return their heights in inches."""
        for text in self._lines:
            text.remove()
        width, height = self.get_size_inches()
        font = FontProperties(family=STYLE["font.family"], size=CAPTION_SIZE)
        found, heights = [], []
        for words, color in ((self._words, "black"), (self._warning, WARNING)):
            lines = wrapped_words(words, width - 2 * _PAD, font)
            sizes = [_size(line, font)[1] + _LEADING for line in lines]
            total = sum(sizes) + 1.5 * _PAD if lines else 0.0
            top = height - 0.75 * _PAD if color == WARNING else total - 0.75 * _PAD
            for line, size in zip(lines, sizes, strict=True):
                text = self.text(_PAD / width, top / height, line, va="top", color=color)
                text.set_fontproperties(font)
                text.set_in_layout(False)
                found.append(text)
                top -= size
            heights.append(total)
        self._lines = tuple(found)
        return heights[0], heights[1]

    def _arrange(self, renderer: Any) -> None:
        below, above = self._captions_height()
        engine, height = self.get_layout_engine(), self.get_size_inches()[1]
        if isinstance(engine, ConstrainedLayoutEngine):
            bottom = min(below / height, 0.8)
            engine.set(rect=(0, bottom, 1, max(1 - bottom - above / height, 0.1)))
            engine.execute(self)
        for axes in self.axes:
            for axis in axes._axis_map.values():  # type: ignore[attr-defined]
                if isinstance(formatter := axis.get_major_formatter(), Ticks):
                    if isinstance(locator := axis.get_major_locator(), MaxNLocator):
                        locator.set_params(nbins=min(5, max(2, axis.get_tick_space())))
                    formatter.relabel(axis)
        if isinstance(engine, ConstrainedLayoutEngine):
            engine.execute(self)
        if self._optional:
            self._hide_overlapping(renderer)

    def _hide_overlapping(self, renderer: Any) -> None:
        """Hide optional texts that overlap each other or a line, or leave their axes."""
        kept: list[Any] = []
        for text in self._optional:
            axes = text.axes
            assert axes is not None
            text.set_visible(True)
            box, frame = text.get_window_extent(renderer).padded(2), axes.get_window_extent()
            free = not any(box.overlaps(other) for other in kept)
            free = free and frame.containsx(box.x0) and frame.containsx(box.x1)
            free = free and frame.containsy(box.y0) and frame.containsy(box.y1)
            for line in axes.lines if free else ():
                places = axes.transData.transform(line.get_xydata())
                free = free and not box.count_contains(places)
            text.set_visible(free)
            if free:
                kept.append(box)


@contextmanager
def one_panel(
    ax: Any,
    caption: Sequence[str] = (),
    warning: str = "",
    *,
    width: float = COLUMN,
    height: float = 6.5,
    projection: str | None = None,
) -> Iterator[Any]:
    """Give axes for one panel: the user's, in the user's style, or those of a new figure.

    Raise InputError if ``ax`` is not axes of matplotlib, or not of space where the panel is.
    """
    if ax is not None:
        if not isinstance(ax, Axes):
            raise InputError(
                f"ax={shortened(repr(ax))} is not an Axes of matplotlib; give one, for example of "
                "figure, ax = matplotlib.pyplot.subplots()"
            )
        if projection == "3d" and ax.name != "3d":
            raise InputError(
                "three components need axes of three dimensions; give ax = "
                'figure.add_subplot(projection="3d")'
            )
        yield ax
        return
    with styled():
        figure = Figure.of_size(width, height, caption, warning)
        yield figure.add_subplot(projection=projection)


def figure_of(ax: Axes) -> Any:
    """Return the figure to which axes belong."""
    return ax.get_figure(root=True)


def require_no_axes(ax: Any, names: str) -> None:
    """Refuse ``ax`` for a figure of several panels; ``names`` is an example of one panel."""
    if ax is not None:
        raise InputError(
            f"the overview has several panels and makes its own figure; with ax= give what to "
            f"draw, for example plot({names}, ax=ax)"
        )


def legend(axes: Axes, **options: Any) -> None:
    """Add a legend if anything has a label, equal ones once; of many entries in several columns."""
    entries = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    if entries:
        labels, handles = list(entries), list(entries.values())
        columns = 1 if len(labels) <= 4 else 2
        axes.legend(handles, labels, **{"ncols": columns, **options})


def legend_above(axes: Axes) -> None:
    """Add a legend of few short entries above axes, beside their title."""
    if labels := axes.get_legend_handles_labels()[1]:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.1,
            borderpad=0.1,
            columnspacing=0.9,
            handlelength=1.4,
            handletextpad=0.4,
            frameon=False,
            ncols=len(labels),
        )


# -- axes ------------------------------------------------------------------------------------------


_POWER = re.compile(r"\$\\times\\mathdefault\{(10\^\{[-−]?\d+\})\}")  # of matplotlib's offset text


class Ticks(ScalarFormatter):
    """Tick labels whose power of ten and offset are drawn in the label of the axis."""

    def __init__(self) -> None:
        super().__init__(useMathText=True)
        self.set_powerlimits((-3, 4))
        self.parts = ("", "")
        self.shown = ""

    def get_offset(self) -> str:
        return ""

    def relabel(self, axis: Axis) -> None:
        """Write the label of an axis with the power of ten and the offset of its ticks."""
        if axis.get_label_text() != self.shown:  # the user's own
            self.parts = (axis.get_label_text(), "")
        self.set_locs(list(axis.get_majorticklocs()))
        text, unit = self.parts
        if self.offset:
            text += f" {'−' if self.offset > 0 else '+'} {number(abs(self.offset), 15)}"
        power = _POWER.match(super().get_offset())
        self.shown = with_unit(text, unit, f"${power[1]}$" if power else "")
        if isinstance(axis, YAxis):
            self._fit(axis)
        axis.set_label_text(self.shown)

    def _fit(self, axis: Axis) -> None:
        """Break a label that is longer than its axis before the unit, and reduce its size."""
        figure = axis.get_figure(root=True)
        assert figure is not None
        room = axis.axes.bbox.height / figure.dpi + _OVERHANG
        font = FontProperties(family=STYLE["font.family"], size=STYLE["axes.labelsize"])
        if _size(self.shown, font)[0] > room and " [" in self.shown:
            self.shown = self.shown.replace(" [", "\n[", 1)
        longest = max(_size(line, font)[0] for line in self.shown.split("\n"))
        axis.label.set_fontsize(STYLE["axes.labelsize"] * min(1.0, max(room / longest, 0.6)))


def label(axis: Axis, text: str, unit: str = "") -> None:
    """Label an axis with a quantity and its unit.

    On a linear axis of a :class:`Figure`, powers of ten and offsets of ticks go into the label; the
    axes of other figures keep matplotlib's ticks.
    """
    axis.set_label_text(with_unit(text, unit))
    if isinstance(axis.get_figure(root=True), Figure) and axis.get_scale() == "linear":
        ticks = Ticks()
        ticks.parts, ticks.shown = (text, unit), axis.get_label_text()
        axis.set_major_formatter(ticks)
        axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 2.5, 5, 10]))


def color_bar(axes: Any, norm: Normalize, text: str, unit: str = "", **options: Any) -> None:
    """Add a colour bar of :func:`shades` beside axes, one or several."""
    mappable = ScalarMappable(norm, ListedColormap(shades(256)))
    bar = figure_of(np.ravel(axes)[0]).colorbar(mappable, ax=axes, pad=0.02, **options)
    label(bar.ax.yaxis, text, unit)


# -- lines of captions -----------------------------------------------------------------------------


def wrapped_words(words: Sequence[str], width: float, font: FontProperties) -> list[str]:
    """Break words into lines of at most this width in inches, as they will be drawn.

    A plain word that is wider than a line is broken too.
    """
    lines, rest = [], [*words]
    while rest:
        count = _fitting(rest, width, font)
        word, length = rest[0], len(rest[0])
        if count == 0 and length > 1 and not cbook.is_math_text(word):
            while length > 1 and _size(word[:length], font)[0] > width:
                length = int(0.9 * length)
            lines.append(word[:length])
            rest[0] = word[length:]
            continue
        count = max(count, 1)
        lines.append(" ".join(rest[:count]))
        rest = rest[count:]
    return lines


def _fitting(words: Sequence[str], width: float, font: FontProperties) -> int:
    """Number of words that fit on a line: by the mean width of those tried, then the next numbers.

    To measure a formula takes milliseconds, so that few lines are.
    """
    fits, too_many, tried = 0, len(words) + 1, len(words)
    while too_many - fits > 1:
        found = _size(" ".join(words[:tried]), font)[0]
        if found <= width:
            fits = tried
        else:
            too_many = tried
        tried = min(max(int(tried * width / max(found, 1e-6)), fits + 1), too_many - 1)
    return fits


@functools.lru_cache(maxsize=20_000)
def _size(text: str, font: FontProperties) -> tuple[float, float]:
    """Width and height of a line in inches; its height is at least that of plain text."""
    with styled():
        own = Text(0, 0, text, fontproperties=font)
        own.set_figure(matplotlib.figure.Figure(dpi=288))
        box = own.get_window_extent(RendererAgg(1, 1, 288))
    return 1.02 * box.width / 288, max(box.height / 288, 1.1 * font.get_size_in_points() / 72)
