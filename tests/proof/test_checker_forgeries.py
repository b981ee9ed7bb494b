"""Forged claims of every kind: neither checker accepts a false one, and both agree.

Each number of a claim is changed in turn. Some changes leave a true claim, such as a looser bound:
these are accepted. Data of another form are refused with the errors that the checkers document.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import math

import numpy as np
import pytest
import sympy
from flint import ctx

import hamsym
from hamsym.errors import CertificationError, FileError
from hamsym.flow_maps.compiled_piece import CompiledPiece
from hamsym.orbits.certificate import statement_of
from hamsym.problems.description import described, described_formula
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.boxes.box_certificate import map_digest
from hamsym.proof.checker.equilibria import check_equilibrium
from hamsym.proof.checker.flow_maps import check_flow_map
from hamsym.proof.checker.formulas import NotProvenError
from hamsym.proof.checker.invariants import check_invariant
from hamsym.proof.checker.orbits import _Orbit, check_orbit
from hamsym.proof.checker.solutions import check_solution
from hamsym.proof.independent import _flow_data, _orbit_data
from hamsym.solution.digest import digest
from hamsym.support.sealed_text import sealed
from tests.proof.test_checker import EQUILIBRIA, INVARIANTS, QUARTIC, data_of, enclosed_equilibria
from tests.proof.test_checker_orbits import ORBITS

CHECKERS = ("kernel", "independent")


@pytest.fixture(scope="module")
def case():
    """A solution with its certificate."""
    solution = hamsym.solve(QUARTIC, [1.3, 1.0], (0, 1.5))
    return solution, solution.certify()


def agreed(certificate, result):
    """Whether both checkers accept a certificate; they must agree."""
    verdicts = []
    for checker in CHECKERS:
        try:
            hamsym.verify(certificate, result, checker=checker)
            verdicts.append(True)
        except (CertificationError, FileError):
            verdicts.append(False)
    assert len({*verdicts}) == 1, certificate
    return verdicts[0]


# -- solutions ------------------------------------------------------------------------------------

FIELDS = ("bound", "component_bounds", "energy_bound", "ell_max_bound")
LOWERS = tuple(name.replace("bound", "lower") for name in FIELDS)


def changed(certificate, name, change):
    """Claims with one number changed, name[place] or name."""
    field, _, place = name.partition(" ")
    value = getattr(certificate, field)
    if place:
        k = int(place)
        return {field: (*value[:k], change(value[k]), *value[k + 1 :])}
    return {field: change(value)}


def numbers(certificate):
    """Names of all bounds of a certificate."""
    for field in (*FIELDS, *LOWERS, "piece_bounds"):
        value = getattr(certificate, field)
        yield from [field] if np.ndim(value) == 0 else [f"{field} {k}" for k in range(len(value))]


def forgeries(certificate):
    """Claims that are false or no bounds at all."""
    relaxed = {
        field: 0.0 if np.ndim(value) == 0 else (0.0,) * len(value)
        for field in LOWERS
        for value in [getattr(certificate, field)]
    }
    for name in numbers(certificate):
        if "lower" in name:
            for factor in (1.03, 1.5, 1e6, 1e300):
                upper = changed(certificate, name.replace("lower", "bound"), lambda v: v * 1e301)
                claims = upper | changed(certificate, name, lambda v, f=factor: v * f)
                if "bound" in upper:  # all components may be as large
                    claims |= {"piece_bounds": (1e300,) * len(certificate.piece_bounds)}
                yield claims
        else:
            for factor in (0.97, 0.5, 1e-3, 1e-30, 0.0):
                if "piece" not in name or factor < 0.3:  # else it may be true
                    yield relaxed | changed(certificate, name, lambda v, f=factor: v * f)
        for value in (np.nan, -1.0, -np.inf, -5e-324):
            yield changed(certificate, name, lambda v, w=value: w)
        if "lower" in name:
            yield changed(certificate, name, lambda v: np.inf)
    edges = certificate.edges
    swapped = ("component_bounds", "component_lowers")
    yield {name: getattr(certificate, name)[::-1] for name in swapped}
    yield {"edges": (*edges[:-1], edges[-1] + 0.5)}
    yield {"edges": (edges[0] - 0.5, *edges[1:])}
    yield {"edges": edges[::-1]}
    yield {"edges": (edges[0],), "piece_bounds": ()}
    yield {"edges": (edges[0], np.nan, edges[-1]), "piece_bounds": (1.0, 1.0)}
    yield {"digest": "0" * 64}
    yield {"components": certificate.components[::-1]}


def test_forged_solutions_are_refused_by_both_checkers(case):
    solution, certificate = case
    for claims in list(forgeries(certificate))[::17]:
        assert not agreed(dataclasses.replace(certificate, **claims), solution)


@pytest.mark.slow
def test_all_forged_solutions_are_refused_by_both_checkers(case):
    solution, certificate = case
    found = list(forgeries(certificate))
    assert len(found) > 100
    accepted = [
        claims
        for claims in found
        if agreed(dataclasses.replace(certificate, **claims), solution)
    ]  # fmt: skip
    assert accepted == []


@pytest.mark.slow
def test_claims_are_checked_by_the_proof_too(case):
    """The checker itself refuses forgeries, not only the check of their form before it."""
    data = data_of(*case)
    for claims in forgeries(case[1]):
        if claims.keys().isdisjoint({"digest", "components"}):
            forged = data | {"claims": data["claims"] | claims}
            with pytest.raises(NotProvenError):
                check_solution(**forged, check_time=lambda: None)


def test_looser_claims_are_accepted_by_both_checkers(case):
    solution, certificate = case
    looser = changed(certificate, "bound", lambda v: 1.1 * v)
    assert agreed(dataclasses.replace(certificate, **looser), solution)
    every = {
        field: tuple(f * v for v in value) if np.ndim(value) else f * value
        for names, f in ((FIELDS, 1.1), (LOWERS, 0.9))
        for field in names
        for value in [getattr(certificate, field)]
    }
    assert agreed(dataclasses.replace(certificate, **every), solution)


RESULTS = {
    "H": lambda s: {"H": hamsym.Hamiltonian("p**2/2 + x**2/2 + 0.25000000001*x**4")},
    "kinetic": lambda s: {"H": hamsym.Hamiltonian("p**2/1.9999999999 + x**2/2 + x**4/4")},
    "other pair": lambda s: {"H": hamsym.Hamiltonian("x**2/2 + p**2/2 + p**4/4")},
    "readout": lambda s: {
        "trial": dataclasses.replace(s.trial, readouts=s.trial.readouts * (1 + 1e-11))
    },
    "zero": lambda s: {"trial": dataclasses.replace(s.trial, readouts=0 * s.trial.readouts)},
    "series": lambda s: {
        "trial": dataclasses.replace(s.trial, series=s.trial.series * (1 - 1e-11))
    },
    "states": lambda s: {
        "trial": dataclasses.replace(
            s.trial, states=np.vstack([s.trial.states[:1], s.trial.states[1:] + 1e-10])
        )
    },
    "z0": lambda s: {
        "z0": s.z0 + 1e-10,
        "trial": dataclasses.replace(
            s.trial, states=np.vstack([s.trial.states[:1] + 1e-10, s.trial.states[1:]])
        ),
    },
}


@pytest.mark.parametrize("name", RESULTS)
def test_certificates_do_not_hold_for_other_solutions(case, name):
    """Even where their digest is that of the other result."""
    other = dataclasses.replace(case[0], **RESULTS[name](case[0]))
    assert not agreed(dataclasses.replace(case[1], digest=digest(other)), other)


# -- periodic orbits ------------------------------------------------------------------------------


def moved(ball, places, change):
    """A ball with one middle or radius changed."""
    middle, radius = (np.array(part, dtype=float) for part in ball)
    part = (middle, radius)[places[0]]
    part[places[1:]] = change(part[places[1:]])
    return [middle.tolist(), radius.tolist()]


def forged_orbits(claims):
    """Fields of claims, and values that are false, or none at all."""
    for name in ("z0", "period", "monodromy"):
        middle, radius = map(np.array, claims[name])
        for place in np.ndindex(middle.shape):
            r = float(radius[place])
            for shift in (4 * r + 1e-15, -1e-9, 0.1, math.nan, math.inf, -math.inf):
                if not abs(shift) <= 2 * r:  # which may be true
                    yield name, moved(claims[name], (0, *place), lambda v, s=shift: v + s)
            for value in (-1.0, math.nan, -5e-324):
                yield name, moved(claims[name], (1, *place), lambda v, w=value: w)
    for value in (1e-3 * claims["bound"], 1e-30, 0.0, -1.0, math.nan):
        yield "bound", value
    for value in (10.0, 1e300, math.inf, -1.0, math.nan):  # within 10 it crosses the plane again
        yield "unique_within", value
    words = ("elliptic", "hyperbolic", "mixed", "complex unstable", "parabolic", "attracting",
             "repelling", "unstable", "stable", "")  # fmt: skip
    for word in words:
        true = (claims["stability"], *({"hyperbolic": ["unstable"]}.get(claims["stability"], [])))
        if word not in true:
            yield "stability", word
    for value in (0, -1, 10**9):
        yield "pieces", value
    yield "components", claims["components"][::-1]


def restated(values, orbit):
    """The text of a certificate of an orbit, with its own statement and checksum."""
    values = {key: value for key, value in values.items() if key != "sha256"}
    parts = values["bound"], values["unique_within"], values["stability"], values["pieces"]
    # else it is none that can be stated, and refused when it is read
    with contextlib.suppress(ValueError, OverflowError):
        values["statement"] = statement_of(orbit.problem, Ball(*values["period"]), *parts)
    return sealed(values)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reversing", "henon", "whole", "three", "period"])
def test_all_forged_orbits_are_refused(name, monkeypatch):
    assert_orbits_are_refused(name, monkeypatch)


def test_some_forged_orbits_are_refused(monkeypatch):
    assert_orbits_are_refused("quarter", monkeypatch, 13)


def assert_orbits_are_refused(name, monkeypatch, every=1):
    """Refused by both checkers, and by the claims of the independent one alone."""
    orbit = ORBITS[name]()
    certificate = orbit.certify()
    claims = json.loads(certificate.to_json())
    proven, known = _Orbit.proven, {}

    def once(self, given, effort):
        """The orbit in a box, around which all claims are looked at."""
        if effort not in known:
            known[effort] = proven(self, claims, effort)
        return known[effort]

    monkeypatch.setattr(_Orbit, "proven", once)
    monkeypatch.setattr(hamsym, "prove_orbit", lambda *_, **__: certificate)
    assert agreed(restated(claims, orbit), orbit)
    found = [*forged_orbits(claims)]
    assert len(found) > 60
    for field, value in found[::every]:
        assert not agreed(restated(claims | {field: value}, orbit), orbit), (field, value)
        with pytest.raises(NotProvenError):
            check_orbit(
                described(orbit.H), _orbit_data(orbit), claims | {field: value}, lambda: None
            )


# -- flow maps ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flow():
    """A flow map with its certificate, and its largest errors at some of its starts."""
    flow = hamsym.flow_map(
        "p**2/2 + k*x**2/2", {"x": (1, 1.1), "p": 0}, (0, 1), {"k": (0.5, 1.5)}, tol=1e-6
    )
    t, k = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 40), np.linspace(0.5, 1.5, 40)))
    w = np.sqrt(k)
    true = 1.1 * np.array([np.cos(w * t), -w * np.sin(w * t)]).T
    errors = np.abs(flow(t, {"x": 1.1}, {"k": k}) - true).max(axis=0)
    return flow, flow.certify(), errors


def forged_flow_maps(certificate, errors):
    for i in range(2):
        for value in (0.99 * errors[i], 0.5 * errors[i], 1e-3 * errors[i], 0.0, -1.0, np.nan):
            bound = [*certificate.bound]
            bound[i] = float(value)
            yield {"bound": tuple(bound)}
    yield from [
        {"bound": certificate.bound[::-1]}, {"bound": certificate.bound[:1]},
        {"box": {"x": (1.0, 1.2), "k": (0.5, 1.5)}}, {"box": {"x": (1.0, 1.1), "k": (0.4, 1.5)}},
        {"box": {"x": (1.1, 1.0), "k": (0.5, 1.5)}}, {"box": {"x": (1.0, 1.1)}},
        {"span": (0.0, 2.0)}, {"span": (0.0, np.inf)}, {"span": (-1.0, 1.0)},
        {"formula": "p**2/2 + k*x**2"}, {"fixed": {"p": 1.0}}, {"components": ("p", "x")},
        {"expressions": {"p": "k"}}, {"digest": "0" * 64}, {"parts": -1},
    ]  # fmt: skip


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_forged_flow_maps_are_refused(flow, every):
    flow, certificate, errors = flow
    assert agreed(certificate, flow)
    assert (errors < certificate.bound).all()
    assert (errors > 1e-10).all()  # and not of round-off
    assert certificate.bound[0] < errors[1]  # so that the swapped bounds are false
    for claims in [*forged_flow_maps(certificate, errors)][::every]:
        assert not agreed(dataclasses.replace(certificate, **claims), flow), claims
    other = dataclasses.replace(flow, span=(0.0, 0.9))
    for checker in CHECKERS:
        with pytest.raises(CertificationError, match="SHA-256"):
            hamsym.verify(certificate, other, checker=checker)


@pytest.mark.slow
def test_claims_about_flow_maps_are_checked_by_the_proof_too(flow):
    """The checker itself refuses forgeries, not only the check of their form before it."""
    flow, certificate, errors = flow
    H, data, whole = described(flow.H), _flow_data(flow), json.loads(certificate.to_json())
    check_flow_map(H, data, whole, lambda: None)
    wider = {"x": [1.0, 1.1], "k": [0.5, 3.0]}
    for claims in [*forged_flow_maps(certificate, errors), {"box": wider}]:
        if {"bound", "box"} & claims.keys() and claims != {
            "box": {"x": (1.0, 1.2), "k": (0.5, 1.5)}
        }:
            with pytest.raises(NotProvenError):
                check_flow_map(H, data, whole | claims, lambda: None)


def of_leg(change):
    """Other numbers of a leg."""

    def changed(flow):
        leg = copy.deepcopy(flow.map)
        change(leg)
        return {"map": leg}

    return changed


def piece(number, **factors):
    """A piece whose arrays are multiplied."""

    def change(leg):
        own = leg.pieces[number]
        arrays = {name: getattr(own, name) for name in ("degrees", "readouts", "columns")}
        arrays |= {name: factor * arrays[name] for name, factor in factors.items()}
        leg.pieces[number] = CompiledPiece(**arrays)

    return of_leg(change)


def degrees(leg):
    own = leg.pieces[0]
    leg.pieces[0] = CompiledPiece(own.degrees[::-1].copy(), own.readouts, own.columns)


def attribute(name, change):
    return of_leg(lambda leg: setattr(leg, name, change(getattr(leg, name))))


def with_box(**changes):
    return lambda flow: {"region": dataclasses.replace(flow.region, **changes)}


FORCED = hamsym.Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0}, forces={"p": "-1e-7*p"})
MAPS = {
    "H": with_box(H=hamsym.Hamiltonian("p**2/2 + 1.0000001*k*x**2/2", parameters={"k": 1.0})),
    "kinetic": with_box(H=hamsym.Hamiltonian("p**2/1.9999999 + k*x**2/2", parameters={"k": 1.0})),
    "other pair": with_box(H=hamsym.Hamiltonian("k*p**2/2 + x**2/2", parameters={"k": 1.0})),
    "time": with_box(H=hamsym.Hamiltonian("p**2/2 + k*x**2/2 + 1e-7*x*t", parameters={"k": 1.0})),
    "forces": with_box(H=FORCED),
    "fixed": with_box(fixed={"p": 1e-7}),
    "readouts": piece(0, readouts=1 + 1e-6),
    "columns": piece(-1, columns=1 - 1e-6),
    "no columns": piece(2, columns=0),
    "degrees": of_leg(degrees),
    "pieces": attribute("pieces", lambda pieces: pieces[::-1]),
    "scaling": attribute("scaling", lambda matrix: matrix * (1 + 1e-6)),
    "shift": attribute("shift", lambda vector: vector + 1e-6),
    "offset": attribute("offset", lambda vector: vector + 1e-7),
    "selection": attribute("selection", lambda matrix: matrix * (1 + 1e-7)),
    "edges": attribute("edges", lambda edges: np.array([0, *(edges[1:-1] + 1e-4), edges[-1]])),
    "begin": lambda flow: {"map": shifted(flow.map), "span": (0.25, 1.25)},
}


def shifted(leg):
    found = copy.deepcopy(leg)
    found.begin = 0.25
    return found


@pytest.mark.parametrize("name", MAPS)
def test_certificates_do_not_hold_for_other_flow_maps(flow, name):
    """Even where their digest and all that they state is that of the other map."""
    own, certificate, _ = flow
    other = dataclasses.replace(own, **MAPS[name](own))
    claims = {"digest": map_digest(other), "formula": other.H.formulas, "fixed": dict(other.fixed)}
    restated = dataclasses.replace(certificate, **claims, span=other.span)
    if name == "begin":  # H does not contain the time
        assert agreed(restated, other)
    else:
        assert not agreed(restated, other)


def test_flow_maps_of_a_part_and_with_looser_bounds_are_accepted(flow):
    own, certificate, _ = flow
    looser = tuple(1.5 * value for value in certificate.bound)
    part = {"x": (1.0, 1.02), "k": (0.7, 0.75)}
    assert agreed(dataclasses.replace(certificate, bound=looser, box=part), own)


# -- equilibria and invariants --------------------------------------------------------------------


@dataclasses.dataclass
class RawBall:
    """A ball whose numbers are not checked."""

    mid: np.ndarray
    radius: np.ndarray


def forged_equilibria(found):
    ball, linear = found.enclosure, found.linear
    for i in range(len(found.names)):
        for shift in (4 * ball.radius[i] + 1e-15, -1e-9, 0.1, np.nan, np.inf, 1e300):
            middle = ball.mid.copy()
            middle[i] += shift
            yield dataclasses.replace(found, enclosure=RawBall(middle, ball.radius))
        radius = ball.radius.copy()
        radius[i] = -1.0
        yield dataclasses.replace(found, enclosure=RawBall(ball.mid, radius))
    yield dataclasses.replace(found, enclosure=None)
    yield dataclasses.replace(found, names=found.names[::-1])
    words = {"centre", "saddle", "centre-centre", "saddle-centre", "focus-focus", "saddle-saddle"}
    for word in sorted(words - {found.type}):
        yield dataclasses.replace(found, linear=dataclasses.replace(linear, type=word))
    yield dataclasses.replace(found, linear=dataclasses.replace(linear, stable=not linear.stable))
    for sign in {1, -1} - {linear.definite}:
        yield dataclasses.replace(found, linear=dataclasses.replace(linear, definite=sign))


@pytest.mark.slow_cases(EQUILIBRIA[2])
@pytest.mark.parametrize("text", EQUILIBRIA)
def test_forged_equilibria_are_refused(text):
    for H, found in enclosed_equilibria(text):
        for forged in forged_equilibria(found):
            with pytest.raises(CertificationError):
                hamsym.verify(forged, H, checker="independent")


@pytest.mark.parametrize("text", INVARIANTS)
def test_forged_invariants_are_refused(text):
    """By both programs: what is_conserved, of the prover, refuses, the checker does."""
    H = hamsym.Hamiltonian(text)
    for found in [hamsym.Invariant(H.expr, 2), *H.invariants()]:
        for k, symbol in enumerate(H.z):
            for change in (symbol, symbol**2, sympy.sin(symbol)):
                expr = found.expr + sympy.Rational(1, 10**12 + k) * change
                if H.is_conserved(expr):
                    continue
                with pytest.raises(CertificationError, match="conserved is not proven"):
                    hamsym.verify(dataclasses.replace(found, expr=expr), H, checker="independent")


# -- data of another form -------------------------------------------------------------------------

INFINITE = ("9" * 5_000, "1e999999999")  # as float64 numbers
NONSENSE = (None, "x", *INFINITE, "1e-999999999", "-inf", [], {}, "missing")


def places(values, path=()):
    """Paths to all values in nested dicts and lists."""
    for key, value in values.items() if isinstance(values, dict) else enumerate(values):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def spoilt(values):
    """Data with each value in turn replaced by nonsense, or left out."""
    for *above, last in places(values):
        for value in NONSENSE:
            found = copy.deepcopy(values)
            place = found
            for key in above:
                place = place[key]
            if place[last] == value:
                continue
            if value == "missing":
                del place[last]
            else:
                place[last] = value
            yield (*above, last), value, found


CERTIFIED = {
    "solution": lambda: hamsym.solve(QUARTIC, [1.3, 1.0], (0, 0.3)),
    "orbit": ORBITS["quarter"],
    "flow map": lambda: hamsym.flow_map(
        "p**2/2 + x**2/2", {"x": (1, 1.1), "p": 0}, (0, 0.3), tol=1e-6
    ),
}


@pytest.mark.parametrize("kind", CERTIFIED)
def test_texts_of_another_form_are_refused(kind):
    """Though their checksum is right."""
    result = CERTIFIED[kind]()
    values = json.loads(result.certify().to_json())
    del values["sha256"]
    found = list(spoilt(values))
    assert len(found) > 100
    for _, _, claims in found:
        for checker in CHECKERS:
            with pytest.raises((CertificationError, FileError)):
                hamsym.verify(sealed(claims), result, checker=checker)


def assert_refused(check, found, loose=()):
    """Require that claims of another form are refused, and that nothing else is raised.

    - loose: Fields of upper bounds, which may be infinite.
    """
    assert len(found) > 10
    for path, value, claims in found:
        if path[0] in loose and value in INFINITE:
            continue
        with pytest.raises(NotProvenError):
            check(claims)


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.slow)])
def test_solutions_of_another_form_are_refused_by_the_checker_alone(every, case):
    data = data_of(*case)
    used = (*FIELDS, *LOWERS, "edges", "piece_bounds")
    found = [  # the first edge is zero, as 1e-999999999 is
        each for each in spoilt(data["claims"]) if each[0][0] in used and each[0] != ("edges", 0)
    ]
    assert len(found) > 150
    assert_refused(
        lambda claims: check_solution(**data | {"claims": claims}, check_time=lambda: None),
        found[::every],
        (*FIELDS, "piece_bounds"),
    )


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.slow)])
def test_orbits_of_another_form_are_refused_by_the_checker_alone(every, monkeypatch):
    orbit = ORBITS["quarter"]()
    whole = json.loads(orbit.certify().to_json())
    used = ("z0", "period", "bound", "unique_within", "monodromy", "stability", "pieces",
            "components")  # fmt: skip
    H, data, known = described(orbit.H), _orbit_data(orbit), []
    proven = _Orbit.proven

    def once(self, given, *rest):
        same = all(given.get(key) == whole[key] for key in ("z0", "period"))
        if not (same and known):
            known.append(proven(self, given, *rest))
        return known[-1]

    monkeypatch.setattr(_Orbit, "proven", once)
    check_orbit(H, data, whole, lambda: None)
    found = [each for each in spoilt(whole) if each[0][0] in used]
    assert len(found) > 150
    assert_refused(lambda claims: check_orbit(H, data, claims, lambda: None), found[::every])


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_flow_maps_of_another_form_are_refused_by_the_checker_alone(every, flow):
    flow, certificate, _ = flow
    H, data, whole = described(flow.H), _flow_data(flow), json.loads(certificate.to_json())
    found = [each for each in spoilt(whole) if each[0][0] in ("bound", "box")]
    assert_refused(lambda claims: check_flow_map(H, data, claims, lambda: None), found[::every])


def test_equilibria_of_another_form_are_refused_by_the_checker_alone():
    H = described(hamsym.Hamiltonian("(p - 1)**2/2 + (x - 1)**2/2 + (x - 1)**4"))
    whole = {"mid": [1.0, 1.0], "radius": [1e-9, 1e-9], "type": "centre", "stable": True,
             "definite": 1}  # fmt: skip
    check_equilibrium(H, whole)
    found = [  # a radius of 1e-999999999 counts as zero, and is true
        each for each in spoilt(whole) if each[0][0] != "radius" or each[1] != "1e-999999999"
    ]
    assert_refused(lambda claims: check_equilibrium(H, claims), found)


def test_invariants_of_another_form_are_refused_by_the_checker_alone():
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2")
    whole = {"H": described(H), "f": described_formula(0.1 * (H.q[0] * H.p[1] - H.q[1] * H.p[0]),
                                                       H.names)}  # fmt: skip

    def check(claims):
        check_invariant(claims["H"], [], claims["f"])

    check(whole)
    for path, value, claims in spoilt(whole):
        if path in (("H",), ("f",)) and value == "missing":
            continue
        try:
            check(claims)
        except NotProvenError:
            continue
        # Units do not matter, and a number is an invariant.
        assert path[:2] in (("H", "units"), ("f", "formula"), ("f", "floats")), (path, value)


def test_bounds_of_pieces_count_beside_infinite_ones():
    solution = hamsym.solve("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0], (0.0, 2.0), tol=1e-6)
    claims = solution.certify()
    pieces = tuple(0.0 for _ in claims.piece_bounds)
    forged = dataclasses.replace(claims, bound=math.inf, piece_bounds=pieces, lower=0.0)
    for checker in ("kernel", "independent"):
        with pytest.raises(CertificationError):
            hamsym.verify(forged.to_json(), solution, checker=checker)


def test_words_that_are_no_type_are_refused():
    H = hamsym.Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    found = hamsym.equilibria(H)[0]
    forged = dataclasses.replace(
        found, linear=dataclasses.replace(found.linear, type="SADDLE-centre")
    )
    with pytest.raises(CertificationError, match="words"):
        hamsym.verify(forged, H, checker="independent")


def test_checker_leaves_the_settings_of_arb_to_others():
    solution = hamsym.solve("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0], (0.0, 1.0), tol=1e-6)
    claims = solution.certify()
    before = ctx.prec, ctx.cap
    hamsym.verify(claims, solution, checker="independent")
    assert (ctx.prec, ctx.cap) == before
