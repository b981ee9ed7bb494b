"""Bounds that are asked for are proven, refused or refuted; their certificates are checked."""

import copy
import dataclasses
import json
import math

import numpy as np
import pytest

import hamsym
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.proof import prove
from hamsym.proof.prove import verify
from hamsym.proof.windows.certificate import Certificate, rounded_down
from hamsym.proof.windows.window_proof import WindowProof
from hamsym.support.sealed_text import sealed


@pytest.fixture(scope="module")
def solution():
    return hamsym.solve("p**2/2 + x**2/2", [1.0, 0.0], (0.0, 3.0), tol=1e-6)


@pytest.fixture(scope="module")
def sharp(solution):
    return solution.certify()


@pytest.fixture(scope="module")
def asked(solution):
    return solution.certify(bound=[1e-8, 2e-8])


def errors(solution):
    """Largest errors of the components at many times, by the exact solution."""
    t = np.linspace(*solution.span, 2001)
    return np.abs(solution(t) - np.stack([np.cos(t), -np.sin(t)], axis=1)).max(axis=0)


# -- bounds that are asked for ---------------------------------------------------------------------


def test_bound_that_holds_is_proven(solution, asked):
    assert asked.asked == (1e-8, 2e-8)
    found = errors(solution)
    assert (found <= np.array(asked.component_bounds) + 1e-15).all()
    assert (np.array(asked.component_bounds) <= asked.asked).all()
    assert (np.array(asked.component_lowers) <= found + 1e-15).all()
    verify(asked.to_json(), solution)


def test_one_bound_counts_for_every_component(solution):
    assert solution.certify(bound=1e-8).asked == (1e-8, 1e-8)
    assert hamsym.certify(solution, bound=np.array([1e-8, 1e-7])).asked == (1e-8, 1e-7)


@pytest.mark.parametrize("place", [0, 1])
def test_bound_below_the_error_is_refuted_with_the_component(solution, sharp, place):
    bound = [1e-6, 1e-6]
    bound[place] = 0.9 * sharp.component_lowers[place]
    with pytest.raises(CertificationError, match=f"of {'xp'[place]} is proven to be at least"):
        solution.certify(bound=bound)


def test_bound_just_above_the_error_is_proven_and_just_below_is_not(solution, sharp):
    above = [1.05 * value for value in sharp.component_bounds]
    assert solution.certify(bound=above).asked == tuple(above)
    below = [0.95 * value for value in sharp.component_lowers]
    with pytest.raises(CertificationError):
        solution.certify(bound=below)


def test_error_of_altered_weights_is_above_the_bound(solution):
    trial = copy.deepcopy(solution.trial)
    trial.readouts[3, 5, 1] += 1e-4
    hurt = dataclasses.replace(solution, trial=trial)
    with pytest.raises(CertificationError, match=r"proven to be at least .* above the bound 1e-08"):
        hurt.certify(bound=1e-8)


@pytest.mark.parametrize("upper", [math.nan, math.inf, 1e-7])
def test_bounds_that_are_not_below_are_refused(solution, monkeypatch, upper):
    """Whatever the proof returns: NaN is not below the bound."""
    claims = {"component_lowers": (0.0, 0.0), "component_bounds": (1e-9, upper)}
    monkeypatch.setattr(prove, "_on_windows", lambda *_: dict(claims))
    with pytest.raises(CertificationError, match="of p is proven to be at most"):
        solution.certify(bound=1e-8)


def test_moving_component_is_not_proven_to_be_exact(solution):
    with pytest.raises(CertificationError, match="of p is proven to be at least"):
        solution.certify(bound=[1e-6, 0])


