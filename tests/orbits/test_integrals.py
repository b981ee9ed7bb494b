"""Integrals beside an orbit: those that symmetries share, and brackets that vanish along orbits."""

import dataclasses

import flint
import numpy as np
import pytest

import hamsym
from hamsym.orbits.integrals import (
    are_permuted,
    independent_integrals,
    integrals_of,
    neutral,
    shared_integrals,
    slice_of,
)
from hamsym.orbits.quotients import ShiftDerivative
from hamsym.orbits.symmetry import closing_of
from tests.orbits.test_periodic_orbit import EIGHT, eight_symmetries, three_bodies

SPRING = "(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2/4"


def test_integrals_of_three_bodies_are_energy_momenta_and_angular_momentum():
    H = three_bodies()
    found = independent_integrals(H, np.array(EIGHT), np.ones(12))
    assert found[0] == H
    assert len(found) == 4
    assert neutral(found, H) == [True] * 4


def test_momenta_of_a_turned_frame_are_not_taken_as_zero():
    # {p_x, p_y x - p_x y} = p_y, whose mean over a period is zero only if p_y is a rate
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + c*p_y", parameters={"c": 1.0})
    momentum, turning = (
        hamsym.Hamiltonian(text, q=["x", "y"], p=["p_x", "p_y"])
        for text in ("p_x", "x*p_y - y*p_x")
    )
    assert neutral([momentum, turning], H) == [False, False]
    free = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2")
    assert neutral([momentum, turning], free) == [True, True]


def test_symmetries_share_integrals_that_keep_their_direction():
    H = hamsym.Hamiltonian(SPRING)
    assert shared_integrals(H, closing_of(H, None)) == integrals_of(H)
    mirror = closing_of(H, {"x": "-x", "p_x": "-p_x"})
    assert shared_integrals(H, mirror) == (H,)
    turn = closing_of(H, {"x": "-x", "y": "-y", "p_x": "-p_x", "p_y": "-p_y"})
    assert len(shared_integrals(H, turn)) == 2
    reversing = closing_of(H, {"p_x": "-p_x", "p_y": "-p_y"})
    shared = shared_integrals(H, reversing)
    assert [each.formula for each in shared] in (
        ["p_x*y - p_y*x"],
        ["-p_x*y + p_y*x"],
        ["p_y*x - p_x*y"],
    )
    assert are_permuted(integrals_of(H), mirror.shift)


def test_reversing_orbit_of_a_central_force_is_proven_up_to_rotations():
    H = hamsym.Hamiltonian(SPRING)
    orbit = hamsym.periodic_orbit(
        H, ([1.0, 0.0, 0.0, 0.0], 7.4), symmetry={"p_x": "-p_x", "p_y": "-p_y"}
    )
    assert orbit.is_isolated
    certificate = orbit.certify()
    assert certificate.bound < 1e-13
    assert certificate.z0.contains([1.0, 0.0, 0.0, 0.0])


def test_figure_eight_by_its_symmetries_is_proven_elliptic():
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259), symmetry=eight_symmetries())
    assert orbit.certify().stability == "elliptic"


def test_planes_cross_all_directions_of_an_orbit():
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259))
    planes = slice_of(orbit.problem, orbit.arc)
    assert planes.normals.shape == (4, 12)
    units = planes.normals * orbit.problem.scale_of(orbit.arc)
    np.testing.assert_allclose(units @ units.T, np.eye(4), atol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_quotient_of_a_product_has_the_multipliers_that_are_left(seed):
    # Maps that keep the first momentum and its direction, beside a rotation by 0.3 in all
    random = np.random.default_rng(seed)
    maps = []
    for angle in (0.1, 0.15, 0.05):
        c, s = np.cos(angle), np.sin(angle)
        matrix = np.eye(4)
        matrix[0, 2] = random.normal() * 100
        matrix[1::2, 1::2] = [[c, s], [-s, c]]
        a, b = random.normal(size=2)
        matrix = matrix @ np.array([[1, a, 0, b], [0, 1, b, 0], [0, 0, 1, 0], [0, 0, -a, 1]])
        maps.append(flint.arb_mat(matrix.tolist()))
    places = [(flint.arb_mat([[0, 0, 1, 0]]), flint.arb_mat([[1], [0], [0], [0]]))] * 4
    closing = closing_of(hamsym.Hamiltonian(SPRING), None)
    found = ShiftDerivative(closing, maps, [flint.arb(1)] * 4).across(places)
    assert (found.nrows(), found.ncols()) == (2, 2)
    assert abs(float((found[0, 0] + found[1, 1]).mid()) - 2 * np.cos(0.3)) < 1e-12
    with pytest.raises(ZeroDivisionError):
        ShiftDerivative(closing, maps, [flint.arb(1)] * 4).across(
            [(places[0][0] * 0, places[0][1])] * 4
        )


def test_wrong_energy_of_a_problem_is_refused():
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259))
    problem = dataclasses.replace(orbit.problem, energy=orbit.energy * 1.01)
    with pytest.raises(hamsym.CertificationError):
        dataclasses.replace(orbit, problem=problem).certify()
