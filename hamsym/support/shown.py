"""Mixin of results that notebooks show as HTML."""

from __future__ import annotations

import hamsym


class Shown:
    """A result with a representation as HTML, which Jupyter asks for."""

    def _repr_html_(self) -> str:
        return hamsym.representation(self)
