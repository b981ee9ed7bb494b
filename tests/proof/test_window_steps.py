"""Steps of a window: bounds that hold in exact arithmetic and for linear equations."""

import math
from fractions import Fraction

import numpy as np
import pytest

from hamsym.kernel.enclosures import REDUCED_ANGLE, enclosures
from tests.proof.misses import (
    Transport,
    clenshaw_misses,
    dense_misses,
    set_misses,
    transport_bounds,
    transport_misses,
    value_misses,
)

_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_SADDLE = np.array([[0.0, 1.0], [1.0, 0.0]])
_NONE = np.zeros(2)
_NO_F = np.zeros((2, 2))
_RIPPLE = np.array([[1e-3, -2e-3], [5e-4, 1e-3]])
_SOME_F = np.array([[0.1, -0.02], [0.03, 0.05]])


def transport(A, **options):
    settings = {"start": _NONE, "D": _NONE, "F": np.zeros_like(A), **options}
    return Transport(np.array(A), **settings)


CASES = {
    "start error": transport(0.3 * _TURN, start=np.array([1e-3, 2e-3]), F=_SOME_F),
    "start error of an unstable flow": transport(1.5 * _SADDLE, start=np.ones(2), F=_SOME_F),
    "defect of V": transport(0.1 * _SADDLE, start=np.array([1.0, 0.5]), flat=True),
    "defect of V of a damped flow": transport(
        [[-0.4, 0.1], [0.2, -0.9]], start=np.ones(2), flat=True
    ),
    "ripple of V": transport(0.7 * _SADDLE, start=np.ones(2), ripple=_RIPPLE),
    "ripple of V in a rotation": transport(1.2 * _TURN, start=np.ones(2), ripple=_RIPPLE),
    "ripple of V beside the start": transport(
        0.3 * _TURN, start=np.array([1.0, 0.5]), F=-_RIPPLE, ripple=_RIPPLE
    ),
    "matrix that changes": transport(
        0.8 * _SADDLE, start=np.ones(2), D=np.array([1e-3, 2e-3]), slope=0.9
    ),
    "defect of V under a matrix that changes": transport(
        0.2 * _SADDLE, start=np.ones(2), flat=True, slope=-0.9
    ),
    "start error turned onto the defect": transport(
        math.pi / 2 * _TURN,
        start=np.array([1.0, 0.0]),
        F=np.array([[1e-3, 0.0], [0.0, 0.0]]),
        D=np.array([3e-4, 0.0]),
    ),
    "defect": transport(0.7 * _SADDLE, D=np.array([1e-3, 1e-4])),
    "defect of a rotation": transport(1.2 * _TURN, D=np.array([1e-3, 1e-4])),
    "growth": transport(3.0 * _SADDLE, start=np.ones(2), D=np.ones(2) * 1e-2, F=1e-2 * _SOME_F),
    "matrix in a tube": transport(0.5 * _SADDLE, start=np.ones(2), loose=0.05),
    "units": transport(
        [[0.0, 2.0], [0.5, 0.0]], start=np.ones(2), flat=True, D=np.ones(2) * 0.1, units=(4.0, 1.0)
    ),
    "parameter": transport(
        [[0.0, 0.4, 0.2], [-0.4, 0.0, 0.7]], start=np.array([0.0, 0.0, 1.0]), loose=0.01
    ),
    "parameter without its column": transport(
        [[0.0, 0.4, 0.2], [-0.4, 0.0, 0.7]], start=np.array([0.0, 0.0, 1.0]), flat=True
    ),
    "ripple beside a parameter": transport(
        [[0.0, 0.4, 0.2], [-0.4, 0.0, 0.7]],
        start=np.array([0.1, 0.2, 1.0]),
        ripple=np.array([[0.0, 1e-3, 1e-3], [1e-3, 0.0, -2e-3]]),
    ),
}


@pytest.fixture(scope="module")
def L():
    return enclosures()


@pytest.mark.parametrize("name", CASES)
def test_bounds_of_a_window_hold_for_linear_equations(L, name):
    assert transport_misses(L, CASES[name]) == []


def test_bounds_of_an_accurate_flow_are_small(L):
    tube, d, derivative, norm = transport_bounds(L, transport(0.3 * _TURN, start=np.ones(2)))
    assert d.max() < 1e-9
    assert derivative.max() < 1e-9
    assert tube.max() < 4
    assert norm < 1e-13


def test_ripple_of_the_guess_counts_without_its_derivative(L):
    """The defect of V is an integral: 1e-3 T_20 has the derivative 0.4."""
    rippled = transport(0.3 * _TURN, start=np.ones(2), F=-_RIPPLE, ripple=_RIPPLE)
    _, d, derivative, _ = transport_bounds(L, rippled)
    assert 2e-3 < derivative.max() < 1e-2
    assert 3e-3 < d.max() < 2e-2


def test_growth_is_that_of_the_flow(L):
    _, d, _, norm = transport_bounds(L, transport(1.0 * _SADDLE, D=np.array([1e-3, 1e-3])))
    assert norm == pytest.approx(2.0)  # of dz/dt; half the length is 1/2
    assert d.max() <= 2 * math.sqrt(2) * 1e-3 * math.exp(2) * 1.001


