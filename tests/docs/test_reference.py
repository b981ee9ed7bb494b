"""Every public name and attribute has a docstring, and a page of the reference."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import pytest
from docstrings import described, prepared
from reference import GROUPS, RETURNED, found, pages

import hamsym

PUBLIC = [f"hamsym.{name}" for name in hamsym.__all__] + RETURNED
CLASSES = [path for path in PUBLIC if inspect.isclass(found(path))]


def public_attributes(kind: type) -> dict[str, Any]:
    """Return what users can ask an object of this class for, without what Python adds."""
    attributes = {
        name: value
        for owner in reversed(kind.__mro__)
        if owner.__module__.startswith("hamsym")
        for name, value in vars(owner).items()
        if not name.startswith("_")
    }
    if dataclasses.is_dataclass(kind):
        attributes |= {f.name: f for f in dataclasses.fields(kind) if not f.name.startswith("_")}
    return attributes


def undocumented(kind: type) -> list[str]:
    owners = [owner for owner in kind.__mro__ if owner.__module__.startswith("hamsym")]
    sections = ("Attributes", "Parameters") if dataclasses.is_dataclass(kind) else ("Attributes",)
    named = [name for owner in owners for part in sections for name in described(owner, part)]
    return [
        name
        for name, value in public_attributes(kind).items()
        if name not in named and not (inspect.getdoc(value) and not _is_field(value))
    ]


def _is_field(value: Any) -> bool:
    simple = isinstance(value, (str, int, float, tuple, type(None)))
    return simple or isinstance(value, dataclasses.Field) or type(value).__name__ == "_tuplegetter"


@pytest.mark.parametrize("path", CLASSES)
def test_public_attributes_are_documented(path: str) -> None:
    assert undocumented(found(path)) == []


def test_attributes_without_text_are_named() -> None:
    @dataclasses.dataclass
    class Told:
        """One of two fields is described.

        Attributes
        ----------
        first, second : float
            Both numbers.
        """

        first: float
        third: float = 1.0

        @property
        def fourth(self) -> float:
            return 1.0

    Told.__module__ = "hamsym.told"
    assert described(Told) == ["first", "second"]
    assert undocumented(Told) == ["third", "fourth"]


def test_every_public_name_has_a_page() -> None:
    texts = pages()
    for path in PUBLIC:
        assert path in texts[f"{path}.rst"]
        assert f":doc:`{path}`" in texts["index.rst"]


def test_subjects_name_what_exists() -> None:
    named = [name for names in GROUPS.values() for name in names]
    assert len(set(named)) == len(named)
    assert set(named) <= set(hamsym.__all__)


def test_formulas_in_docstrings_are_no_markup() -> None:
    assert prepared(["|z^_i(t)| of a*b and ``x*y``"]) == [r"\|z^_i(t)\| of a\*b and ``x*y``"]
    assert prepared([">>> 2 * 3 | 4", "6"]) == [">>> 2 * 3 | 4", "6"]


def test_references_without_a_page_become_code() -> None:
    assert prepared([":func:`solve` :mod:`hamsym.proof.prove`"]) == [
        ":func:`~hamsym.solve` ``hamsym.proof.prove``"
    ]
    assert prepared([":meth:`hamsym.Solution.events`"]) == [":meth:`hamsym.Solution.events`"]
    assert prepared([":mod:`hamsym.nothing`"]) == [":mod:`hamsym.nothing`"]  # Sphinx reports it
