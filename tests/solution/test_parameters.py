"""Derivatives of trajectories in parameters, against exact solutions and other solves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import sympy
import torch

import hamsym
from hamsym import Hamiltonian, InputError, Solution
from hamsym.errors import ParameterError

Exact = Callable[..., tuple[Any, ...]]


def oscillator(t: Any, m: Any, k: Any) -> tuple[Any, ...]:
    w = mp.sqrt(k / m)
    return mp.cos(w * t), -m * w * mp.sin(w * t)


def pendulum(t: Any, g: Any) -> tuple[Any, ...]:
    """Released at the angle 1."""
    k, w = mp.sin(mp.mpf(1) / 2), mp.sqrt(g)
    cd, sn, dn = (mp.ellipfun(name, w * t, m=k**2) for name in ("cd", "sn", "dn"))
    rate = -2 * k * w * (1 - k**2) * sn / dn**2 / mp.sqrt(1 - (k * cd) ** 2)
    return 2 * mp.asin(k * cd), rate


def kepler(t: Any, mu: Any) -> tuple[Any, ...]:
    """From the pericentre (1, 0) with the velocity (0, 6/5)."""
    speed = mp.mpf(6) / 5
    a = 1 / (2 - speed**2 / mu)
    e, n = 1 - 1 / a, mp.sqrt(mu / a**3)
    angle = mp.findroot(lambda E: E - e * mp.sin(E) - n * t, n * t)
    c, s, b = mp.cos(angle), mp.sin(angle), a * mp.sqrt(1 - e**2)
    rate = n / (1 - e * c)
    return a * (c - e), b * s, -a * s * rate, b * c * rate


def driven(t: Any, F: Any, w: Any) -> tuple[Any, ...]:
    size = F / (1 - w**2)
    x = mp.cos(t) + size * (mp.cos(w * t) - mp.cos(t))
    return x, -mp.sin(t) + size * (mp.sin(t) - w * mp.sin(w * t))


def quartic(t: Any, b: Any) -> tuple[Any, ...]:
    a = mp.mpf(13) / 10
    w = mp.sqrt(1 + b * a**2)
    cn, sn, dn = (mp.ellipfun(n, w * t, m=b * a**2 / (2 * w**2)) for n in ("cn", "sn", "dn"))
    return a * cn, -a * w * sn * dn


def damped(t: Any, c: Any, k: Any) -> tuple[Any, ...]:
    w = mp.sqrt(k - c**2 / 4)
    x = mp.exp(-c * t / 2) * (mp.cos(w * t) + c / (2 * w) * mp.sin(w * t))
    return x, -mp.exp(c * t / 2) * k / w * mp.sin(w * t)


def saddle(t: Any, a: Any) -> tuple[Any, ...]:
    w = mp.sqrt(a)
    return mp.cosh(w * t), w * mp.sinh(w * t)


SPRING = "p**2/(2*m) + k*x**2/2"
DRIVEN = "p**2/2 + x**2/2 - F*x*cos(w*t)"
CASES = {
    "oscillator": (SPRING, {"m": 1.3, "k": 2.0}, (1, 0), (0, 20), oscillator),
    "backwards": (SPRING, {"m": 1.3, "k": 2.0}, (1, 0), (0, -20), oscillator),
    "small unit of k": (SPRING, {"m": 1.0, "k": 1e-12}, (1, 0), (0, 2e7), oscillator),
    "large unit of k": (SPRING, {"m": 1.0, "k": 1e9}, (1, 0), (0, 1e-3), oscillator),
    "atoms": (SPRING, {"m": 1e-27, "k": 1e3}, (1, 0), (0, 2e-14), oscillator),
    "pendulum": ("p**2/2 - g*cos(theta)", {"g": 9.81}, (1, 0), (0, 10), pendulum),
    "Kepler": (
        "(p_x**2 + p_y**2)/2 - mu/sqrt(x**2 + y**2)",
        {"mu": 1.0},
        (1, 0, 0, 1.2),
        (0, 30),
        kepler,
    ),
    "driven": (DRIVEN, {"F": 0.3, "w": 1.7}, (1, 0), (0, 20), driven),
    # Without the force the motion is slow: windows of z^ do not resolve the forcing.
    "a force of amplitude zero": (DRIVEN, {"F": 0.0, "w": 100.0}, (1, 0), (0, 20), driven),
    "quartic": ("p**2/2 + x**2/2 + b*x**4/4", {"b": 1.0}, (1.3, 0), (0, 20), quartic),
    "damped": (
        "p**2/2*exp(-c*t) + k*x**2/2*exp(c*t)",
        {"c": 0.2, "k": 1.5},
        (1, 0),
        (0, 20),
        damped,
    ),
    "saddle": ("p**2/2 - a*x**2/2", {"a": 4.0}, (1, 0), (0, 10), saddle),
}


def exact_derivatives(exact: Exact, t: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """Shape (n, dim, number of parameters), by differences in 40 digits."""
    found = []
    with mp.workdps(40):
        known = {name: mp.mpf(value) for name, value in values.items()}
        for name, value in known.items():
            h = mp.mpf(10) ** -15 * (abs(value) or 1)
            ends = [
                [exact(mp.mpf(float(time)), **known | {name: value + side}) for time in t]
                for side in (-h, h)
            ]
            slopes = (np.array(ends[1], dtype=object) - np.array(ends[0], dtype=object)) / (2 * h)
            found.append(slopes.astype(float))
    return np.stack(found, axis=-1)


@pytest.mark.parametrize("case", CASES)
def test_derivatives_against_exact_solutions(case: str) -> None:
    formula, values, z0, span, exact = CASES[case]
    solution = hamsym.solve(Hamiltonian(formula, parameters=values), z0, span, tol=1e-11)
    assert solution.success
    t = np.linspace(*span, 7)
    found = solution.sensitivity(t, parameters=list(values))
    expected = exact_derivatives(exact, t, values)
    assert found.shape == expected.shape
    sizes = np.abs(expected).max(axis=0)
    np.testing.assert_array_less(np.abs(found - expected).max(axis=0), 1e-9 * sizes + 1e-300)


@pytest.mark.slow
def test_derivatives_against_differences_of_solves() -> None:
    H = Hamiltonian(
        "(p_x**2 + p_y**2)/2 + (a*x**2 + y**2)/2 + c*x**2*y - y**3/3",
        parameters={"a": 1.0, "c": 1.0},
    )
    z0, span, t, h = [0.3, 0.1, 0.2, 0.4], (0, 30), np.linspace(0, 30, 11), 2e-4
    found = hamsym.solve(H, z0, span, tol=1e-11).sensitivity(t, parameters=["c", "a"])
    for k, name in enumerate(["c", "a"]):
        ends = [
            hamsym.solve(H.with_parameters(**{name: 1 + side * h}), z0, span, tol=1e-12)(t)
            for side in (-2, -1, 1, 2)
        ]
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        np.testing.assert_allclose(found[:, :, k], slope, atol=1e-7 * np.abs(slope).max())


@pytest.mark.slow
def test_trained_network_is_differentiated() -> None:
    H = Hamiltonian(DRIVEN, parameters={"F": 0.0, "w": 50.0})
    solution = hamsym.solve(
        H,
        [1, 0],
        (0, 6),
        method=hamsym.LevenbergMarquardt(iterations=60, points=50, hidden=(20, 20)),
    )
    t = np.linspace(0, 6, 7)
    expected = exact_derivatives(driven, t, {"F": 0.0, "w": 50.0})
    np.testing.assert_allclose(solution.sensitivity(t, parameters=["F", "w"]), expected, atol=1e-11)


@pytest.mark.slow
def test_equations_finer_than_the_motion() -> None:
    """The tangent map of a rest position whose stiffness oscillates, against a moving start."""
    H = Hamiltonian("p**2/2 + (1 + a*cos(w*t))*x**2/2", parameters={"a": 200.0, "w": 60.0})
    rest = hamsym.solve(H, [0, 0], (0, 10))
    columns = [hamsym.solve(H, z0, (0, 10), tol=1e-11)(10.0) for z0 in ([1, 0], [0, 1])]
    np.testing.assert_allclose(rest.sensitivity(10.0), np.transpose(columns), atol=1e-9)


def test_maps_finer_than_the_motion() -> None:
    """The tangent map of a rest position about which nearby motions oscillate quickly."""
    w, H = 300.0, Hamiltonian("p**2/2 + w**2*x**2/2", parameters={"w": 300.0})
    c, s = math.cos(10 * w), math.sin(10 * w)
    found = hamsym.solve(H, [0, 0], (0, 10)).sensitivity(10.0)
    scale = np.array([[1.0, 1 / w], [w, 1.0]])  # of each entry over a period
    np.testing.assert_allclose(found / scale, [[c, s], [-s, c]], atol=1e-9)


def test_pulse_between_the_nodes_acts() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - F*x*exp(-((t - 3)/0.01)**2)", parameters={"F": 0.0})
    found = hamsym.solve(H, [1, 0], (0, 10)).sensitivity(10.0, parameters=["F"])
    size = 0.01 * math.sqrt(math.pi) * math.exp(-(0.01**2) / 4)
    np.testing.assert_allclose(found[:, 0], [size * math.sin(7), size * math.cos(7)], rtol=1e-11)


@pytest.mark.slow
def test_kink_of_the_hessian_is_no_limit() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + max(x - k, 0)**2", parameters={"k": 0.3})
    found = hamsym.solve(H, [1, 0], (0, 5)).sensitivity(5.0, parameters=["k"])
    ends = [
        hamsym.solve(H.with_parameters(k=0.3 + h), [1, 0], (0, 5), tol=1e-11)(5.0)
        for h in (-1e-5, 1e-5)
    ]
    np.testing.assert_allclose(found[:, 0], (ends[1] - ends[0]) / 2e-5, rtol=1e-5)


def test_unresolvable_equations_give_nan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hamsym.solution.sensitivity._MOST_WINDOWS", 100)
    H = Hamiltonian(DRIVEN, parameters={"F": 0.0, "w": 1e6})
    found = hamsym.solve(H, [1, 0], (0, 10)).sensitivity([5.0, 10.0], parameters=["F"])
    assert np.isnan(found).all()


def test_unused_parameters_have_derivative_zero() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + c*t + k + b**2*x", parameters={"c": 1.0, "k": 2.0, "b": 0.0})
    found = hamsym.solve(H, [1, 0], (0, 5)).sensitivity([0.0, 5.0], parameters=["k", "c", "b"])
    np.testing.assert_array_equal(found, np.zeros((2, 2, 3)))


def test_names_that_are_reserved_elsewhere() -> None:
    formula, names = "p**2/2 + lambda*x**2/2 + out*x + z*x", ["z", "lambda", "out"]
    H = Hamiltonian(formula, parameters={"lambda": 2.0, "out": 0.3, "z": 0.2})
    plain = Hamiltonian("p**2/2 + a*x**2/2 + b*x + c*x", parameters={"a": 2.0, "b": 0.3, "c": 0.2})
    found, expected = (
        hamsym.solve(h, [1, 0], (0, 5)).sensitivity(5.0, parameters=given)
        for h, given in ((H, names), (plain, ["c", "a", "b"]))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_symbols_with_assumptions_and_numbers() -> None:
    k, (x, p) = sympy.Symbol("k", positive=True), sympy.symbols("x p")
    H = Hamiltonian(p**2 / 2 + sympy.sqrt(k) ** 2 * x**2 / 2 + 0.1 * k**2 * x, parameters={k: 2.0})
    solution = hamsym.solve(H, [1, 0], (0, 3), tol=1e-11)

    def exact(t: Any, k: Any) -> tuple[Any, ...]:
        w, rest = mp.sqrt(k), -mp.mpf(0.1) * k
        return rest + (1 - rest) * mp.cos(w * t), -w * (1 - rest) * mp.sin(w * t)

    expected = exact_derivatives(exact, np.array([3.0]), {"k": 2.0})[0]
    np.testing.assert_allclose(solution.sensitivity(3.0, parameters=[k]), expected, rtol=1e-10)


@pytest.fixture(scope="module")
def spring() -> Solution:
    H = Hamiltonian(SPRING, parameters={"m": 1.3, "k": 2.0})
    return hamsym.solve(H, [1, 0], (0, 10), tol=1e-11)


def test_shapes_and_order_of_columns(spring: Solution) -> None:
    both = spring.sensitivity([1.0, 2.0, 3.0], parameters=["k", "m"])
    assert both.shape == (3, 2, 2)
    assert spring.sensitivity(2.0, parameters=["k", "m"]).shape == (2, 2)
    np.testing.assert_allclose(spring.sensitivity(2.0, parameters="m")[:, 0], both[1, :, 1])
    tensor = spring.sensitivity(torch.tensor([1.0, 2.0, 3.0]), parameters=["k", "m"])
    np.testing.assert_allclose(tensor.numpy(), both, rtol=1e-12, atol=1e-12)
    assert spring.sensitivity(2.0).shape == (2, 2)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (["q"], "'q' is not a parameter of H; it has k, m"),
        (["x"], "'x' is not a parameter of H"),
        ([3], "'3' is not a parameter of H"),
        ([], "names no parameter"),
        (5, "parameters=5 cannot be used; give a name or a list"),
    ],
)
def test_names_that_are_refused(spring: Solution, parameters: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        spring.sensitivity(1.0, parameters=parameters)


@pytest.mark.slow_cases(
    "k*x + abs(x)-0.3-the force jumps at t = ", "abs(x - k)-0.3-the force jumps at t = 0\\\\.86"
)
@pytest.mark.parametrize(
    ("formula", "value", "message"),
    [
        ("abs(k)*x", 0.0, "no derivative in 'k' at k = 0, where k = 0 inside abs"),
        ("abs(k*x)", 0.0, "no derivative in 'k' at k = 0"),
        ("sign(k)*x", 0.0, "no derivative in 'k' at k = 0"),
        ("max(k, 1)*x", 1.0, "no derivative in 'k' at k = 1"),
        ("sqrt(k)*x", 0.0, "derivative of the force in 'k' is not finite at t = "),
        ("abs(x - k)", 0.3, r"the force jumps at t = 0\.86"),
        ("k*x + abs(x)", 0.3, "the force jumps at t = "),
        ("x*tanh(t)*sign(t - k)", 2.0, "the force jumps at t = 2"),
    ],
)
def test_missing_derivatives_are_refused(formula: str, value: float, message: str) -> None:
    H = Hamiltonian(f"p**2/2 + x**2/2 + {formula}", parameters={"k": value})
    solution = hamsym.solve(H, [1, 0], (0, 5))
    with pytest.raises(ParameterError, match=message):
        solution.sensitivity(5.0, parameters=["k"])


@pytest.mark.parametrize(
    ("formula", "value"), [("abs(k)*x", 1.0), ("k*abs(k)*x", 0.0), ("sign(k)", 0.0)]
)
def test_corners_without_effect_are_allowed(formula: str, value: float) -> None:
    H = Hamiltonian(f"p**2/2 + x**2/2 + {formula}", parameters={"k": value})
    found = hamsym.solve(H, [1, 0], (0, 5)).sensitivity(5.0, parameters=["k"])[:, 0]
    np.testing.assert_allclose(found, [value * (math.cos(5) - 1), -value * math.sin(5)], atol=1e-11)
