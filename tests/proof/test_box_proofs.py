"""Proofs of the error of flow maps over boxes."""

import copy
import dataclasses
import json

import mpmath
import numpy as np
import pytest

import hamsym
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.flow_maps.box import checked_box
from hamsym.flow_maps.compiled_piece import CompiledPiece
from hamsym.flow_maps.expansion import Chain, Split
from hamsym.proof.boxes import box_proof, carried_errors
from hamsym.proof.boxes.box_certificate import BoxCertificate
from hamsym.proof.boxes.tube import Flow

QUARTIC = "p**2/2 + x**2/2 + x**4/4"
HENON = "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3"


@pytest.fixture(scope="module")
def harmonic():
    return hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 1), tol=1e-8)


@pytest.fixture(scope="module")
def quartic():
    box = {"x": (1.29, 1.31), "p": (0.99, 1.01)}
    return hamsym.flow_map(QUARTIC, box, (0, 1), tol=1e-6)


@pytest.fixture(scope="module")
def certificate(quartic):
    return quartic.certify()


def turned(starts, times):
    """The exact motion of the harmonic oscillator."""
    x, p = np.asarray(starts).T
    cosine, sine = np.cos(times), np.sin(times)
    return np.stack((x * cosine + p * sine, p * cosine - x * sine), axis=-1)


def corrupted(flow, amount):
    """A map with one readout changed."""
    changed = copy.deepcopy(flow.map)
    piece = changed.pieces[0]
    readouts = piece.readouts.copy()
    readouts[0, 0] += amount
    changed.pieces[0] = CompiledPiece(piece.degrees, readouts, piece.columns)
    return dataclasses.replace(flow, map=changed)


@pytest.mark.parametrize("checker", ["kernel", "independent"])
def test_both_checkers_compare_what_users_evaluate(quartic, certificate, checker):
    # The compiled function keeps the numbers that it was made with.
    changed = corrupted(quartic, 1e-3)
    changed(0.5, [1.3, 1.0])
    changed.map.pieces[0].readouts = quartic.map.pieces[0].readouts
    with pytest.raises(CertificationError, match="the flow map at t = "):
        hamsym.verify(certificate, changed, checker=checker)


def test_bound_contains_error_of_harmonic_map(harmonic):
    found = harmonic.certify()
    random = np.random.default_rng(1)
    starts, times = random.uniform((1, -1), (2, 1), (1_000, 2)), random.uniform(0, 1, 1_000)
    error = np.abs(harmonic(times, starts) - turned(starts, times)).max(axis=0)
    assert (error <= np.array(found.bound) + 4e-15).all()
    assert max(found.bound) < 1e-9


@pytest.mark.slow
def test_bound_contains_error_at_random_points(quartic, certificate):
    random = np.random.default_rng(2)
    starts = random.uniform((1.29, 0.99), (1.31, 1.01), (20, 2))
    times = np.linspace(0, 1, 51)[1:]
    largest = np.zeros(2)
    with mpmath.workdps(25):
        for start in starts:
            exact = mpmath.odefun(
                lambda _, z: [z[1], -z[0] - z[0] ** 3], 0, [mpmath.mpf(v) for v in start], tol=1e-18
            )
            states = np.array([[float(value) for value in exact(float(t))] for t in times])
            largest = np.maximum(largest, np.abs(quartic(times, start) - states).max(axis=0))
    bound = np.array(certificate.bound)
    assert (largest <= bound).all()
    assert (bound <= 20 * np.maximum(largest, 1e-8)).all()


@pytest.mark.slow
def test_bound_is_near_the_estimate(quartic, certificate):
    assert (np.array(certificate.bound) <= 3 * quartic.largest_error + 3e-8).all()


@pytest.mark.slow
def test_corrupted_map_has_a_larger_bound(quartic, certificate):
    wrong = corrupted(quartic, 1e-3 * np.abs(quartic.map.pieces[0].readouts).max())
    random = np.random.default_rng(3)
    starts, times = random.uniform((1.29, 0.99), (1.31, 1.01), (500, 2)), random.uniform(0, 1, 500)
    change = np.abs(wrong(times, starts) - quartic(times, starts)).max(axis=0)
    bound = np.array(wrong.certify().bound)
    assert (bound > 2 * np.array(certificate.bound)).any()
    assert (bound >= change - np.array(certificate.bound)).all()


