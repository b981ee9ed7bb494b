"""Stable and unstable manifolds against exact separatrices, graphs and 30 digits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import hamsym
from hamsym import InputError

HENON = "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3"


def _saddle(formula: str, guess: object = None) -> hamsym.Equilibrium:
    found = hamsym.equilibria(formula, guess)
    return next(one for one in found if one.stable is False)


def test_pendulum_separatrix_is_exact() -> None:
    found = _saddle("p**2/2 - cos(x)").manifolds(duration=8)
    assert found.success
    assert found.unstable.local_error < 1e-12
    assert len(found.unstable) == len(found.stable) == 2
    for part in found:
        for t, z in part.paths:
            x = z[:, 0] - 2 * np.pi * (z[0, 0] > np.pi)
            sign = np.sign(z[0, 1])
            begun = t[0] - 2 * np.arctanh(np.tan(sign * x[0] / 4))
            exact = sign * 4 * np.arctan(np.tanh((t - begun) / 2))
            assert np.abs(x - exact).max() < 1e-11
            assert np.abs(z[:, 1] - sign * 2 / np.cosh(t - begun)).max() < 1e-11


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e9, 1e150])
def test_duffing_separatrix_in_any_unit(unit: float) -> None:
    found = _saddle(f"p**2/2 - x**2/2 + x**4/(4*{unit**2!r})", [0.0, 0.0]).manifolds(duration=8)
    assert found.success
    t, z = found.unstable.paths[0]
    x = np.abs(z[:, 0]) / unit
    begun = t[0] + np.arccosh(math.sqrt(2) / x[0])
    assert np.abs(x - math.sqrt(2) / np.cosh(t - begun)).max() < 1e-11


@pytest.mark.parametrize("unit", [2.0**-73, 2.0**60])
def test_components_at_rest_have_units_of_their_own(unit: float) -> None:
    """Of the saddle on the y axis, where x and p_x are 0."""
    formula = f"c*({HENON})".replace("p_x", "(p_x/c)").replace("p_y", "(p_y/c)")
    H = hamsym.Hamiltonian(formula, parameters={"c": unit})
    saddle = next(one for one in hamsym.equilibria(H) if abs(one.z[1] - 1) < 1e-9)
    assert saddle.manifolds(length=2).unstable.local_error < 1e-12


def test_equilibrium_far_from_the_origin_in_its_unit() -> None:
    a, b = 2.0**36, 2.0**96
    formula = "c*((p/b)**2/2 - cos(x/a))"
    H = hamsym.Hamiltonian(formula, parameters={"a": a, "b": b, "c": a * b / 2.0**24})
    saddle = hamsym.equilibria(H, box={"x": (2 * a, 4 * a), "p": (-b, b)})[0]
    found = saddle.manifolds(duration=8 * 2.0**24)
    assert found.success
    assert found.unstable.local_error < 1e-12


def test_henon_heiles_saddle_has_its_exact_branch() -> None:
    saddle = next(one for one in hamsym.equilibria(HENON) if abs(one.z[1] - 1) < 1e-9)
    found = saddle.manifolds(duration=8).unstable
    t, z = found.paths[int(np.argmin(found.z0[:, 1]))]
    begun = t[0] + 2 * np.arccosh(math.sqrt(1.5 / (1 - z[0, 1])))
    assert np.abs(z[:, 1] - (1 - 1.5 / np.cosh((t - begun) / 2) ** 2)).max() < 1e-11
    assert np.abs(z[:, [0, 2]]).max() == 0


def test_escape_in_finite_time_is_reported() -> None:
    saddle = next(one for one in hamsym.equilibria(HENON) if abs(one.z[1] - 1) < 1e-9)
    found = saddle.manifolds(duration=8).unstable
    assert not found.success
    assert "end early" in found.message
    outwards = int(np.argmax(found.z0[:, 1]))
    assert found.ends[outwards] < 8
    assert np.isfinite(found.paths[outwards][1]).all()
    assert saddle.manifolds(length=2).unstable.success


def test_saddle_centre_agrees_with_30_digits() -> None:
    """The reference begins 1e-18 from the saddle, in 40 digits; see the slow test."""
    saddle = _saddle("(p_x**2 + p_y**2)/2 - x**2/2 + y**2 + x**2*y + 3*x**3/10", [0.0] * 4)
    part = saddle.manifolds(duration=5).unstable
    reached = [z for z in _crossings(part, 0.5) if z[0] > 0]
    assert len(reached) == 1
    assert np.abs(reached[0] - _REFERENCE).max() < 1e-11


_REFERENCE = np.array(
    [0.5, -0.04764898471656101394409458, 0.4319800276144223520219715, -0.08761790120452143643734843]
)


def _crossings(part: hamsym.Manifold, x: float) -> list[np.ndarray]:
    """The first states with a value of the first component."""
    found = []
    for k in range(len(part)):
        events = part.trajectories[k].events(f"x = {x}")
        found += list(events.y_events[0][:1])
    return found


@pytest.mark.slow
def test_reference_of_30_digits() -> None:
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(40):
        small = mpmath.mpf(10) ** -18

        def field(t: object, z: list) -> list:
            x, y, px, py = z
            return [px, py, x - 2 * x * y - mpmath.mpf(9) / 10 * x**2, -2 * y - x**2]

        solution = mpmath.odefun(field, 0, [small, 0, small, 0], tol=mpmath.mpf(10) ** -32)
        t = mpmath.mpf("40.90823248593894996239560848946587555613")
        assert max(abs(a - b) for a, b in zip(solution(t), _REFERENCE, strict=True)) < 1e-16


#: S, whose graph p = grad S is the unstable manifold, as momenta of x and y without it.
_PX, _PY = "(p_x - (x**2 + y**2 + 2*x*y**2))", "(p_y - (2*x*y + 2*x**2*y))"
_LINEAR = {
    "two rates": (f"x*{_PX} + 1.7*y*{_PY}", [1.7, 1.0]),
    "resonant rates": (f"x*{_PX} + 2*y*{_PY}", [2.0, 1.0]),
    "equal rates": (f"x*{_PX} + y*{_PY}", [1.0, 1.0]),
    "focus": (f"(x*{_PX} + y*{_PY})/2 + 2*(x*{_PY} - y*{_PX})", [0.5 + 2j, 0.5 - 2j]),
}


@pytest.mark.slow_cases("two rates", "resonant rates", "equal rates")
@pytest.mark.parametrize("case", _LINEAR)
def test_two_dimensional_manifold_is_the_graph_of_a_gradient(case: str) -> None:
    linear, rates = _LINEAR[case]
    origin = hamsym.equilibria(f"{linear} + ({_PX}**2 + {_PY}**2)/2", [0.0] * 4)[0]
    part = origin.manifolds(duration=1, count=8).unstable
    assert part.success
    assert part.dimension == 2
    assert part.local_error < 1e-11
    np.testing.assert_allclose(part.rates, rates, atol=1e-13)
    for _, z in part.paths:
        x, y = z[:, 0], z[:, 1]
        slopes = np.stack([x**2 + y**2 + 2 * x * y**2, 2 * x * y + 2 * x**2 * y], axis=1)
        assert np.abs(z[:, 2:] - slopes).max() < 1e-9 * np.abs(z).max()


def test_equal_exponents_without_eigenvectors_are_refused() -> None:
    H = f"x*{_PX} + y*{_PY} + y*{_PX}/2 + ({_PX}**2 + {_PY}**2)/2"
    with pytest.raises(InputError, match="too few eigenvectors"):
        hamsym.equilibria(H, [0.0] * 4)[0].manifolds()


def test_components_of_other_sizes_have_their_own_units() -> None:
    """The same motion in units from 1e-10 to 1e10."""
    H = (
        "1e20*p_x**2/2 + 1e-12*p_y**2/2 - 4e-20*x**2/2 - 1e12*y**2/2"
        " + 0.1e-40*x**4 + 0.2e-8*x**2*y**2 + 0.3e-24*x**3*y"
    )
    part = hamsym.equilibria(H, [0.0] * 4)[0].manifolds(duration=2, count=4, spacing=10).unstable
    assert part.success
    assert part.local_error < 1e-11
    np.testing.assert_allclose(part.rates, [2, 1], rtol=1e-12)
    energies = part.trajectories.energy([0.0, 1.0, 2.0])
    states = part.trajectories([0.0, 1.0, 2.0])
    assert np.abs(energies).max() < 1e-10 * (1e20 * states[..., 2] ** 2).max()


def test_ring_is_spaced() -> None:
    origin = hamsym.equilibria(f"{_LINEAR['two rates'][0]}", [0.0] * 4)[0]
    coarse = origin.manifolds(duration=1, count=6, spacing=10).unstable
    fine = origin.manifolds(duration=1, count=6, spacing=0.3).unstable
    assert len(coarse) == 6 < len(fine)
    assert fine.gap <= 0.3 < coarse.gap
    extents = np.ptp(coarse(np.linspace(0, 1, 200)), axis=(0, 1))
    apart = np.abs(coarse(1.0) - np.roll(coarse(1.0), 1, axis=0)) / extents
    assert abs(apart.max() - coarse.gap) < 1e-3


def test_length_ends_trajectories() -> None:
    found = _saddle("p**2/2 - cos(x)").manifolds(length=3)
    assert found.success
    np.testing.assert_allclose(found.unstable.lengths, 3, rtol=1e-9)
    for k, end in enumerate(found.unstable.ends):
        # along p = 2 cos(x/2): dx/ds = 1/sqrt(1 + sin(x/2)**2)
        x = found.unstable.trajectories[k](np.array([found.unstable.span[0], end]))[:, 0]
        exact = abs(quad(lambda x: math.sqrt(1 + math.sin(x / 2) ** 2), *x, epsabs=1e-12)[0])
        assert abs(exact - 3) < 1e-8
    assert np.isnan(found.unstable(found.unstable.span[1])).all()
    short = _saddle("p**2/2 - cos(x)").manifolds(length=30)  # the separatrix has 7.29
    assert not short.success


@pytest.mark.parametrize(("place", "width"), [(1e-5, 1e-8), (0.0512, 1e-5)])
def test_barrier_inside_the_local_manifold_is_met(place: float, width: float) -> None:
    # Narrower than the distance of the points at which the polynomial is compared with the force.
    H = hamsym.Hamiltonian(f"p**2/2 - x**2/2 + x**4/4 + 0.1*exp(-((x - {place})/{width})**2)")
    origin = next(o for o in hamsym.equilibria(H, guess=[1e-7, 1e-7]) if o.z[0] == 0)
    part = origin.manifolds(duration=1).unstable
    assert not part.success
    assert not part.local_error < 0.1 * place
    assert "narrow feature of the force" in part.message


@pytest.mark.parametrize("coupling", ["0", "x**2*y/4"])
def test_manifold_leaves_the_subspace_of_its_orbit(coupling: str) -> None:
    # x is at rest along the orbit, and has no size there.
    H = hamsym.Hamiltonian(f"p_x**2/2 - x**2/2 + x**4/4 + p_y**2/2 + y**2 + {coupling}")
    orbit = hamsym.periodic_orbit(H, {"x": 0, "y": 1, "p_x": 0, "p_y": 0})
    found = orbit.manifolds(count=4, duration=4)
    assert found.success
    assert found.unstable.local_error < 1e-11
    assert min(np.abs(z[:, 0]).max() for _, z in found.unstable.paths) > 0.5
    assert np.abs(found.unstable.trajectories.energy([0.0, 2.0, 4.0]) - orbit.energy).max() < 1e-10


@pytest.mark.parametrize(
    ("formula", "what"),
    [
        ("p**2/2 + x**2/2", "it is a centre"),
        ("p**2/2 + x**4", "it is degenerate"),
        ("p**2/2 - x**4", "it is degenerate"),
        ("p**2/2 - k*x**2/2", "parameter"),
    ],
)
def test_equilibria_without_manifolds_are_refused(formula: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        hamsym.equilibria(formula)[0].manifolds()


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"duration": 0}, "duration"),
        ({"length": math.nan}, "length"),
        ({"count": 0}, "count"),
        ({"spacing": -1}, "spacing"),
        ({"tol": math.inf}, "tol"),
    ],
)
def test_unusable_arguments_are_refused(options: dict, what: str) -> None:
    with pytest.raises(InputError, match=what):
        _saddle("p**2/2 - cos(x)").manifolds(**options)
    with pytest.raises(InputError, match="no manifolds"):
        hamsym.manifolds("p**2/2")  # type: ignore[arg-type]


# -- periodic orbits -------------------------------------------------------------------------------


def test_separatrix_beside_an_oscillator_is_a_tube() -> None:
    H = hamsym.Hamiltonian("p_x**2/2 - cos(x) + (p_y**2 + y**2)/2")
    orbit = hamsym.periodic_orbit(H, ([np.pi, 1, 0, 0], 2 * np.pi))
    part = orbit.manifolds(count=6, spacing=10).unstable
    assert part.success
    assert part.dimension == 2
    assert len(part) == 12
    assert part.local_error < 1e-11
    assert abs(part.rates[0] - math.exp(2 * np.pi)) < 1e-7 * math.exp(2 * np.pi)
    for _, z in part.paths:
        assert np.abs(z[:, 2] ** 2 / 2 - np.cos(z[:, 0]) - 1).max() < 1e-10
        assert np.abs((z[:, 3] ** 2 + z[:, 1] ** 2) / 2 - 0.5).max() < 1e-9


def test_negative_multiplier_makes_a_twisted_strip() -> None:
    """After a period a trajectory is on the other side, on the manifold again."""
    H = hamsym.Hamiltonian("p**2/2 + (0.25 + 0.5*cos(t))*x**2/2 + x**4/4")
    orbit = hamsym.periodic_orbit(H, [0, 0], period="2*pi")
    part = orbit.manifolds(duration=15, count=8).unstable
    assert part.success
    assert part.rates[0].real < -4
    assert part.phases.min() == 0
    assert 1.5 < part.phases.max() < 2
    leaving = part.departure
    early = int(np.argmax(part.phases))  # its image is within the ball
    u = leaving.coordinates(part.directions[[early]], part.phases[[early]])
    image = leaving.local(u * leaving.rates)[0]
    np.testing.assert_allclose(part.trajectories(2 * np.pi)[early], image, atol=1e-12)
    end = solve_ivp(
        lambda t, z: [z[1], -(0.25 + 0.5 * math.cos(t)) * z[0] - z[0] ** 3],
        (0, 15), part.z0[0], method="DOP853", rtol=1e-13, atol=1e-15,
    )  # fmt: skip
    np.testing.assert_allclose(part.trajectories(15.0)[0], end.y[:, -1], atol=1e-10)


def test_local_manifold_of_an_orbit_is_invariant() -> None:
    """By an independent integrator: the image of W(u/m) is W(u), within the reported error."""
    H, orbit = _lyapunov(0.18)
    part = orbit.manifolds(count=4, spacing=10, duration=2).stable
    leaving = part.departure
    assert part.success
    assert part.local_error < 1e-11
    J = np.kron([[0, 1], [-1, 0]], np.eye(2))
    gradient = H.compile("numpy").gradient
    for u in (0.3, -1.0):
        start = leaving.local(np.array([u / leaving.rates[0].real], dtype=complex))
        found = solve_ivp(
            lambda t, z: -J @ np.asarray(gradient(z)), (0, orbit.period), start,
            method="DOP853", rtol=1e-13, atol=1e-15,
        )  # fmt: skip
        wanted = leaving.local(np.array([u], dtype=complex))
        assert np.abs(found.y[:, -1] - wanted).max() < 1e-10


def _lyapunov(energy: float) -> tuple[hamsym.Hamiltonian, hamsym.PeriodicOrbit]:
    """The Lyapunov orbit of Henon-Heiles at its saddle on the y axis."""
    H = hamsym.Hamiltonian(HENON)
    z0 = H.state_at_energy(energy, {"x": 0, "y": 1.0, "p_y": 0})
    symmetry = {"x": "-x", "p_y": "-p_y"}
    guess = z0, 2 * np.pi / math.sqrt(3)
    return H, hamsym.periodic_orbit(H, guess, energy=energy, symmetry=symmetry)


def test_orbit_manifolds_keep_their_energy() -> None:
    H, orbit = _lyapunov(0.18)
    for part in orbit.manifolds(count=4, spacing=10, length=3):
        assert part.success
        for _, z in part.paths:
            assert np.abs(H.compile("numpy").energy(z) - 0.18).max() < 1e-9


@pytest.mark.slow
def test_two_unstable_multipliers() -> None:
    H = hamsym.Hamiltonian("p_x**2/2 - cos(x) + p_w**2/2 - cos(w)/4 + (p_y**2 + y**2)/2")
    names = {"x": np.pi, "w": np.pi, "y": 1.0, "p_x": 0.0, "p_w": 0.0, "p_y": 0.0}
    orbit = hamsym.periodic_orbit(H, (H.state_from(names), 2 * np.pi))
    part = orbit.manifolds(count=6).unstable
    assert part.dimension == 3
    assert part.local_error < 1e-8
    x, w, px, pw = (H.names.index(name) for name in ("x", "w", "p_x", "p_w"))
    for _, z in part.paths:
        assert np.abs(z[:, px] ** 2 / 2 - np.cos(z[:, x]) - 1).max() < 1e-8
        assert np.abs(z[:, pw] ** 2 / 2 - np.cos(z[:, w]) / 4 - 0.25).max() < 1e-8


def test_orbits_without_manifolds_are_refused() -> None:
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    with pytest.raises(InputError, match="it is parabolic"):
        orbit.manifolds()
    H = hamsym.Hamiltonian("p**2/2 + (0.26 + 0.02*cos(t))*x**2/2 + x**4/4")
    with pytest.raises(InputError, match="it is elliptic"):
        hamsym.periodic_orbit(H, [0, 0], period="2*pi").manifolds()
