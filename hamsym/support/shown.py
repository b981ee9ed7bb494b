"""Mixins of results: their facts, with what is made from them, and their files.

What other stages do with a result, as to draw it, are functions that are found by its type. The
type is known by its name: to import all of them would import most of the package.
"""

from __future__ import annotations

import importlib
import inspect
import os
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, overload

import hamsym
from hamsym.support.suggestions import checked_keywords
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

R = TypeVar("R")


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


class Listed(Sequence[R]):
    """A result that is the sequence of those in one of its fields."""

    _FIELD: ClassVar[str] = "found"

    def __len__(self) -> int:
        return len(getattr(self, self._FIELD))

    @overload
    def __getitem__(self, index: int) -> R: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[R, ...]: ...
    def __getitem__(self, index: int | slice) -> R | tuple[R, ...]:
        found: tuple[R, ...] = getattr(self, self._FIELD)
        return found[index]


def by_type(
    room: str, chosen: Callable[[str, inspect.Signature], bool]
) -> dict[str, Callable[..., Any]]:
    """Return functions of a room by the type with which their first argument is annotated.

    - room: A package; all its modules are imported.
    - chosen: (name, signature) -> whether a function is one of these.
    """
    found: dict[str, Callable[..., Any]] = {}
    for entry in pkgutil.iter_modules(importlib.import_module(room).__path__, f"{room}."):
        for name, function in vars(importlib.import_module(entry.name)).items():
            if inspect.isfunction(function) and function.__module__ == entry.name:
                signature = inspect.signature(function)
                if signature.parameters and chosen(name, signature):
                    first = next(iter(signature.parameters.values()))
                    found[str(first.annotation)] = function
    found.pop("Any", None)
    return found


def function_of(
    result: Any, functions: Mapping[str, Callable[..., Any]]
) -> Callable[..., Any] | None:
    """Return the function for the type of a result, or for one that it inherits."""
    own = (kind.__name__ for kind in type(result).__mro__ if kind.__module__.startswith("hamsym."))
    return next((functions[name] for name in own if name in functions), None)


class Drawn:
    """A result with a figure; the documentation of its class says what it shows."""

    @checked_keywords
    def plot(self, *names: Any, ax: Any = None) -> Figure:
        """Draw the result, or what names choose; the text about its class says what these are.

        Parameters
        ----------
        *names : str or sympy.Expr
            Panels, components or formulas (:meth:`hamsym.Hamiltonian.observable`).
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
