"""Figures of exponents, orbits, equilibria, proofs, fits and flow maps."""

from __future__ import annotations

import dataclasses
from typing import Any

import matplotlib.figure
import numpy as np
import pytest

import hamsym
from hamsym.dynamics.chaos_indicators import ChaosIndicators
from hamsym.dynamics.lyapunov import LyapunovExponents
from hamsym.dynamics.lyapunov_map import LyapunovMap
from hamsym.errors import InputError
from hamsym.orbits.certificate import OrbitCertificate
from hamsym.plotting.equilibria import energy_at_rest
from hamsym.plotting.figure import one_panel
from hamsym.plotting.names import energy_unit
from hamsym.plotting.orbits import draw_multipliers
from hamsym.plotting.sections import _directions
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.boxes.box_certificate import BoxCertificate
from hamsym.proof.windows.certificate import Certificate
from tests.plotting.inspection import check_layout

HENON_HEILES = "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3"
WELL = "p**2/2 - x**2/2 + x**4/4"
SPRING_UNITS = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}
SPRING = hamsym.Hamiltonian(
    "p**2/(2*m) + k*x**2/2", parameters={"m": 9.1e-31, "k": 3.6e-13}, units=SPRING_UNITS
)


def chain(dof: int) -> hamsym.Hamiltonian:
    kinetic = "+".join(f"p{i}**2/2 + q{i}**2/2" for i in range(1, dof + 1))
    springs = "+".join(f"(q{i + 1} - q{i})**4/4" for i in range(1, dof))
    return hamsym.Hamiltonian(f"{kinetic} + {springs or 'q1**4/4'}")


def exponents(dof: int, count: int, H: Any = None, **options: Any) -> LyapunovExponents:
    """Exponents +-1/i and less, which fall to these values."""
    t = np.geomspace(0.1, 1e3, 200)
    half = np.concatenate((1 / np.arange(1, dof), [0.0]))
    last = np.sort(np.concatenate((half, -half)))[::-1][:count]
    values = last + np.sort(np.random.default_rng(0).normal(0, 1, count))[::-1] / t[:, None]
    values = np.sort(values, axis=1)[:, ::-1]
    H = H or chain(dof)
    given = {"z0": np.zeros(H.dim), "span": (0.0, 1e3), "energy_error": 0.0, "method": "gauss6"}
    cost = {"dt": 0.1, "seconds": 1.0, "success": True, "message": ""}
    made = {"H": H, **given, **cost, **options}
    return LyapunovExponents(t=t, exponents=values, **made)


@pytest.fixture(scope="module")
def orbit() -> hamsym.PeriodicOrbit:
    H = hamsym.Hamiltonian(HENON_HEILES)
    z0 = H.state_at_energy(1 / 12, {"x": 0, "y": 0, "p_y": 0})
    symmetry = {"x": "-x", "p_y": "-p_y"}
    return hamsym.periodic_orbit(H, z0, energy=1 / 12, symmetry=symmetry)


@pytest.fixture(scope="module")
def family(orbit: hamsym.PeriodicOrbit) -> hamsym.OrbitFamily:
    return orbit.family(energy=0.1)


@pytest.fixture(scope="module")
def well() -> hamsym.Equilibria:
    return hamsym.equilibria(WELL, box={"x": (-2, 2), "p": (-1, 1)})


def drawn(axes: Any) -> np.ndarray:
    """All points of the lines of axes, shape (n, 2)."""
    return np.concatenate([np.column_stack(line.get_data()) for line in axes.lines])


def titles(figure: Any) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes]


# -- exponents and indicators ----------------------------------------------------------------------


@pytest.mark.slow_cases("30-60", "2-4", "1-2", "6-12", "30-7")
@pytest.mark.parametrize(("dof", "count"), [(1, 2), (2, 1), (2, 4), (6, 12), (30, 60), (30, 7)])
def test_exponents_of_any_number_are_laid_out(dof: int, count: int) -> None:
    check_layout(exponents(dof, count, chain(dof)).plot())


