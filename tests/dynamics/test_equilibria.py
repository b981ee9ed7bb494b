"""Equilibria: Lagrange points against their closed forms, complete sets with known counts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import sympy
from mpmath import findroot, mp, mpf

import hamsym
from hamsym import Equilibria, Hamiltonian, equilibria
from hamsym.errors import CertificationError, InputError, ParameterError, VariableError

EARTH_MOON = 0.012150585609624  # as in JPL's catalogue of periodic orbits
ROTATING = (
    "(p_x**2 + p_y**2)/2 + y*p_x - x*p_y - (1 - mu)/sqrt((x + mu)**2 + y**2)"
    " - mu/sqrt((x - 1 + mu)**2 + y**2)"
)
ROUTH = (1 - math.sqrt(69) / 9) / 2
KINETIC = "(p_x**2 + p_y**2)/2 + "


def three_bodies(mu: float) -> Hamiltonian:
    return Hamiltonian(ROTATING, parameters={"mu": mu})


Interval = tuple[float, float]


def plane(x: Interval, y: Interval = (-1, 1), p: float = 1.0) -> dict[str, Any]:
    return {"x": x, "y": y, "p_x": (-p, p), "p_y": (-p, p)}


def line(x: Interval) -> dict[str, Any]:
    return {"x": x, "p": (-1, 1)}


# -- Lagrange points -------------------------------------------------------------------------------


def collinear(mu: float) -> list[tuple[float, float, float]]:
    """Place, frequency and exponent of L1, L2, L3.

    From the quintic equations of Euler (Szebehely, Theory of Orbits, 1967, section 4.4), and the
    linearised motion in c2 (Koon, Lo, Marsden & Ross, Dynamical Systems, the Three-Body Problem and
    Space Mission Design, section 2.7).
    """
    mp.dps = 40
    m = mpf(mu)
    quintics = [
        ([1, -(3 - m), 3 - 2 * m, -m, 2 * m, -m], mpf("0.1"), 1 - m, -1),
        ([1, 3 - m, 3 - 2 * m, -m, -2 * m, -m], mpf("0.1"), 1 - m, 1),
        ([1, 2 + m, 1 + 2 * m, m - 1, -2 * (1 - m), m - 1], mpf(1), -m, -1),
    ]
    rows = []
    for coefficients, start, primary, side in quintics:
        x = primary + side * findroot(lambda g, c=coefficients: mp.polyval(c, g), start)
        c2 = (1 - m) / abs(x + m) ** 3 + m / abs(x - 1 + m) ** 3
        root = mp.sqrt(9 * c2**2 - 8 * c2)
        frequency, exponent = mp.sqrt((2 - c2 + root) / 2), mp.sqrt((c2 - 2 + root) / 2)
        rows.append((float(x), float(frequency), float(exponent)))
    return rows


@pytest.mark.parametrize("mu", [EARTH_MOON, 9.537e-4], ids=["Earth-Moon", "Sun-Jupiter"])
def test_lagrange_points_have_their_places_and_exponents(mu: float) -> None:
    H = three_bodies(mu)
    starts = [[x, 0.0, 0.0, x] for x, _, _ in collinear(mu)]
    triangle = [0.5 - mu, math.sqrt(3) / 2, -math.sqrt(3) / 2, 0.5 - mu]
    mirrored = [triangle[0], -triangle[1], -triangle[2], triangle[3]]
    found = H.equilibria(np.array([*starts, triangle, mirrored]) + 1e-3)
    assert len(found) == 5
    assert all(each.how == "proven" and each.radius < 1e-15 for each in found)
    by_x = {round(each.z[0], 5): each for each in found if each.type == "saddle-centre"}
    for x, frequency, exponent in collinear(mu):
        each = by_x[round(x, 5)]
        assert abs(each.z[0] - x) <= each.radius + 1e-16
        np.testing.assert_allclose(each.frequencies, [frequency], rtol=1e-13)
        np.testing.assert_allclose(each.eigenvalues[0], exponent, rtol=1e-13)
        assert each.stable is False
    # k^4 + k^2 + 27 mu (1 - mu)/4 = 0 at L4 and L5; the slow mode has negative energy.
    root = math.sqrt(1 - 27 * mu * (1 - mu))
    for each in found[3:]:
        assert each.type == "centre-centre"
        expected = [math.sqrt((1 - root) / 2), math.sqrt((1 + root) / 2)]
        np.testing.assert_allclose(each.frequencies, expected, rtol=1e-12)
        assert each.signatures.tolist() == [-1, 1]
        assert each.stable is True
        assert each.lyapunov_stable is None


@pytest.mark.slow
def test_published_values_of_the_earth_and_the_moon() -> None:
    """Six digits, as tabulated for mu = 0.0121506 in many textbooks."""
    found = three_bodies(EARTH_MOON).equilibria()
    assert [round(z[0], 6) for z in found.z[:3]] == [0.836915, 1.155682, -1.005063]
    assert found[0].frequencies[0] == pytest.approx(2.334386, abs=5e-7)
    assert found[0].eigenvalues[0].real == pytest.approx(2.932056, abs=5e-7)


@pytest.mark.parametrize(
    ("mu", "kind", "stable"),
    [
        (ROUTH - 1e-9, "centre-centre", True),
        (ROUTH, "degenerate", None),
        (ROUTH + 1e-9, "focus-focus", False),
    ],
)
def test_stability_changes_at_the_critical_mass_of_routh(
    mu: float, kind: str, stable: bool | None
) -> None:
    [found] = three_bodies(mu).equilibria([0.46, 0.866, -0.866, 0.46])
    assert (found.type, found.stable) == (kind, stable)
    assert found.radius < 1e-15


def test_triangular_points_are_proven_to_be_alone_in_a_box() -> None:
    box = {"x": (0.3, 0.7), "y": (-1, 1), "p_x": (-1, 1), "p_y": (-1, 1)}
    found = three_bodies(EARTH_MOON).equilibria(box=box)
    assert found.complete
    np.testing.assert_allclose(found.z[:, 1], [-math.sqrt(0.75), math.sqrt(0.75)], rtol=1e-15)


@pytest.mark.slow
def test_primaries_remain_undecided() -> None:
    found = three_bodies(EARTH_MOON).equilibria(box=plane((-2, 2), (-2, 2), 2.0))
    assert len(found) == 5
    assert not found.complete
    assert len(found.undecided) == 2
    for region, x in zip(found.undecided, (-EARTH_MOON, 1 - EARTH_MOON), strict=True):
        assert region.low[0] <= x <= region.high[0]
        assert "is not smooth there" in region.reason


# -- complete sets ---------------------------------------------------------------------------------

_MUELLER_BROWN = KINETIC + (
    "-200*exp(-(x - 1)**2 - 10*y**2) - 100*exp(-x**2 - 10*(y - 0.5)**2)"
    " - 170*exp(-6.5*(x + 0.5)**2 + 11*(x + 0.5)*(y - 1.5) - 6.5*(y - 1.5)**2)"
    " + 15*exp(0.7*(x + 1)**2 + 0.6*(x + 1)*(y - 1) + 0.7*(y - 1)**2)"
)
_CHEBYSHEV = str(sympy.chebyshevt(9, sympy.Symbol("x")))
_SQUARE = plane((-6, 6), (-6, 6))
_HILL = KINETIC + "y*p_x - x*p_y - 1/sqrt(x**2 + y**2) - x**2 + y**2/2"
_WAVE = "(x**2 + p**2)/2 - (x**2 + p**2)**2/4 + x/5"
_CAMEL = KINETIC + "(4 - 2.1*x**2 + x**4/3)*x**2 + x*y + (4*y**2 - 4)*y**2"


@pytest.mark.parametrize(
    ("formula", "word"),
    [
        ("p**2/2 + x**2/2", "elliptic"),
        ("p**2/2 - x**2/2", "hyperbolic"),
        ("p_x**2/2 + p_y**2/2 + x**2 - y**2", "mixed"),
        ("y*p_x - x*p_y + x*p_x + y*p_y", "complex unstable"),
        ("p**2/2 + x**4/4", "undecided"),
    ],
)
def test_stability_has_the_words_of_orbits(formula: str, word: str) -> None:
    H = hamsym.Hamiltonian(formula)
    [found] = H.equilibria([[0.0] * H.dim])
    assert found.stability == word


#: H, box, numbers of linearly stable equilibria and of the others in it.
COUNTS: dict[str, tuple[str, dict[str, Any], int, int]] = {
    "pendulum": ("p**2/2 - cos(x)", line((-10, 10)), 3, 4),
    "double well": ("p**2/2 - x**2/2 + x**4/4", line((-2, 2)), 2, 1),
    "Henon-Heiles": (KINETIC + "(x**2 + y**2)/2 + x**2*y - y**3/3", _SQUARE, 1, 3),
    # Nine at zero coupling, all regular, so that weak coupling keeps them.
    "coupled wells": (KINETIC + "(x**2 - 1)**2 + (y**2 - 1)**2 + x*y/9", _SQUARE, 4, 5),
    # T9 has 8 extrema in (-1, 1), minima and maxima in turn.
    "Chebyshev": (f"p**2/2 + {_CHEBYSHEV}", line((-1.5, 1.5)), 4, 4),
    # Mueller & Brown, Theor. Chim. Acta 53 (1979) 75: three minima, two saddles.
    "Mueller-Brown": (_MUELLER_BROWN, plane((-1.5, 1.2), (-0.5, 2)), 3, 2),
    # Himmelblau 1972: four minima, four saddles, one maximum.
    "Himmelblau": (KINETIC + "(x**2 + y - 11)**2 + (x + y**2 - 7)**2", _SQUARE, 4, 5),
    # Dixon & Szegoe 1978: six minima, two maxima, seven saddles.
    "six-hump camel": (_CAMEL, plane((-3, 3), (-2, 2)), 6, 9),
    "Morse": ("p**2/2 + (1 - exp(-x))**2", line((-1, 9)), 1, 0),
    # Hill's problem: x = 3^(-1/3) on this side.
    "Hill": (_HILL, plane((0.2, 2)), 0, 1),
    # All angles are multiples of pi for weak coupling.
    "coupled pendulums": (KINETIC + "-cos(x) - cos(y) - cos(x - y)/5", _SQUARE, 1, 8),
    "Lennard-Jones": ("p**2/2 + 4*(x**-12 - x**-6)", line((0.8, 3)), 1, 0),
    # Bifurcation of a driven nonlinear wave: (1 - x^2) x = -1/5 has three real solutions.
    "driven wave": (_WAVE, {"x": (-2, 2), "p": (-2, 2)}, 2, 1),
    # An irrational coefficient: no exact fractions.
    "sqrt(2)": ("p**2/2 + sqrt(2)*x**2 - x**4", line((-2, 2)), 1, 2),
    "none": ("p**2/2 + exp(x)", line((-9, 9)), 0, 0),
}


@pytest.mark.slow_cases("Mueller-Brown")
@pytest.mark.parametrize("name", COUNTS)
def test_counts_in_boxes_are_complete(name: str) -> None:
    text, box, stable, others = COUNTS[name]
    found = equilibria(text, box=box)
    assert found.complete, str(found)
    assert sum(each.stable is True for each in found) == stable
    assert len(found) == stable + others
    assert all(each.enclosure.contains(each.z) for each in found if each.enclosure)


def test_mueller_brown_has_its_published_points() -> None:
    """Mueller & Brown 1979; E. Weinan et al., J. Chem. Phys. 126 (2007) 164103."""
    found = equilibria(_MUELLER_BROWN, box=plane((-1.5, 1.2), (-0.5, 2)))
    published = [(-0.558, 1.442), (0.623, 0.028), (-0.050, 0.467), (0.212, 0.293), (-0.822, 0.624)]
    assert [tuple(z[:2]) for z in found.z.round(3)] == published
    np.testing.assert_allclose(
        found.energies, [-146.700, -108.167, -80.768, -72.249, -40.665], atol=6e-4
    )


@pytest.mark.parametrize("seed", range(4))
def test_random_quartics_agree_with_their_groebner_basis(seed: int) -> None:
    """The number of real zeros is that of the last polynomial of a lexicographic basis."""
    generator = np.random.default_rng(seed)
    x, y = sympy.symbols("x y")
    powers = [(i, j) for i in range(4) for j in range(4 - i) if i + j]
    V = x**4 + y**4 + sum(int(generator.integers(-4, 5)) * x**i * y**j for i, j in powers)
    basis = sympy.groebner([V.diff(x), V.diff(y)], x, y, order="lex")
    last = sympy.Poly(basis.exprs[-1], y)
    assert basis.exprs[0].as_poly(x).degree() == 1  # x is a function of y
    found = equilibria(Hamiltonian(KINETIC + str(V)), box=plane((-9, 9), (-9, 9)))
    assert found.complete
    exact = sorted(float(root) for root in last.real_roots())
    np.testing.assert_allclose(np.sort(found.z[:, 1]), exact, atol=1e-9)


def test_scaled_units_find_the_same() -> None:
    """The double well in metres of 1e-24 and masses of 1e-30."""
    unit, mass = 1e-24, 1e-30
    parameters = {"m": mass, "k": mass, "g": mass / unit**2}
    H = Hamiltonian("p**2/(2*m) - k*x**2/2 + g*x**4/4", parameters=parameters)
    found = H.equilibria(box={"x": (-2 * unit, 3 * unit), "p": (-mass * unit, mass * unit)})
    assert found.complete
    np.testing.assert_allclose(found.z[:, 0], np.array([-1, 1, 0]) * unit, rtol=1e-15)
    assert [each.type for each in found] == ["centre", "centre", "saddle"]
    np.testing.assert_allclose(found[0].frequencies, [math.sqrt(2)], rtol=1e-14)


def test_pair_close_to_a_fold_is_told_apart() -> None:
    """V = cosh(x) - x^2/2 + x^3/3 - e^2 x: x = +-e to first order, with e = 5e-7."""
    H = "p**2/2 + cosh(x) - x**2/2 + x**3/3 - 2.5e-13*x"
    found = equilibria(H, box=line((-0.5, 2)))
    assert found.complete
    np.testing.assert_allclose(np.sort(found.z[:, 0]), [-5e-7, 5e-7], rtol=1e-6)
    assert sorted(each.type for each in found) == ["centre", "saddle"]


def test_equilibria_on_the_edge_are_found_and_marked() -> None:
    found = equilibria("p**2/2 - cos(x)", box={"x": (0, 1), "p": (0, 1)})
    assert found.complete
    [each] = found
    assert each.on_edge
    assert not equilibria("p**2/2 - cos(x)", box=line((-1, 1)))[0].on_edge


def test_degenerate_polynomials_are_complete() -> None:
    [each] = found = equilibria("p**2/2 + x**4", box=line((-1, 1)))
    assert found.complete
    assert (each.type, each.stable, each.how) == ("degenerate", None, "proven")


def test_degenerate_points_of_the_plane_are_shown_but_not_proven() -> None:
    found = equilibria(KINETIC + "x**4 + y**4 + (x*y)**2*cos(y)", box=plane((-1, 1)))
    assert not found.complete
    [each] = found
    assert each.how == "numerical"
    assert math.isinf(each.radius)
    assert np.abs(each.z).max() < 1e-6
    assert "not proven" in found.message


@pytest.mark.slow
def test_singularities_are_undecided() -> None:
    found = equilibria(KINETIC + "-1/sqrt(x**2 + y**2)", box=plane((-1, 2)))
    assert not found.complete
    assert len(found) == 0
    [region] = found.undecided
    assert all(a <= 0 <= b for a, b in zip(region.low, region.high, strict=True))
    assert region.reason == "1/sqrt(x**2 + y**2) is not smooth there"


def test_limits_are_honoured_and_reported() -> None:
    found = equilibria(_MUELLER_BROWN, box=plane((-1.5, 1.2), (-0.5, 2)), max_boxes=50)
    assert found.boxes == 50
    assert not found.complete
    assert "undecided" in found.message
    assert not equilibria(_MUELLER_BROWN, box=plane((-1.5, 1.2)), time_limit=1e-9).complete


# -- continua --------------------------------------------------------------------------------------


def test_cyclic_coordinates_give_one_continuum() -> None:
    H = "p_r**2/2 + p_phi**2/(2*r**2) + (r - 1)**2/2"
    box = {"r": (0.5, 2), "phi": (-3, 3), "p_r": (-1, 1), "p_phi": (-1, 1)}
    [each] = found = equilibria(H, box=box)
    assert found.complete
    assert each.family == "any phi"
    assert each.type == "degenerate"
    assert each.enclosure is None
    assert "1 continuum" in str(equilibria(H)) or "continuum" in found.message


@pytest.mark.slow
def test_circles_of_equilibria_are_one_continuum() -> None:
    found = equilibria(KINETIC + "(x**2 + y**2 - 1)**2", box=plane((-2, 2), (-2, 2)))
    assert not found.complete
    assert [bool(each.family) for each in found] == [True, False]
    assert np.hypot(*found[0].z[:2]) == pytest.approx(1)
    assert found[1].type == "saddle-saddle"
    assert found.boxes < 5_000


@pytest.mark.slow
def test_translations_give_lines_of_equilibria() -> None:
    H = "(p1**2 + p2**2 + p3**2)/2 + exp(q1 - q2) + exp(q2 - q3) + exp(q3 - q1)"
    [each] = equilibria(H)
    assert each.family == "any q3, with q1 = q3, q2 = q3"
    assert each.exact is not None
    # Distances oscillate with sqrt(3), twice (Toda's three particles).
    assert np.sort(np.abs(each.eigenvalues.imag)).tolist()[2:] == pytest.approx([math.sqrt(3)] * 4)


def test_degenerate_but_isolated_points_are_no_continuum() -> None:
    [each] = equilibria(KINETIC + "x**4 + y**4 + (x*y)**2*cos(y)", [0.1, 0.1, 0.0, 0.0])
    assert each.family == ""


# -- without a box ---------------------------------------------------------------------------------


def test_closed_forms_are_kept_and_proven() -> None:
    found = equilibria("p**2/2 - x**2 + x**4/4")
    assert [each.exact[0] for each in found if each.exact] == [-sympy.sqrt(2), sympy.sqrt(2), 0]
    assert all(each.how == "symbolic" and each.radius < 1e-15 for each in found)
    assert not found.complete


def test_periodic_angles_are_shown_in_one_period() -> None:
    found = equilibria("p**2/2 - cos(x)")
    assert found.z[:, 0].tolist() == [0.0, math.pi]
    assert "period 2*pi in x" in found.message


@pytest.mark.slow
def test_points_without_closed_form_are_proven() -> None:
    [each] = equilibria("p**2/2 + x**2/2 - 3*x/10 + cos(x)")
    mp.dps = 30
    exact = findroot(lambda x: x - mpf(3) / 10 - mp.sin(x), 1.2)
    assert each.how == "proven"
    assert abs(mpf(each.z[0]) - exact) <= each.radius


def test_equilibria_far_from_the_origin_are_proven() -> None:
    """There the rounding of the place changes dH/dx more than the rounding of its evaluation."""
    (found,) = equilibria("p**2/2 - 0.396*cos(x)", guess=[172 * np.pi, 0.0])
    assert found.how == "proven"
    assert found.enclosure is not None
    assert 3.5e-14 < found.enclosure.radius[0] < 3.6e-14  # 172 pi has this distance to a float


def test_guesses_lead_to_their_equilibria() -> None:
    H = Hamiltonian("p**2/2 - cos(x)")
    [each] = H.equilibria({"x": 12.0, "p": 0.3})
    assert each.z[0] == pytest.approx(4 * math.pi)
    with pytest.raises(
        InputError, match=r"give box=\{'x': \(-4, 4\), ...\} .*or \[-4, 4\] for two"
    ):
        H.equilibria({"x": (-4, 4), "p": (-1, 1)})
    many = H.equilibria({"x": [0.1, 3.0, -0.1], "p": 0.0})
    assert len(many) == 2
    failed = equilibria("p**2/2 + exp(x)", [0.0, 0.0])
    assert len(failed) == 0
    assert "did not converge" in failed.message


@pytest.mark.slow_cases("exp(-x**2)*x + x")
@pytest.mark.parametrize("potential", ["exp(x)", "exp(-x**2)*x + x", "1/x", "-1/sqrt(x**2)"])
def test_flat_tails_are_no_equilibria(potential: str) -> None:
    assert len(equilibria(f"p**2/2 + {potential}")) == 0


def test_functions_without_enclosure_are_found_but_not_proven() -> None:
    H = "p**2/2 + abs(x)**3/3 - x + sin(x)/10"
    found = equilibria(H, guess=[1.0, 0.0])
    [each] = found
    assert each.how == "numerical"
    assert each.type == "centre"
    with pytest.raises(CertificationError, match="'abs'"):
        equilibria(H, box=line((0.5, 2)))


@pytest.mark.slow
def test_symbols_without_value_are_allowed_in_closed_forms() -> None:
    found = equilibria("p**2/2 - k*x**2/2 + g*x**4/4")
    assert len(found) == 3
    assert found[0].type == "unknown"
    assert np.isnan(found.z).all()
    with pytest.raises(AttributeError, match="no value"):
        found[0].frequencies  # noqa: B018
    with pytest.raises(ParameterError, match="no closed form"):
        equilibria("p**2/2 + x**2 + cos(a*x)*x")


@pytest.mark.slow
def test_text_fits_the_terminal() -> None:
    for found in (
        equilibria("p**2/2 - cos(x)", box=line((-10, 10))),
        three_bodies(EARTH_MOON).equilibria([[0.5, 0.8, -0.8, 0.5], [1.1, 0.0, 0.0, 1.1]]),
        equilibria(KINETIC + "-1/sqrt(x**2 + y**2)", box=plane((-1, 2))),
        equilibria(KINETIC + "(x**2 + y**2 - 1)**2", box=plane((-2, 2))),
    ):
        assert max(map(len, str(found).splitlines())) <= 80
        for each in found:
            assert max(map(len, str(each).splitlines())) <= 80


def test_method_and_function_agree() -> None:
    H = Hamiltonian("p**2/2 - cos(x)")
    found = H.equilibria(box=line((-1, 4)))
    assert isinstance(found, Equilibria)
    assert isinstance(found[0], hamsym.Equilibrium)
    assert np.array_equal(found.z, equilibria(H, box=[(-1, 4), (-1, 1)]).z)
    assert found[0:1] == (found[0],)


# -- bad input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("H", "options", "error", "match"),
    [
        ("p**2/2 + cos(t)*x", {}, InputError, "depends on the time t"),
        (7, {}, InputError, "must be a Hamiltonian or a formula"),
        ("p**2/2 + x**2", {"box": {"x": (-1, 1)}}, VariableError, "no interval for p"),
        ("p**2/2 + x**2", {"box": {"x": (-1, 1), "y": (0, 1)}}, VariableError, "'y' in box"),
        ("p**2/2 + x**2", {"box": [(-1, 1)]}, InputError, "each of x, p"),
        ("p**2/2 + x**2", {"box": 3}, InputError, "each of x, p"),
        ("p**2/2 + x**2", {"box": [(1, -1), (0, 1)]}, InputError, "low < high"),
        ("p**2/2 + x**2", {"box": [(0, math.inf), (0, 1)]}, InputError, "low < high"),
        ("p**2/2 + x**2", {"box": [(0, math.nan), (0, 1)]}, InputError, "low < high"),
        ("p**2/2 + x**2", {"box": [3, (0, 1)]}, InputError, "low < high"),
        ("p**2/2 + x**2", {"box": line((0, 1)), "guess": [0, 0]}, InputError, "one of them"),
        ("p**2/2 + x**2", {"box": line((0, 1)), "max_boxes": 0}, InputError, "max_boxes"),
        ("p**2/2 + x**2", {"box": line((0, 1)), "time_limit": -1}, InputError, "time_limit"),
        ("p**2/2 + x**2", {"guess": {"x": 1}}, VariableError, "'p' is missing"),
        ("p**2/2 + x**2", {"guess": np.empty((0, 2))}, InputError, r"shape \(0, 2\)"),
        ("p**2/2 + a*x**2", {"guess": [0, 0]}, ParameterError, "a has no value"),
        ("p**2/2 + a*x**2", {"box": line((0, 1))}, ParameterError, "a has no value"),
    ],
)
def test_unusable_arguments_are_rejected(
    H: Any, options: dict[str, Any], error: type[Exception], match: str
) -> None:
    with pytest.raises(error, match=match):
        equilibria(H, **options)


@pytest.mark.parametrize("text", ["p**2/2 + x**2.5", "p**2/2 - x**3.5", "p**2/2 + x**3*log(x)"])
def test_no_type_is_stated_beside_a_place_where_h_is_not_smooth(text: str) -> None:
    """The gradient vanishes as x decreases to zero, where H ends."""
    found = equilibria(text, box={"x": (-0.5, 0.5), "p": (-1, 1)})
    assert not found.complete
    for each in found:
        assert each.type == "degenerate"
        assert each.stable is None
        assert each.lyapunov_stable is None
        assert not len(each.frequencies)


def test_zeros_that_float64_does_not_separate_have_no_ball() -> None:
    H = Hamiltonian("p**2/2 + (x-1)**3/3 - 3*(x-1)**2/(2*10**20) + 2*(x-1)/10**40")
    found = hamsym.equilibria(H, box={"x": (0, 2), "p": (-1, 1)})
    assert "all 2 equilibria in the box, proven" in found.message
    assert all(each.enclosure is None and each.how == "numerical" for each in found)


def test_zero_beside_the_box_is_said_to_be_on_its_edge() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x - x/10**80")
    found = hamsym.equilibria(H, box={"x": (0, 1), "p": (-1, 1)})
    assert found.message == "the only equilibrium in the box or on its edge, proven"


@pytest.mark.parametrize("guess", [None, [[0.85, -0.4, 0, 0]]])
def test_saddles_whose_coordinates_have_units_of_their_own(guess: list[list[float]] | None) -> None:
    H = Hamiltonian(
        "s*(((p_x*a/s)**2 + (p_y*b/s)**2 + (x/a)**2 + (y/b)**2)/2 + (x/a)**2*y/b - (y/b)**3/3)",
        parameters={"a": 1.0, "b": 2.0**-60, "s": 2.0**10},
    )
    units = np.array([1.0, 2.0**-60, 2.0**10, 2.0**70])
    found = hamsym.equilibria(H, guess=None if guess is None else np.array(guess) * units)
    saddles = [each for each in found if each.z[0] > 0.5]
    assert [each.type for each in saddles] == ["saddle-centre"]
    np.testing.assert_allclose(saddles[0].frequencies, math.sqrt(3), rtol=1e-14)


@pytest.mark.parametrize("box", [None, {"x": (-3, 3), "p": (-1, 1)}])
def test_powers_too_long_for_fractions(box: dict[str, tuple[float, float]] | None) -> None:
    """0.999999999999**1e12, which is about 1/e, has 5e13 bits."""
    values = {"k": 0.999999999999, "m": 1e12}
    found = equilibria(Hamiltonian("p**2/2 - k**m*x**2/2 + x**4", parameters=values), box=box)
    assert len(found) == 3
    assert max(each.z[0] for each in found) == pytest.approx(math.exp(-0.5) / 2, rel=1e-4)