@pytest.mark.slow
def test_map_far_from_the_solution_is_refused(quartic):
    wrong = corrupted(quartic, 1e3 * np.abs(quartic.map.pieces[0].readouts).max())
    with pytest.raises(CertificationError, match=r"no bound beyond t = .*; give a smaller box"):
        wrong.certify(max_parts=4)


@pytest.mark.slow
def test_henon_heiles_box_of_four_inputs():
    middle = {"x": 0.1, "y": 0.2, "p_x": 0.3, "p_y": 0.1}
    box = {name: (value - 0.02, value + 0.02) for name, value in middle.items()}
    flow = hamsym.flow_map(HENON, box, (0, 4), tol=1e-6)
    found = flow.certify()
    bound = np.array(found.bound)
    random = np.random.default_rng(4)
    starts = random.uniform(*np.array(list(box.values())).T, (40, 4))
    exact = hamsym.solve_many(HENON, starts, (0, 4), tol=1e-11, progress=False)
    times = np.linspace(0, 4, 40)
    for start, states in zip(starts, exact(times), strict=True):
        assert (np.abs(flow(times, start) - states).max(axis=0) <= bound + 1e-10).all()
    assert bound.max() < 5e-7
    assert found.parts < 50


@pytest.mark.slow
def test_parameters_are_inputs():
    H, box = "p**2/2 + k*x**2/2", {"x": (1, 1.1), "p": 0}
    flow = hamsym.flow_map(H, box, (0, 1), {"k": (1, 1.2)}, tol=1e-7)
    found = flow.certify()
    random = np.random.default_rng(5)
    x, k, t = random.uniform((1, 1, 0), (1.1, 1.2, 1), (1_000, 3)).T
    omega = np.sqrt(k)
    exact = np.stack((x * np.cos(omega * t), -x * omega * np.sin(omega * t)), axis=-1)
    error = np.abs(flow(t, {"x": x}, {"k": k}) - exact).max(axis=0)
    assert (error <= np.array(found.bound) + 4e-15).all()
    assert max(found.bound) < 1e-7


@pytest.mark.slow
def test_expressions_time_and_roots_have_models():
    z0 = {"x": "1 - e", "y": 0, "p_x": 0, "p_y": "sqrt((1 + e)/(1 - e))"}
    H = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
    flow = hamsym.flow_map(H, z0, (0, 0.5), {"e": (0.1, 0.12)}, tol=1e-7)
    found = flow.certify()
    assert max(found.bound) < 1e-7
    assert "p_y = sqrt((1 + e)/(1 - e))" in found.statement
    driven = hamsym.flow_map("p**2/2 - cos(x) - x*sin(t)", {"x": (0, 0.1), "p": 0}, (1, 0.5))
    assert max(driven.certify().bound) < 1e-5


def springs(starts, stiffness, times):
    """The exact motion with H = p^2/2 + k x^2/2."""
    (x, p), omega = np.asarray(starts).T, np.sqrt(stiffness)
    cosine, sine = np.cos(omega * times), np.sin(omega * times)
    return np.stack((x * cosine + p * sine / omega, p * cosine - omega * x * sine), axis=-1)


def quartic_motion(start, times):
    """The exact motion with H = p^2/2 + x^2/2 + x^4/4, in 40 digits."""
    with mpmath.workdps(40):
        x, p = map(mpmath.mpf, start)
        square = mpmath.sqrt(1 + 2 * p**2 + 2 * x**2 + x**4) - 1
        A, rate, m = mpmath.sqrt(square), mpmath.sqrt(1 + square), square / (2 * (1 + square))
        phase = -mpmath.sign(p) * mpmath.ellipf(mpmath.acos(x / A), m)
        found = []
        for t in times.tolist():
            u = rate * t + phase
            sn, cn, dn = (mpmath.ellipfun(name, u, m=m) for name in ("sn", "cn", "dn"))
            found.append((float(A * cn), float(-A * rate * sn * dn)))
    return np.array(found)


def errors_at_random(flow, exact, count=1_000):
    """The largest errors of a map with the inputs x and p, and perhaps k, at random points."""
    random = np.random.default_rng(6)
    inputs = random.uniform(flow.region.low, flow.region.high, (count, len(flow.inputs)))
    times = random.uniform(*sorted(flow.span), count)
    given = {name: inputs[:, 2 + i] for i, name in enumerate(flow.region.parameters)}
    states = flow(times, inputs[:, :2], given)
    return np.abs(states - exact(inputs[:, :2], *given.values(), times)).max(axis=0)