@pytest.mark.slow
def test_negative_exponents_are_drawn_with_the_others() -> None:
    found = exponents(3, 6, chain(3))
    convergence, all_of_them = found.plot().axes
    ends = {round(float(line.get_ydata()[-1]), 12) for line in all_of_them.lines[:6]}
    assert ends == {round(float(value), 12) for value in found.exponents[-1]}
    assert (found.exponents[-1] < 0).sum() == 2
    assert convergence.get_yscale() == "log"


@pytest.mark.slow
def test_sums_of_pairs_are_said_only_of_all_exponents_without_forces() -> None:
    assert "pairs" in exponents(2, 4, chain(2)).plot().caption
    assert "pairs" not in exponents(2, 3, chain(2)).plot().caption
    damped = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "-p/9"})
    assert "pairs" not in exponents(1, 2, damped).plot().caption


@pytest.mark.slow
def test_exponents_that_vanish_are_said() -> None:
    found = exponents(1, 2, chain(1))
    found.exponents[:] = 0.0
    figure = found.plot()
    check_layout(figure)
    assert [text.get_text() for text in figure.axes[0].texts] == ["no positive exponent"]


@pytest.mark.slow
def test_failed_exponents_are_marked() -> None:
    figure = exponents(2, 2, chain(2), success=False, message="energy lost").plot()
    assert figure.warning == "Failed: energy lost"


def test_radians_do_not_count_in_the_unit_of_the_energy() -> None:
    units = {"theta": "rad", "p": "kg*m**2/s", "I": "kg*m**2", "k": "kg*m**2/s**2"}
    H = hamsym.Hamiltonian("p**2/(2*I) + k*theta**2/2", units=units)
    assert energy_unit(H) == "J"


def test_rates_have_the_unit_of_a_reciprocal_time() -> None:
    figure = exponents(1, 2, SPRING).plot("exponents")
    assert figure.axes[0].get_ylabel() == r"exponent $\lambda$ [1/s]"
    assert figure.axes[0].get_xlabel() == "time $t$ [s]"


@pytest.mark.slow_cases("gali1")
@pytest.mark.parametrize("gali", [np.geomspace(1, 1e-300, 100), np.zeros(100)])
def test_indicators_are_laid_out(gali: np.ndarray) -> None:
    t = np.linspace(1, 100, 100)
    own = {"z0": np.zeros(4), "span": (0.0, 100.0), "energy_error": 0.0, "method": "gauss6"}
    own |= {"dt": 0.1, "seconds": 1.0}
    found = ChaosIndicators(
        t=t,
        megno=t / 9,
        mean_megno=t / 18,
        gali=gali[:, None],
        success=True,
        message="",
        H=chain(2),
        **own,
    )
    figure = found.plot()
    check_layout(figure)
    assert ("below 1e-307" in " ".join(figure.caption.split())) == (not gali.all())


def lyapunov_map(shape: tuple[int, ...]) -> LyapunovMap:
    z0 = np.zeros((*shape, 4))
    z0[..., 0] = np.linspace(-1, 1, shape[0]).reshape(-1, *[1] * (len(shape) - 1))
    z0[..., 3] = np.linspace(0, 5, shape[-1])
    values = np.sin(z0[..., 0] + z0[..., 3])[..., None]
    values.reshape(-1)[:2] = np.nan
    success = np.isfinite(values[..., 0])
    return LyapunovMap(
        exponents=values, success=success, message=np.full(shape, "", dtype=object), z0=z0,
        parameters={}, names=("x", "y", "p_x", "p_y"), span=(0, 9), method="gauss6", seconds=1.0,
        energy_error=np.zeros(shape), steps=np.ones(shape, dtype=int),
        H=hamsym.Hamiltonian(HENON_HEILES),
    )  # fmt: skip


@pytest.mark.slow_cases("shape0")
@pytest.mark.parametrize("shape", [(7,), (5, 6)])
def test_starts_without_an_exponent_are_counted(shape: tuple[int, ...]) -> None:
    figure = lyapunov_map(shape).plot()
    check_layout(figure)
    size = int(np.prod(shape))
    assert f"2 of {size} starts have no exponent" in " ".join(figure.caption.split())


