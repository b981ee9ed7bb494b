"""Switches in time: Piecewise and Heaviside, their times, and solutions against exact ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.symbolic import switching

x, p, t, a = sympy.symbols("x p t a", real=True)
TIMES = np.linspace(0, 10, 201)
DRIVEN = "p**2/2 + x**2/2 - F*x*Heaviside(t - t1)"


def exact(times: np.ndarray, start: float = 1.0, force: float = 2.0) -> np.ndarray:
    """Oscillator from rest at x = 1, with a constant force from a time on."""
    later = np.maximum(times - start, 0)
    return np.stack(
        [np.cos(times) + force * (1 - np.cos(later)), -np.sin(times) + force * np.sin(later)], -1
    )


@pytest.mark.parametrize("options", [{}, {"breakpoints": [1.0, 2.5]}])
def test_switched_force_is_solved_to_the_tolerance(options: dict) -> None:
    H = Hamiltonian(DRIVEN, parameters={"F": 2.0, "t1": 1.0})
    solution = hamsym.solve(H, [1, 0], (0, 10), tol=1e-9, **options)
    assert solution.success
    assert np.abs(solution(TIMES) - exact(TIMES)).max() < 1e-9
    assert 1.0 in solution.record.edges.tolist()


def test_backward_in_time() -> None:
    H = Hamiltonian(DRIVEN, parameters={"F": 2.0, "t1": 1.0})
    solution = hamsym.solve(H, exact(np.array(10.0)), (10, 0))
    assert solution.success
    np.testing.assert_allclose(solution(0.0), [1, 0], atol=1e-8)


def test_each_member_has_its_own_switches() -> None:
    H = Hamiltonian(DRIVEN, parameters={"F": 2.0, "t1": 1.0})
    starts = np.array([0.5, 1.0, 20.0])
    many = hamsym.solve_many(H, [1, 0], (0, 10), parameters={"t1": starts})
    assert many.success.all()
    for values, start in zip(many(TIMES), starts, strict=True):
        assert np.abs(values - exact(TIMES, start)).max() < 1e-8


def test_square_wave_makes_a_triangle() -> None:
    """The momentum of H = p**2/2 - x*sign(sin(t)) is the distance to the even multiples of pi."""
    solution = hamsym.solve("p**2/2 - x*sign(sin(t))", [0, 0], (0, 20))
    assert solution.success
    times = np.linspace(0, 20, 301)
    triangle = np.abs((times + np.pi) % (2 * np.pi) - np.pi)
    assert np.abs(solution(times)[:, 1] - triangle).max() < 1e-9


@pytest.mark.parametrize(
    "pulse",
    [
        sympy.Piecewise((0, t < a), (1, t < 2 * a), (0, True)),
        sympy.Piecewise((1, (t >= a) & (t < 2 * a)), (0, True)),
        sympy.Piecewise((0, (t < a) | (t > 2 * a)), (1, True)),
        sympy.Heaviside(t - a) - sympy.Heaviside(t - 2 * a),
    ],
)
def test_pulse_in_every_form(pulse: sympy.Expr) -> None:
    """A force 1 for one second from rest: p = 1 and x = 1/2 + 1 a second later."""
    H = Hamiltonian(p**2 / 2 - x * pulse, parameters={a: 1.0})
    assert not H.expr.has(sympy.Piecewise)
    solution = hamsym.solve(H, [0, 0], (0, 3))
    assert solution.success
    np.testing.assert_allclose(solution(3.0), [1.5, 1.0], atol=1e-9)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (sympy.Piecewise((x, x < 1), (0, True)), "derivative of .* is not a regular function"),
        (sympy.Piecewise((x, t < 1)), "no value where no condition holds"),
        (sympy.Piecewise((x, sympy.Eq(t, 1)), (0, True)), "not a comparison"),
    ],
)
def test_other_pieces_are_refused(expression: sympy.Expr, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Hamiltonian(p**2 / 2 + expression)


def times_of(text: str, span: tuple[float, float], **parameters: float) -> list[float]:
    return switching.switch_times(Hamiltonian(text, parameters=parameters).real_equations, span)


def test_times_of_switches() -> None:
    assert times_of("p**2 + x*abs(t - 1) + x*max(t, 3)", (0, 5)) == [1, 3]
    assert times_of("p**2 + x*Heaviside(2*t - k)", (0, 5), k=3.0) == [1.5]
    assert times_of("p**2 + x*Heaviside(t**2 - 4) + x*Heaviside(t - 2)", (-3, 3)) == pytest.approx(
        [-2, 2]
    )
    assert times_of("p**2 + x*Heaviside(t - 7)", (0, 5)) == []
    assert times_of("p**2 + sign(x - t)*p + x", (0, 5)) == []
    assert times_of("p**2 + abs(x)", (0, 5)) == []
    assert times_of("p**2 + x*sign(cos(t))", (10, 0)) == pytest.approx(
        [np.pi / 2, 3 * np.pi / 2, 5 * np.pi / 2]
    )


@pytest.mark.parametrize(
    ("argument", "first", "last"),
    [
        ("1e-16 - (t - 5.00013)**2", 5.00013 - 1e-8, 5.00013 + 1e-8),
        ("cos((t - 5.00013)/10) - cos(1/100000)", 5.00013 - 1e-4, 5.00013 + 1e-4),
        ("1e-7 - abs(t - 5.00013)", 5.00013 - 1e-7, 5.00013 + 1e-7),
    ],
)
def test_pulse_between_two_samples_is_found(argument: str, first: float, last: float) -> None:
    # A sample of the span is 5e-4.
    times = times_of(f"p**2 + x*Heaviside({argument})", (0, 10))
    assert times[0] == pytest.approx(first, abs=1e-12)
    assert times[-1] == pytest.approx(last, abs=1e-12)


def test_short_pulse_of_a_square_is_solved_to_the_tolerance() -> None:
    width, middle = 1e-4, 5.00013
    H = Hamiltonian("p**2/2 + x**2/2 - 1e4*x*Heaviside(1e-8 - (t - 5.00013)**2)")
    solution = hamsym.solve(H, [1, 0], (0, 10), tol=1e-9)
    change = 2 / width * np.sin(width) * np.sin(10 - middle)
    assert solution.success
    assert solution(10.0)[0] == pytest.approx(np.cos(10) + change, abs=1e-9)


def test_tiny_argument_has_zeros() -> None:
    assert times_of("p**2 + x*sign(1e-200*sin(t))", (0, 5)) == pytest.approx([np.pi])


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("Heaviside(t - 1) + t/10 - 1/2", [1.0]),
        ("sign(sin(t)) + t/10", [np.pi]),
        ("erf(t - 1)*sign(t - 2)", [1.0, 2.0]),
    ],
)
def test_argument_may_contain_steps_and_erf(argument: str, expected: list[float]) -> None:
    assert times_of(f"p**2 + x*sign({argument})", (0, 5)) == pytest.approx(expected)


def test_too_many_switches_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(switching, "_MOST", 10)
    with pytest.raises(InputError, match="switched 31 times in the span, more than 10"):
        hamsym.solve("p**2/2 - x*sign(sin(t))", [0, 0], (0, 100))


def test_switched_solution_is_kept_in_a_file(tmp_path: Path) -> None:
    H = Hamiltonian(DRIVEN, parameters={"F": 2.0, "t1": 1.0})
    solution = hamsym.solve(H, [1, 0], (0, 3))
    hamsym.save(solution, tmp_path / "s.hamsym")
    loaded = hamsym.load(tmp_path / "s.hamsym")
    assert loaded.H == H
    np.testing.assert_array_equal(loaded(TIMES[:50]), solution(TIMES[:50]))


def test_formula_of_a_switch_reads_back() -> None:
    H = Hamiltonian(p**2 + x * sympy.Heaviside(t - 1))
    assert H.formula == "p**2 + x*Heaviside(t - 1)"
    assert Hamiltonian(H.formula) == H
