"""Summaries of results: the error first, within 80 columns, with nothing left out silently."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian

OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
KEPLER = "(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)"
HENON_HEILES = "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3"
IN_SI = Hamiltonian(
    "(p_x**2 + p_y**2)/(2*m) + k*(x**2 + 2*y**2)/2",
    parameters={"m": 9.109e-31, "k": 1e-12},
    units={"x": "m", "y": "m", "p_x": "kg*m/s", "p_y": "kg*m/s", "m": "kg", "k": "N/m"},
)


def chain(count: int) -> Hamiltonian:
    terms = [f"p{i}**2/2 + q{i}**2/2" for i in range(count)]
    return Hamiltonian(" + ".join(terms + [f"(q{i} - q{i + 1})**4/4" for i in range(count - 1)]))


def solved(degrees: int) -> hamsym.Solution:
    H = chain(degrees)
    return hamsym.solve(H, np.linspace(0.1, 1.0, H.dim), (0, 2))


def narrow(text: str) -> bool:
    return max(map(len, text.splitlines())) <= 80


@pytest.mark.slow_cases("30")
@pytest.mark.parametrize("degrees", [1, 2, 6, 30])
def test_solution_begins_with_the_largest_error(degrees: int) -> None:
    solution = solved(degrees)
    text = solution.summary()
    assert narrow(text)
    found = re.match(r"converged: largest estimated error (\S+) in (\w+), ", text)
    assert found is not None
    shares = solution.largest_error / solution.allowed_error
    name = solution.H.names[int(np.argmax(shares))]
    assert found.groups() == (f"{solution.largest_error[np.argmax(shares)]:.1e}", name)
    rows = [line.split()[0] for line in text.splitlines() if line.endswith(" %")]
    if solution.H.dim <= 12:
        assert rows == list(solution.H.names)
        return
    order = np.argsort(-shares, kind="stable")
    assert rows == [solution.H.names[k] for k in order[:12]]
    assert f"... and {solution.H.dim - 12} components with smaller errors; all with" in text
    whole = solution.summary(rows=None)
    with pytest.raises(hamsym.InputError, match="rows='a' cannot be used; give a whole number"):
        solution.summary(rows="a")  # type: ignore[arg-type]
    assert all(f"\n{name} " in whole for name in solution.H.names)
    assert "..." not in whole


def test_units_of_si_are_shown() -> None:
    start = [1e-6, 2e-6, 1e-27, 1e-24]
    text = hamsym.solve(IN_SI, start, (0, 2e-8)).summary()
    assert narrow(text)
    assert re.match(r"converged: largest estimated error \S+ (m|kg\*m/s) in \w+, ", text)
    assert re.search(r"^p_y  kg\*m/s +1e-24 ", text, re.MULTILINE)
    assert "paper" not in text  # metres beside momenta
    text = hamsym.integrate(IN_SI, start, (0, 2e-8), tol=1e-9).summary()
    assert narrow(text)
    assert re.match(r"largest estimated error \S+ kg\*m/s in p_[xy], \S+ % of tol 1.0e-09", text)


@pytest.mark.slow
def test_bound_of_the_paper_is_given_where_it_says_something() -> None:
    solution = hamsym.solve(OSCILLATOR, [1.3, 1], (0, 9))
    assert solution.largest_error.max() <= solution.error_bound < 1
    assert f"ell_max/sigma_min: {solution.error_bound:.2e} (heuristic)" in solution.summary()
    violated = hamsym.solve(KEPLER, [1, 0, 0, 1], (0, 60))  # errors grow, the bound does not
    assert violated.error_bound < violated.largest_error.max()
    assert "paper" not in violated.summary()
    assert "ell_max/sigma_min" in violated.summary(rows=None)
    free = hamsym.solve(Hamiltonian("p**2/2", q=["x"], p=["p"]), [0.0, 1.0], (0, 1))
    assert "paper" not in free.summary()
    text = " ".join(free.summary(rows=None).split())
    assert "infinite: the Hessian is singular on the trajectory" in text


@pytest.mark.slow
def test_failure_is_said_first() -> None:
    text = hamsym.solve("p**2/2 - x**4/4", [1, 1], (0, 5)).summary()
    assert text.startswith("stopped at t = 1.31103")
    assert "% of the" in text
    assert "converged" not in text
    trajectory = hamsym.integrate(KEPLER, [[1, 0, 0, 1], [1, 0, 0, 0]], (0, 6), tol=1e-6)
    assert trajectory.summary().startswith("1 of 2 trajectories failed, number 1 first")


def test_component_of_zero_meets_what_was_asked() -> None:
    solution = hamsym.solve("(p_x**2+p_y**2)/2 + (x**2+y**2)/2", [1, 0, 0, 0], (0, 9))
    assert (solution.largest_error <= solution.allowed_error).all()
    assert "more" not in solution.summary()


@pytest.mark.slow
def test_trained_network_is_related_to_its_tolerance() -> None:
    solution = hamsym.solve(
        OSCILLATOR, [1.3, 1], (0, 0.4), method=hamsym.Adam(epochs=40, points=20)
    )
    text = " ".join(solution.summary().split())
    assert re.search(r"largest estimated error \S+ in [xp], \S+ % of the \S+ asked", text)
    assert "ms of CPU per epoch" in text


def test_loaded_solution_has_the_same_summary(tmp_path) -> None:
    solution = hamsym.solve(KEPLER, [1, 0, 0, 1], (0, 5), tol=1e-7)
    solution.save(tmp_path / "orbit")
    assert hamsym.load(tmp_path / "orbit").summary() == solution.summary()


def test_trajectory_without_tolerance_has_no_error() -> None:
    trajectory = hamsym.integrate(chain(30), np.linspace(0.1, 1, 60), (0, 1), "dop853", steps=50)
    text = trajectory.summary()
    assert narrow(text)
    assert text.startswith("dop853: ")
    assert "estimated error" not in text
    assert "... and 50 components; all with" in text
    assert "q29 " in trajectory.summary(rows=None)


def test_comparison_begins_with_the_error_of_the_network() -> None:
    solution = hamsym.solve(OSCILLATOR, [1.3, 1], (0, 5))
    comparison = hamsym.compare(solution, "gauss4", max_steps=1000)
    text = comparison.summary()
    assert text.startswith(f"converged: error {comparison.rows[0].error:.2e} (2-norm) against ")
    assert comparison.reference.text in text.replace("\n", " ")
    assert str(comparison) == text


def results() -> list[tuple[Any, str]]:
    H, start = HENON_HEILES, [0.3, -0.3, 0.3, 0.15]
    t = np.linspace(0, 5, 40)
    orbit = hamsym.periodic_orbit("p**2/2 - cos(x)", [2, 0], symmetry={"p": "-p"})
    fit = hamsym.fit(
        "p**2/2 - g*cos(theta)",
        t,
        {"theta": 0.1 * np.cos(1.2 * t) + 0.001 * np.random.default_rng(0).normal(size=len(t))},
        free={"g": 1.3},
        z0={"theta": 0.1, "p": 0.0},
        span=(0, 5),
    )
    section = hamsym.section(H, start, (0, 100), "x = 0, p_x > 0")
    certificate = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 3)).certify()
    equilibria = hamsym.equilibria("p**2/2 - cos(x)", box={"x": (-40, 40), "p": (-1, 1)})
    return [
        (hamsym.lyapunov(H, start, (0, 200), count=2), "After a time of 200 the largest exponent"),
        (hamsym.lyapunov(H, [start] * 20, (0, 20)), "20 of 20 trajectories reached t = 20"),
        (hamsym.chaos_indicators(H, start, (0, 200)), "After a time of 200 the mean MEGNO is"),
        (section, f"{len(section.t)} crossings of x = 0, p_x > 0"),
        (certificate, "proven: error of "),
        (orbit, "converged: largest estimated error "),
        (orbit.family(energy=0.9, max_orbits=50), "family: "),
        (equilibria, "all 25 equilibria in the box, proven"),
        (fit, "converged in "),
    ]


@pytest.mark.slow
def test_every_result_has_a_summary() -> None:
    for result, begin in results():
        text = result.summary()
        assert text.startswith(begin), text
        assert narrow(text)
        if "..." in text and "rows=None" in text:
            assert "rows=None" not in result.summary(rows=None)
