"""The solver of members, against exact solutions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian
from hamsym.kernel.loops import Equations
from hamsym.random_features import members
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.members import Batch, MemberSolver, basis_for, checked_accuracy
from hamsym.random_features.trial import FeatureTrial
from hamsym.systems import CATALOGUE
from tests.kernel.row_functions import RowProgram

HENON_HEILES = CATALOGUE["henon_heiles"]().H
OSCILLATOR = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1})
SHARES = np.linspace(0, 1, 13)


@pytest.mark.parametrize(
    ("change", "slope", "kept"),
    [
        (1e-12, 1.0, True),
        (1e-6, 1.0, False),
        (0.0, np.inf, False),
        (0.0, np.nan, False),
        (np.nan, 1.0, False),
    ],
)
def test_energy_is_kept_only_within_a_finite_limit(change: float, slope: float, kept: bool) -> None:
    """The solver judges by the H, the velocity and the force that it is given."""
    checking = False

    def velocity(z: np.ndarray, t: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
        out[0] = z[1] * (slope if checking else 1.0)

    def energy(z: np.ndarray, t: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
        nonlocal checking
        checking = True
        out[0] = (z**2).sum(axis=0) / 2 + change * t

    flow = flow_of(OSCILLATOR)
    given = Equations(
        dim=2,
        separable=1,
        velocity=RowProgram(2, 1, 1, velocity),
        force=flow.programs["force"],
        hessian=flow.programs["hessian"],
        energy=RowProgram(2, 1, 1, energy),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(members, "flow_of", lambda H: replace(flow, programs=given))
        assert _solved(OSCILLATOR, [[1.0, 0.5]], (0, 2)).accepted.tolist() == [kept]
    assert checking


def _random(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, shape)


def _solved(
    H: Hamiltonian,
    states: Any,
    span: tuple[float, float],
    *,
    tol: float = 1e-9,
    parameters: Any = None,
) -> Batch:
    accuracy = checked_accuracy(tol, 0.0, None, span, H.dim)
    values = [[H.parameters[name] for name in H.parameter_names]] * len(states)
    values = np.array(values if parameters is None else parameters, dtype=float)
    solver = MemberSolver(H, span, accuracy, basis_for(0, tol))
    return solver.solve(np.asarray(states, dtype=float), values)


def _members(batch: Batch) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Edges, states and readouts of each member; empty where it was not accepted."""
    edge = window = 0
    for count in batch.counts.tolist():
        edges = slice(edge, edge + count + 1 if count else edge)
        yield batch.edges[edges], batch.states[edges], batch.readouts[window : window + count]
        edge, window = edges.stop, window + count
    assert edge == len(batch.edges) == len(batch.states)
    assert window == len(batch.readouts)


def _values(batch: Batch, basis: FeatureBasis, shares: np.ndarray) -> np.ndarray:
    """States of all members at shares of the span, shape (members, times, dim); NaN without."""
    out = np.full((len(batch.counts), len(shares), batch.sizes.shape[1]), np.nan)
    for values, (edges, states, readouts) in zip(out, _members(batch), strict=True):
        if len(edges):
            t = edges[0] + shares * (edges[-1] - edges[0])
            direction = np.sign(edges[-1] - edges[0])
            window = np.searchsorted(direction * edges, direction * t, side="right") - 1
            window = window.clip(0, len(readouts) - 1)
            columns = basis.columns((t - edges[window]) / np.diff(edges)[window])[0]
            values[:] = states[window] + np.einsum("tm,tmd->td", columns, readouts[window])
    return out


def test_oscillators_follow_exact_solution() -> None:
    frequency = np.linspace(0.3, 3, 40)
    start, span = _random(0, 40, 2), (0.0, 30.0)
    batch = _solved(OSCILLATOR, start, span, parameters=frequency[:, None] ** 2)
    assert batch.accepted.all()
    t, (x, p) = SHARES * span[1], start.T[:, :, None]
    w = frequency[:, None]
    exact = np.stack(
        [x * np.cos(w * t) + p / w * np.sin(w * t), p * np.cos(w * t) - w * x * np.sin(w * t)], -1
    )
    error = np.abs(_values(batch, basis_for(0, 1e-9), SHARES) - exact).max(axis=1)
    assert (error <= batch.largest + 1e-14).all()
    assert (batch.largest <= 1e-9 * batch.sizes).all()
    assert batch.excess == pytest.approx((batch.largest / (1e-9 * batch.sizes)).max(axis=1))


def test_tightens_where_errors_grow() -> None:
    # Along the stable direction, away from which errors grow like e^t.
    H = Hamiltonian("p**2/2 - x**2/2")
    states, span = np.array([[1.0, -1 + 1e-9], [1.0, 0.5]]), (0.0, 19.0)
    loose = _solved(H, states, span, tol=1e-7)
    assert loose.accepted.all()
    # The evaluations of all marches are counted.
    assert loose.evaluations[0] > 1.5 * loose.evaluations[1]
    a, b = (states[:, :1] + states[:, 1:] * [1, -1]).T[:, :, None] / 2
    t = SHARES * span[1]
    exact = np.stack([a * np.exp(t) + b * np.exp(-t), a * np.exp(t) - b * np.exp(-t)], -1)
    error = np.abs(_values(loose, basis_for(0, 1e-7), SHARES) - exact).max(axis=1)
    assert (error <= 1e-7 * np.abs(exact).max(axis=1)).all()


