"""Published periodic orbits of three equal bodies, against an integrator of other origin."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hamsym
from hamsym.orbits.arc import Problem
from hamsym.orbits.search import first_arc
from hamsym.orbits.symmetry import closing_of
from hamsym.orbits.window_maps import WindowMaps


def three_bodies(axes, third=1.0):
    q = [f"{c}{i}" for i in "123" for c in axes]
    masses = {"1": 1.0, "2": 1.0, "3": third}
    kinetic = " + ".join(f"p_{name}**2/(2*{masses[name[1]]})" for name in q)
    potential = " - ".join(
        f"{masses[i] * masses[j]}/sqrt(" + " + ".join(f"({c}{i} - {c}{j})**2" for c in axes) + ")"
        for i, j in ("12", "13", "23")
    )
    return hamsym.Hamiltonian(f"{kinetic} - {potential}", q=q, p=[f"p_{name}" for name in q])


PLANAR = three_bodies("xy")

#: Suvakov & Dmitrasinovic, Three classes of Newtonian three-body planar periodic orbits (2013):
#: velocity of the outer bodies, published period.
PUBLISHED = {
    "butterfly I": (0.306892758965492, 0.125506782829762, 6.23564136316479),
    "butterfly II": (0.392955223941802, 0.097579235208034, 7.0038),
    "moth I": (0.464445237398184, 0.396059973403921, 14.8939113169584),
    "yin-yang I": (0.513938052808, 0.304736003876, 17.328),
    "bumblebee": (0.184278506469036, 0.587188195840054, 63.534),
}

#: Li & Liao, a stable orbit in space, O_3(1.0).
STABLE = (
    [
        *(-1, 0, 0, 1, 0, 0, 0, 0, 0.476878264280312),
        *(0.402136910074724, 0.180356951286259, 0.210445128137873),
        *(0.402136910074724, 0.180356951286259, -0.210445128137873),
        *(-0.804273820149448, -0.360713902572518, 0),
    ],
    6.83162203628444,
)


def published(name):
    a, b, period = PUBLISHED[name]
    return [-1, 0, 1, 0, 0, 0, a, b, a, b, -2 * a, -2 * b], period


def motion(axes):
    """Newton's equations in positions and velocities, by hand."""

    def rates(t, z):
        q, v = z.reshape(2, 3, axes)
        apart = q[None] - q[:, None]
        distances = np.linalg.norm(apart, axis=2) + np.eye(3)
        return np.concatenate([v, (apart / distances[..., None] ** 3).sum(axis=1)]).ravel()

    return rates


def closure(orbit, axes):
    """Distance of the end from the start, by Dormand and Prince's method of order 8."""
    span = (0, orbit.period)
    path = solve_ivp(motion(axes), span, orbit.z0, method="DOP853", rtol=3e-14, atol=1e-15)
    return np.abs(path.y[:, -1] - orbit.z0).max()


@pytest.mark.slow_cases("moth I")
@pytest.mark.parametrize(
    "name",
    ["moth I", *(pytest.param(n, marks=pytest.mark.slow) for n in ("butterfly I", "yin-yang I"))],
)
def test_published_orbit_is_found_and_closes(name):
    guess, period = published(name)
    orbit = hamsym.periodic_orbit(PLANAR, (guess, period), tol=1e-8)
    assert orbit.success
    # The published periods have three to four digits in common with those of the starts.
    assert orbit.period == pytest.approx(period, rel=2e-4)
    assert np.abs(orbit.z0 - guess).max() < 2e-6
    assert closure(orbit, 2) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "word"),
    [("moth I", "elliptic"), ("butterfly I", "mixed"), ("yin-yang I", "mixed")],
)
def test_published_orbit_is_proven_with_its_stability(name, word):
    orbit = hamsym.periodic_orbit(PLANAR, published(name))
    assert orbit.is_isolated
    assert orbit.relative_error < 1e-11
    certificate = orbit.certify()
    assert certificate.stability == orbit.stability == word
    assert certificate.bound < 1e-12
    assert abs(certificate.period.mid - orbit.period) < 1e-12 * orbit.period
    certificate.verify(orbit)


@pytest.mark.slow
def test_stable_orbit_in_space_is_proven_elliptic(stable):
    assert stable.relative_error < 1e-12
    certificate = stable.certify()
    assert certificate.stability == "elliptic"
    assert certificate.bound < 1e-12
    assert abs(certificate.period.mid - STABLE[1]) < 1e-12


def test_arc_of_a_guess_has_no_kicks_at_the_ends_of_windows():
    guess, period = published("moth I")
    problem = Problem(PLANAR, closing_of(PLANAR, None))
    arc = first_arc(problem, np.array(guess), period)
    maps = WindowMaps(problem, arc, ())
    assert np.abs(maps.ends[..., -1] / problem.scale_of(arc)).max() < 1e-12


