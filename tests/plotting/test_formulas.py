"""Figures and animations of formulas: values, labels, gaps, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

import hamsym
from hamsym.errors import InputError
from tests.plotting.inspection import check_layout

UNITS = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}


@pytest.fixture(scope="module")
def oscillator() -> hamsym.Trajectory:
    H = hamsym.Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1.0, "k": 1.0}, units=UNITS)
    return hamsym.integrate(H, [1, 0], (0, 10), tol=1e-9)


def test_a_formula_is_drawn_over_time_with_its_unit(oscillator: hamsym.Trajectory) -> None:
    figure = oscillator.plot("p**2/(2*m)")
    (axes,) = figure.axes
    t, values = axes.lines[0].get_data()
    np.testing.assert_allclose(values, np.sin(t) ** 2 / 2, atol=1e-7)
    assert axes.get_ylabel() == r"$\frac{p^{2}}{2 m}$ [kg·m$^{2}$/s$^{2}$]"
    check_layout(figure)


def test_planes_and_spaces_take_formulas(oscillator: hamsym.Trajectory) -> None:
    x, p = sympy.symbols("x p")
    figure = oscillator.plot("x", p**2)
    first, second = figure.axes[0].lines[0].get_data()
    np.testing.assert_allclose(first**2 + second, 1.0, atol=1e-7)
    assert figure.axes[0].get_title("left") == ""
    assert oscillator.plot("x", "p", "x*p").axes[0].get_zlabel() == "$p x$ [kg·m$^{2}$/s]"
    assert oscillator.plot("t", x * p).axes[0].get_xlabel() == "$t$ [s]"


def test_gaps_are_counted_in_the_caption(oscillator: hamsym.Trajectory) -> None:
    figure = oscillator.plot("sqrt(x)")
    t, values = figure.axes[0].lines[0].get_data()
    np.testing.assert_array_equal(np.isnan(values), np.cos(t) < 0)
    assert np.nanmin(values) < 0.05  # the curve is followed to its end
    assert "sqrt(x) is no finite real number at" in figure.caption.replace("\n", " ")
    with pytest.raises(InputError, match=r"'sqrt\(-1 - x\*\*2\)' is no finite real number at any"):
        oscillator.plot("sqrt(-1 - x**2)")


def test_lines_do_not_pass_through_infinity(oscillator: hamsym.Trajectory) -> None:
    axes = oscillator.plot("1/x").axes[0]
    values = axes.lines[0].get_ydata()
    jumps = np.sign(values[:-1]) * np.sign(values[1:])
    assert not (jumps == -1).any()
    assert np.isnan(values).any()
    assert axes.get_yscale() == "symlog"
    plane = oscillator.plot("1/x", "p").axes[0]
    assert (plane.get_xscale(), plane.get_yscale()) == ("symlog", "linear")


def test_fast_formulas_are_sampled_again(oscillator: hamsym.Trajectory) -> None:
    slow, fast = (
        len(oscillator.plot(name).axes[0].lines[0].get_xdata()) for name in ("x", "sin(400*x)")
    )
    assert fast > 1.5 * slow


def test_members_are_drawn_with_their_parameters() -> None:
    many = hamsym.solve_many(
        "p**2/2 + k*x**2/2", {"x": 1.0, "p": 0.0}, (0, 3), parameters={"k": [1.0, 4.0]}
    )
    ends = [line.get_ydata()[0] for line in many.plot("k*x**2/2").axes[0].lines]
    assert ends == [0.5, 2.0]
    states = many.animate("k*x", "p", frames=3)
    assert states.states.shape == (3, 2, 2)
    np.testing.assert_allclose(states._film._places[0, :, 0, 0], [1.0, 4.0])


def test_long_formulas_are_shortened_on_the_axis() -> None:
    H = hamsym.Hamiltonian("sum(i, 1, 30, p[i]**2/2 + q[i]**2/2)")
    trajectory = hamsym.integrate(H, np.ones(60), (0, 3), "gauss4", steps=60)
    text = "sum(i, 1, 30, p[i]**2/2 + q[i]**2/2)/30"
    figure = trajectory.plot(text)
    assert len(figure.axes[0].get_ylabel()) < 30
    assert f"Drawn is {text}" in figure.caption.replace("\n", " ")
    check_layout(figure)


def test_flow_maps_exponents_and_orbits_take_formulas() -> None:
    flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 1), tol=1e-6)
    figure = flow.plot("x**2 + p**2")
    lines = [line.get_ydata() for line in figure.axes[0].lines]
    assert all(np.ptp(values) < 1e-4 for values in lines)  # conserved
    assert flow.plot("x**2", "p").axes[0].get_xlabel() == "$x^{2}$"
    starts = {"x": np.array([0.5, 1.0, 1.5]), "p": 0.0}
    exponents = hamsym.lyapunov("p**2/2 - cos(x)", starts, (0, 5), dt=0.1)
    axes = exponents.plot("H").axes[0]
    np.testing.assert_allclose(axes.lines[0].get_xdata(), -np.cos(starts["x"]))
    orbit = hamsym.periodic_orbit("p**2/2 - cos(x)", [2, 0])
    assert orbit.plot("x", "p**2/2").axes[0].get_ylabel() == "$p^{2} / 2$"


def test_equilibria_are_drawn_in_planes_of_components() -> None:
    found = hamsym.equilibria("p**2/2 - x**2/2 + x**4/4")
    with pytest.raises(InputError, match=r"'x\*\*2' is a formula; equilibria .* of x, p"):
        found.plot("x**2", "p")


def test_animations_take_formulas_in_a_plane(oscillator: hamsym.Trajectory) -> None:
    animation = oscillator.animate("x**2", "sqrt(x)", frames=4)
    places = animation._film._places[:, 0, 0]
    shown = np.isfinite(places[:, 1])
    np.testing.assert_allclose(places[shown, 1] ** 4, places[shown, 0], atol=1e-9)
    assert not shown.all()
    with pytest.raises(InputError, match="is a formula, which is drawn in a plane"):
        oscillator.animate("x**2", "p", kind="phase")
    with pytest.raises(InputError, match="two components for each body"):
        oscillator.animate("x**2")
    with pytest.raises(InputError, match="'v' does not occur in H"):
        oscillator.animate("x", "v**2")
