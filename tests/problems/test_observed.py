"""Formulas in the tables, the items, the events and the sections of results."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy

import hamsym
from hamsym.errors import InputError, VariableError
from hamsym.problems.surface import parse_surface, surface_text

pytest.importorskip("pandas")
pytest.importorskip("xarray")

SPRING = "p**2/2 + k*x**2/2"
T = np.array([0.0, 1.0, 2.5])


@pytest.fixture(scope="module")
def solution() -> hamsym.Solution:
    return hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 10), tol=1e-9)


@pytest.fixture(scope="module")
def many() -> hamsym.Solutions:
    """Two oscillators with frequencies 1 and 2."""
    return hamsym.solve_many(
        SPRING, {"x": [1.0, 2.0], "p": 0.0}, (0, 3), parameters={"k": [1.0, 4.0]}
    )


@pytest.fixture(scope="module")
def ensemble() -> hamsym.Trajectory:
    return hamsym.integrate(
        SPRING,
        {"x": [1.0, 2.0], "p": 0.0},
        (0, 3),
        "gauss6",
        steps=60,
        parameters={"k": [1.0, 4.0]},
    )


def test_tables_of_a_solution_have_formulas(solution: hamsym.Solution) -> None:
    table = solution.to_dataframe(T, "x", "p**2/2", sympy.Symbol("x") ** 2)
    assert table.columns.tolist() == ["x", "p**2/2", "x**2"]
    np.testing.assert_allclose(table["p**2/2"], np.sin(T) ** 2 / 2, atol=1e-8)
    assert np.isnan(solution.to_dataframe(T, "sqrt(x)")["sqrt(x)"].iloc[-1])
    data = solution.to_xarray(T, "x*p", "H")
    assert data["value"].dims == ("time", "quantity")
    np.testing.assert_allclose(data["value"].sel(quantity="H"), 0.5, atol=1e-8)
    assert "value" not in solution.to_xarray(T)


def test_members_have_parameters_of_their_own(
    many: hamsym.Solutions, ensemble: hamsym.Trajectory
) -> None:
    energies = np.array([0.5, 8.0])
    table = many.to_dataframe(T, "H", "k*x**2/2")
    assert table.columns.tolist() == ["H", "k*x**2/2", "k"]
    np.testing.assert_allclose(table["H"].to_numpy().reshape(2, 3), energies[:, None] * [1, 1, 1])
    values = many.to_xarray(T, "H")["value"]
    assert values.dims == ("member", "time", "quantity")
    np.testing.assert_allclose(values[:, 1, 0], energies)
    np.testing.assert_allclose(ensemble["H"], ensemble.energy, rtol=1e-12)
    assert ensemble["k*x**2/2"].shape == (2, 61)
    frame = ensemble.to_dataframe("k*x**2/2")
    np.testing.assert_allclose(frame.xs(0.0, level="t")["k*x**2/2"], energies)
    assert ensemble.to_xarray("x", "H")["value"].shape == (2, 61, 2)


def test_sections_have_formulas_with_parameters_of_each_start() -> None:
    found = hamsym.section(
        SPRING, {"x": [1.0, 2.0], "p": 0.0}, (0, 10), "x = 0, p > 0", parameters={"k": [1.0, 4.0]}
    )
    table = found.to_dataframe("H", "p")
    energies = np.array([0.5, 8.0])[found.trajectory]
    np.testing.assert_allclose(table["H"], energies, rtol=1e-7)
    assert table.columns.tolist() == ["trajectory", "t", "H", "p", "z0_x", "z0_p", "k"]
    assert found.plot("H", "p").axes[0].get_xlabel() == "$H$"


def test_events_and_surfaces_are_formulas(solution: hamsym.Solution) -> None:
    x, p = sympy.symbols("x p")
    expected = np.pi / 4 * np.array([1, 3, 5, 7, 9, 11])
    for event in ("p**2/2 = x**2/2", "H - x**2 = 0", sympy.Eq(p**2, x**2), p**2 - x**2):
        np.testing.assert_allclose(solution.events(event).t_events[0], expected, atol=1e-8)
    assert len(solution.events([x, "p = 0"]).t_events) == 2
    found = hamsym.section("p**2/2 + x**2/2", [1, 0], (0, 10), sympy.Eq(x, p))
    assert found.surface == "x = p"
    np.testing.assert_allclose(found.t, expected[1::2], atol=1e-8)
    assert surface_text(solution.H, p**2 / 2 - x) == "p**2/2 - x = 0"


@pytest.mark.parametrize(
    ("event", "message"),
    [
        ("sqrt(x) = 1/2", r"'sqrt\(x\) = 1/2' is not a number at t = 1\.57"),
        (sympy.log(sympy.Symbol("x")), r"'log\(x\) = 0' is not a number at t"),
        ("q = 0", "'q' does not occur in H; use only x, p, t"),
        (sympy.Symbol("x") > 0, "a surface is a str, not StrictGreaterThan"),
        ("x", "is not an equation"),
        ("2 = 1", "does not depend on the state"),
        ("__import__('os') = 0", "not a known function"),
    ],
)
def test_events_without_a_number_are_refused(
    solution: hamsym.Solution, event: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        solution.events(event)


def test_unknown_names_in_tables_are_refused(
    solution: hamsym.Solution, ensemble: hamsym.Trajectory
) -> None:
    for make in (
        lambda: solution.to_dataframe(T, "v"),
        lambda: solution.to_xarray(T, "x", "v"),
        lambda: ensemble.to_dataframe("v**2"),
        lambda: ensemble["v"],
    ):
        with pytest.raises(VariableError, match="'v' does not occur in H"):
            make()


def test_commas_in_functions_do_not_separate_conditions() -> None:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2")
    surface = parse_surface(H, "atan2(p, x) = 0, max(x, p) > 0")
    assert len(surface.conditions) == 1
