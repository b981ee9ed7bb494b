"""Sets of many windows: they contain every moved point and do not grow by wrapping."""

import math
from fractions import Fraction

import numpy as np
import pytest
from flint import arb

import hamsym
from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic.balls import number_of, working
from hamsym.proof.windows.equation import Equation
from hamsym.proof.windows.window_lemma import TooLongError, WindowLemma
from hamsym.proof.windows.window_sets import ErrorSet, Place, set_sizes
from tests.proof.misses import TERMS, exact_polynomials

_BITS = 300


def turned(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s], [-s, c]])


def moved(J, R, count, error, extra):
    """The set after ``count`` windows of one map."""
    found = ErrorSet.of_radii(np.asarray(R, dtype=float)[:, None])
    J_error = np.full(J.shape, error)
    for _ in range(count):
        found = found.moved(J, J_error, np.full((len(J), 1), extra), np.ones(len(J)))
    return found


def test_turned_box_keeps_its_widths_over_thousands_of_windows():
    count, extra = 5_000, 1e-13
    found = moved(turned(0.7), [1.0, 1e-6], count, 1e-17, extra)
    for angle in (0.0, 0.7 * count, 0.7 * count + math.pi / 2):
        direction = np.array([math.cos(angle), -math.sin(angle)])
        own = turned(0.7 * count) @ np.diag([1.0, 1e-6])
        exact = np.abs(direction @ own).sum()
        width = float((np.abs(direction @ found.G) @ found.R)[0])
        # Each window adds its errors, turned; roundings are below 1e-15 a window.
        assert exact * (1 - 1e-9) <= width <= exact + 3 * count * (extra + 1e-15)
    assert found.G.shape[1] < 300


def test_errors_of_many_windows_add_up():
    """Without an initial set: a box of errors grows linearly, not exponentially."""
    sizes = [moved(turned(0.7), [0.0, 0.0], n, 0.0, 1e-10).sizes().max() for n in (500, 4_000)]
    assert 500e-10 < sizes[0] < 1_500e-10
    assert 4_000e-10 < sizes[1] < 12_000e-10


def test_shear_stretches_the_set_as_it_does_its_corner():
    found = moved(np.array([[1.0, 0.5], [0.0, 1.0]]), [1e-6, 1e-6], 1_000, 0.0, 0.0)
    assert found.sizes()[:, 0] == pytest.approx([501e-6, 1e-6], rel=1e-6)


_MAPS = {
    "rotation": turned(0.7),
    "shear": np.array([[1.0, 0.3], [0.0, 1.0]]),
    "growth": np.array([[1.05, 0.02], [0.03, 0.94]]),
    "two rotations": np.block([[turned(0.3), np.eye(2) / 10], [np.zeros((2, 2)), turned(1.1)]]),
}


@pytest.mark.parametrize("name", _MAPS)
@pytest.mark.parametrize("radius", [0.0, 1e-3])
def test_sets_of_many_windows_contain_moved_points(name, radius):
    J, rng, count = _MAPS[name], np.random.default_rng(1), 400
    n = len(J)
    error, extra = 1e-9, 1e-8
    sets = [ErrorSet.of_radii(np.full((n, 1), radius))]
    for _ in range(count):
        fresh = np.full((n, 1), extra)
        sets.append(sets[-1].moved(J, np.full((n, n), error), fresh, np.ones(n)))
    with working(_BITS):
        for _ in range(3):
            z = [arb(radius) * int(s) for s in rng.choice([-1, 1], n)]
            for own in sets[1:]:
                steps = rng.choice([-1, 1], (n, n + 1)) * [*[1] * n, extra]
                z = [
                    sum(
                        ((arb(a) + s * error) * b for a, s, b in zip(row, signs, z, strict=True)),
                        last,
                    )
                    for row, (*signs, last) in zip(J.tolist(), steps.tolist(), strict=True)
                ]
                bounds = own.sizes()[:, 0].tolist()
                assert all(abs(value) <= arb(b) for value, b in zip(z, bounds, strict=True))
    # The worst case grows so, too.
    assert (sets[-1].sizes()[:, 0] < 50 * (radius + count * 3 * extra) * 1.06**count).all()


def test_set_without_a_radius_has_no_columns_of_its_own():
    empty = ErrorSet.of_radii(np.zeros((2, 1)))
    assert empty.G.shape == (2, 0)
    assert (empty.sizes() == 0).all()


@pytest.mark.parametrize("value", [math.inf, math.nan])
@pytest.mark.parametrize("part", ["map", "error", "extra"])
def test_bounds_that_are_not_finite_give_no_finite_set(part, value):
    J, J_error, extra = np.eye(2), np.zeros((2, 2)), np.zeros((2, 1))
    {"map": J, "error": J_error, "extra": extra}[part][0, 0] = value
    with np.errstate(all="ignore"):
        found = ErrorSet.of_radii(np.ones((2, 1))).moved(J, J_error, extra, np.ones(2))
        assert not (found.sizes() <= 1e300).all()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_boxed_set_without_an_orthogonal_matrix_is_infinite(value):
    G, R = np.array([[1.0, 0.3, 0.1], [0.2, 1.0, 0.4]]), np.ones((3, 1))
    _, radii = enclosures().boxed_set(G, R, np.array([value, 1.0]))
    assert not (radii < np.inf).any()


