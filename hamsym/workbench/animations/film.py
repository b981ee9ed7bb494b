"""Drawing of the frames of an animation with matplotlib."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba

from hamsym.errors import InputError
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import Figure, label
from hamsym.plotting.phase_portraits import draw_levels
from hamsym.plotting.style import COLORS, shades, styled
from hamsym.workbench.animations.motion import Motion
from hamsym.workbench.animations.scenes import Scene

_WIDTH = 11.0  # of a figure, in centimetres
_SAMPLES = 4_000  # of a path, of which a tail is a part
_PIECES = 6_000  # of all tails
_MARGIN = 0.07
_FLATTEST = 0.45  # smallest ratio of the sides of an axis with equal units
_MOST_NAMED = 9  # points in a legend
_COLUMNS = 3  # of a legend


class Film:
    """The frames of an animation.

    - times: Of the frames, equally spaced, shape (frames,).
    - tail: Part of the span that a tail covers.
    - states: Shape (frames, members, dim).
    """

    def __init__(self, motion: Motion, scene: Scene, times: np.ndarray, tail: float) -> None:
        self._motion, self._scene, self._times = motion, scene, times
        every = max(1, math.ceil(_SAMPLES / len(times))) if tail and scene.traced else 1
        start, end = motion.span
        count = (len(times) - 1) * every + (every if motion.closed else 1)
        fine = np.linspace(start, end, count, endpoint=not motion.closed)
        fine[::every] = times
        states = motion.at(fine)
        self.states = states[::every]
        self._every, self._length = every, round(tail * (len(fine) - 1))
        places = scene.places(states, fine[:, None])  # (n, members, points, 2)
        # Beyond 1e300 the limits of the axes would overflow.
        self._places = np.where(np.abs(places) < 1e300, places, np.nan)
        if not np.isfinite(self._places).any(axis=(0, 1, 2)).all():
            raise InputError("no place of the motion is finite; there is nothing to animate")
        self.title = f"H = {motion.H.formulas}"
        with styled():
            self._build()

    # -- times ---------------------------------------------------------------------------------

    def time_text(self, t: float) -> str:
        """A time with as many digits as neighbouring frames need."""
        step = abs(self._times[1] - self._times[0])
        largest = float(np.abs(self._times).max())
        unit = self._motion.H.units.get("t", "1")
        unit = "" if unit == "1" else f" {unit}"
        if step >= 1e-3 and largest < 1e6:
            digits = max(0, 1 - math.floor(math.log10(step)))
            return f"t = {t:.{min(digits, 4)}f}{unit}"
        digits = max(2, math.ceil(math.log10(largest / step)))
        return f"t = {t:.{min(digits, 6)}e}{unit}"

    # -- drawing ---------------------------------------------------------------------------------

    def _build(self) -> None:
        scene, places = self._scene, self._places
        members, points = places.shape[1:3]
        (x0, x1), (y0, y1) = limits = self._limits()
        ratio = (y1 - y0) / (x1 - x0) if scene.equal else 0.75
        named = scene.points[:_MOST_NAMED]
        height = 0.88 * _WIDTH * min(max(ratio, 0.4), 1.2) + 1.8 + 0.45 * (len(named) // _COLUMNS)
        self.figure = Figure.of_size(_WIDTH, height)
        axis = self.figure.subplots()
        axis.set(xlim=limits[0], ylim=limits[1])
        for line, words in zip((axis.xaxis, axis.yaxis), scene.labels, strict=True):
            if any(words):
                label(line, *words)
        if scene.equal:
            axis.set_aspect("equal")
        notes: list[Any] = [*filter(None, (scene.note, *self._motion.notes))]
        if scene.level_sets is not None:
            x, y = (self._motion.H.names[k] for k in scene.level_sets)
            notes += draw_levels(axis, self._motion.H, x, y)
        # Bodies have colours of their own, else the members of an ensemble.
        self._colors = np.empty((members, points, 4))
        count = points if scene.points else members
        own = [*map(to_rgba, COLORS[:count])] if count <= len(COLORS) else shades(count)
        self._colors[:] = np.array(own).reshape((1, -1, 4) if scene.points else (-1, 1, 4))
        self._tails = LineCollection([], linewidths=1.3, animated=True)
        self._rods = LineCollection([], linewidths=1.8, animated=True)
        for lines in (self._tails, self._rods):
            axis.add_collection(lines)
        sizes = np.full((members, points), 45.0 if points * members <= 12 else 18.0)
        sizes[:, list(scene.pivots)] = 10.0
        start, colors = np.zeros(members * points), self._colors.reshape(-1, 4)
        self._dots = axis.scatter(
            start, start, s=sizes.ravel(), color=colors, zorder=3, animated=True
        )
        for number, name in enumerate(named):
            axis.plot([], [], "o", color=self._colors[0, number], label=name)
        if named:
            left = len(scene.points) - len(named)
            axis.plot([], [], alpha=0, label=f"and {left} more") if left else None
            place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
            place |= {"borderaxespad": 0.2, "columnspacing": 0.8, "handletextpad": 0}
            axis.legend(**place, ncols=_COLUMNS, frameon=False)
        self._time = axis.set_title(self.time_text(self._times[-1]), loc="left", fontsize=9)
        self.figure.set_caption(caption_words(self._motion.H, *notes), self._motion.failure)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")  # the layout is that of all frames
        self._time.set_animated(True)
        self.draw(0)

    def _limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of the axes that hold all frames."""
        flat = self._places.reshape(-1, 2)
        low, high = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
        middle, half = (low + high) / 2, (high - low) / 2
        size = max(half.max(), 1e-12 * np.abs(middle).max()) or 1.0
        if self._scene.equal:
            half = np.maximum(half, _FLATTEST * size)
        else:
            half = np.where(half > 1e-12 * np.abs(middle), half, np.maximum(np.abs(middle), 1e-300))
        half = half * (1 + 2 * _MARGIN)
        (x0, y0), (x1, y1) = middle - half, middle + half
        return (float(x0), float(x1)), (float(y0), float(y1))

    def draw(self, number: int) -> None:
        """Set the figure to a frame."""
        at = number * self._every
        places, scene = self._places, self._scene
        self._dots.set_offsets(places[at].reshape(-1, 2))
        if scene.rods:
            pairs = places[at][:, list(scene.rods)]  # (members, rods, 2, 2)
            self._rods.set_segments(list(pairs.reshape(-1, 2, 2)))
            own = self._colors[:, [second for _, second in scene.rods]]
            self._rods.set(color=own.reshape(-1, 4))
        if self._length and scene.traced:
            self._draw_tails(at)
        self._time.set_text(self.time_text(float(self._times[number])))

    def _draw_tails(self, at: int) -> None:
        places, count = self._places, len(self._places)
        first = at - self._length
        if not self._motion.closed:
            first = max(first, 0)
        paths = places.shape[1] * len(self._scene.traced)
        pieces = min(max(20, min(300, _PIECES // paths)), at - first)
        if not pieces:
            self._tails.set_segments([])
            return
        rows = np.round(np.linspace(first, at, pieces + 1)).astype(int) % count
        tails = places[rows][:, :, list(self._scene.traced)]
        tails = np.moveaxis(tails, 0, 2)  # (members, traced, pieces + 1, 2)
        segments = np.stack((tails[..., :-1, :], tails[..., 1:, :]), axis=-2)
        own = self._colors[:, list(self._scene.traced)]
        colors = np.repeat(own[:, :, None], pieces, axis=2)
        age = np.linspace(first, at, pieces + 1)[1:] - (at - self._length)
        colors[..., 3] = age / self._length
        self._tails.set_segments(list(segments.reshape(-1, 2, 2)))
        self._tails.set(color=colors.reshape(-1, 4))

    def pixels(self, dpi: float, numbers: Sequence[int] | None = None) -> Iterator[np.ndarray]:
        """Yield frames as colours, shape (height, width, 4), of uint8."""
        figure = self.figure
        canvas, usual = FigureCanvasAgg(figure), figure.dpi
        figure.dpi = dpi
        try:
            canvas.draw()  # all but what moves
            still = canvas.copy_from_bbox(figure.bbox)
            for number in range(len(self._times)) if numbers is None else numbers:
                self.draw(number)
                canvas.restore_region(still)
                with styled():
                    for artist in (self._tails, self._rods, self._dots, self._time):
                        figure.axes[0].draw_artist(artist)
                yield np.asarray(canvas.buffer_rgba()).copy()
        finally:
            figure.dpi = usual