def test_named_plane_shows_every_start_of_any_array() -> None:
    found = lyapunov_map((3, 2, 4))
    axes = found.plot("x", "p_y").axes[0]
    assert len(axes.lines[0].get_xdata()) + len(axes.collections[0].get_offsets()) == 24
    with pytest.raises(InputError, match="neither a row nor a plane"):
        found.plot()


# -- orbits ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_orbit_is_drawn_with_its_multipliers(orbit: hamsym.PeriodicOrbit) -> None:
    figure = orbit.plot()
    check_layout(figure)
    path, plane = figure.axes
    assert path.get_xlabel() == "$x$"
    marks = next(line for line in plane.lines if line.get_marker() == "x")
    np.testing.assert_allclose(np.sort(marks.get_xdata()), np.sort(orbit.multipliers.real))
    assert "hyperbolic" in titles(figure)[1]


@pytest.mark.parametrize(
    ("names", "panels"), [(("x",), 1), (("y", "p_y"), 1), (("multipliers",), 1)]
)
def test_orbit_is_drawn_by_names(orbit: hamsym.PeriodicOrbit, names: Any, panels: int) -> None:
    assert len(orbit.plot(*names).axes) == panels


def multipliers_figure(values: np.ndarray) -> Any:
    with one_panel(None, [], height=7.5) as axes:
        draw_multipliers(axes, values, "Multipliers")
        return axes.figure


def test_large_multipliers_are_in_an_inset_beside_a_round_circle() -> None:
    matrix = np.diag([1e7, 0.5, 1e-7, 2.0])
    figure = multipliers_figure(np.linalg.eigvals(matrix))
    check_layout(figure)
    [axes] = figure.axes
    circle, near = axes.lines
    x, y = axes.transData.transform(circle.get_xydata()).T
    assert np.ptp(x) == pytest.approx(np.ptp(y), rel=1e-4)
    np.testing.assert_allclose(np.sort(near.get_xdata()), [1e-7, 0.5])
    [inset] = axes.child_axes
    assert inset.get_yscale() == "log"
    np.testing.assert_allclose(np.sort(inset.lines[0].get_ydata()), [1e-7, 0.5, 2.0, 1e7])


@pytest.fixture(scope="module")
def halo() -> hamsym.PeriodicOrbit:
    H = hamsym.Hamiltonian(
        "(p_x**2 + p_y**2 + p_z**2)/2 + y*p_x - x*p_y - (1 - mu)/sqrt((x + mu)**2 + y**2 + z**2)"
        " - mu/sqrt((x - 1 + mu)**2 + y**2 + z**2)",
        parameters={"mu": 0.01215058560962404},
    )
    guess = [0.82338518, 0, 0.0224, 0, 0.95762658, 0], 2.7464
    return hamsym.periodic_orbit(H, guess, symmetry={"y": "-y", "p_x": "-p_x", "p_z": "-p_z"})


def test_orbit_in_space_is_seen_along_each_axis(halo: hamsym.PeriodicOrbit) -> None:
    figure = halo.plot()
    check_layout(figure)
    named = ["Orbit", "Multipliers: mixed", *(f"Seen along ${k}$" for k in "zyx"), "Energies"]
    assert titles(figure) == named
    assert figure.axes[0].name == "3d"
    seen = figure.axes[3].lines[0]
    np.testing.assert_allclose(
        np.ptp(seen.get_ydata()), np.ptp(halo(np.linspace(0, 3, 999))[:, 2]), rtol=1e-3
    )
    assert halo.plot("orbit").axes[0].name == "3d"


def test_multipliers_that_are_not_finite_are_counted() -> None:
    figure = multipliers_figure(np.array([np.nan, 1.0]))
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert "1 of 2 are not finite" in texts


