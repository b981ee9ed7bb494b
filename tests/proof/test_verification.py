"""Certificates of flow maps and orbits: their texts, and forgeries that are not verified."""

import copy
import dataclasses
import json

import numpy as np
import pytest

import hamsym
from hamsym.archive import certificate_from
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.orbits.certificate import statement_of
from hamsym.orbits.proven_stability import WEAKER
from hamsym.support.sealed_text import opened, sealed

QUARTIC = "p**2/2 + x**2/2 + x**4/4"


@pytest.fixture(scope="module")
def flow():
    return hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 1.1), "p": (0, 0.1)}, (0, 0.5), tol=1e-6)


@pytest.fixture(scope="module")
def of_box(flow):
    return flow.certify()


@pytest.fixture(scope="module")
def orbit():
    return hamsym.periodic_orbit(QUARTIC, [1.0, 0.0], energy=0.75)


@pytest.fixture(scope="module")
def of_orbit(orbit):
    return orbit.certify()


@pytest.fixture(params=["box", "orbit"])
def case(request):
    """A result with its certificate."""
    name = {"box": "flow", "orbit": "orbit"}[request.param]
    return request.getfixturevalue(name), request.getfixturevalue(f"of_{request.param}")


@pytest.mark.slow_cases("box")
def test_certificates_are_read_back_and_verified(case):
    result, certificate = case
    text = certificate.to_json()
    again = certificate_from(text)
    assert type(again) is type(certificate)
    assert again.to_json() == text
    hamsym.verify(text, result)
    hamsym.verify(certificate, result)


def test_every_edited_entry_is_refused(case):
    text = case[1].to_json()
    for line in text.splitlines()[1:-1]:
        digits = [i for i, letter in enumerate(line) if letter.isdigit()]
        for i in digits[:1] + digits[-1:]:
            edited = line[:i] + str((int(line[i]) + 1) % 10) + line[i + 1 :]
            changed = text.replace(line, edited, 1)
            if json.loads(changed) == json.loads(text):
                continue  # another decimal of the same number
            with pytest.raises(FileError, match="not a certificate"):
                certificate_from(changed)


def test_text_without_checksum_is_no_certificate(case):
    values = json.loads(case[1].to_json())
    del values["sha256"]
    with pytest.raises(FileError, match="it has no checksum"):
        certificate_from(json.dumps(values))


def smaller(values):
    return tuple(0.5 * value for value in values)


BOXES = {
    "bounds": (lambda c: {"bound": smaller(c.bound)}, "is not proven: the proof gives"),
    "tiny": (lambda c: {"bound": (1e-30, 1e-30)}, "is not proven: the proof gives"),
    "not a number": (lambda c: {"bound": (np.nan, np.nan)}, "not a valid certificate"),
    "larger box": (lambda c: {"box": {**c.box, "x": (0.5, 1.1)}}, "outside the box"),
    "other input": (lambda c: {"box": {"x": c.box["x"]}}, "different inputs"),
    "longer": (lambda c: {"span": (0.0, 2.0)}, "different span"),
    "formula": (lambda c: {"formula": "p**2/2"}, "different formula"),
    "components": (lambda c: {"components": ("p", "x")}, "different components"),
    "fixed": (lambda c: {"fixed": {"k": 1.0}}, "different fixed"),
    "expressions": (lambda c: {"expressions": {"x": "e"}}, "different expressions"),
    "digest": (lambda c: {"digest": "0" * 64}, "does not belong"),
}


@pytest.mark.slow_cases("tiny")
@pytest.mark.parametrize("name", BOXES)
def test_forged_claims_of_boxes_are_not_proven(flow, of_box, name):
    change, reason = BOXES[name]
    with pytest.raises(CertificationError, match=reason):
        hamsym.verify(dataclasses.replace(of_box, **change(of_box)), flow)


@pytest.mark.slow
def test_forged_bounds_with_a_right_checksum_are_not_proven(flow, of_box, tmp_path):
    flow.save(tmp_path / "map.hamsym")
    forged = dataclasses.replace(of_box, bound=(1e-30, 1e-30))
    assert certificate_from(forged.to_json()) == forged
    with pytest.raises(CertificationError, match="is not proven"):
        hamsym.verify(forged.to_json(), tmp_path / "map.hamsym")
    hamsym.verify(of_box.to_json(), tmp_path / "map.hamsym")


def test_weaker_bound_of_a_part_is_verified(flow, of_box):
    part = {**of_box.box, "x": (1.02, 1.03)}
    bound = tuple(2 * value for value in of_box.bound)
    hamsym.verify(dataclasses.replace(of_box, box=part, bound=bound, parts=7, seconds=0.0), flow)


