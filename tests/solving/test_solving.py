"""solve(prove=True): success is a proof that errors are within the tolerance."""

import copy
import dataclasses

import numpy as np
import pytest

import hamsym
from hamsym import InputError
from hamsym.errors import CertificationError
from hamsym.proof.prove import verify

OSCILLATOR = "p**2/2 + x**2/2"


def altered(change):
    """The method of features with changed weights."""

    class Altered(hamsym.Features):
        def solve(self, problem):
            solution = super().solve(problem)
            trial = copy.deepcopy(solution.trial)
            change(trial)
            return dataclasses.replace(solution, trial=trial)

    return Altered()


def _readout(size):
    def change(trial):
        trial.readouts[3, 5, 1] += size

    return change


def test_success_is_proven():
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 3), tol=1e-8, prove=True)
    assert solution.success
    assert "proven: the error of" in solution.message
    certificate = solution.certificate
    # 1e-8 of the largest |z_i|
    assert certificate.asked == pytest.approx((1e-8, 1e-8), rel=1e-3)
    t = np.linspace(0, 3, 500)
    error = np.abs(solution(t) - np.stack([np.cos(t), -np.sin(t)], axis=1)).max(axis=0)
    assert (error <= np.array(certificate.component_bounds) + 1e-15).all()
    verify(certificate.to_json(), solution)


def test_absolute_tolerance_is_part_of_what_is_proven():
    start = [1.0, 0.0]
    solution = hamsym.solve(OSCILLATOR, start, (0, 3), tol=1e-9, atol=[0.0, 1e-6], prove=True)
    assert solution.success
    assert solution.certificate.asked == pytest.approx((1e-9, 1.001e-6), rel=1e-3)


SPATIAL = "(p_x**2 + p_y**2 + p_z**2)/2 - 1/sqrt(x**2 + y**2 + z**2)"


@pytest.mark.parametrize(
    ("formula", "start", "zero"),
    [
        ("p**2/2 - cos(x)", [0.0, 0.0], [0, 1]),
        (SPATIAL, [1.0, 0.0, 0.0, 0.0, 1.1, 0.0], [2, 5]),
        ("(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y", [0.0, 0.3, 0.0, 0.1], [0, 2]),
    ],
)
def test_components_at_rest_are_proven_to_be_exact(formula, start, zero):
    solution = hamsym.solve(formula, start, (0, 3), prove=True)
    assert solution.success
    assert [i for i, b in enumerate(solution.certificate.component_bounds) if b == 0] == zero
    verify(solution.certificate, solution)


def test_component_that_leaves_zero_is_not_at_rest():
    # y is driven by x^2 off zero; a trial with y = 0 is wrong
    def rest(trial):
        for array in (trial.states, trial.readouts):
            array[..., [1, 3]] = 0.0

    formula, start = "(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y", [0.3, 0.0, 0.0, 0.0]
    assert not hamsym.solve(formula, start, (0, 3), method=altered(rest), prove=True).success


def test_nothing_is_proven_without_being_asked():
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 3))
    assert solution.certificate is None
    assert "proven" not in solution.message


@pytest.mark.parametrize("size", [1e-4, -1e-2, 1.0])
def test_too_large_error_is_no_success(size):
    given = {"method": altered(_readout(size)), "tol": 1e-8}
    assert hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 3), **given).success
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 3), prove=True, **given)
    assert not solution.success
    assert "not proven: the error of" in solution.message
    assert solution.certificate is None


def test_error_below_the_tolerance_is_still_proven():
    method = altered(_readout(1e-10))
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 3), method=method, tol=1e-8, prove=True)
    assert solution.success
    assert 1e-13 < solution.certificate.bound < 1e-8


def test_failed_proof_is_no_success(monkeypatch):
    def refuse(*_, **__):
        raise CertificationError("no enclosure beyond t = 1")

    monkeypatch.setattr(hamsym, "certify", refuse)
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 3), prove=True)
    assert not solution.success
    assert solution.message.endswith("not proven: no enclosure beyond t = 1")
    assert solution.certificate is None


def test_function_that_is_not_smooth_is_not_proven():
    solution = hamsym.solve("p**2/2 + abs(x)", [2.0, 0.0], (0, 1), prove=True)
    assert not solution.success
    assert "not proven" in solution.message
    assert "abs" in solution.message


@pytest.mark.slow
def test_failed_solution_is_not_proven():
    solution = hamsym.solve("p**2/2 - 1/x**2", [1.0, 0.0], (0, 1), prove=True)
    assert not solution.success
    assert "proven" not in solution.message
    assert solution.certificate is None


def test_chain_of_networks_is_proven():
    method = hamsym.NetworkChain(windows=2)
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 1), method=method, tol=1e-6, prove=True)
    assert solution.success
    assert solution.certificate.asked == pytest.approx((1e-6, np.sin(1) * 1e-6), rel=1e-3)


@pytest.mark.slow
def test_trained_network_is_proven_to_its_tolerance():
    method = hamsym.LevenbergMarquardt(hidden=(8,), points=20, iterations=60)
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 1), method=method, tol=1e-3, prove=True)
    assert solution.success, solution.message
    assert solution.record.stopped == "tolerance"
    assert solution.certificate.asked == pytest.approx((1e-3, np.sin(1) * 1e-3), rel=1e-2)
    t = np.linspace(0, 1, 101)
    error = np.abs(solution(t) - np.stack([np.cos(t), -np.sin(t)], axis=1)).max(axis=0)
    assert (error <= np.array(solution.certificate.component_bounds) + 1e-15).all()


@pytest.mark.slow_cases("LBFGS", "SSBroyden", "Adam")
@pytest.mark.parametrize("kind", [hamsym.Adam, hamsym.LBFGS, hamsym.SSBroyden])
def test_network_beyond_its_tolerance_is_not_proven(kind):
    few = {"epochs": 2} if kind is hamsym.Adam else {"iterations": 2}
    method = kind(hidden=(6,), points=20, **few)
    solution = hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 1), method=method, tol=1e-6, prove=True)
    assert not solution.success
    assert "proven" not in solution.message
    assert solution.certificate is None


@pytest.mark.parametrize("value", [1, 0, None, "yes", np.array([True])])
def test_prove_is_true_or_false(value):
    with pytest.raises(InputError, match="prove="):
        hamsym.solve(OSCILLATOR, [1.0, 0.0], (0, 1), prove=value)