@pytest.mark.slow
def test_family_has_periods_orbits_and_multipliers(family: hamsym.OrbitFamily) -> None:
    figure = family.plot()
    check_layout(figure)
    assert titles(figure)[:3] == ["Period", "Orbits", "Largest multiplier"]
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), family.periods)
    with pytest.raises(InputError, match="periods of their own"):
        family.plot("x")


def test_family_over_energies_has_level_sets() -> None:
    family = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0]).family(energy=1.0)
    assert "Grey: level sets" in hamsym.plot(family, "x", "p").caption


@pytest.mark.slow
def test_proven_orbit_says_its_proof() -> None:
    middle = np.array([[0.0, 1.0], [-1.0, 0.0]])
    ball = Ball(np.zeros(2), np.zeros(2))
    found = OrbitCertificate(
        *(ball, Ball(6.28, 1e-12), 1e-13, 1e-3, Ball(middle, 0 * middle), "elliptic", 3, 1.0),
        *("", "", ("x", "p")),
    )
    figure = found.plot()
    check_layout(figure)
    assert "Proven" in figure.caption
    assert "elliptic" in titles(figure)[0]


# -- equilibria ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_equilibria_stand_at_their_places_over_level_sets(well: hamsym.Equilibria) -> None:
    figure = well.plot()
    check_layout(figure)
    axes = figure.axes[0]
    places = {tuple(place) for place in drawn(axes).round(9) + 0.0}
    assert places == {tuple(each.z.round(9) + 0.0) for each in well}
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["centre", "saddle"]
    assert any(len(getattr(artist, "levels", ())) > 3 for artist in axes.collections)
    assert "proven to be all" in titles(figure)[0]


def test_places_that_differ_by_round_off_have_one_label(well: hamsym.Equilibria) -> None:
    beside = dataclasses.replace(well[0], z=np.nextafter(well[0].z, 9.0))
    figure = dataclasses.replace(well, found=(*well, beside)).plot()
    assert f"1, {len(well) + 1}" in [text.get_text() for text in figure.axes[0].texts]


def test_level_sets_in_a_rotating_frame_are_those_of_the_effective_potential() -> None:
    mu = 0.01
    H = hamsym.systems.restricted_three_bodies(mu=mu).H
    q = np.array([[0.3, 0.4], [-0.5, 0.9]])
    x, y = q.T
    r1, r2 = np.hypot(x + mu, y), np.hypot(x - 1 + mu, y)
    expected = -(x**2 + y**2) / 2 - (1 - mu) / r1 - mu / r2
    np.testing.assert_allclose(energy_at_rest(H, q), expected, rtol=1e-12)


@pytest.mark.parametrize("kinetic", ["p_x**4/4 + p_x", "p_x**4/4 + p_x**2/2 + p_x"])
def test_level_sets_of_other_momenta_are_refused(kinetic: str) -> None:
    H = hamsym.Hamiltonian(f"{kinetic} + p_y**2/2 + x**2/2 + y**2/2")
    assert energy_at_rest(H, np.array([[1.0, 2.0]])) is None


@pytest.mark.slow_cases("1", "6", "30")
@pytest.mark.parametrize("dof", [1, 2, 6, 30])
def test_equilibria_of_any_size_are_laid_out(dof: int) -> None:
    found = hamsym.equilibria(chain(dof), guess=np.zeros(2 * dof))
    check_layout(found.plot())
    check_layout(found[0].plot())


def test_one_equilibrium_in_SI_units_has_surroundings_of_its_size() -> None:
    values = {"m": 9.1e-31, "k": 3.6e-13, "b": 1e-4}
    H = hamsym.Hamiltonian("p**2/(2*m) + k*x**2/2 + b*x**4/4", parameters=values)
    axes = hamsym.equilibria(H).plot().axes[0]
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert 1e-5 < (right - left) / 2 < 1e-3  # sqrt(k/b) = 6e-5
    assert 1e-27 < (high - low) / 2 < 1e-24  # times sqrt(k m) = 6e-22


def test_equilibrium_shows_eigenvalues_with_signatures(well: hamsym.Equilibria) -> None:
    texts = [text.get_text() for text in well[0].plot().axes[0].texts]
    assert texts == ["1.41421 (+)"]
    assert [text.get_text() for text in well[-1].plot().axes[0].texts] == ["1"]


