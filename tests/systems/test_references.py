"""Reference states of the catalogue, against other integrators and published numbers."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import itertools
import json
from collections.abc import Callable
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
import scipy.integrate
import sympy

import hamsym
from hamsym import systems
from hamsym.systems import CATALOGUE, Problem
from hamsym.systems.catalogue import _references, listed
from tests.audit import make_references
from tests.audit.taylor import formula

# Names and starts as the file has them: to build all systems takes seconds.
ROWS = [(row["system"], row["start"]) for row in _references()]
_SLOW = {"argon_crystal", "lennard_jones", "pleiades"}
_FEW = ["kepler", "henon_heiles", "driven_duffing", "point_vortices", "swinging_atwood", "stormer"]


def _slow(name: str) -> object:
    return pytest.mark.slow if name in _SLOW else ()


@functools.cache
def made(name: str, start: str) -> Problem:
    return CATALOGUE[name](**({"start": start} if start else {}))


def scipy_rates(problem: Problem):
    """Right-hand side from the text of H; shares no code with the package."""
    H, half = problem.H, problem.H.dim // 2
    expression = formula(H.formula, [*H.names, *H.parameters, "t"])
    z = [sympy.Symbol(name, real=True) for name in (*H.names, "t")]
    expression = expression.subs({sympy.Symbol(n, real=True): v for n, v in H.parameters.items()})
    rates = [expression.diff(p) for p in z[half:-1]] + [-expression.diff(q) for q in z[:half]]
    function = sympy.lambdify([*z], rates, "numpy", cse=True)
    return lambda t, state: function(*state, t)


def scipy_end(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """End state by DOP853, and the largest magnitude of each component."""
    found = scipy.integrate.solve_ivp(
        scipy_rates(problem), problem.span, problem.z0, "DOP853", rtol=3e-14, atol=1e-14
    )
    assert found.success
    return found.y[:, -1], np.abs(found.y).max(axis=1)


def check_by_scipy(problem: Problem) -> None:
    z, scale = scipy_end(problem)
    # DOP853 makes errors of round-off size, which grow as a change of the start does.
    allowed = 1e-12 + 3e-14 * problem.reference.growth
    assert allowed < 1e-7
    assert (np.abs(z - problem.reference.state) <= allowed * np.maximum(scale, 1e-3)).all()


@pytest.mark.slow
def test_every_usual_problem_has_a_reference() -> None:
    assert {name for name, _ in ROWS} == set(CATALOGUE)
    assert len(set(ROWS)) == len(ROWS)
    for name, start in ROWS:
        problem = made(name, start)
        assert problem.start == start
        reference = problem.reference
        assert reference is not None
        assert reference.t == problem.span[1]
        assert reference.digits == 30
        assert len(reference.z) == problem.H.dim
        assert all((name, other) in ROWS for other in problem.starts)


@pytest.mark.slow
def test_problem_and_reference_have_the_same_numbers() -> None:
    """The stored ones, which a function computes up to its round-off."""
    for row in _references():
        name, start = row["system"], row["start"]
        problem = made(name, start)
        assert problem.z0 == tuple(row["z0"])
        assert problem.span[1] == problem.reference.t == row["t"]
        assert dict(problem.H.parameters) == row["parameters"]  # as written, not computed
        computed = inspect.unwrap(CATALOGUE[name])(**({"start": start} if start else {}))
        np.testing.assert_allclose(computed.z0, problem.z0, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(computed.span, problem.span, rtol=1e-13)


def test_round_off_of_the_start_leaves_its_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    def toda_chain() -> Problem:
        problem = inspect.unwrap(systems.toda_chain)()
        return dataclasses.replace(problem, z0=tuple(np.nextafter(problem.z0, 9.0).tolist()))

    monkeypatch.setitem(CATALOGUE, "toda_chain", systems.toda_chain)  # put back later
    found, usual = listed(toda_chain)(), systems.toda_chain()
    assert found.reference == usual.reference is not None
    assert found.z0 == usual.z0


@pytest.mark.parametrize("name", _FEW)
def test_reference_agrees_with_scipy(name: str) -> None:
    check_by_scipy(made(name, next(start for key, start in ROWS if key == name)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "start"), ROWS)
def test_every_reference_agrees_with_scipy(name: str, start: str) -> None:
    check_by_scipy(made(name, start))


@pytest.mark.parametrize(
    ("name", "solution"),
    [
        ("harmonic_oscillator", make_references.linear),
        ("coupled_oscillators", make_references.linear),
        ("penning_trap", make_references.linear),
        ("kepler", make_references.kepler),
        ("pendulum", make_references.pendulum),
    ],
)
def test_reference_has_thirty_digits(name: str, solution: Callable) -> None:
    """Against exact solutions from the same float64 start, in 50 digits by mpmath."""
    problem = made(name, "")
    H = problem.H
    system = SimpleNamespace(
        z0=problem.z0, span=problem.span, names=H.names, text=H.formula, parameters=H.parameters
    )
    (exact,) = solution(system, [problem.reference.t])
    for value, digits in zip(exact, problem.reference.z, strict=True):
        assert abs(value - mpmath.mpf(digits)) < 3e-30


@pytest.mark.slow_cases(
    "point_vortices-shaken polygon",
    "fermi_pasta_ulam_tsingou-",
    "point_vortices-polygon",
)
@pytest.mark.parametrize(
    ("name", "start"), [pytest.param(*row, marks=_slow(row[0])) for row in ROWS]
)
def test_solution_meets_its_tolerance_at_the_end(name: str, start: str) -> None:
    problem = made(name, start)
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
    assert solution.success, solution.message
    error = np.abs(solution(problem.reference.t) - problem.reference.state)
    assert (error <= 1e-9 * solution.scale).all()


def test_exact_solutions_reach_the_references() -> None:
    exact = [made(*row) for row in ROWS if made(*row).exact is not None]
    assert len(exact) > 12
    for problem in exact:
        end = problem.exact(np.array(problem.reference.t))
        np.testing.assert_allclose(end, problem.reference.state, rtol=0, atol=1e-12)


# -- published numbers ----------------------------------------------------------------------------


def test_pleiades_end_where_the_test_set_says() -> None:
    """Positions and velocities at t = 3 in the IVP test set, release 2.4."""
    x = (
        *(0.3706139143970502, 3.237284092057233, -3.222559032418324, 0.6597091455775310),
        *(0.3425581707156584, 1.562172101400631, -0.7003092922212495),
    )
    y = (
        *(-3.943437585517392, -3.271380973972550, 5.225081843456543, -2.590612434977470),
        *(1.198213693392275, -0.2429682344935824, 1.091449240428980),
    )
    vx = (
        *(3.417003806314313, 1.354584501625501, -2.590065597810775, 2.025053734714242),
        *(-1.155815100160448, -0.8072988170223021, 0.5952396354208710),
    )
    vy = (
        *(-3.741244961234010, 0.3773459685750630, 0.9386858869551073, 0.3667922227200571),
        *(-0.3474046353808490, 2.344915448180937, -1.947020434263292),
    )
    state = systems.pleiades().reference.state.reshape(4, 7)
    state[2:] /= np.arange(1, 8)
    np.testing.assert_allclose(state, [x, y, vx, vy], rtol=0, atol=2e-13)


@pytest.mark.parametrize("start", systems.arenstorf().starts)
def test_arenstorf_orbits_close(start: str) -> None:
    problem = made("arenstorf", start)
    assert problem.reference.t == problem.period
    # The published digits, rounded to float64, and the speed of 2 at the start.
    allowed = 1e-15 * problem.reference.growth
    gap = np.abs(problem.reference.state - problem.z0)
    assert allowed < 1e-8
    assert (gap <= allowed * np.array([1, 1, 2, 2])).all()


@pytest.mark.parametrize(
    ("start", "error"),
    [("L1", 1e-12), ("L2, near the moon", 1e-15)],  # of the published start, of ours
)
def test_halo_orbits_close(start: str, error: float) -> None:
    problem = made("halo_orbits", start)
    gap = np.abs(problem.reference.state - problem.z0)
    allowed = error * problem.reference.growth
    assert allowed < 1e-8
    assert (gap <= allowed * np.abs(problem.z0).max()).all()


def test_figure_eight_closes() -> None:
    problem = systems.three_bodies()
    np.testing.assert_allclose(problem.reference.state, problem.z0, rtol=0, atol=1e-13)


# -- which problems have one -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda: systems.kepler(0.5),
        lambda: systems.driven_duffing(force=0.31),
        lambda: systems.point_vortices(5),
        lambda: systems.lagrange_top(spin=3.0),
    ],
)
def test_other_arguments_have_no_reference(make) -> None:
    assert make().reference is None


def test_usual_arguments_may_be_written_out() -> None:
    usual = systems.kepler().reference
    assert usual is not None
    assert systems.kepler(0.6).reference == systems.kepler(eccentricity=0.6).reference == usual


def test_references_are_strict_json() -> None:
    for row in _references():
        json.dumps(row, allow_nan=False)
        assert row["growth"] >= 1


def test_rows_are_in_the_order_of_the_catalogue() -> None:
    names = [name for name, _ in itertools.groupby(ROWS, key=lambda row: row[0])]
    assert names == list(CATALOGUE)