@pytest.fixture(scope="module")
def chain():
    """Two legs."""
    first = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 1.1), "p": (0, 0.1)}, (0, 1), tol=1e-7)
    image = {"x": (0.5, 0.7), "p": (-1, -0.7)}
    second = hamsym.flow_map("p**2/2 + x**2/2", image, (1, 2), tol=1e-7)
    legs = Chain([first.map, second.map], np.array([1.0]), np.array([], dtype=int))
    return dataclasses.replace(first, map=legs, span=(0.0, 2.0))


def with_sides(flow, change):
    """A chain whose second leg is split along a slanted plane, and changed on its upper side."""
    first, second = flow.map.maps
    split = Split(np.array([1.0, 0.5]), 0.2, second, change(second))
    return dataclasses.replace(flow, map=Chain([first, split], flow.map.joints, flow.map.kept))


def shifted(leg, amount):
    changed = copy.deepcopy(leg)
    changed.offset = changed.offset + amount
    return changed


@pytest.mark.slow
def test_split_maps_are_proven_part_by_part(harmonic):
    split = Split(np.array([-2.0, 0.0]), -3.0, harmonic.map, harmonic.map)
    whole = harmonic.certify().bound
    halves = dataclasses.replace(harmonic, map=split).certify()
    assert halves.parts == 2
    assert np.allclose(halves.bound, whole, rtol=0, atol=1e-10)
    plane = Split(np.array([1.0, 1.0]), 1.6, split.low, split.high)
    slanted = dataclasses.replace(harmonic, map=plane).certify()
    assert np.allclose(slanted.bound, whole, rtol=0, atol=1e-10)


def test_chains_of_legs_are_proven(chain):
    found = chain.certify()
    error = errors_at_random(chain, turned)
    assert (error <= np.array(found.bound) + 4e-15).all()
    assert max(found.bound) < 1e-7


def test_changes_between_legs_are_errors(chain, monkeypatch):
    first, second = chain.map.maps
    legs = Chain([first, shifted(second, 1e-6)], chain.map.joints, chain.map.kept)
    wrong = dataclasses.replace(chain, map=legs)
    with pytest.raises(CertificationError, match="the flow map at t = 1.0 "):
        wrong.certify()
    monkeypatch.setattr(box_proof, "check_map", lambda *_: None)
    bound = np.array(wrong.certify().bound)
    assert (errors_at_random(wrong, turned) <= bound + 4e-15).all()
    assert (bound > 1e-6).all()


def test_errors_pass_from_leg_to_leg_once(chain, monkeypatch):
    # Where M has become the identity in the last step of a leg already, that is not done again.
    first, second = chain.map.maps
    changed = copy.deepcopy(first)
    own = changed.pieces[-1]
    changed.pieces[-1] = CompiledPiece(own.degrees, 1.001 * own.readouts, own.columns)
    legs = Chain([changed, second], chain.map.joints, chain.map.kept)
    wrong = dataclasses.replace(chain, map=legs)
    usual = wrong.certify().bound
    monkeypatch.setattr(carried_errors, "_LARGE", 0.0)
    bound = wrong.certify().bound
    assert np.allclose(bound, usual, rtol=1e-3)
    error = errors_at_random(wrong, turned)
    assert (error <= np.array(bound)).all()
    assert (error > 0.5 * np.array(bound)).any()


@pytest.mark.slow
def test_both_sides_of_a_split_after_a_leg_are_proven(chain, monkeypatch):
    same = with_sides(chain, lambda leg: leg).certify()
    assert np.allclose(same.bound, chain.certify().bound, rtol=0, atol=1e-9)
    monkeypatch.setattr(box_proof, "check_map", lambda *_: None)
    wrong = with_sides(chain, lambda leg: shifted(leg, 1e-6))
    bound = np.array(wrong.certify().bound)
    error = errors_at_random(wrong, turned)
    assert (error > 1e-6).all()
    assert (error <= bound + 4e-15).all()
    far = with_sides(chain, lambda leg: leg)
    far.map.maps[1].threshold = 5.0  # above which no state is
    far.map.maps[1].high = shifted(far.map.maps[1].high, 1.0)
    assert far.certify().bound == pytest.approx(chain.certify().bound, rel=1e-6)