def test_near_equilibria_have_labels_of_their_own() -> None:
    H, width = "p**2/2 - x**2/2 + k*x**4/4", 1e-10
    found = hamsym.equilibria(hamsym.Hamiltonian(H, parameters={"k": width**-2}))
    texts = [text.get_text() for text in found.plot().axes[0].texts]
    assert {"1", "2", "3"} <= set(texts)


def test_equilibria_without_numbers_are_refused() -> None:
    found = hamsym.equilibria(hamsym.Hamiltonian("p**2/2 - k*x**2/2 + x**4/4"))
    figure_or_error = [each for each in found if np.isfinite(each.z).all()]
    if figure_or_error:
        assert "not drawn" in " ".join(found.plot().caption.split())
    with pytest.raises(InputError, match="no value"):
        found[0].plot()


# -- proofs ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bands_of_an_enclosure_contain_the_solution() -> None:
    found = hamsym.enclose("p**2/2 + x**2/2", ["1 +- 0.1", 0], (0, 3))
    figure = found.plot("x")
    check_layout(figure)
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    low, high = (bound(band[band[:, 0] == 0.0][:, 1]) for bound in (np.min, np.max))
    assert (low, high) == (pytest.approx(0.9), pytest.approx(1.1))
    check_layout(found.plot())


@pytest.mark.slow_cases("6", "2")
@pytest.mark.parametrize("dof", [2, 6])
def test_components_that_are_left_out_are_said(dof: int) -> None:
    figure = hamsym.enclose(chain(dof), [0.1] * 2 * dof, (0, 0.1)).plot()
    check_layout(figure)
    said = f"6 of {2 * dof} components are drawn" in " ".join(figure.caption.split())
    assert said == (dof == 6)


def certificate(dim: int, **changes: Any) -> Certificate:
    values: dict[str, Any] = {
        "bound": 2e-9, "lower": 1.9e-9, "energy_bound": 1e-10, "energy_lower": 0.0,
        "component_bounds": tuple(np.geomspace(1e-9, 1e-12, dim)),
        "component_lowers": tuple(np.geomspace(0.9e-9, 0.9e-12, dim)),
        "ell_max_bound": 1e-8, "ell_max_lower": 0.0, "edges": (0.0, 1.0, 3.0),
        "piece_bounds": (1e-9, 2e-9), "rtol": 0.02, "digest": "a" * 64,
        "seconds": 1.0, "components": tuple(f"z_{k + 1}" for k in range(dim)),
    }  # fmt: skip
    return Certificate(**(values | changes))


@pytest.mark.slow_cases("12", "60")
@pytest.mark.parametrize("dim", [2, 12, 60])
def test_certificates_are_laid_out(dim: int) -> None:
    figure = certificate(dim, asked=(1e-8,) * dim).plot()
    check_layout(figure)
    steps = figure.axes[0].patches[0]
    np.testing.assert_array_equal(steps.get_data().values, [1e-9, 2e-9])


@pytest.mark.slow_cases("changes0", "changes2")
@pytest.mark.parametrize(
    "changes",
    [
        {"energy_bound": np.inf, "piece_bounds": (np.inf, 1e-3)},
        {"bound": 0.0, "lower": 0.0, "piece_bounds": (0.0, 0.0)},
        {"edges": (3.0, 1.0, 0.0)},
    ],
)
def test_certificates_at_their_limits_are_laid_out(changes: dict[str, Any]) -> None:
    check_layout(certificate(2, **changes).plot())


def test_certificates_are_drawn_with_their_names() -> None:
    axes = certificate(2, components=("theta", "p_theta")).plot("components").axes[0]
    shown = [text.get_text() for text in axes.get_xticklabels()]
    assert shown == [r"$\theta$", r"$p_{\theta}$"]


