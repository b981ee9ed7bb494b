"""Figures of results that have no function of their own."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hamsym
from hamsym import Facts, InputError
from hamsym.facts.facts import Column, Table
from hamsym.plotting.plot import _figures
from hamsym.support.shown import Shown

DRIFT = Column("drift", np.array([0.0, 0.1, 0.3]))
STATES, TEXTS = Column("state", np.zeros((3, 2))), Column("outcome", ["a", "b", "c"])
TIMES = ["0", "1.5", "2.5"]


def result(*columns: Column, rows: list[str] = TIMES, drawn: float = 3.0) -> Shown:
    """A result with these facts."""

    class Drifts(Shown):
        H = hamsym.Hamiltonian("p**2/2 + x**2/2")
        table = Table("times", rows, columns, "t")
        facts = Facts("Drifts", "it drifts", success=False, entries=(table,), drawn=drawn)

    return Drifts()


def test_columns_of_numbers_are_drawn_over_the_rows() -> None:
    other = Column("energy", [1, 2, 3])
    figure = hamsym.plot(result(STATES, DRIFT, TEXTS, other))
    (axes,) = figure.axes
    lines = {line.get_label(): line.get_xydata().tolist() for line in axes.lines}
    assert lines == {
        "drift": [[0.0, 0.0], [1.5, 0.1], [2.5, 0.3]],
        "energy": [[0.0, 1.0], [1.5, 2.0], [2.5, 3.0]],
    }
    assert axes.get_xlabel() == "t"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["drift", "energy"]
    assert "it drifts" in figure.caption
    assert "H" in figure.caption
    assert figure.warning == "Failed: it drifts"


def test_rows_without_numbers_are_named() -> None:
    (axes,) = hamsym.plot(result(DRIFT, rows=["A", "B", "C"])).axes
    assert [text.get_text() for text in axes.get_xticklabels()] == ["A", "B", "C"]
    assert axes.lines[0].get_xdata().tolist() == [0, 1, 2]
    assert axes.get_ylabel() == "drift"


def test_results_without_numbers_are_refused() -> None:
    with pytest.raises(InputError, match="Drifts has no table of numbers"):
        hamsym.plot(result(STATES, TEXTS))
    with pytest.raises(InputError, match="Drifts cannot be plotted"):
        hamsym.plot(result(DRIFT, drawn=math.inf))
    with pytest.raises(InputError, match="int cannot be plotted"):
        hamsym.plot(3)


def test_every_public_result_with_a_plot_has_a_figure() -> None:
    results = {getattr(hamsym, name) for name in hamsym.__all__ if name[0].isupper()}
    drawn = {kind.__name__ for kind in results if hasattr(kind, "plot")}
    assert drawn <= {*_figures()}
