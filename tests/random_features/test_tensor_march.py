"""The march in tensors, on the processor: against the compiled loop and exact solutions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from hamsym import Hamiltonian, InputError
from hamsym.codegen.functions import compile_expressions
from hamsym.codegen.generate import generate
from hamsym.codegen.system import load
from hamsym.random_features import tensor_members
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.members import Batch, MemberSolver
from hamsym.random_features.method import basis_for, checked_accuracy
from hamsym.random_features.options import FeatureOptions
from hamsym.random_features.tensor_members import TensorSolver
from hamsym.random_features.trial import FeatureTrial
from hamsym.systems import CATALOGUE

HENON_HEILES = CATALOGUE["henon_heiles"]().H
PENDULUM = Hamiltonian("p**2/2 - k*cos(x)", parameters={"k": 1})
OSCILLATOR = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1})


def _arguments(H: Hamiltonian, span: tuple[float, float], tol: float) -> tuple[Any, ...]:
    accuracy = checked_accuracy(FeatureOptions(tol=tol), span, H.dim)
    basis = basis_for(0, tol)
    return H, span, tol, accuracy.local, accuracy.absolute, accuracy.longest, basis


def _solved(
    H: Hamiltonian,
    states: Any,
    span: tuple[float, float],
    *,
    tol: float = 1e-9,
    parameters: Any = None,
    solver: type[MemberSolver] = TensorSolver,
    keep_error: bool = True,
) -> Batch:
    device = {"device": "cpu"} if solver is TensorSolver else {}
    values = [[H.parameters[name] for name in H.parameter_names]] * len(states)
    values = np.array(values if parameters is None else parameters, dtype=float)
    found = solver(*_arguments(H, span, tol), **device)
    return found.solve(np.asarray(states, dtype=float), values, keep_error=keep_error)


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


SHARES = np.linspace(0, 1, 13)


def _random(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, shape)


def _kepler(eccentricity: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(eccentricity)
    speed = np.sqrt((1 + eccentricity) / (1 - eccentricity))
    return np.stack([1 - eccentricity, zero, zero, speed], axis=1)


_CASES: dict[str, tuple[Hamiltonian, np.ndarray, tuple[float, float], float, Any]] = {
    "Henon-Heiles": (HENON_HEILES, _random(0, 200, 4) / 4, (0, 6 * math.pi), 1e-9, None),
    "loose, backwards": (HENON_HEILES, _random(1, 50, 4) / 4, (3, -15), 1e-5, None),
    "large basis": (HENON_HEILES, _random(2, 50, 4) / 4, (0, 20), 1e-11, None),
    "Kepler": (
        CATALOGUE["kepler"]().H,
        _kepler(np.linspace(0, 0.6, 50)),
        (0, 2 * math.pi),
        1e-9,
        None,
    ),
    "pendulums": (
        PENDULUM,
        _random(3, 100, 2) * [3, 0.2],
        (0, 20),
        1e-9,
        1.5 + _random(4, 100, 1),
    ),
    "driven": (
        Hamiltonian("p**2/2 + x**2/2 + x**4/4 - a*x*cos(w*t)", parameters={"a": 1, "w": 1}),
        _random(5, 60, 2),
        (2, 12),
        1e-9,
        1.5 + _random(6, 60, 2),
    ),
    "not separable": (CATALOGUE["double_pendulum"]().H, _random(7, 50, 4), (0, 4), 1e-9, None),
}


@pytest.mark.parametrize("name", _CASES)
def test_agrees_with_the_compiled_loop(name: str) -> None:
    H, states, span, tol, parameters = _CASES[name]
    ours, compiled = (
        _solved(H, states, span, tol=tol, parameters=parameters, solver=solver)
        for solver in (TensorSolver, MemberSolver)
    )
    assert compiled.accepted.all()
    assert ours.accepted.all()
    # Lengths of windows depend on residuals that are mostly round-off.
    assert ours.counts.sum() == pytest.approx(compiled.counts.sum(), rel=0.01)
    assert ours.evaluations.sum() == pytest.approx(compiled.evaluations.sum(), rel=0.02)
    basis = basis_for(0, tol)
    difference = np.abs(_values(ours, basis, SHARES) - _values(compiled, basis, SHARES))
    assert (difference.max(axis=1) <= ours.largest + compiled.largest).all()
    assert (difference.max(axis=1) <= 0.1 * tol * compiled.sizes).all()
    assert np.median(ours.excess / compiled.excess) == pytest.approx(1, rel=0.1)
    for field in Batch.__dataclass_fields__:
        one, other = getattr(ours, field), getattr(compiled, field)
        assert (one.dtype, one.shape[1:]) == (other.dtype, other.shape[1:]), field
    assert ours.series.shape[0] == ours.floors.shape[0] == len(ours.readouts)


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
    states, span = np.array([[1.0, -1 + 1e-9], [1.0, 0.5]]), (0.0, 17.0)
    loose = _solved(H, states, span, tol=1e-7)
    compiled = _solved(H, states, span, tol=1e-7, solver=MemberSolver)
    assert loose.accepted.all()
    assert compiled.accepted.all()
    # The evaluations of all marches are counted.
    assert loose.evaluations == pytest.approx(compiled.evaluations, rel=0.1)
    assert loose.evaluations[0] > 1.5 * loose.evaluations[1]
    a, b = (states[:, :1] + states[:, 1:] * [1, -1]).T[:, :, None] / 2
    t = SHARES * span[1]
    exact = np.stack([a * np.exp(t) + b * np.exp(-t), a * np.exp(t) - b * np.exp(-t)], -1)
    error = np.abs(_values(loose, basis_for(0, 1e-7), SHARES) - exact).max(axis=1)
    assert (error <= 1e-7 * np.abs(exact).max(axis=1)).all()


@pytest.mark.parametrize("solver", [TensorSolver, MemberSolver])
def test_errors_beside_a_pole_are_within_their_estimate(solver: type[MemberSolver]) -> None:
    # From the apocentre past two pericentres; where the first march is too coarse for an estimate,
    # a tighter one follows.
    e, tol = np.linspace(0.5, 0.9, 30)[:, None], 0.1
    anomaly = np.pi + np.linspace(0, 4.2 * np.pi, 2001)
    r, b = 1 - e * np.cos(anomaly), np.sqrt(1 - e**2)
    exact = np.stack(
        (np.cos(anomaly) - e, b * np.sin(anomaly), -np.sin(anomaly) / r, b * np.cos(anomaly) / r),
        axis=-1,
    )
    span = (0.0, 3.9 * np.pi)
    batch = _solved(CATALOGUE["kepler"]().H, exact[:, 0], span, tol=tol, solver=solver)
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
    assert batch.series.shape[0] == 0


def test_chunks_and_too_little_room(monkeypatch: pytest.MonkeyPatch) -> None:
    states = _random(0, 40, 4) / 4
    whole = _solved(HENON_HEILES, states, (0, 20), keep_error=False)
    sizes = iter([(40, 50), (7, 500), (20, 10), (1, 0), *[(19, 1000)] * 3])
    asked = []

    def limits(_: TensorSolver) -> tuple[int, float]:
        asked.append(next(sizes))
        return asked[-1]

    monkeypatch.setattr(TensorSolver, "_limits", limits)
    parts = _solved(HENON_HEILES, states, (0, 20), keep_error=False)
    # The first and the third chunk do not fit; a chunk of one member always does.
    assert [size for size, _ in asked] == [40, 7, 20, 1, 19, 19]
    assert parts.accepted.all()
    assert parts.series.shape[0] == parts.floors.shape[0] == 0
    basis = basis_for(0, 1e-9)
    difference = _values(parts, basis, SHARES) - _values(whole, basis, SHARES)
    assert np.abs(difference).max() < 1e-10


def test_room_of_a_chunk_shrinks_with_windows() -> None:
    solver = TensorSolver(*_arguments(HENON_HEILES, (0, 20), 1e-9), device="cpu")
    members, room = solver._limits()
    solver._windows *= 1000
    fewer, same = solver._limits()
    assert 1 <= fewer < members
    assert same == room >= members


@pytest.mark.parametrize("name", ["hessian", "force", "velocity"])
def test_rates_that_become_nan_refuse_the_member(name: str) -> None:
    solver = TensorSolver(*_arguments(HENON_HEILES, (0, 3), 1e-9), device="cpu")
    true = getattr(solver._functions, name)

    def late(states: Any, times: Any, parameters: Any, out: Any) -> None:
        true(states, times, parameters, out)
        if out.shape[1] == 2:
            out[:, 1] = torch.where(times[1] > 2.0, math.nan, out[:, 1])

    states = _random(0, 2, 4) / 4
    solver._functions = solver._functions._replace(**{name: late})
    batch = solver.solve(states, np.empty((2, 0)), keep_error=False)
    assert batch.accepted.tolist() == [True, False]


def test_jump_of_energy_refuses_members() -> None:
    solver = TensorSolver(*_arguments(HENON_HEILES, (0, 3), 1e-9), device="cpu")
    true = solver._functions.energy
    step = 1e-7

    def stepped(states: Any, times: Any, parameters: Any, out: Any) -> None:
        true(states, times, parameters, out)
        out[:, -1] += step  # at the end of the last member

    states = _random(0, 3, 4) / 4
    parameters = np.empty((3, 0))
    solver._functions = solver._functions._replace(energy=stepped)
    batch = solver.solve(states, parameters, keep_error=False)
    assert batch.accepted.tolist() == [True, True, False]
    step = math.nan
    batch = solver.solve(states, parameters, keep_error=False)
    assert batch.accepted.tolist() == [True, True, False]


def test_narrow_features_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + a*tanh(w*(x - 1/3))", parameters={"a": 1, "w": 1})
    states = np.array([[1.0, 0.0], [1.0, 0.0], [0.1, 0.0]])
    parameters = np.array([[0.1, 0.5], [1e-13, 1e7], [0.1, 0.5]])
    checked: list[np.ndarray] = []
    true = TensorSolver._passes

    def passes(solver: TensorSolver, windows: Any, suspects: Any, *rest: Any) -> bool:
        checked.append(suspects)
        return true(solver, windows, suspects, *rest)

    monkeypatch.setattr(TensorSolver, "_passes", passes)
    ours = _solved(H, states, (0, 10), parameters=parameters)
    compiled = _solved(H, states, (0, 10), parameters=parameters, solver=MemberSolver)
    assert ours.accepted.tolist() == compiled.accepted.tolist()
    assert checked
    assert all(len(suspects) for suspects in checked)


def test_a_step_between_the_nodes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    # Its force acts for too short a time for any sampled time to meet it.
    H = Hamiltonian("p**2/2 + a*tanh((x - 1/3)*1e9)", parameters={"a": 1e-3})
    ours = _solved(H, [[0.0, 1.0], [0.5, 1.0]], (0, 1))
    assert ours.accepted.tolist() == [False, True]
    monkeypatch.setattr(tensor_members, "keeps_energy", lambda *_: torch.ones(2) == 1)
    again = _solved(H, [[0.0, 1.0], [0.5, 1.0]], (0, 1))
    assert again.accepted.tolist() == [False, True]  # the place follows from the formula


@pytest.mark.parametrize("device", ["no such device", "cuda:99", 1.5, None, "meta:x"])
def test_unknown_device_is_refused(device: Any) -> None:
    with pytest.raises(InputError, match=r"device=.* cannot be used here; give"):
        TensorSolver(*_arguments(HENON_HEILES, (0, 1), 1e-9), device=device)


@pytest.mark.parametrize(
    "formula",
    [
        "px**2/2 + py**2/2 + k*x**2*y - exp(-y**2)*cos(a*t) + sqrt(a)",
        "p**2/2",
        "p*x**3/(1 + a*p**2) + abs(x)**a + tanh(x - k)*max(p, x) + erf(p)",
    ],
)
def test_rows_in_torch_equal_other_functions(formula: str) -> None:
    H = Hamiltonian(formula, **({"q": ["x"], "p": ["p"]} if formula == "p**2/2" else {}))
    values = {"a": 1.5, "k": 0.5}
    H = H.with_parameters(**{name: values[name] for name in H.parameter_names})
    system, plain = load(generate(H.kernels.equations, "torch")), H.compile("numpy")
    z, t = _random(0, 3, 5, H.dim), _random(1, 3, 5)
    parameters = torch.tensor([[[values[name]]] * 3 for name in H.parameter_names])
    rows, half = torch.tensor(np.moveaxis(z, -1, 0)), H.dof

    def found(name: str, count: int) -> np.ndarray:
        out = torch.full((count, 3, 5), math.nan, dtype=torch.float64)
        system.function(f"{name}_rows")(rows, torch.tensor(t), parameters.double(), out)
        return np.moveaxis(out.numpy(), 0, -1)

    rates = plain.vector_field(*plain.arguments(z, t))
    np.testing.assert_allclose(found("velocity", half), rates[..., :half], rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found("force", half), rates[..., half:], rtol=1e-14, atol=1e-15)
    energy = plain.energy(*plain.arguments(z, t))
    np.testing.assert_allclose(found("energy", 1)[..., 0], energy, rtol=1e-14, atol=1e-15)
    entries = [(i, j) for i, j in H.real_equations.hessian if i <= j]
    second = plain.hessian(*plain.arguments(z, t))
    expected = np.stack([second[..., i, j] for i, j in entries], -1)
    np.testing.assert_allclose(found("hessian", len(entries)), expected, rtol=1e-13, atol=1e-14)
    own = H.kernels.equations
    numbers = {symbol: values[name] for name, (symbol, _) in own.parameters.items()}
    narrow = [argument.subs(numbers) for argument, _ in own.narrow_arguments]
    if narrow:
        expected = compile_expressions(narrow, H.real_equations)(z, t)
        np.testing.assert_allclose(found("argument", len(narrow)), expected, rtol=1e-14)