@pytest.mark.slow
def test_chains_keep_parameters():
    H, stiffness = "p**2/2 + k*x**2/2", {"k": (1, 1.2)}
    first = hamsym.flow_map(H, {"x": (1, 1.1), "p": (0, 0.1)}, (0, 1), stiffness, tol=1e-7)
    image = {"x": (0.4, 0.7), "p": (-1.1, -0.7)}
    second = hamsym.flow_map(H, image, (1, 2), stiffness, tol=1e-7)
    legs = Chain([first.map, second.map], np.array([1.0]), np.array([2]))
    flow = dataclasses.replace(first, map=legs, span=(0.0, 2.0))
    bound = np.array(flow.certify().bound)
    assert (errors_at_random(flow, springs) <= bound + 4e-15).all()
    assert max(bound) < 1e-7


@pytest.mark.slow
def test_forged_certificates_of_chains_and_splits_are_refused(chain):
    for flow in (chain, with_sides(chain, lambda leg: leg)):
        found = flow.certify()
        hamsym.verify(found, flow)
        smaller = dataclasses.replace(found, bound=(found.bound[0], 0.9 * found.bound[1]))
        with pytest.raises(CertificationError, match="the bound of p, .*, is not proven"):
            hamsym.verify(smaller, flow)
    with pytest.raises(CertificationError, match="SHA-256 mismatch"):
        hamsym.verify(chain.certify(), with_sides(chain, lambda leg: leg))


@pytest.mark.slow
def test_wide_box_is_proven_over_a_period():
    box = {"x": (1.0, 1.6), "p": (0.7, 1.3)}
    flow = hamsym.flow_map(QUARTIC, box, (0, 2 * np.pi), tol=1e-6)
    bound = np.array(flow.certify().bound)
    random = np.random.default_rng(7)
    times = np.linspace(0, flow.span[1], 60)
    starts = random.uniform((1.0, 0.7), (1.6, 1.3), (30, 2))
    for start in starts:
        assert (np.abs(flow(times, start) - quartic_motion(start, times)) <= bound + 1e-14).all()
    assert (bound <= 2 * flow.largest_error).all()


@pytest.mark.slow
def test_cells_at_a_singular_expression_are_halved():
    """The model of the root has no value over the whole interval."""
    H = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
    z0 = {"x": "1 - e", "y": 0, "p_x": 0, "p_y": "sqrt((1 + e)/(1 - e))"}
    flow = hamsym.flow_map(H, z0, (0, 0.2), {"e": (0, 0.6)}, tol=1e-6)
    assert max(flow.certify().bound) < 1e-5


def test_part_of_the_box_can_be_certified(quartic, certificate):
    part = quartic.certify(box={"x": (1.3, 1.301)})
    assert part.box == {"x": (1.3, 1.301), "p": (0.99, 1.01)}
    assert (np.array(part.bound) <= np.array(certificate.bound) + 1e-8).all()


def test_certificate_survives_json(certificate):
    text = certificate.to_json()
    assert BoxCertificate.from_json(text) == certificate
    values = json.loads(text)
    for name, value in (("bound", [0.0, 0.0]), ("digest", "0"), ("kind", "x"), ("span", [0.0])):
        with pytest.raises(FileError, match="not a certificate of a flow map"):
            BoxCertificate.from_json(json.dumps({**values, name: value}))


def test_statement_names_box_span_and_bound(certificate):
    assert certificate.statement.startswith(
        "Proven: for every x from 1.29 to 1.31 and every p from 0.99 to 1.01 and every t from 0.0 "
        "to 1.0, |x^(t) - x(t)| <= "
    )


def test_unusable_arguments_are_rejected(quartic):
    for box, text in (
        ({"x": (1.2, 1.3)}, "within that of the map"),
        ({"y": (0, 1)}, "'y' does not vary"),
        ({"x": 1.3}, r"give an interval \(low, high\)"),
        (3, "not a mapping"),
    ):
        with pytest.raises(InputError, match=text):
            quartic.certify(box=box)
    with pytest.raises(InputError, match="max_parts"):
        quartic.certify(max_parts=0)
    with pytest.raises(InputError, match="not options for a flow map"):
        hamsym.certify(quartic, bound=1.0)
    with pytest.raises(CertificationError, match="time limit"):
        quartic.certify(time_limit=1e-3)


def test_kinks_are_refused():
    box = checked_box("p**2/2 + abs(x)", {"x": (2, 2.1), "p": 0}, None)
    with pytest.raises(CertificationError, match="'abs'"):
        Flow(box.H, [])