def test_sizes_over_a_window_bound_the_exact_values():
    rng = np.random.default_rng(2)
    for m in (3, 30):
        V = rng.normal(size=(2, 3, TERMS)) * 0.7 ** np.arange(TERMS)
        G, R = rng.normal(size=(3, m)), 10.0 ** rng.uniform(-9, 0, m)
        bounds = set_sizes(V, G, R)
        for x in (-1.0, 1.0, 0.3):
            basis = exact_polynomials(Fraction(x), TERMS)
            for i in range(2):
                values = [
                    sum((Fraction(c) * t for c, t in zip(row, basis, strict=True)), Fraction(0))
                    for row in V[i].tolist()
                ]
                total = Fraction(0)
                for c in range(m):
                    entry = sum(
                        (v * Fraction(g) for v, g in zip(values, G[:, c].tolist(), strict=True)),
                        Fraction(0),
                    )
                    total += abs(entry) * Fraction(float(R[c]))
                assert total <= Fraction(float(bounds[i]))


def _lemma():
    equation = Equation(Hamiltonian("p**2/2 + x**2/2"))
    lemma = WindowLemma(equation, 1, np.array([0.0, 1.0]), np.zeros(2), 32)
    half = Fraction(1, 8)
    lemma.enter(Place(half, 0.125, number_of(half), number_of(half)))
    return lemma


def test_low_parts_of_any_polynomial_become_normal():
    """Bounds of products leave out those of two low parts, which only small ones allow."""
    lemma = _lemma()
    for high, low in ((1.0, 1e-17), (1.0, -1.1e-16), (1e-30, 1e-47), (0.0, 0.0), (3.0, 2e-3)):
        lemma.bound_defect(np.full((2, 32), high), np.full((2, 32), low))
        own, rest = lemma.y
        assert (np.abs(rest) <= 2.0**-53 * np.abs(own)).all()
        assert Fraction(own[0, 0]) + Fraction(rest[0, 0]) == Fraction(high) + Fraction(low)


def test_windows_without_a_relative_bound_of_their_length_are_refused():
    with pytest.raises(CertificationError, match="another unit of time"):
        hamsym.enclose("p**2/2 + x**2/2", [1, 0], (0, 1e-310))


def test_bounds_of_a_poor_guess_are_wide_or_refused():
    """The lemma holds for any y, V and units: here for the flow of the oscillator from (0, 1)."""
    rng, wide = np.random.default_rng(5), 0
    for k in range(40):
        lemma = _lemma()
        x = np.linspace(-1, 1, 33) if k % 2 else np.array([-1.0, 1.0])
        size = 10.0 ** rng.uniform(-12, 0)
        high = rng.normal(size=(2, 32)) * size * 0.5 ** np.arange(32)
        high[1, 0] += 1
        lemma.bound_defect(high, rng.normal(size=(2, 32)) * size)
        V = rng.normal(size=(2, 2, 32)) * size * 0.5 ** np.arange(32)
        V[:, :, 0] += np.eye(2)
        units = 10.0 ** rng.uniform(-3, 3, 2)
        try:
            found = lemma.bounds(V, units, lemma.start(), np.full(2, 1e-280), k % 3 == 0)
        except TooLongError:
            continue
        wide += 1
        basis = np.polynomial.chebyshev.chebvander(x, 31)
        y = basis @ (lemma.y[0] + lemma.y[1]).T
        time = (x + 1) / 8
        true = np.stack([np.sin(time), np.cos(time)], axis=1)
        assert (np.abs(true - y) <= found.tube + 1e-14).all()
        flow = np.array([[np.cos(time), np.sin(time)], [-np.sin(time), np.cos(time)]])
        apart = np.abs(np.moveaxis(flow, 2, 0) - np.moveaxis(V @ basis.T, 2, 0))
        assert (apart <= found.derivative + 1e-14).all()
    assert wide > 5


@pytest.mark.parametrize(("n", "k", "m"), [(1, 1, 1), (3, 5, 4), (2, 0, 3), (0, 2, 2), (4, 3, 0)])
def test_products_of_any_shape(n: int, k: int, m: int) -> None:
    generator = np.random.default_rng(n)
    a, b = generator.normal(size=(n, k)), generator.normal(size=(k, m))
    product = enclosures().product
    np.testing.assert_allclose(product(a, b), a @ b, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(product(a, b.sum(axis=1)), a @ b.sum(axis=1), atol=1e-14)
    stacked = np.stack((b, -b), axis=2)
    np.testing.assert_allclose(product(a, stacked), np.stack((a @ b, -a @ b), axis=2), atol=1e-14)
    with pytest.raises(ValueError, match="shapes"):
        product(a, np.ones((k + 1, m)))
