"""Figures, texts and tables of sweeps over settings and seeds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym.errors import InputError
from hamsym.plotting.style import WARNING
from tests.plotting.inspection import check_layout

SPAN = (0.0, 3.0)


def sweep_of(settings: dict[str, dict[str, Any]], failed: tuple[str, ...] = ()) -> hamsym.Sweep:
    """Two seeds of each of the settings, of which those named failed."""
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], SPAN, tol=1e-6)
    found = {
        name: tuple(solution.judged(name not in failed, "no <b>$ way") for _ in range(2))
        for name in settings
    }
    return hamsym.Sweep((0, 1), SPAN, found, settings)


def red(axes: Any) -> np.ndarray:
    """Abscissas of the points in the colour of failures."""
    found = [line.get_xdata() for line in axes.lines if line.get_color() == WARNING]
    return np.concatenate(found) if found else np.empty(0)


@pytest.mark.slow
def test_one_swept_option_is_the_axis() -> None:
    sweep = sweep_of({f"1e-{k}": {"tol": 10.0**-k} for k in (8, 4, 6)}, failed=("1e-8",))
    figure = sweep.plot()
    check_layout(figure)
    assert figure.warning.startswith("2 of 6 runs failed")
    for axes in figure.axes:
        assert (axes.get_xlabel(), axes.get_xscale()) == ("tol", "log")
        np.testing.assert_array_equal(axes.lines[0].get_xdata(), [1e-8, 1e-6, 1e-4])
        np.testing.assert_array_equal(red(axes), [1e-8, 1e-8])
    with pytest.raises(InputError, match=r"'eror' is not a panel of this figure \(did you mean"):
        sweep.plot("eror")


@pytest.mark.slow
def test_second_option_makes_series() -> None:
    pairs = [(n, h) for n in (10, 20) for h in ((8,), (8, 8))]
    sweep = sweep_of({f"{n} {h}": {"iterations": n, "hidden": h} for n, h in pairs})
    figure = sweep.plot("time")
    check_layout(figure)
    assert figure.axes[0].get_xlabel() == "iterations"
    _, labels = figure.axes[0].get_legend_handles_labels()
    assert labels == ["hidden = (8,)", "hidden = (8, 8)"]


@pytest.mark.slow
def test_more_options_are_drawn_by_name_and_said() -> None:
    settings = {f"set ${k}": {"tol": 10.0**-k, "atol": k, "points": k} for k in (3, 4)}
    figure = sweep_of(settings, failed=("set $4",)).plot()
    check_layout(figure)
    ticks = [tick.get_text() for tick in figure.axes[0].get_xticklabels()]
    assert ticks == [r"set \$3", r"set \$4"]
    assert "differ in 3 options, tol, atol, points" in figure.caption.replace("\n", " ")
    check_layout(sweep_of({"a": {}}).plot())


def test_text_and_table_have_every_run() -> None:
    pytest.importorskip("pandas")
    sweep = sweep_of({"coarse": {"tol": 1e-3}, "fine": {"tol": 1e-6}}, failed=("coarse",))
    lines = sweep.summary().splitlines()
    assert lines[0].startswith("2 of 4 runs failed, for example: ")
    assert lines[1] == "2 of 4 runs converged, t from 0 to 3; the settings differ in tol"
    assert [line.split()[:2] for line in lines[4:]] == [["coarse", "0"], ["fine", "2"]]
    table = sweep.to_dataframe()
    assert table["tol"].tolist() == [1e-3, 1e-3, 1e-6, 1e-6]
    assert table["success"].tolist() == [False, False, True, True]
    assert table["seed"].tolist() == [0, 1, 0, 1]