@pytest.mark.slow_cases("names1")
@pytest.mark.parametrize("names", [("x", "p"), tuple(f"coordinate_{k}" for k in range(24))])
def test_bounds_over_a_box_are_laid_out(names: tuple[str, ...]) -> None:
    found = BoxCertificate(
        bound=tuple(np.geomspace(1e-9, 1e-7, len(names))), components=names,
        box={"x": (1.0, 2.0)}, fixed={}, expressions={}, span=(0.0, 9.0), formula="p**2/2",
        parts=4, digest="a" * 64, seconds=1.0,
    )  # fmt: skip
    figure = found.plot()
    check_layout(figure)
    assert drawn(figure.axes[0])[: len(names), 1].tolist() == list(found.bound)


# -- fits and flow maps ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit() -> hamsym.Fit:
    H = hamsym.Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0})
    t = np.linspace(0, 6, 40)
    noise = 0.01 * np.random.default_rng(2).normal(size=(2, 40))
    data = {"x": np.cos(1.5 * t) + noise[0], "p": -1.5 * np.sin(1.5 * t) + noise[1]}
    return hamsym.fit(H, t, data, free={"k": 2.0, "x": 0.9, "p": 0.0}, sigma=0.01, span=(0, 6))


@pytest.mark.slow
def test_fit_shows_estimates_and_residuals(fit: hamsym.Fit) -> None:
    figure = fit.plot()
    check_layout(figure)
    assert "±" in figure.caption
    assert len(figure.axes) == 4
    np.testing.assert_array_equal(figure.axes[1].lines[0].get_ydata(), fit.weighted_residuals["x"])


@pytest.mark.slow
def test_observable_is_drawn_into_given_axes(fit: hamsym.Fit) -> None:
    own = matplotlib.figure.Figure()
    axes = own.subplots()
    assert fit.plot("p", ax=axes) is own
    with pytest.raises(InputError, match="with ax= name one"):
        fit.plot(ax=axes)


@pytest.mark.slow_cases("names2", "names0", "names1")
@pytest.mark.parametrize("names", [(), ("x",), ("x", "p")])
def test_flow_maps_are_laid_out(names: tuple[str, ...]) -> None:
    flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 3), tol=1e-6)
    figure = flow.plot(*names)
    check_layout(figure)
    if names == ("x", "p"):
        first = np.column_stack(figure.axes[0].lines[0].get_data())
        np.testing.assert_allclose([first.min(axis=0), first.max(axis=0)], [[1, -1], [2, 1]])


# -- names and axes --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "wrong", "meant"),
    [
        (lambda: exponents(2, 2, chain(2)), ("exponent",), "exponents"),
        (lambda: lyapunov_map((5, 6)), ("px", "x"), "p_x"),
        (lambda: hamsym.equilibria(WELL), ("X", "p"), "x"),
        (lambda: hamsym.enclose(WELL, [0.1, 0], (0, 0.1)), ("wdth",), "width"),
        (lambda: certificate(2), ("bounds",), "bound"),
    ],
)
def test_unknown_names_have_a_suggestion(make: Any, wrong: tuple[str, ...], meant: str) -> None:
    with pytest.raises(InputError, match=f"did you mean '{meant}"):
        make().plot(*wrong)


@pytest.mark.parametrize(
    "make", [lambda: exponents(2, 4, chain(2)), lambda: certificate(2)]
)  # fmt: skip
def test_overview_refuses_axes_with_the_names_of_panels(make: Any) -> None:
    axes = matplotlib.figure.Figure().subplots()
    with pytest.raises(InputError, match="the overview has 2 panels"):
        make().plot(ax=axes)


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: exponents(2, 4, chain(2)), ("exponents",)),
        (lambda: lyapunov_map((5, 6)), ()),
        (lambda: hamsym.equilibria(WELL), ()),
        (lambda: certificate(2), ("components",)),
    ],
)
def test_one_panel_is_drawn_into_given_axes(make: Any, names: tuple[str, ...]) -> None:
    own = matplotlib.figure.Figure()
    axes = own.subplots()
    assert make().plot(*names, ax=axes) is own
    assert axes.has_data()
    with pytest.raises(InputError, match="is not an Axes"):
        make().plot(*names, ax=3)


