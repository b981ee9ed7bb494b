"""Canonical transformations: new Hamiltonians, motion on both sides, and what is refused."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import VariableError
from hamsym.symbolic.brackets import poisson_bracket

KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
SPACE = "(p_x**2 + p_y**2 + p_z**2)/(2*m) - k/sqrt(x**2 + y**2 + z**2) + x*z/9"
OSCILLATOR = "p**2/2 + x**2/2"
POLAR = {"x": "r*cos(phi)", "y": "r*sin(phi)"}

#: (H, formulas, options, a state, whether time enters)
CASES: list[tuple[Hamiltonian, dict[str, Any], dict[str, Any], list[float]]] = [
    (Hamiltonian(KEPLER), POLAR, {"positive": "r"}, [1.0, 0.2, -0.1, 1.1]),
    (
        Hamiltonian(SPACE, parameters={"m": 2.0, "k": 1.5}),
        {"x": "r*sin(th)*cos(ph)", "y": "r*sin(th)*sin(ph)", "z": "r*cos(th)"},
        {"positive": ["r"], "new": ["r", "th", "ph"]},
        [0.7, -0.4, 0.3, 0.2, 1.1, 0.5],
    ),
    (
        Hamiltonian(SPACE, parameters={"m": 2.0, "k": 1.5}),
        POLAR,  # z stays
        {"positive": "r"},
        [0.7, -0.4, 0.3, 0.2, 1.1, 0.5],
    ),
    (
        Hamiltonian(KEPLER),  # a rotating frame
        {"x": "X*cos(t) - Y*sin(t)", "y": "X*sin(t) + Y*cos(t)"},
        {},
        [1.0, 0.2, -0.1, 1.1],
    ),
    (
        Hamiltonian(OSCILLATOR),
        {"x": "sqrt(2*J)*sin(w + t)", "p": "sqrt(2*J)*cos(w + t)"},
        {"new": {"w": "J"}, "positive": "J"},
        [0.3, 0.9],
    ),
    (  # parabolic coordinates
        Hamiltonian(KEPLER),
        {"x": "xi**2 - eta**2", "y": "2*xi*eta"},
        {},
        [1.0, 0.2, -0.1, 1.1],
    ),
    (Hamiltonian("p**2/2 + x**4/4"), {"x": "P", "p": "-Q"}, {"new": {"Q": "P"}}, [0.4, 0.9]),
    (
        Hamiltonian("p**2/2 - cos(x) - x*sin(t)/3", forces={"p": "-p/5 + cos(x)"}),
        {"x": "X + X**3/6 + sin(t)"},
        {},
        [0.4, 0.2],
    ),
]


MARKED = [pytest.param(k, marks=[pytest.mark.slow] * (k == 1)) for k in range(len(CASES))]


@functools.cache
def transformed(case: int) -> Any:
    H, formulas, options, _ = CASES[case]
    return H.transformed(formulas, **options)


def test_states_where_a_positive_variable_is_not_have_no_old_ones() -> None:
    # |(x, y)|**3 is written r**3: behind the axis it attracts to minus infinity
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + sqrt(x**2 + y**2)**3")
    polar = H.transformed(POLAR, positive="r")
    fall = hamsym.solve(polar.H, polar.to_new([1.0, 0, 0, 0]), (0, 2.5))
    times = np.linspace(0, 2.5, 50)
    before = polar.to_old(fall(times[:20]))
    exact = hamsym.solve(Hamiltonian("p**2/2 + x**3"), [1.0, 0], (0, 2.5))(times[:20])
    assert np.abs(before[:, [0, 2]] - exact).max() < 1e-8
    after = fall(2.5)
    after[polar.H.names.index("r")] = 0.0
    for states in (fall(2.5), fall(times), after):
        with pytest.raises(InputError, match="r is .*only while it is above zero"):
            polar.to_old(states)


@pytest.mark.parametrize("case", MARKED)
def test_motion_is_the_same_on_both_sides(case: int) -> None:
    (H, _, _, z0), found = CASES[case], transformed(case)
    start = found.to_new(z0)
    assert np.abs(found.to_old(start) - z0).max() < 1e-13
    times = np.linspace(0, 6, 40)
    new = hamsym.solve(found.H, start, (0, 6), tol=1e-11, atol=1e-12)
    old = hamsym.solve(H, z0, (0, 6), tol=1e-11, atol=1e-12)
    assert new.success
    assert np.abs(found.to_old(new(times), times) - old(times)).max() < 1e-9
    # and back along the trajectory, without jumps of angles
    back = found.to_new(old(times), times, near=start)
    assert np.abs(back - new(times)).max() < 1e-8


@pytest.mark.parametrize("case", MARKED)
def test_brackets_of_the_old_variables(case: int) -> None:
    (H, _, _, z0), found = CASES[case], transformed(case)
    known = found.formulas
    point = dict(zip(found.H.names, found.to_new(z0, 0.4).tolist(), strict=True))
    values = {sympy.Symbol(n, real=True): sympy.Float(v, 30) for n, v in point.items()}
    values[sympy.Symbol("t", real=True)] = sympy.Rational(2, 5)
    form = found.H.real_equations
    for a in known:
        for b in known:
            bracket = poisson_bracket(known[a], known[b], form.z)
            pair = (H.names.index(a), H.names.index(b))
            expected = {H.dof: 1, -H.dof: -1}.get(pair[1] - pair[0], 0)
            assert abs(bracket.xreplace(values).evalf(30) - expected) < 1e-20


@pytest.mark.slow
@pytest.mark.parametrize("case", range(len(CASES)))
def test_motion_in_50_digits_on_both_sides(case: int) -> None:
    (H, _, _, z0), found = CASES[case], transformed(case)
    time = sympy.Symbol("t", real=True)

    def function(own: Hamiltonian, rows: list[sympy.Expr]) -> Callable[..., list[mpmath.mpf]]:
        form = own.real_equations
        values = {symbol: sympy.Rational(value) for symbol, value in form.parameters.values()}
        return sympy.lambdify([*form.z, time], [row.xreplace(values) for row in rows], "mpmath")

    end = mpmath.mpf(1) / 4

    def moved(own: Hamiltonian, start: list[mpmath.mpf]) -> list[mpmath.mpf]:
        rates = function(own, [*own.real_equations.vector_field])
        return list(mpmath.odefun(lambda t, y: rates(*y, t), 0, start)(end))

    with mpmath.workdps(50):
        known, symbols = found.formulas, dict(zip(H.names, H.real_equations.z, strict=True))
        old = function(found.H, [known.get(name, symbols[name]) for name in H.names])
        start = [*map(mpmath.mpf, found.to_new(z0).tolist())]
        new = moved(found.H, start)
        apart = mpmath.matrix(old(*new, end)) - mpmath.matrix(moved(H, old(*start, 0)))
        assert mpmath.norm(apart, mpmath.inf) < 1e-45


def test_readable_hamiltonians() -> None:
    polar = Hamiltonian(KEPLER).transformed(POLAR, positive="r").H
    assert polar == Hamiltonian(
        "p_r**2/2 + p_phi**2/(2*r**2) - 1/r", q=["phi", "r"], p=["p_phi", "p_r"]
    )
    frame = Hamiltonian(KEPLER).transformed(CASES[3][1]).H
    assert frame.time is None
    assert frame.is_conserved("X*p_Y - Y*p_X")


@pytest.mark.parametrize(
    ("kind", "function", "expected"),
    [
        ("F1", "x*X", "X**2/2 + P**2/2"),
        ("F2", "x*P + P**2/2", "P**2/2 + (X - P)**2/2"),
        ("F3", "-p*X + p**2/2", None),
        ("F4", "p*P", "X**2/2 + P**2/2"),
        ("F2", "(x - t)*P", "P**2/2 + (X + t)**2/2 - P"),
    ],
)
def test_generating_functions(kind: str, function: str, expected: str | None) -> None:
    found = Hamiltonian(OSCILLATOR).transformed(new={"X": "P"}, **{kind: function})
    if expected is not None:
        assert sympy.expand(found.H.expr - Hamiltonian(expected, q=["X"], p=["P"]).expr) == 0
    z0 = [0.3, -0.8]
    new = hamsym.solve(found.H, found.to_new(z0), (0, 3), atol=1e-10)
    exact = np.array([np.cos(3) * 0.3 - np.sin(3) * 0.8, -np.sin(3) * 0.3 - np.cos(3) * 0.8])
    assert np.abs(found.to_old(new(3.0), 3.0) - exact).max() < 1e-8


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ({"x": "2*X", "p": "P"}, {}, "{x, p} is 2 in the new variables, not 1"),
        ({"x": "X + P**2", "p": "P + X**2"}, {"new": {"X": "P"}}, "not canonical"),
        ({"x": "3"}, {"new": "X"}, "the determinant of their derivatives by X is zero"),
        ({}, {}, "not a mapping of old variables"),
        ("x", {}, "not a mapping of old variables"),
        (None, {}, "or one generating function"),
        ({"x": "X"}, {"F2": "x*P"}, "or one generating function"),
        ({"x": "X*t"}, {"positive": "q"}, "positive='q' is no new variable"),
        ({"p": "P"}, {}, "give formulas of coordinates alone"),
        (None, {"F2": "x*P"}, "name the new variables of F2"),
        (
            None,
            {"F1": "x**2*X + x*X**2", "new": {"X": "P"}},
            "the equations of F1 have 2 solutions",
        ),
        (None, {"F1": "x", "new": {"X": "P"}}, "of F1 have no solution for x, p"),
        ({"x": "X**3 + X*exp(X*t)", "p": "P"}, {}, "not canonical"),
        ({"x": object()}, {}, "a formula must be a str or a sympy expression, not object"),
        ({"x": "X"}, {"positive": 3}, "positive=3 cannot be used; give a name or a list"),
        ({"x": "X"}, {"new": 3}, "new=3 cannot be used; give a name or a list"),
    ],
)
def test_maps_that_are_refused(arguments: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        Hamiltonian(OSCILLATOR).transformed(arguments, **options)


@pytest.mark.parametrize("t", ["a", 1j, 10**400, [1, 2, 3], [0.0]])
def test_times_that_do_not_belong_to_the_states_are_refused(t: Any) -> None:
    found = Hamiltonian(OSCILLATOR).transformed({"x": "2*X"})
    for convert in (found.to_old, found.to_new):
        with pytest.raises(InputError, match="t has (an entry that is not|shape)"):
            convert([1, 0] if t != [0.0] else [[1, 0], [2, 0]], t)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ({"y": "X"}, {}, "H has no variable 'y'"),
        ({"x": "x + 1"}, {}, "'x' is a name of H"),
        ({"x": "X*Y"}, {}, "1 coordinate changes, and the new ones are X, Y"),
        ({"x": "X/m"}, {"new": "X"}, "'m' is neither a new variable nor a parameter of H"),
        (None, {"F2": "x*X", "new": {"X": "P"}}, "F2 is a function of (q, P), which 'X' is none"),
        ({"x": "X"}, {"new": {"X": "X"}}, "name as many with new="),
    ],
)
def test_names_that_do_not_fit(arguments: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(VariableError, match=re.escape(message)):
        Hamiltonian(OSCILLATOR).transformed(arguments, **options)


def test_forces_need_coordinates_alone() -> None:
    H = Hamiltonian(OSCILLATOR, forces={"p": "-p"})
    with pytest.raises(InputError, match="coordinates alone"):
        H.transformed({"x": "P", "p": "-Q"}, new={"Q": "P"})


def test_variables_that_are_positive_stay_so() -> None:
    found = Hamiltonian(KEPLER).transformed(POLAR, positive="r")
    random = np.random.default_rng(2)
    for z0 in random.uniform(-2, 2, (40, 4)):
        r = found.to_new(z0)[found.H.names.index("r")]
        assert r == pytest.approx(np.hypot(*z0[:2]))


@pytest.mark.parametrize(
    "sizes", [(1e11, 1e-8), (1e-11, 1e8), (1.5e11, 3e4), (1e5, 1e-12)], ids=str
)
def test_components_of_different_sizes_are_each_mapped_back(sizes: tuple[float, float]) -> None:
    found = Hamiltonian(KEPLER).transformed(POLAR, positive="r")
    random = np.random.default_rng(4)
    for z0 in random.uniform(-2, 2, (4, 4)) * np.repeat(sizes, 2):
        back = found.to_old(found.to_new(z0))
        for pair in (slice(0, 2), slice(2, 4)):
            np.testing.assert_allclose(
                back[pair], z0[pair], rtol=0, atol=1e-9 * sizes[pair.start // 2]
            )
    on_axis = np.array([sizes[0], 0.0, 0.0, sizes[1]])
    back = found.to_old(found.to_new(on_axis))
    assert (np.abs(back - on_axis) <= 1e-9 * np.repeat(sizes, 2)).all()


@pytest.mark.parametrize("sizes", [(2.0**60, 2.0**60), (1.5e11, 1.8e29), (2.0**-60, 2.0**-90)])
def test_starts_of_the_search_have_the_units_of_the_new_variables(
    sizes: tuple[float, float],
) -> None:
    polar = Hamiltonian(KEPLER).transformed(POLAR, positive="r")
    state = polar.to_new(np.array([1.0, 0.2, 0.1, 1.1]) * np.repeat(sizes, 2))
    length, momentum = sizes
    assert polar.H.names == ("phi", "r", "p_phi", "p_r")
    units = [1.0, length, length * momentum, momentum]
    own = polar.to_new([1.0, 0.2, 0.1, 1.1])
    np.testing.assert_allclose(state / units, own, rtol=1e-12)  # of the same turn
    oscillator = Hamiltonian(OSCILLATOR)
    cubed = oscillator.transformed({"x": f"X + X**3/{length}**2"})
    back = cubed.to_old(cubed.to_new([0.0, momentum]))
    np.testing.assert_allclose(back, [0.0, momentum], atol=1e-12 * length)


def test_a_frame_that_rotates_fast() -> None:
    frame = {"x": "X*cos(3e7*t) - Y*sin(3e7*t)", "y": "X*sin(3e7*t) + Y*cos(3e7*t)"}
    found = Hamiltonian(KEPLER).transformed(frame)
    assert found.H.time is None
    assert found.H.is_conserved("X*p_Y - Y*p_X")


def test_angles_of_too_many_turns_are_no_solution() -> None:
    found = Hamiltonian(KEPLER).transformed(POLAR, positive="r")
    z0 = [1.0, 0.2, -0.1, 1.1]
    with pytest.raises(InputError, match="no new variables are found for"):
        found.to_new(z0, near={"phi": 1e22, "r": 1e10, "p_phi": 1.0, "p_r": 1.0})


def test_states_without_new_variables() -> None:
    found = Hamiltonian(OSCILLATOR).transformed({"x": "exp(X)"})
    with pytest.raises(InputError, match="no new variables are found for"):
        found.to_new([-1.0, 0.0])


def test_old_variables_that_are_not_finite_are_refused() -> None:
    action = Hamiltonian(OSCILLATOR).transformed(
        {"x": "sqrt(2*J)*sin(w)", "p": "sqrt(2*J)*cos(w)"}, new={"w": "J"}
    )
    with pytest.raises(InputError, match=r"x is nan at \{'w': 1.0, 'J': -1.0\}"):
        action.to_old([[1.0, 1.0], [1.0, -1.0]])
    polar = Hamiltonian(KEPLER).transformed(POLAR)
    with pytest.raises(InputError, match="p_x is nan at .*'r': 0.0"):
        polar.to_old({"phi": 0.0, "r": 0.0, "p_phi": 1.0, "p_r": 1.0})