def test_errors_beside_a_pole_are_within_their_estimate() -> None:
    # From the apocentre past two pericentres; where the first march is too coarse for an estimate,
    # a tighter one follows.
    e, tol = np.linspace(0.5, 0.9, 60)[:, None], 0.1
    anomaly = np.pi + np.linspace(0, 4.2 * np.pi, 2001)
    r, b = 1 - e * np.cos(anomaly), np.sqrt(1 - e**2)
    exact = np.stack(
        (np.cos(anomaly) - e, b * np.sin(anomaly), -np.sin(anomaly) / r, b * np.cos(anomaly) / r),
        axis=-1,
    )
    span = (0.0, 3.9 * np.pi)
    batch = _solved(CATALOGUE["kepler"]().H, exact[:, 0], span, tol=tol)
    assert batch.accepted.mean() > 0.5
    allowed = tol * np.abs(exact).max(axis=1)
    assert (batch.largest[batch.accepted] <= allowed[batch.accepted]).all()
    series = basis_for(0, tol).series
    for k, windows in enumerate(_members(batch)):
        if not batch.accepted[k]:
            continue
        times = anomaly - e[k] * np.sin(anomaly) - np.pi
        some = times <= span[1]
        path = FeatureTrial(*windows, series, np.array(0.0))
        errors = np.abs(path.states_at(times[some]) - exact[k, some])
        assert (errors <= allowed[k]).all()
        assert (errors.max(axis=0) <= 1.02 * batch.largest[k]).all()


def test_bad_members_leave_others_alone() -> None:
    good = _random(0, 6, 4) / 4
    bad = np.array([[np.nan, 0, 0, 0], [0, 2, 0, 0.5], [np.inf, 0, 0, 0], [1e200, 1, 1, 1]])
    order = np.array([0, 6, 1, 2, 7, 3, 8, 4, 9, 5])
    mixed = _solved(HENON_HEILES, np.concatenate((good, bad))[order], (0, 20))
    alone = _solved(HENON_HEILES, good, (0, 20))
    assert mixed.accepted.tolist() == (order < 6).tolist()
    assert (mixed.counts > 0).tolist() == (order < 6).tolist()
    assert np.isinf(mixed.excess[order >= 6]).all()
    basis = basis_for(0, 1e-9)
    values, others = _values(mixed, basis, SHARES)[order < 6], _values(alone, basis, SHARES)
    assert np.abs(values - others).max() < 1e-10


def test_no_member_of_a_bad_batch_is_accepted() -> None:
    batch = _solved(HENON_HEILES, [[0, 2, 0, 0.5], [np.nan] * 4], (0, 20))
    assert not batch.accepted.any()
    assert batch.edges.shape == (0,)
    assert batch.states.shape == (0, 4)
    assert batch.readouts.shape == (0, basis_for(0, 1e-9).series.shape[1], 4)


def test_solutions_of_one_member_do_not_share_memory() -> None:
    """In threads, and where the next ones are longer and shorter."""
    starts, ends = _random(0, 12, 4) / 4, [20, 300, 5] * 4

    def solved(k: int) -> list[bytes]:
        found = hamsym.solve(HENON_HEILES, starts[k], (0, ends[k]))
        kept = found.record.states, found.record.readouts, found.error.series, found.error.largest
        hamsym.solve(HENON_HEILES, starts[k - 1], (0, ends[k - 1]))
        return [array.tobytes() for array in kept]

    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(solved, range(12)))
    members._SPARE.clear()
    for k, arrays in enumerate(together):
        assert arrays == solved(k)
        batch = _solved(HENON_HEILES, starts[k : k + 1], (0, ends[k]))
        assert arrays[:2] == [batch.states.tobytes(), batch.readouts.tobytes()]


def test_a_step_between_the_nodes_is_refused() -> None:
    # Its force acts for too short a time for any sampled time to meet it.
    H = Hamiltonian("p**2/2 + a*tanh((x - 1/3)*1e9)", parameters={"a": 1e-3})
    assert _solved(H, [[0.0, 1.0], [0.5, 1.0]], (0, 1)).accepted.tolist() == [False, True]


def test_weak_pulses_between_the_places_are_met() -> None:
    """Each changes the momentum by 18 times the tolerance; members may be left out."""
    width, peak = 1e-3, 1e-5
    formula = f"p**2/2 + x**2/2 - x*{peak}*exp(-((t - c)/{width})**2)"
    H = Hamiltonian(formula, parameters={"c": 1.0})
    places = np.random.default_rng(0).uniform(0.1, 9.9, 100)
    batch = _solved(H, [[1.0, 0.0]] * 100, (0, 10), parameters=places[:, None])
    kick = peak * width * math.sqrt(math.pi)
    for place, (_, states, _) in zip(places, _members(batch), strict=True):
        if len(states):
            exact = [
                math.cos(10) + kick * math.sin(10 - place),
                -math.sin(10) + kick * math.cos(10 - place),
            ]
            assert np.abs(states[-1] - exact).max() < 1.1e-9
