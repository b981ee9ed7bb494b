"""Proofs of ensembles: each member is proven, or has the reason why not."""

import numpy as np
import pytest

import hamsym
from hamsym import InputError
from hamsym.errors import CertificationError
from hamsym.proof.prove import verify

OSCILLATOR = hamsym.Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0})


@pytest.fixture(scope="module")
def many():
    starts = {"x": [[1.0], [2.0]], "p": 0.0}
    return hamsym.solve_many(
        OSCILLATOR, starts, (0, 3), parameters={"k": [1.0, 4.0]}, tol=1e-8, prove=True
    )


@pytest.fixture(scope="module")
def partly():
    """One member that collides, and one that does not."""
    return hamsym.solve_many("p**2/2 - 1/x**2", [[1.0, 0.0], [20.0, 0.0]], (0, 1), prove=True)


def test_every_member_is_proven(many):
    proofs = many.proofs
    assert proofs.proven.shape == proofs.certificates.shape == proofs.message.shape == (2, 2)
    assert proofs.proven.all()
    assert (proofs.message == "").all()
    assert repr(proofs) == "Proofs(4 proven, 0 not)"
    t = np.linspace(0, 3, 300)
    for place in np.ndindex(2, 2):
        x, w = (1.0, 2.0)[place[0]], (1.0, 2.0)[place[1]]
        exact = np.stack([x * np.cos(w * t), -x * w * np.sin(w * t)], axis=1)
        error = np.abs(many[place](t) - exact).max(axis=0)
        assert (error <= proofs.bounds[place] + 4e-15).all()
        # the tolerance of the member: 1e-8 of its largest |z_i|
        largest = np.abs(exact).max(axis=0)
        assert proofs.certificates[place].asked == pytest.approx(1e-8 * largest, rel=1e-3)
        assert (proofs.bounds[place] <= proofs.certificates[place].asked).all()


def test_certificates_are_those_of_the_members(many):
    for place in ((0, 0), (1, 1)):
        verify(many.proofs.certificates[place].to_json(), many[place])
    with pytest.raises(CertificationError, match="does not belong"):
        verify(many.proofs.certificates[0, 0], many[1, 1])


def test_member_without_a_solution_is_not_proven(partly):
    proofs = partly.proofs
    assert proofs.proven.tolist() == [False, True]
    assert repr(proofs) == "Proofs(1 proven, 1 not)"
    assert proofs.certificates[0] is None
    assert np.isinf(proofs.bounds[0]).all()
    assert "no solution within the tolerance" in proofs.message[0]
    assert np.isfinite(proofs.bounds[1]).all()


def test_bound_of_ones_own_is_proven_or_refuted(many):
    proofs = many.certify(bound=[1e-7, 1e-6])
    assert proofs.proven.all()
    assert {one.asked for one in proofs.certificates.ravel()} == {(1e-7, 1e-6)}
    refuted = many.certify(bound=1e-30)
    assert not refuted.proven.any()
    assert np.isinf(refuted.bounds).all()
    assert all("above the bound 1e-30" in text for text in refuted.message.ravel())


def test_refused_proof_of_one_member_leaves_the_others(many, monkeypatch):
    run = hamsym.certify

    def refuse(solution, **options):
        if solution.z0[0] == 2.0:
            raise CertificationError("no enclosure beyond t = 1")
        return run(solution, **options)

    monkeypatch.setattr(hamsym, "certify", refuse)
    proofs = many.certify()
    assert proofs.proven.tolist() == [[True, True], [False, False]]
    assert proofs.message[1, 0] == "no enclosure beyond t = 1"


def test_function_that_is_not_smooth_is_not_proven():
    found = hamsym.solve_many("p**2/2 + abs(x)", [[2.0, 0.0]], (0, 1), prove=True).proofs
    assert not found.proven.any()
    assert "abs" in found.message[0]


def test_nothing_is_proven_without_being_asked():
    assert hamsym.solve_many(OSCILLATOR, [[1.0, 0.0]], (0, 1)).proofs is None


@pytest.mark.parametrize("bound", [-1, 0, np.nan, "x", [1, 2, 3]])
def test_invalid_bounds_are_refused(many, bound):
    with pytest.raises(InputError, match="bound="):
        many.certify(bound=bound)
