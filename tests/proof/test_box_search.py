"""All zeros of gradients in boxes: against numpy's roots of polynomials, and what is undecided."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian
from hamsym.proof.limits import Deadline
from hamsym.proof.zeros import box_search
from hamsym.proof.zeros.box_search import DEGENERATE, SINGULAR, Search, search_box, singular_term
from hamsym.proof.zeros.derivative_balls import DerivativeBalls
from hamsym.proof.zeros.roots import Root


def searched(
    H: Hamiltonian, low: list[float], high: list[float], most: int = 20_000, finest: float = 2**-32
) -> Search:
    """Zeros in a box of the coordinates."""
    block = list(range(H.dof))
    deadline = Deadline.after(None)
    return search_box(
        DerivativeBalls(H), block, low, high, most=most, deadline=deadline, finest=finest
    )


def middles(roots: list[Root]) -> np.ndarray:
    return np.array([[float(entry.mid()) for entry in root.enclosure] for root in roots])


def potential_of_slope(zeros: list[float]) -> str:
    """H = p^2/2 + V(x) with V' the monic polynomial of these zeros, as text."""
    x = sympy.Symbol("x")
    slope = sympy.prod([x - sympy.Rational(*float(z).as_integer_ratio()) for z in zeros])
    return f"p**2/2 + {sympy.integrate(sympy.expand(slope), x)}"


def test_all_zeros_of_random_polynomials_are_found() -> None:
    generator = np.random.default_rng(1)
    for _ in range(8):
        coefficients = generator.normal(size=7).round(3)
        H = Hamiltonian("p**2/2 + " + "+".join(f"({c})*x**{k}" for k, c in enumerate(coefficients)))
        slope = np.polynomial.Polynomial(coefficients).deriv()
        exact = slope.roots()
        exact = np.sort(exact[np.abs(exact.imag) < 1e-9].real)
        exact = exact[np.abs(exact) < 3]
        found = searched(H, [-3.0], [3.0])
        assert not found.undecided
        np.testing.assert_allclose(middles(found.roots)[:, 0], exact, atol=1e-8)


def test_zeros_where_boxes_are_divided_are_found_once() -> None:
    """Zeros on a first cut of the box, and on the second ones."""
    cuts = [-1 + 2 * 0.4871, -1 + 2 * 0.4871**2, 0.0, -1.0, 1.0]
    H = Hamiltonian(potential_of_slope(cuts))
    found = searched(H, [-1.0], [1.0])
    assert not found.undecided
    np.testing.assert_allclose(middles(found.roots)[:, 0], np.sort(cuts), atol=1e-12)


def test_zeros_outside_the_box_are_left_out() -> None:
    H = Hamiltonian(potential_of_slope([-1.0, 0.25, 1.0]))
    assert middles(searched(H, [-1 + 1e-12], [1 - 1e-12]).roots).ravel() == pytest.approx([0.25])


def test_close_pair_is_decided() -> None:
    H = Hamiltonian(potential_of_slope([0.3, 0.3 + 1e-6]))
    found = searched(H, [-2.0], [2.0])
    assert len(found.roots) == 2
    assert not found.undecided


def test_degenerate_zero_remains_undecided() -> None:
    found = searched(Hamiltonian("(p_x**2 + p_y**2)/2 + x**4 + y**4 + (x*y)**2"), [-1, -1], [1, 2])
    assert not found.roots
    assert {part.reason for part in found.undecided} == {DEGENERATE}
    low = np.min([part.low for part in found.undecided], axis=0)
    high = np.max([part.high for part in found.undecided], axis=0)
    assert (low <= 0).all()
    assert (high >= 0).all()
    assert (high - low < 1e-7).all()


def test_singularity_remains_undecided() -> None:
    H = Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r + r")
    places = [H.names.index(name) for name in ("r", "p_phi")]
    deadline = Deadline.after(None)
    found = search_box(DerivativeBalls(H), places, [-2, -1], [2, 1], most=20_000, deadline=deadline)
    assert SINGULAR in {part.reason for part in found.undecided}
    assert all(part.low[0] > -1e-7 and part.high[0] < 1e-7 for part in found.undecided)


def test_points_outside_the_domain_are_excluded() -> None:
    """x log(x) has its minimum at 1/e and no value below 0; zero itself is on the edge."""
    found = searched(Hamiltonian("p**2/2 + x*log(x)"), [-5.0], [5.0])
    assert middles(found.roots).ravel() == pytest.approx([math.exp(-1)])
    assert all(part.low[0] > -1e-8 and part.high[0] < 1e-8 for part in found.undecided)
    for term in ("asin(x)", "sqrt(1 - x)", "atanh(x)", "(1 - x)**(1/3)"):
        none = searched(Hamiltonian(f"p**2/2 + {term} + x**2"), [1.5], [9.0])
        assert not none.roots
        assert not none.undecided


def test_domains_of_other_components_do_not_exclude() -> None:
    """The momentum has no block in which the root is defined at zero."""
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + x**4 - exp(x) + sqrt(y - 1) - y")
    deadline = Deadline.after(None)
    balls = DerivativeBalls(H)
    assert len(search_box(balls, [0], [-2], [4], most=500, deadline=deadline).roots) == 1
    assert len(search_box(balls, [1], [1.1], [4], most=500, deadline=deadline).roots) == 1


def test_curves_of_singularities_are_not_followed_for_long() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + 1/(x - y + 0.3) + x*y")
    found = searched(H, [-2, -2], [2, 2], most=50_000)
    assert found.boxes < 20_000
    assert SINGULAR in {part.reason for part in found.undecided}
    for part in found.undecided:  # x - y = -0.3 meets each, apart from neighbours
        assert part.low[0] - part.high[1] - 0.05 < -0.3 < part.high[0] - part.low[1] + 0.05


def test_limits_leave_the_rest_undecided() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + cos(x)*cos(y) + x*y/7")
    few = searched(H, [-9, -9], [9, 9], most=40)
    assert few.boxes == 40
    assert few.undecided
    over = Deadline(0.0, began=-1e9)
    none = search_box(DerivativeBalls(H), [0, 1], [-9, -9], [9, 9], most=1_000, deadline=over)
    assert none.boxes == 0
    assert none.undecided[0].low == (-9, -9)


def test_terms_that_are_not_smooth_are_named() -> None:
    H = Hamiltonian("p**2/2 + sqrt(x - 1)")
    assert singular_term(H, [0.5, 0.0], [2.0, 1.0]) == "1/sqrt(x - 1)"
    assert singular_term(H, [2.0, 0.0], [3.0, 1.0]) == ""


def test_search_ends_where_zeros_accumulate(monkeypatch: pytest.MonkeyPatch) -> None:
    """x**4 sin(1/x) has infinitely many extrema next to 0."""
    monkeypatch.setattr(box_search, "_MOST_ROOTS", 60)
    found = hamsym.equilibria("p**2/2 + x**4*sin(1/x)", box={"x": (-1, 1), "p": (-1, 1)})
    assert not found.complete
    assert len(found) >= 50
    assert any(
        region.low[0] <= 0 <= region.high[0] and "infinitely many" in region.reason
        for region in found.undecided
    )
