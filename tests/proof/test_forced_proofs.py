"""Proofs about systems with forces, against exact solutions of high precision."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import sympy

import hamsym
from hamsym.errors import CertificationError
from hamsym.proof.arithmetic.functions import BALLS
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.proof.windows.equation import Equation

C, K = 0.2, 1.5
DAMPED = hamsym.Hamiltonian("p**2/2 + k*x**2/2", forces={"p": "-c*p"}, parameters={"c": C, "k": K})


def _exact(t: float) -> list[mpmath.mpf]:
    """The damped oscillation from (1, 0), to 40 digits."""
    with mpmath.workdps(40):
        c, k, t = mpmath.mpf(C), mpmath.mpf(K), mpmath.mpf(t)
        w = mpmath.sqrt(k - c**2 / 4)
        decay, b = mpmath.exp(-c * t / 2), c / 2 / w
        x = decay * (mpmath.cos(w * t) + b * mpmath.sin(w * t))
        p = -c / 2 * x + w * decay * (b * mpmath.cos(w * t) - mpmath.sin(w * t))
        return [x, p]


@pytest.fixture(scope="module")
def solution() -> hamsym.Solution:
    return hamsym.solve(DAMPED, [1, 0], (0, 10), tol=1e-6)


def test_bounds_enclose_the_true_error(solution: hamsym.Solution) -> None:
    certificate = hamsym.certify(solution)
    assert certificate.lower <= certificate.bound <= 1.03 * certificate.lower
    errors, energies = [], []
    for t in np.linspace(0, 10, 501):
        z, exact = [mpmath.mpf(v) for v in solution(t)], _exact(t)
        errors.append(float(mpmath.norm([a - b for a, b in zip(z, exact, strict=True)])))
        energy = lambda s: s[1] ** 2 / 2 + mpmath.mpf(K) * s[0] ** 2 / 2
        energies.append(float(abs(energy(z) - energy(exact))))
    # Samples of z^ are rounded to float64.
    assert 0.97 * certificate.lower - 1e-15 <= max(errors) <= certificate.bound + 1e-15
    assert 0.97 * certificate.energy_lower - 1e-15 <= max(energies)
    assert max(energies) <= certificate.energy_bound + 1e-15
    hamsym.verify(certificate.to_json(), solution)


def test_wrong_force_is_noticed(solution: hamsym.Solution) -> None:
    """The bound of the same function as a solution of another friction is its distance."""
    other = hamsym.Solution(
        **{
            name: getattr(solution, name)
            for name in ("z0", "span", "trial", "method", "record", "settings", "error", "success")
        },
        H=DAMPED.with_parameters(c=0.201),
    )
    certificate = hamsym.certify(other)
    assert certificate.lower > 1e-4


def test_enclosure_contains_the_solution_for_all_starts() -> None:
    enclosure = hamsym.enclose(DAMPED, ["1 +- 1e-6", "0 +- 1e-6"], (0, 10))
    for t in (2.0, 10.0):
        ball = enclosure(t)
        distance = np.abs(ball.mid - np.array([float(v) for v in _exact(t)]))
        assert (distance < ball.radius).all()
        assert ball.width < 1e-5


def test_enclosure_of_a_friction_in_a_ball() -> None:
    loose = DAMPED.with_parameters()
    enclosure = hamsym.enclose(loose, [1, 0], (0, 5), parameters={"c": "0.2 +- 1e-5"})
    ends = [
        hamsym.solve(DAMPED.with_parameters(c=c), [1, 0], (0, 5), tol=1e-12)(5.0)
        for c in (0.19999, 0.20001)
    ]
    ball = enclosure(5.0)
    for end in ends:
        assert (np.abs(ball.mid - end) <= ball.radius + 1e-12).all()
    assert (ball.radius < 10 * np.abs(ends[0] - ends[1])).all()


def test_derivatives_are_enclosed_in_both_arithmetics() -> None:
    from flint import arb

    H = hamsym.Hamiltonian("p**2/2*(1 + x**2)", forces={"p": "-p**3*cos(x) + exp(-t)"})
    x, p, t = sympy.symbols("x p t", real=True)
    field = [p * (1 + x**2), -(p**2) * x - p**3 * sympy.cos(x) + sympy.exp(-t)]
    at = {x: sympy.Rational(3, 10), p: sympy.Rational(-7, 5), t: sympy.Rational(1, 4)}
    balls = [arb(at[s].p) / at[s].q for s in (x, p, t)]
    found = dict(GeneratedFunctions(H, BALLS)("jacobian", balls[:2], balls[2]))
    for i in range(2):
        for j, symbol in enumerate((x, p)):
            expected = field[i].diff(symbol).xreplace(at).evalf(30)
            assert abs(float(found[i, j].mid()) - float(expected)) < 1e-13
    equation = Equation(H)
    assert not equation.conserved
    assert {(i, j) for i, j, _ in equation.entries} == {(0, 0), (0, 1), (1, 0), (1, 1)}
    assert (equation.signs == 1).all()


def test_jumping_force_has_no_proof() -> None:
    dry = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "-sign(p)/10"})
    found = hamsym.solve(dry, [1, 0.5], (0, 0.3))
    with pytest.raises(CertificationError, match="'sign', which has no enclosure"):
        hamsym.certify(found)


@pytest.mark.slow
def test_flow_map_of_friction_is_proven() -> None:
    H = hamsym.Hamiltonian("p**2/2 - cos(x)", forces={"p": "-c*p"}, parameters={"c": 0.3})
    flow = hamsym.flow_map(H, {"x": (0.9, 0.95), "p": (-0.05, 0.05)}, (0, 2), tol=1e-7)
    certificate = flow.certify()
    assert "force of p = -c*p" in certificate.statement
    random = np.random.default_rng(0)
    for z0 in random.uniform([0.9, -0.05], [0.95, 0.05], (10, 2)):
        exact = hamsym.solve(H, z0, (0, 2), tol=1e-12)
        for t in (0.7, 2.0):
            error = np.abs(flow(t, z0) - exact(t))
            assert (error <= np.array(certificate.bound) + 1e-12).all()
    assert max(certificate.bound) < 1e-6