# -- sections --------------------------------------------------------------------------------------


@pytest.mark.slow_cases("start0-$x$ at start-entries0")
@pytest.mark.parametrize(
    ("start", "title", "entries"),
    [
        ({"x": [1.0, 2.0], "p": 0.0}, "$x$ at start", ["1", "2"]),
        (
            {"x": [1.0, 2.0], "p": [1e-17, 0.5]},
            "trajectory: start",
            ["0: $x$ = 1, $p$ = 0", "1: $x$ = 2, $p$ = 0.5"],
        ),
    ],
)
def test_legend_of_a_section_names_the_starts(start: Any, title: str, entries: list[str]) -> None:
    figure = hamsym.section("p**2/2 + x**2/2", start, (0, 9), "x = 0", dt=0.1).plot()
    check_layout(figure)
    legend = figure.axes[0].get_legend()
    assert legend.get_title().get_text() == title
    assert [text.get_text() for text in legend.get_texts()] == entries


def test_section_has_the_boundary_of_its_energy() -> None:
    H = hamsym.Hamiltonian(HENON_HEILES)
    starts = [H.state_at_energy(1 / 8, {"x": 0, "y": y, "p_y": 0}) for y in (0.1, 0.3)]
    figure = hamsym.section(H, starts, (0, 60), "x = 0, p_x > 0").plot()
    check_layout(figure)
    y, p_y = figure.axes[0].lines[-1].get_data()
    np.testing.assert_allclose(p_y**2 / 2 + y**2 / 2 - y**3 / 3, 1 / 8, atol=1e-4)
    assert y.max() < 1  # not the other side of the saddle
    assert y[0] == y[-1]
    assert "boundary" in figure.caption


def test_section_of_a_rotating_frame_is_bounded_where_the_velocity_vanishes() -> None:
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + y*p_x - x*p_y + x**2 + y**2")
    found = hamsym.section(H, [1, 0, 0.3, 0.8], (0, 30), "y = 0")
    # dy/dt = p_y - x = 0
    x, p_x = found.plot().axes[0].lines[-1].get_data()
    np.testing.assert_allclose(p_x**2 / 2 + x**2 / 2, 0.565, atol=1e-4)


@pytest.mark.parametrize(
    "start", [[[0, 0.1, 0.4, 0], [0, 0.1, 0.3, 0]], [[0, 0, 0.1, 0, 0.4, 0]]], ids=["energies", "3"]
)
def test_section_without_one_boundary_has_none(start: Any) -> None:
    more = "" if len(start[0]) == 4 else " + p_w**2/2 + w**2/2"
    H = hamsym.Hamiltonian(HENON_HEILES + more)
    assert "boundary" not in hamsym.section(H, start, (0, 20), "x = 0").plot().caption


def test_directions_are_those_of_the_velocity() -> None:
    found = hamsym.section("p**2/2 + x**2/2", [1.0, 0.0], (0, 9), "x = 0", dt=0.1)
    rising, sentence = _directions(found)
    np.testing.assert_array_equal(rising, found.z[:, 1] > 0)
    assert sentence == "Dots: x = 0 is crossed upwards; crosses: downwards"


@pytest.mark.slow
def test_directions_are_those_of_each_parameter() -> None:
    H = hamsym.Hamiltonian("k*p**2/2 + x**2/2 + (1 - k)*p", parameters={"k": 1.0})
    found = hamsym.section(H, [0.5, 0.3], (0, 9), "x = 0", dt=0.01, parameters={"k": [1.0, 3.0]})
    k = np.array([1.0, 3.0])[found.trajectory]
    rising = k * found.z[:, 1] + 1 - k > 0
    drawn_upwards = [line for line in found.plot().axes[0].lines if line.get_marker() == "."]
    points = drawn_upwards and np.concatenate([line.get_ydata() for line in drawn_upwards])
    np.testing.assert_array_equal(np.sort(points), np.sort(found.z[rising, 1]))
    assert 0 < rising.sum() < len(rising)