@pytest.mark.slow
def test_closest_encounters_are_found_with_their_error():
    guess, period = published("butterfly II")
    orbit = hamsym.periodic_orbit(PLANAR, (guess, period), tol=1e-11)
    assert orbit.success
    assert orbit.multiplier_error < 1e-7
    assert np.abs(orbit.z0 - guess).max() < 2e-6
    assert closure(orbit, 2) < 1e-6


@pytest.mark.slow
def test_long_orbit_takes_the_windows_it_needs():
    orbit = hamsym.periodic_orbit(PLANAR, published("bumblebee"), tol=1e-7)
    assert orbit.success
    assert len(orbit.arc.edges) > 400
    assert orbit.period == pytest.approx(63.534, rel=2e-5)
    assert closure(orbit, 2) < 1e-6
    assert orbit.stability == "elliptic"


def listed(third, z0, vx, vy, vz, period):
    """An orbit of the list of Li & Liao."""
    guess = [-1, 0, 0, 1, 0, 0, 0, 0, z0, vx, vy, vz, vx, vy, -vz, -2 * vx, -2 * vy, 0]
    return hamsym.periodic_orbit(three_bodies("xyz", third=third), (guess, period), tol=1e-8)


@pytest.mark.slow
def test_stable_orbit_with_multipliers_off_the_circle_by_round_off_is_elliptic():
    # O_4(1.6), with close encounters
    start = -7.3378705779838e-02, 0.561172381542911, -5.16977162063208e-02, -4.12864096843598e-02
    orbit = listed(1.6, *start, 9.89467523479519)
    assert orbit.success
    assert np.abs(np.abs(orbit.shift_multipliers) - 1).max() < 10 * orbit.multiplier_error
    assert orbit.multiplier_error < 1e-6
    assert orbit.stability == "elliptic"


@pytest.mark.slow
def test_orbit_that_multiplies_round_off_is_found_with_its_stability():
    # O_59(0.6), of which float64 leaves 1e-5, and of the multipliers nothing
    start = 0.0861926361138026, 0.266702433834442, 0.0354672184676783, 0.0552668646574773
    orbit = listed(0.6, *start, 31.0328286752835)
    assert orbit.success
    assert abs(orbit.period - 31.0328286752835) < 1e-12
    assert orbit.multiplier_error < 1e-4
    assert np.abs(orbit.shift_multipliers[0]) == pytest.approx(1.0162, abs=1e-4)
    assert orbit.stability == "mixed"


@pytest.mark.slow
def test_period_of_a_guess_is_moved_to_the_nearest_return():
    guess, period = published("moth I")
    orbits = [
        hamsym.periodic_orbit(PLANAR, (guess, factor * period), tol=1e-8)
        for factor in (0.995, 1.005)
    ]
    assert all(orbit.success for orbit in orbits)
    assert orbits[0].period == pytest.approx(orbits[1].period, rel=1e-9)


@pytest.fixture(scope="module")
def stable():
    return hamsym.periodic_orbit(three_bodies("xyz"), STABLE, tol=1e-8)


@pytest.mark.slow
def test_stable_orbit_in_space_is_elliptic(stable):
    assert stable.success
    assert stable.period == pytest.approx(STABLE[1], rel=1e-9)
    assert closure(stable, 3) < 1e-9
    assert stable.stability == "elliptic"


@pytest.mark.slow
def test_multipliers_beside_ten_integrals_are_those_of_differences(stable):
    # 18 components, less 3 and 3 of the centre of mass, 3 and 1 of rotations, 2 of the flow
    nontrivial = stable.shift_multipliers
    assert len(nontrivial) == 6
    assert (stable.multipliers == 1).sum() == 12
    np.testing.assert_allclose(np.abs(nontrivial), 1, atol=1e-9)
    # The characteristic polynomial at other points has no trouble with Jordan blocks.
    step, columns = 1e-5, []
    for k in range(18):
        ends = []
        for sign in (1, -1):
            start = stable.z0 + sign * step * np.eye(18)[k]
            path = solve_ivp(
                motion(3), (0, stable.period), start, method="DOP853", rtol=1e-12, atol=1e-13
            )
            ends.append(path.y[:, -1])
        columns.append((ends[0] - ends[1]) / (2 * step))
    monodromy = np.array(columns).T
    for place in (2.0, -1.5, 1j, 0.3 + 0.3j):
        own = np.prod(place - nontrivial) * (place - 1) ** 12
        assert np.linalg.det(place * np.eye(18) - monodromy) == pytest.approx(own, rel=1e-4)
