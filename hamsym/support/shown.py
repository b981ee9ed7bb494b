"""Mixins of results: those that notebooks show as HTML, and those that have files."""

from __future__ import annotations

import os

import hamsym


class Shown:
    """A result with a representation as HTML, which Jupyter asks for."""

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
