"""No certificate is made where the public object evaluates another function than was proven."""

import copy
import dataclasses
from fractions import Fraction

import numpy as np
import pytest

import hamsym
from hamsym.dynamics import equilibrium_points
from hamsym.errors import CertificationError
from hamsym.flow_maps.expansion import Leg
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.proof.boxes.public_map import check_map
from hamsym.proof.public_check import require_same
from hamsym.proof.windows.enclose import Enclosure
from hamsym.proof.windows.public_windows import check_solution
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution

LINEAR = "p**2/2 + x**2/2"
QUARTIC = "p**2/2 + x**2/2 + x**4/4"
APART = "more apart than the rounding of its evaluation|not evaluated to states"


@pytest.fixture(scope="module")
def solution():
    return hamsym.solve(QUARTIC, [1.0, 0.0], (0.0, 3.0), tol=1e-8)


@pytest.fixture(scope="module")
def flow():
    return hamsym.flow_map(LINEAR, {"x": (1, 1.1), "p": (0, 0.1)}, (0, 1), tol=1e-6)


@pytest.fixture(scope="module")
def orbit():
    return hamsym.periodic_orbit(QUARTIC, [1.0, 0.0])


def shifted(function, amount):
    """A method whose values are moved, by as little as a thousand roundings."""
    return lambda self, *args, **options: function(self, *args, **options) + amount


CHANGES = [1e-9, np.nan, np.inf]


@pytest.mark.parametrize("amount", CHANGES)
def test_changed_solution_has_no_certificate(solution, monkeypatch, amount):
    monkeypatch.setattr(Solution, "__call__", shifted(Solution.__call__, amount))
    with pytest.raises(CertificationError, match=APART):
        solution.certify()


@pytest.mark.parametrize("prove", [hamsym.certify, lambda s: hamsym.certify(s, bound=1e-6)])
def test_changed_evaluation_of_features_has_no_certificate(solution, monkeypatch, prove):
    monkeypatch.setattr(FeatureTrial, "states_at", shifted(FeatureTrial.states_at, 1e-9))
    with pytest.raises(CertificationError, match=APART):
        prove(solution)


def test_solution_changed_in_one_window_has_no_certificate(solution, monkeypatch):
    whole = Solution.__call__
    low, high = solution.trial.edges[1:3]

    def moved(self, t, **options):
        inside = (np.asarray(t) > low) & (np.asarray(t) < high)
        return whole(self, t, **options) + 1e-9 * inside[..., None]

    monkeypatch.setattr(Solution, "__call__", moved)
    with pytest.raises(CertificationError, match="the solution at t = "):
        solution.certify()


def test_solve_with_proof_fails_for_a_changed_solution(monkeypatch):
    monkeypatch.setattr(Solution, "__call__", shifted(Solution.__call__, 1e-9))
    found = hamsym.solve(QUARTIC, [1.0, 0.0], (0.0, 1.0), prove=True)
    assert not found.success
    assert found.certificate is None
    assert "rounding of its evaluation" in found.message


def test_networks_that_are_held_are_not_proven_as_moving():
    network = hamsym.solve(
        LINEAR, [1.0, 0.0], (0, 1), method=hamsym.NetworkChain(hidden=(8,)), tol=1e-4
    )
    check_solution(network)
    for piece in network.trial.pieces:
        piece.hold([0])
    with pytest.raises(CertificationError, match=APART):
        check_solution(network)


@pytest.mark.parametrize("span", [(0.0, 3.0), (1000.0, 990.0), (1e6, 1e6 + 2)])
def test_unchanged_solutions_pass_at_any_times(span):
    check_solution(hamsym.solve("p**2/2 - cos(x)", [1.0, 0.3], span))


@pytest.mark.slow_cases("nan", "inf")
@pytest.mark.parametrize("amount", CHANGES)
def test_changed_map_has_no_certificate(flow, monkeypatch, amount):
    monkeypatch.setattr(FlowMap, "__call__", shifted(FlowMap.__call__, amount))
    with pytest.raises(CertificationError, match="the flow map at t = "):
        flow.certify()


def test_map_that_evaluates_other_legs_has_no_certificate(flow, monkeypatch):
    monkeypatch.setattr(Leg, "parts", lambda self, times: [(0, np.arange(len(times)))])
    assert len(flow.map.pieces) > 1
    with pytest.raises(CertificationError, match="the flow map at t = "):
        flow.certify()


def test_map_with_other_stored_numbers_has_no_certificate(flow):
    changed = copy.deepcopy(flow.map)
    changed.pieces[0].readouts[0, 0] += 1e-3  # its compiled form keeps the old one
    with pytest.raises(CertificationError, match="the flow map at t = "):
        dataclasses.replace(flow, map=changed).certify()


def test_unchanged_map_passes(flow):
    box = tuple((Fraction(low), Fraction(high)) for low, high in flow.box.values())
    check_map(flow, [box])


@pytest.mark.parametrize("amount", CHANGES)
def test_changed_orbit_has_no_certificate(orbit, monkeypatch, amount):
    monkeypatch.setattr(PeriodicOrbit, "__call__", shifted(PeriodicOrbit.__call__, amount))
    with pytest.raises(CertificationError, match="the orbit at t = "):
        orbit.certify()


def test_orbit_with_another_start_has_no_certificate(orbit, monkeypatch):
    monkeypatch.setattr(PeriodicOrbit, "z0", property(lambda self: self.arc.ends[0] + 1e-9))
    with pytest.raises(CertificationError, match="not that of its arc"):
        orbit.certify()


def test_changed_enclosure_is_refused(monkeypatch):
    whole = Enclosure.__call__
    monkeypatch.setattr(
        Enclosure,
        "__call__",
        lambda self, t: hamsym.Ball(whole(self, t).mid + 1e-9, whole(self, t).radius),
    )
    with pytest.raises(CertificationError, match="the enclosure at t = "):
        hamsym.enclose(QUARTIC, [1, 0], (0, 2))


def test_enclosure_with_smaller_radii_is_refused(monkeypatch):
    whole = Enclosure.__call__
    monkeypatch.setattr(
        Enclosure,
        "__call__",
        lambda self, t: hamsym.Ball(whole(self, t).mid, 0 * whole(self, t).radius),
    )
    with pytest.raises(CertificationError, match="the enclosure at t = "):
        hamsym.enclose(QUARTIC, [1, 0], (0, 2))


def test_equilibrium_of_another_energy_is_refused(monkeypatch):
    monkeypatch.setattr(equilibrium_points.Finder, "energy", lambda self, z: 1e-3)
    with pytest.raises(CertificationError, match="has H = 0.001"):
        hamsym.equilibria("p**2/2 - cos(x) + x/10", box={"x": (-1, 1), "p": (-1, 1)})


def test_values_that_are_not_states_are_refused():
    proven, allowed = np.zeros((1, 2, 1)), np.ones((1, 2, 1))
    for public in (np.zeros((2, 2)), np.zeros((2, 1), dtype=np.float32), "x"):
        with pytest.raises(CertificationError, match="not evaluated to states"):
            require_same("map", ["x"], public, proven, allowed, str)
    require_same("map", ["x"], np.ones((2, 1)), proven, allowed, str)
    with pytest.raises(CertificationError, match=r"the map at 1 has x = 2.0"):
        require_same("map", ["x"], np.array([[1.0], [2.0]]), proven, allowed, str)
    with pytest.raises(CertificationError, match=APART):
        require_same("map", ["x"], np.zeros((2, 1)), proven, np.nan * allowed, str)
