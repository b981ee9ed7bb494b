"""Mixins of results: their facts, with what is made from them, and their files."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import hamsym
from hamsym.support.suggestions import checked_keywords
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Shown:
    """A result that describes itself: as facts, as text, and as HTML, which Jupyter asks for."""

    @property
    def facts(self) -> hamsym.Facts:
        """What is known of it: what was asked, the errors, how they are known, and the cost."""
        return hamsym.describe(self)

    @checked_keywords
    def summary(self, rows: int | None = ROWS) -> str:
        """Describe it as text: first the verdict and the largest error against what was asked.

        Parameters
        ----------
        rows : int, optional
            Most rows of a table; with None all, and further facts.

        Examples
        --------
        >>> import hamsym
        >>> print(hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-6).summary())
        converged: largest estimated error ... in ..., ... % of the 1.0e-06 asked
        tol 1.0e-06 met: ...
        """
        return self.facts.text(rows)

    def _repr_html_(self) -> str:
        return hamsym.representation(self)


class Saved(Shown):
    """A result that has files."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result to a file that :func:`hamsym.load` reads; see :func:`hamsym.save`.

        Raises
        ------
        FileError
            If the file cannot be written, or the result is not valid.
        """
        hamsym.save(self, path)


class Drawn:
    """A result with a figure; the documentation of its class says what it shows."""

    @checked_keywords
    def plot(self, *names: Any, ax: Any = None) -> Figure:
        """Draw the result, or what names choose; the text about its class says what these are.

        Parameters
        ----------
        *names : str
            Panels or components.
        ax : matplotlib.axes.Axes, optional
            Axes to draw one panel into, in your own style.

        Returns
        -------
        matplotlib.figure.Figure
            A figure that notebooks show; ``savefig`` writes .png, .svg and .pdf.

        Raises
        ------
        InputError
            If a name is unknown or there is nothing to draw, or ``ax`` is given for several panels.

        Examples
        --------
        >>> trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 6), dt=0.1)
        >>> trajectory.plot("x", "p").axes[0].get_ylabel()
        '$p$'
        """
        return hamsym.plot(self, *names, ax=ax)