def ball(middle, radius):
    return hamsym.Ball(middle, radius)


ORBITS = {
    "start": lambda c: {"z0": ball(c.z0.mid + 1e-6, c.z0.radius)},
    "period": lambda c: {"period": ball(c.period.mid, 0.5 * c.period.radius)},
    "later period": lambda c: {"period": ball(c.period.mid + 1e-9, c.period.radius)},
    "monodromy": lambda c: {"monodromy": ball(c.monodromy.mid, 0 * c.monodromy.radius)},
    "bound": lambda c: {"bound": 0.5 * c.bound},
    "unique_within": lambda c: {"unique_within": 2 * c.unique_within},
    "stability": lambda c: {"stability": "hyperbolic"},
    "instability": lambda c: {"stability": "unstable"},
    "pieces": lambda c: {"pieces": 2 * c.pieces},
}


def changed_orbit(orbit, certificate, **changes):
    """A certificate with other claims, and the statement that fits them."""
    changed = dataclasses.replace(certificate, **changes)
    claimed = (getattr(changed, f) for f in ("period", "bound", "unique_within", "stability"))
    stated = statement_of(orbit.problem, *claimed, changed.pieces)
    return dataclasses.replace(changed, statement=stated)


@pytest.mark.parametrize("name", ORBITS)
def test_forged_claims_of_orbits_are_not_proven(orbit, of_orbit, name):
    forged = changed_orbit(orbit, of_orbit, **ORBITS[name](of_orbit))
    with pytest.raises(CertificationError, match=r"the \w+ of the certificate is not proven"):
        hamsym.verify(forged.to_json(), orbit)


def test_weaker_stability_of_an_orbit_is_verified(orbit, of_orbit):
    assert of_orbit.stability == "parabolic"
    hamsym.verify(changed_orbit(orbit, of_orbit, stability="undecided").to_json(), orbit)
    unstable = hamsym.periodic_orbit("p**2/2 - x**2/2 + 0.1*x*cos(t)", [0.05, 0.0], period="2*pi")
    proven = unstable.certify()
    assert proven.stability == "hyperbolic"
    for weaker in WEAKER["hyperbolic"]:
        hamsym.verify(changed_orbit(unstable, proven, stability=weaker).to_json(), unstable)


@pytest.mark.parametrize("word", WEAKER)
def test_each_word_of_a_proven_stability_is_read_back(of_orbit, word):
    text = dataclasses.replace(of_orbit, stability=word).to_json()
    assert certificate_from(text).stability == word


def test_statement_of_an_orbit_fits_its_numbers(orbit, of_orbit):
    forged = dataclasses.replace(of_orbit, statement="H has no periodic orbit.")
    with pytest.raises(CertificationError, match="statement of the certificate does not match"):
        hamsym.verify(forged, orbit)


def test_certificate_of_another_result_is_refused(flow, orbit, of_box, of_orbit):
    other = hamsym.periodic_orbit(QUARTIC, [1.5, 0.0])
    with pytest.raises(CertificationError, match="does not belong to this orbit"):
        hamsym.verify(of_orbit, other)
    moved = copy.deepcopy(flow.map)
    moved.offset = moved.offset + 1e-12
    with pytest.raises(CertificationError, match="does not belong to this flow map"):
        hamsym.verify(of_box, dataclasses.replace(flow, map=moved))
    for certificate, result, needed in (
        (of_box, orbit, "FlowMap"),
        (of_orbit, flow, "PeriodicOrbit"),
        (3, flow, "certificate must be"),
    ):
        with pytest.raises(InputError, match=needed):
            hamsym.verify(certificate, result)


def test_time_limits_end_verifications(case):
    result, certificate = case
    with pytest.raises(CertificationError, match="time limit of"):
        hamsym.verify(certificate, result, time_limit=1e-6)


@pytest.mark.parametrize("text", ["", "{}", "[]", "1", None, '{"kind": 1}', '{"kind": "a"}'])
def test_texts_of_no_kind_are_no_certificates(text):
    with pytest.raises(FileError, match="not a certificate"):
        certificate_from(text)


def test_sealed_text_holds_its_values_once():
    values = {"kind": "a", "entry": [1.5, None, "x"]}
    text = sealed(values)
    assert opened(text, 1_000) == values
    for wrong in (text.replace("1.5", "1.50000001"), text.replace('"kind"', '"kind": 1, "kind"')):
        with pytest.raises(ValueError, match="checksum|twice"):
            opened(wrong, 1_000)