@pytest.mark.parametrize(
    "bound",
    [
        *(0, -1, math.nan, math.inf, "x", [1, 2, 3], [1e-6, -0.1], [1e-6, math.nan], 10**400),
        *([], {}, 1j, [[1, 2], [3, 4]]),
    ],
    ids=lambda bound: str(bound)[:20],
)
def test_invalid_bounds_are_refused_in_one_sentence(solution, bound):
    with pytest.raises(InputError, match="bound=") as refused:
        solution.certify(bound=bound)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (hamsym.certify, "solution=3 cannot be used; give a Solution or a FlowMap"),
        (hamsym.prove_orbit, "orbit=3 cannot be used; give a PeriodicOrbit"),
    ],
)
def test_other_objects_have_no_proof(function, message):
    with pytest.raises(InputError, match=message):
        function(3)


def test_bound_is_no_option_for_a_flow_map():
    flow = hamsym.FlowMap.__new__(hamsym.FlowMap)
    with pytest.raises(InputError, match="bound"):
        hamsym.certify(flow, bound=1e-6)


# -- certificates as texts ---------------------------------------------------------------------


@pytest.mark.parametrize("name", ["sharp", "asked"])
def test_certificates_are_read_back(request, solution, name):
    certificate = request.getfixturevalue(name)
    text = certificate.to_json()
    values = json.loads(text)
    assert values["version"] == 4
    assert Certificate.from_json(text) == certificate
    assert Certificate.from_json(text).to_json() == text
    assert ("As asked" in certificate.statement) == (name == "asked")
    assert Certificate.from_json(text).components == tuple(values["components"])
    verify(text, solution)


def test_names_of_components_are_checked(solution, asked):
    values = without_checksum(json.loads(asked.to_json()))
    names = tuple(solution.H.names)
    assert asked.components == names
    worst = dataclasses.replace(asked, component_bounds=(1.0, *asked.component_bounds[1:]))
    assert f"error of {names[0]} at most 1" in " ".join(worst.summary().split())
    with pytest.raises(CertificationError, match="name components differently"):
        verify(dataclasses.replace(asked, components=names[::-1]), solution)
    for wrong in ([], ["x"], ["x\x1b", "p"], ["x", "x"], "xp", [1, 2]):
        with pytest.raises(FileError, match="not a certificate"):
            Certificate.from_json(sealed(values | {"components": wrong}))


def test_statement_names_what_is_asked(asked):
    for word in ("1e-08, 2e-08", "windows", "float64", "106 bits", "Lohner"):
        assert word in asked.statement.replace("1.00000000e-08", "1e-08").replace(
            "2.00000000e-08", "2e-08"
        )


_EDITS = {
    "asked too small": lambda c: {"asked": ["1e-15", "1e-15"]},
    "asked of another number": lambda c: {"asked": ["1e-08"]},
    "asked NaN": lambda c: {"asked": ["nan", "nan"]},
    "asked infinite": lambda c: {"asked": ["inf", "inf"]},
    "asked with extra digits": lambda c: {"asked": ["1.0e-08", "2e-08"]},
    "asked as numbers": lambda c: {"asked": [1e-8, 2e-8]},
    "asked as one text": lambda c: {"asked": "1e-08"},
    "nothing asked": lambda c: {"asked": None},
    "version 3": lambda c: {"version": 3},
    "version 5": lambda c: {"version": 5},
    "version with a point": lambda c: {"version": 4.0},
    "another bound": lambda c: {"bound": "1.00000000e-15"},
    "another statement": lambda c: {"statement": "Proven: all is well."},
}


@pytest.mark.parametrize("name", _EDITS)
def test_edited_text_is_no_certificate(solution, asked, name):
    values = json.loads(asked.to_json())
    edited = values | _EDITS[name](asked)
    assert json.dumps(edited) != json.dumps(values)
    with pytest.raises(FileError, match="not a certificate .* its checksum"):
        verify(json.dumps(edited, indent=1), solution)
    with pytest.raises(FileError, match="not a certificate (?!.*checksum)"):
        verify(sealed(without_checksum(edited)), solution)


@pytest.mark.parametrize("name", ["components", "asked"])
def test_text_without_an_entry_is_no_certificate(asked, name):
    values = json.loads(asked.to_json())
    del values[name]
    with pytest.raises(FileError, match="of its values is missing"):
        Certificate.from_json(sealed(without_checksum(values)))