@pytest.mark.parametrize("value", [math.inf, math.nan])
@pytest.mark.parametrize("part", ["start", "D", "loose"])
def test_bounds_that_are_not_finite_give_no_tube(L, part, value):
    bad = {part: value if part == "loose" else np.array([0.0, value])}
    tube = transport_bounds(L, transport(0.3 * _TURN, **bad))[0]
    assert not (tube <= 1e300).all()


@pytest.mark.parametrize("name", ["moved_set", "boxed_set", "set_radius"])
def test_sets_contain_corners_of_the_exact_set(L, name):
    assert set_misses(L, name, 100, seed=1) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["moved_set", "boxed_set", "set_radius"])
def test_sets_contain_corners_of_very_many_sets(L, name):
    assert set_misses(L, name, 2_000, seed=2) == []


@pytest.mark.parametrize("radius", [math.inf, math.nan])
def test_box_of_an_infinite_set_is_infinite(L, radius):
    found = L.boxed_set(np.eye(2), np.array([[1.0], [radius]]), np.ones(2))[1]
    assert not (found <= 1e300).all()


def test_logarithmic_norm_covers_ratios_of_units_that_underflow(L):
    """Half of 1e304 1e-170/1e155, between two components that are not coupled otherwise."""
    units, none = np.array([1e155, 1e-170]), np.zeros(2)
    V = np.zeros((2, 2, 4))
    V[:, :, 0] = np.eye(2)
    given = np.array([[1e304, 0.0, 0.0, 0.0]]), np.ones(1, dtype=np.int64)
    signed = np.array([[0, 1, 0]]), np.ones(1)
    sizes = np.abs(V).sum(axis=2)
    flow = L.flow_defects(*given, *signed, V, sizes, 1.0)
    models = given[0], np.zeros(1), given[1]
    norm = L.transport(*models, *signed, none, none, sizes, *flow, none, 1.0, units)[3]
    exact = Fraction(1e304) * Fraction(units[1]) / Fraction(units[0]) / 2
    assert exact <= Fraction(norm) <= Fraction(1e-10)


def test_box_of_a_flat_set_contains_it(L):
    G = np.array([[1.0, 2.0, 0.0], [0.5, 1.0, 0.0]])
    Q, radii = L.boxed_set(G, np.array([[1.0], [1e-3], [1.0]]), np.ones(2))
    for r in ([1.0, 1e-3, 1.0], [1.0, -1e-3, -1.0]):
        assert (np.abs(np.linalg.solve(Q, G @ np.array(r))) <= radii[:, 0] + 1e-15).all()
    assert radii[:, 0].min() < 1e-14


@pytest.mark.parametrize("unit", [1.0, 2.0**-80])
def test_box_of_a_turned_box_is_the_box(L, unit):
    """A thin set under a hundred turns keeps its widths but for roundings, in any units."""
    c, s = math.cos(0.7), math.sin(0.7)
    J, E = np.array([[c, s / unit], [-s * unit, c]]), np.zeros((2, 2))
    units = np.array([1.0, unit])
    Q, R = np.diag(units), np.array([[1.0], [1e-6]])
    for _ in range(100):
        G, rest = L.moved_set(J, E, Q, R)
        Q, R = L.boxed_set(np.hstack([G, np.eye(2)]), np.vstack([R, rest]), units)
    assert R[0, 0] < 1.001
    assert R[1, 0] < 1.001e-6


def test_box_does_not_depend_on_units_of_its_kinds(L):
    """Sets of derivatives by components of different dimensions are boxed together."""
    rng = np.random.default_rng(4)
    G, R = rng.normal(size=(4, 9)), 10.0 ** rng.uniform(-12, -3, (9, 2))
    units, kinds = 2.0 ** rng.integers(-90, 90, 4), np.array([2.0**70, 2.0**-60])
    P, radii = L.boxed_set(G, R, np.ones(4))
    Q, others = L.boxed_set(G * units[:, None], R * kinds, units)
    assert (P * units[:, None] == Q).all()
    np.testing.assert_allclose(others, radii * kinds, rtol=1e-9)


@pytest.mark.parametrize("name", ["chebyshev_balls", "vector_value", "matrix_value"])
def test_values_of_series_contain_the_exact_ones(L, name):
    assert value_misses(L, name, 100, seed=1) == []


def test_dense_layers_contain_the_exact_sums(L):
    assert dense_misses(L, 60, seed=1) == []


def test_series_of_lines_contain_the_exact_values(L):
    assert clenshaw_misses(L, 25, seed=1) == []


def test_arrays_of_another_type_or_shape_are_refused(L):
    with pytest.raises(ValueError, match="another layout or type"):
        L.run_values(np.zeros((1, 4)), np.zeros((3, 8)))
    with pytest.raises(ValueError, match="do not fit"):
        L.moved_set(np.eye(2), np.eye(2), np.eye(3), np.ones((3, 1)))
    assert L.chebyshev_balls((1, 0, 0), 3)[:, 0].tolist() == [1.0, 1.0, 1.0]


def test_reduced_angle_has_no_value_beside_the_state(L):
    rows = np.ones((2, 8))
    L.run_values(np.array([[REDUCED_ANGLE, 1, 0, 0]]), rows)
    assert np.isnan(rows[1]).all()
