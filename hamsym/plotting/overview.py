"""Overview of a motion: components over time, paths, and panels of a result below."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes

from hamsym.plotting.bodies import PROJECTIONS, bodies_of, draw_bodies, draw_projection
from hamsym.plotting.figure import Figure
from hamsym.plotting.motions import Motion, in_plane, over_time, plane_title
from hamsym.plotting.names import with_unit
from hamsym.plotting.style import PAGE

# Most degrees of freedom, one in each row of a page.
_MAX_DOF = 6
# Centimetres of a row, by the number of rows, and of other rows, so that a page has all.
_ROW = {1: 3.0, 2: 2.5, 3: 2.2, 4: 2.0}
_PLANE, _PROJECTION, _BESIDE_PORTRAIT, _LOWER = 5.8, 4.9, 3.2, 3.0


class MotionPanels:
    """The upper part of an overview: components over time, paths; then free panels below.

    - lower: Number of panels below; of one degree of freedom the first two stand beside the phase
      portrait.
    """

    def __init__(self, motion: Motion, lower: int) -> None:
        H, self.motion = motion.H, motion
        shown = min(H.dof, _MAX_DOF)
        row = max(_ROW.get(shown, 1.75), 2.5 if H.units else 0.0)  # units make labels long
        beside = 2 if H.dof == 1 else 0
        below = -(-(lower - beside) // 2) if lower > beside else 0
        named = any(motion.labels())
        keys = [0.55 + 0.35 * -(-len(motion.z) // 6)] if named else []
        spatial = bool(bodies_of(H, "xyz"))
        planes = [_PROJECTION] * 2 if spatial else [_PLANE]
        planes = [_BESIDE_PORTRAIT] * 2 if H.dof == 1 else planes
        heights = keys + [row] * shown + planes + [_LOWER] * below
        self.notes: list[Any] = []
        if shown < H.dof:
            i = H.dof - 1
            self.notes.append(
                f"{shown} of {H.dof} degrees of freedom are drawn; plot('{H.names[i]}', "
                f"'{H.names[H.dof + i]}') draws others"
            )
        figure = Figure.of_size(PAGE, sum(heights) + 1.2, (), "")
        self.figure = figure
        grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
        if named:  # a row for the legend
            axes = figure.add_subplot(grid[0, :])
            axes.set_axis_off()
        tops: list[Axes] = []
        first = len(keys)
        for k in range(shown):
            for column in (0, 1):
                axes = figure.add_subplot(grid[first + k, column])
                component = motion.component(k + column * H.dof)
                over_time(axes, motion, component, timed=k == shown - 1)
                tops.append(axes)
        if named:
            handles, texts = tops[0].get_legend_handles_labels()
            figure.axes[0].legend(
                handles,
                texts,
                title=with_unit(*motion.varied[:2]),
                loc="center",
                ncols=6,
                frameon=False,
            )
        first += shown
        if H.dof == 1:
            axes = figure.add_subplot(grid[first : first + 2, 0])
            self.notes += in_plane(axes, motion, motion.component(0), motion.component(1))
            axes.set_title(plane_title(H, H.names[0], H.names[1]))
            places = [grid[first, 1], grid[first + 1, 1]]
            if lower == 1:
                places = [grid[first : first + 2, 1]]
        else:
            places = []
            if spatial:
                space = figure.add_subplot(grid[first, 0], projection="3d")
                self.notes += draw_bodies(space, motion, "xyz")
                for k, letters in enumerate(PROJECTIONS, 1):
                    place = grid[first + k // 2, k % 2]
                    draw_projection(figure.add_subplot(place), motion, letters)
            else:
                self.notes += draw_bodies(figure.add_subplot(grid[first, 0]), motion, "xy")
                plane = figure.add_subplot(grid[first, 1])
                in_plane(plane, motion, motion.component(0), motion.component(H.dof))
                plane.set_title(plane_title(H, H.names[0], H.names[H.dof]))
        for k in range(below):
            last = len(heights) - below + k
            alone = lower - len(places) == 1
            places += [grid[last, :]] if alone else [grid[last, 0], grid[last, 1]]
        self.free = [figure.add_subplot(place) for place in places]
        motion.color_bar(tops)

    def finished(self, *sentences: Any) -> Figure:
        """Return the figure with its caption."""
        self.figure.set_caption(self.motion.caption(*self.notes, *sentences), self.motion.warning)
        return self.figure
