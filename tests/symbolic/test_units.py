"""Units of components: consistency by dimension and factor, the unit of the time, where they go."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import VariableError

SPRING = "p**2/(2*m) + k*x**2/2"
UNITS = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}


@pytest.mark.parametrize(
    ("formula", "units", "time"),
    [
        (SPRING, UNITS, "s"),
        (SPRING, {"x": "cm", "p": "g*cm/ms", "m": "g", "k": "g/ms**2"}, "ms"),
        (SPRING + " + k*x**2*cos(w*t)", UNITS | {"w": "Hz"}, "s"),
        ("p**2/2 + x**2/2", {"x": "1", "p": "1"}, "1"),
        ("cos(t)*p**2 + t*x**2", {"x": "1", "p": "1", "t": "1"}, "1"),
        (
            "p_r**2/(2*m) + p_phi**2/(2*m*r**2) - k/r",
            {"r": "au", "phi": "rad", "p_r": "kg*au/day", "p_phi": "kg*au**2/day", "m": "kg"}
            | {"k": "kg*au**3/day**2"},
            "day",
        ),
        (
            "sqrt(p**2*c**2 + m**2*c**4) + x*E",
            {"x": "m", "p": "eV*s/m", "c": "m/s", "m": "eV*s**2/m**2", "E": "eV/m"},
            "s",
        ),
        (
            "p**2/(2*m) - V*exp(-abs(x)/l) + max(k*x**2, V) + V*atan2(x, l)",
            UNITS | {"V": "J", "l": "m"},
            "s",
        ),
        ("p**2/(2*m) + b*x", UNITS | {"p": "kg*m/s", "b": "kg*m/s**2", "x": "m"}, "s"),
    ],
)
def test_unit_of_the_time_follows(formula: str, units: dict[str, str], time: str) -> None:
    units = {name: unit for name, unit in units.items() if f"{name}" in formula}
    assert Hamiltonian(formula, units=units).units == units | {"t": time}


@pytest.mark.parametrize(
    ("formula", "units", "mentions"),
    [
        (SPRING, UNITS | {"x": "cm"}, ["k*x**2/2", "0.0001*kg*m**2/s**2", "not converted"]),
        ("p**2/(2*m) + k*x**3", UNITS, ["k*x**3", "kg*m**3/s**2"]),
        (SPRING + " + 1", UNITS, ["'1'", "kg*m**2/s**2"]),
        ("p**2/(2*m) + k*x**2*cos(t)", UNITS, ["'t' in 'cos(t)'", "unit s", "plain numbers"]),
        ("p**2/(2*m) + k*x**2*2**x", UNITS, ["'x' in '2**x'", "unit m"]),
        (SPRING + " + k*x**2*cos(w*t)", UNITS | {"w": "1/ms", "t": "ms"}, ["'t' has the unit"]),
        ("p**2/(2*I) - k*cos(x)", {"x": "deg", "p": "J*s", "I": "kg*m**2", "k": "J"}, ["0.01745"]),
        (
            "p_1**2/2 + p_2**2/2 + x1*x2",
            {"x1": "m", "p_1": "m/s", "x2": "m", "p_2": "m"},
            ["x2*p_2", "m**2", "one unit of action"],
        ),
        ("cos(t)*p**2 + t*x**2", {"x": "1", "p": "1"}, ["every term", "unit of 't'"]),
        (SPRING, UNITS | {"x": "foo"}, ["'foo'", "not known"]),
        (SPRING, UNITS | {"x": "m + s"}, ["'m + s' is not a unit of 'x'"]),
        (SPRING, UNITS | {"x": "sin(m)"}, ["not a unit"]),
        (SPRING, UNITS | {"x": "-m"}, ["not a unit"]),
        (SPRING, UNITS | {"x": "m^2"}, ["not a unit", "column 2"]),
        (SPRING, UNITS | {"x": 3}, ["a text such as"]),
        (SPRING, ["m"], ["not a mapping"]),
    ],
)
def test_units_that_do_not_fit_are_refused(
    formula: str, units: object, mentions: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        Hamiltonian(formula, units=units)  # type: ignore[arg-type]
    for mention in mentions:
        assert mention in str(caught.value)


def test_names_of_units_are_those_of_H() -> None:
    with pytest.raises(VariableError, match="'y' has a unit"):
        Hamiltonian(SPRING, units=UNITS | {"y": "m"})
    with pytest.raises(VariableError, match="'p' has no unit"):
        Hamiltonian(SPRING, units={"x": "m", "m": "kg", "k": "N/m"})
    assert Hamiltonian("p**2 + t**2", q=["t"], p=["p"], units={"t": "1", "p": "1"}).units == {
        "t": "1",
        "p": "1",
        "time": "1",
    }


def test_units_are_kept(tmp_path: Path) -> None:
    H = Hamiltonian(SPRING, parameters={"m": 1.0, "k": 4.0}, units=UNITS)
    expected = UNITS | {"t": "s"}
    assert H.with_parameters(k=2.0).units == expected
    assert pickle.loads(pickle.dumps(H)).units == expected
    assert Hamiltonian(SPRING, parameters={"m": 1.0, "k": 4.0}) == H
    solution = hamsym.solve(H, [1, 0], (0, 2))
    path = tmp_path / "s.hamsym"
    hamsym.save(solution, path)
    loaded = hamsym.load(path)
    assert loaded.H.units == expected
    np.testing.assert_array_equal(loaded(1.0), solution(1.0))


def test_units_with_a_factor_are_kept() -> None:
    """The unit of the time is 1/137 s, which has no name: its text is read again."""
    units = {"x": "m", "p": "137*kg*m/s", "m": "kg", "k": "137**2*N/m"}
    H = Hamiltonian(SPRING, units=units)
    assert H.units["t"].endswith("*s")
    assert H.with_parameters(k=2.0).units == H.units


@pytest.mark.slow
def test_axes_show_units() -> None:
    H = Hamiltonian(SPRING, parameters={"m": 1.0, "k": 4.0}, units=UNITS)
    assert H.labelled("x") == "x [m]"
    for result in (hamsym.solve(H, [1, 0], (0, 2)), hamsym.integrate(H, [1, 0], (0, 2), steps=50)):
        axes = hamsym.plot(result).axes
        assert axes[0].get_xlabel() == "$t$ [s]"
        assert axes[0].get_ylabel() == "$x$ [m]"
        assert axes[1].get_ylabel() == "$p$ [kg·m/s]"
    plain = hamsym.plot(hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 2))).axes
    assert plain[0].get_xlabel() == "$t$"
