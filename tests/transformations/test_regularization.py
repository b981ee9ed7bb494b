"""Regularized Hamiltonians: through collisions, the same motion, canonical maps, refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import VariableError
from hamsym.symbolic.brackets import poisson_bracket

PLANE = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
SPACE = "(p_x**2 + p_y**2 + p_z**2)/2 - 1/sqrt(x**2 + y**2 + z**2)"
RESTRICTED = (
    "(p_x**2 + p_y**2{0})/2 + p_x*y - p_y*x - (1-mu)/sqrt((x+mu)**2 + y**2{1})"
    " - mu/sqrt((x-1+mu)**2 + y**2{1})"
)
MU = {"mu": 0.1}


@pytest.mark.parametrize("eccentricity", [0.6, 1 - 1e-12, 1.0])
@pytest.mark.parametrize("kind", ["levi-civita", "kustaanheimo-stiefel"])
def test_kepler_through_collisions(kind: str, eccentricity: float) -> None:
    H, more = (Hamiltonian(PLANE), []) if kind == "levi-civita" else (Hamiltonian(SPACE), [0.0])
    found, e = H.regularized(kind), eccentricity
    z0 = [-1 - e, 0.0, *more, 0.0, -np.sqrt((1 - e) / (1 + e)), *more]
    solution = hamsym.solve(found.H, found.start(z0), (0, 6 * np.pi), atol=1e-12)
    assert solution.success
    anomaly = np.linspace(0, 6 * np.pi, 400)
    t, z = found.to_old(solution(anomaly))
    E = np.pi + anomaly
    assert np.abs(z[:, 0] - (np.cos(E) - e)).max() < 1e-9
    assert np.abs(z[:, 1] - np.sqrt(1 - e * e) * np.sin(E)).max() < 1e-9
    assert np.abs(t - (E - e * np.sin(E) - np.pi)).max() < 1e-9


@pytest.mark.parametrize(
    ("H", "kind", "options", "z0"),
    [
        (PLANE, None, {"sundman": "sqrt(x**2 + y**2)"}, [1, 0, 0.1, 0.4]),
        (PLANE + " - x*sin(t)/10", "levi-civita", {}, [1, 0, 0, 0.4]),
        (PLANE + " - x*sin(t)/10", None, {"sundman": "1 + x**2"}, [1, 0, 0, 0.4]),
        (SPACE, "kustaanheimo-stiefel", {}, [0.3, -0.7, 0.4, 0.1, 0.5, -0.3]),
        (SPACE, "kustaanheimo-stiefel", {}, [-0.3, 0.7, 0.4, 0.1, 0.5, -0.3]),
        (
            Hamiltonian(RESTRICTED.format("", ""), parameters=MU),
            "levi-civita",
            {"about": {"x": "1 - mu"}},
            [0.6, 0.3, 0.1, 0.5],
        ),
        (
            Hamiltonian(RESTRICTED.format(" + p_z**2", " + z**2"), parameters=MU),
            "kustaanheimo-stiefel",
            {"about": {"x": "-mu"}},
            [0.3, -0.7, 0.4, 0.1, 0.5, -0.3],
        ),
        (
            "(p_x**2 + p_y**2 + p_w**2)/2 - 1/sqrt(x**2 + y**2) + w**2/2 + w*x/5",
            "levi-civita",
            {"coordinates": ["x", "y"]},
            [1, 0, 0.3, 0, 0.6, 0.1],
        ),
    ],
)
def test_motion_is_that_of_the_original(
    H: Any, kind: str | None, options: dict[str, Any], z0: list[float]
) -> None:
    H = Hamiltonian.of(H)
    z0 = (
        dict(zip(H.names, z0, strict=True))
        if "w" not in H.names
        else dict(zip(["x", "y", "w", "p_x", "p_y", "p_w"], z0, strict=True))
    )
    found = H.regularized(kind, **options)
    solution = hamsym.solve(found.H, found.start(z0, 0.3), (0, 2), atol=1e-12)
    assert solution.success
    t, z = found.to_old(solution(np.array([0.0, 1.0, 2.0])))
    assert t[0] == 0.3
    direct = hamsym.solve(H, z0, (0.3, float(t[-1])), tol=1e-11)
    assert np.abs(z - direct(t)).max() < 1e-8


def _bodies(masses: list[Any], axes: str = "xy") -> Hamiltonian:
    n = range(1, len(masses) + 1)
    kinetic = [f"p_{a}{i}**2/(2*{m})" for i, m in zip(n, masses, strict=True) for a in axes]
    pairs = [
        f"{masses[i - 1]}*{masses[j - 1]}/sqrt({' + '.join(f'({a}{i} - {a}{j})**2' for a in axes)})"
        for i in n
        for j in range(1, i)
    ]
    return Hamiltonian(f"{' + '.join(kinetic)} - {' - '.join(pairs)}")


def _moved(text: str, other: str) -> Hamiltonian:
    """Three bodies with another term."""
    known = "(p_x1**2/2 + p_y1**2/2 + p_x2**2 + p_y2**2 + p_x3**2 + p_y3**2)"
    near = " - ".join(
        f"1/sqrt((x{i}-x{j})**2 + (y{i}-y{j})**2)" for i, j in ((1, 2), (1, 3), (2, 3))
    )
    return Hamiltonian(f"{known} - {near}".replace(text, other))


@pytest.mark.parametrize(
    ("masses", "axes", "span"),
    [
        ([3, 4, 5], "xy", 1.0),
        (["m", 2, "0.5*m"], "xy", 1.0),
        pytest.param(["m", 2, "0.5*m"], "xyz", 1.0, marks=pytest.mark.slow),
    ],
)
def test_several_bodies_move_as_in_the_original(masses: list[Any], axes: str, span: float) -> None:
    H = _bodies(masses, axes)
    H = H.with_parameters(m=1.5) if "m" in H.parameter_names else H
    random = np.random.default_rng(5)
    z0 = np.concatenate([random.uniform(-3, 3, H.dof), random.uniform(-1, 1, H.dof)])
    found = H.regularized("heggie")
    start = found.start(z0, 0.3)
    assert np.abs(found.to_old(start)[1] - z0).max() < 1e-14
    solution = hamsym.solve(found.H, start, (0, span), atol=1e-12)
    assert solution.success
    t, z = found.to_old(solution(np.linspace(0, span, 4)))
    assert t[0] == 0.3
    direct = hamsym.solve(H, z0, (0.3, float(t[-1])), tol=1e-11)
    assert np.abs(z - direct(t)).max() < 1e-8
    # many starts at once are the same as each
    many = found.start(np.stack([z0, 2 * z0]))
    assert (many[1] == found.start(2 * z0)).all()


def test_pythagorean_problem_to_its_end() -> None:
    """Masses 3, 4 and 5 at rest in the corners of a triangle (Szebehely & Peters 1967)."""
    found = _bodies([3, 4, 5]).regularized("heggie")
    places = {"x1": 1, "y1": 3, "x2": -2, "y2": -1, "x3": 1, "y3": -1}
    start = found.start({**places, **{f"p_{name}": 0 for name in places}})
    begin = hamsym.solve(found.H, start, (0, 50), tol=1e-9)
    assert begin.success
    t, z = found.to_old(begin(np.linspace(0, 50, 50_001)))
    assert t[-1] > 33
    # their closest approach: 4e-4 at t = 15.8299
    apart = np.hypot(z[:, 1] - z[:, 2], z[:, 4] - z[:, 5])
    nearest = int(apart.argmin())
    assert 3.5e-4 < apart[nearest] < 4.5e-4
    assert t[nearest] == pytest.approx(15.8299, abs=1e-4)
    # at the end masses 4 and 5 are a binary, which mass 3 leaves
    whole = hamsym.solve(found.H, start, (0, 120), tol=1e-3)
    assert whole.success
    t, z = found.to_old(whole(np.linspace(0, 120, 2_001)))
    assert t[-1] > 70
    late = z[t > 62]
    binary = np.hypot(late[:, 1] - late[:, 2], late[:, 4] - late[:, 5])
    escaping = np.hypot(late[:, 0], late[:, 3])
    assert binary.max() < 1.2
    assert (np.diff(escaping) > 0).all()


@pytest.mark.slow
def test_close_starts_of_three_bodies_go_on() -> None:
    """4,096 of them, at rest: all fall into close approaches."""
    found = _bodies([1, 1, 1]).regularized("heggie")
    random = np.random.default_rng(0)
    places = random.uniform(-0.1, 0.1, (4_096, 6))
    starts = found.start(np.concatenate([places, 0 * places], axis=1))
    many = hamsym.solve_many(found.H, starts, (0, 0.5), tol=1e-6)
    assert many.success.mean() > 0.99
    t, z = found.to_old(many(0.5))
    assert (t > 0).all()
    energy = found.original.compile("numpy").energy
    before = energy(np.concatenate([places, 0 * places], axis=1))
    assert np.median(np.abs(energy(z) / before - 1)) < 1e-6


@pytest.mark.parametrize(
    ("H", "options", "error", "message"),
    [
        (_bodies([1, 1]), {}, VariableError, "three bodies in"),
        (SPACE, {}, VariableError, "three bodies in"),
        (_bodies([1, 1, 1]), {"coordinates": [["x1", "y1"]]}, VariableError, "three bodies"),
        (_bodies([1, 1, 1]), {"about": {"x1": 1}}, InputError, "heggie removes all of them"),
        (_bodies([1, 1, 1]), {"coordinates": [["x1", "y1"], ["x2", "y2"]]}, VariableError, "each"),
        (_moved("p_x1**2/2", "p_x1**2/3"), {}, InputError, "point masses"),
        (_moved("p_x1**2/2", "p_x1**2/2 + x1**2"), {}, InputError, "point masses"),
        (_moved("p_x1**2/2", "p_x1**2/2 + y2*p_x1"), {}, InputError, "point masses"),
        (_moved("sqrt(", "(1 + "), {}, InputError, "point masses"),
    ],
)
def test_what_are_no_bodies(H: Any, options: dict[str, Any], error: Any, message: str) -> None:
    with pytest.raises(error, match=message):
        Hamiltonian.of(H).regularized("heggie", **options)


def test_spatial_map_is_canonical_where_the_bilinear_form_is_zero() -> None:
    found = Hamiltonian(SPACE).regularized("kustaanheimo-stiefel")
    z = sympy.symbols("u1:5 p_u1:5", real=True)
    u, P = z[:4], z[4:]
    form = u[0] * P[3] - u[1] * P[2] + u[2] * P[1] - u[3] * P[0]
    names = list(found.formulas)
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            bracket = poisson_bracket(found.formulas[a], found.formulas[b], z)
            rest = sympy.numer(sympy.together(bracket - {3: 1, -3: -1}.get(j - i, 0)))
            assert sympy.rem(sympy.expand(rest), form, P[3]) == 0
    start = found.start([0.3, -0.7, 0.4, 0.1, 0.5, -0.3])
    solution = hamsym.solve(found.H, start, (0, 5))
    own = found.H.observable("u1*p_u4 - u2*p_u3 + u3*p_u2 - u4*p_u1")
    assert np.abs(own(solution(np.linspace(0, 5, 9)))).max() < 1e-9


def test_a_regularized_orbit_is_proven_through_its_collision() -> None:
    found = Hamiltonian(PLANE).regularized("levi-civita")
    fall = hamsym.solve(found.H, found.start([1, 0, 0, 0]), (0, 3), prove=True)
    assert fall.success


@pytest.mark.parametrize(
    ("H", "arguments", "options", "error", "message"),
    [
        (PLANE, [], {}, InputError, "give a kind"),
        (PLANE, ["levi-civita"], {"sundman": "1"}, InputError, "give a kind"),
        (PLANE, ["levi civita"], {}, InputError, "levi-civita"),
        (PLANE, ["kustaanheimo-stiefel"], {}, VariableError, "3 coordinates of a collision"),
        (PLANE, ["levi-civita"], {"coordinates": ["x", "x"]}, VariableError, "2 coordinates"),
        (PLANE, ["levi-civita"], {"coordinates": ["x", "z"]}, VariableError, "of x, y"),
        (PLANE, ["levi-civita"], {"about": {"z": 1}}, VariableError, "about= has 'z'"),
        (PLANE, ["levi-civita"], {"about": {"x": "y"}}, InputError, "more than parameters"),
        (PLANE, [], {"sundman": "x", "about": {"x": 1}}, InputError, "belong to a kind"),
        (SPACE + " + p_x**4", ["kustaanheimo-stiefel"], {}, InputError, "kinetic energy"),
        (
            Hamiltonian(PLANE, forces={"p_x": "-p_x"}),
            ["levi-civita"],
            {},
            InputError,
            "without forces",
        ),
    ],
)
def test_what_is_not_regularized(
    H: Any, arguments: list[str], options: dict[str, Any], error: type, message: str
) -> None:
    with pytest.raises(error, match=message):
        Hamiltonian.of(H).regularized(*arguments, **options)


def test_a_time_that_does_not_run_forward_is_refused() -> None:
    with pytest.raises(InputError, match="dt/ds is -1 at the start"):
        Hamiltonian(PLANE).regularized(sundman="x").start([-1, 0, 0, 1])


def test_a_start_in_a_collision_is_refused() -> None:
    with pytest.raises(InputError, match="no collision"):
        Hamiltonian(PLANE).regularized("levi-civita").start([0, 0, 1, 0])


@pytest.mark.parametrize("t", ["a", math.nan, [0, 1]])
def test_start_needs_a_finite_time(t):
    plane = Hamiltonian("(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)").regularized("levi-civita")
    with pytest.raises(InputError, match="t="):
        plane.start([1, 0, 0, 1], t=t)


@pytest.mark.parametrize("about", [3, {"x": math.nan}, {"x": [1]}])
def test_place_of_a_collision_is_checked(about):
    H = Hamiltonian("(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)")
    with pytest.raises(InputError, match=r"about=3|the place of x"):
        H.regularized("levi-civita", about=about)
    with pytest.raises(InputError, match="coordinates=3 cannot be used"):
        H.regularized("levi-civita", coordinates=3)