def without_checksum(values):
    return {name: value for name, value in values.items() if name != "sha256"}


def _times(value, factor):
    return tuple(part * factor for part in value) if isinstance(value, tuple) else value * factor


_FORGERIES = {
    "bound": {"bound": 0.97, "lower": 0.5},
    "component bounds": {"component_bounds": 0.97, "component_lowers": 0.5},
    "lower": {"lower": 1.05, "bound": 1.2},
    "component lowers": {"component_lowers": 1.05, "component_bounds": 1.2},
    "energy": {"energy_bound": 0.95, "energy_lower": 0.5},
    "residual": {"ell_max_bound": 0.95, "ell_max_lower": 0.5},
    "pieces": {"piece_bounds": 0.5},
}


@pytest.mark.parametrize("name", _FORGERIES)
def test_forged_bounds_of_windows_are_not_proven(solution, sharp, name):
    """As an object, whose statement fits to its numbers."""
    changed = {field: _times(getattr(sharp, field), by) for field, by in _FORGERIES[name].items()}
    forged = dataclasses.replace(sharp, **changed)
    with pytest.raises(CertificationError, match="does not hold|not proven"):
        verify(forged.to_json(), solution)


def test_smaller_bounds_than_asked_are_not_proven(solution, asked, sharp):
    low = tuple(rounded_down(0.9 * value) for value in sharp.component_lowers)
    claims = {"asked": low, "component_bounds": low, "component_lowers": (0.0, 0.0)}
    forged = dataclasses.replace(asked, **claims)
    with pytest.raises(CertificationError, match="does not hold|not proven"):
        verify(forged.to_json(), solution)


def test_infinite_energy_bound_is_not_claimed_as_finite(solution, asked):
    assert math.isinf(asked.energy_bound)
    forged = dataclasses.replace(asked, energy_bound=1e-30, ell_max_bound=1e-30)
    with pytest.raises(CertificationError, match="does not hold|not proven"):
        verify(forged.to_json(), solution)


def test_weaker_claims_are_verified(solution, sharp):
    for change in (
        {"bound": math.inf, "energy_bound": math.inf, "ell_max_bound": math.inf},
        {"lower": 0.0, "component_lowers": (0.0, 0.0)},
        {"piece_bounds": _times(sharp.piece_bounds, 2.0)},
        {"edges": solution.span, "piece_bounds": (sharp.bound,)},
        {"asked": _times(sharp.component_bounds, 1.5)},
        {"rtol": 1e6, "seconds": 0.0},
    ):
        verify(dataclasses.replace(sharp, **change).to_json(), solution)


# -- time limits -----------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"bound": 1e-8}])
def test_time_limit_ends_the_proof(solution, options):
    with pytest.raises(CertificationError, match="time limit of 1e-09 s"):
        solution.certify(time_limit=1e-9, **options)


def test_reason_of_the_first_attempt_is_kept_at_the_time_limit(solution, monkeypatch):
    def late(self, *_):
        self._deadline.check("the solution was enclosed")
        object.__setattr__(self._deadline, "began", -math.inf)
        raise CertificationError("the set of solutions became too wide; use an earlier end")

    monkeypatch.setattr(WindowProof, "_found", late)
    with pytest.raises(CertificationError, match="^the set .* too wide; use an earlier end$"):
        solution.certify(time_limit=60)


@pytest.mark.parametrize("name", ["sharp", "asked"])
def test_time_limit_ends_the_verification(request, solution, name):
    certificate = request.getfixturevalue(name)
    with pytest.raises(CertificationError, match="time limit of 1e-09 s"):
        verify(certificate, solution, time_limit=1e-9)


@pytest.mark.parametrize("limit", [0, -1, math.nan, "long"])
def test_invalid_time_limits_are_refused(solution, asked, limit):
    with pytest.raises(InputError, match="time_limit"):
        solution.certify(bound=1e-8, time_limit=limit)
    with pytest.raises(InputError, match="time_limit"):
        verify(asked, solution, time_limit=limit)
