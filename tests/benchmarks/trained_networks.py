"""Networks trained to a tolerance by Levenberg-Marquardt: success, true error and CPU seconds.

The reference is a Taylor series of order 34 in arithmetic of 128 bits (:mod:`tests.audit.taylor`)
at 200 times of the span. An error is the largest one of any component, each relative to the
largest value of that component.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from flint import arb

import hamsym
from hamsym import LevenbergMarquardt, NetworkChain, systems
from hamsym.support.method_object import Method
from hamsym.support.records import packed
from tests.audit.taylor import Equations, Orbit, integrate

from . import markdown
from .measuring import cpu, median
from .results import Section

_TIMES = 200
_LIMIT = 60.0  # seconds of a call
_ITERATIONS = 200  # of joint training

_TOLERANCE, _ONE, _UNITS, _ABLATION = "tolerance", "one network", "units", "ablation"
_CAPTIONS = {
    _TOLERANCE: "Chains of networks with the default options.",
    _ONE: "One network over the whole span.",
    _UNITS: "Small and large units.",
    _ABLATION: f"What the training consists of; joint training takes {_ITERATIONS} iterations.",
}


@dataclass(frozen=True)
class _Case:
    """An initial-value problem from t = 0."""

    label: str
    H: hamsym.Hamiltonian
    z0: Sequence[float]
    end: float

    @classmethod
    def of(cls, label: str, problem: systems.Problem, end: float) -> _Case:
        return cls(label, problem.H, problem.z0, end)

    @property
    def times(self) -> np.ndarray:
        return np.linspace(0.0, self.end, _TIMES)

    @functools.cached_property
    def truth(self) -> Orbit:
        names, half = self.H.names, self.H.dof
        equations = Equations(
            str(self.H), names[:half], names[half:], dict(self.H.parameters or {})
        )
        return integrate(equations, list(self.z0), 0.0, self.times.tolist())

    def solve(self, tol: float, method: Method, seed: int = 0) -> hamsym.Solution:
        return hamsym.solve(
            self.H, self.z0, (0.0, self.end), tol=tol, method=method, seed=seed, progress=False
        )

    def error(self, solution: hamsym.Solution) -> float | None:
        """Return the true error relative to the sizes; none if the solution ends too early."""
        if solution.span[1] != self.end:
            return None
        found = solution(self.times)
        if not np.isfinite(found).all():
            return None
        # Balls subtract exactly: the truth has more digits than float64.
        errors = [
            [abs(float(arb(float(value)) - exact)) for value, exact in zip(*pair, strict=True)]
            for pair in zip(found, self.truth.states, strict=True)
        ]
        return float((np.max(errors, axis=0) / self.truth.scales).max())


@dataclass(frozen=True)
class _Training:
    """A row of a table: a case, the words for its method, and the tolerance that is asked for."""

    table: str
    case: _Case
    words: str
    method: Method
    tol: float = 1e-9


def _paper() -> tuple[_Case, _Case]:
    return (
        _Case.of("oscillator, 4 pi", systems.nonlinear_oscillator(), 4 * math.pi),
        _Case.of("Henon-Heiles, 6 pi", systems.henon_heiles(), 6 * math.pi),
    )


def _to_tolerance() -> Iterator[_Case]:
    oscillator, henon = systems.nonlinear_oscillator(), systems.henon_heiles()
    driven, double = systems.driven_oscillator(), systems.double_pendulum()
    saddle = hamsym.Hamiltonian("p**2/2 - x**2/2")
    paper = _paper()
    yield paper[0]
    yield _Case.of("oscillator, 20 pi", oscillator, 20 * math.pi)
    yield _Case.of("oscillator, 100 pi", oscillator, 100 * math.pi)
    yield paper[1]
    yield _Case.of("Henon-Heiles, 12 pi", henon, 12 * math.pi)
    yield _Case.of("Henon-Heiles, t = 300", henon, 300.0)
    yield _Case.of("Kepler e = 0.3, 1 period", systems.kepler(0.3), 2 * math.pi)
    yield _Case.of("Kepler e = 0.6, 2 periods", systems.kepler(0.6), 4 * math.pi)
    yield _Case("saddle, t = 10", saddle, (1.0, -0.5), 10.0)
    yield _Case.of("driven oscillator, 8 pi", driven, driven.span[1])
    yield _Case.of("double pendulum, t = 20", double, double.span[1])


def _in_units() -> Iterator[_Case]:
    end = 4 * math.pi
    linear = hamsym.Hamiltonian("p**2/2 + x**2/2")
    mixed = hamsym.Hamiltonian("p**2/(2*m) + m*x**2/2", parameters={"m": 1e15})
    for unit in (1e-9, 1e6):
        yield _Case(f"linear, {unit:.0e}", linear, (unit, 0.5 * unit), end)
    yield _Case("linear, x 1e-09, p 1e+06", mixed, (1e-9, 0.5e6), end)
    for unit in (1e-9, 1e6):
        scaled = hamsym.Hamiltonian("p**2/2 + x**2/2 + k*x**4/4", parameters={"k": unit**-2})
        yield _Case(f"oscillator, {unit:.0e}", scaled, (1.3 * unit, unit), end)
    # From 1e6 the frequency is 1e6 times larger too, and p is a million times x.
    quartic = hamsym.Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    yield _Case("oscillator, x 1e+06, t = 1e-05", quartic, (1.3e6, 1e12), 1e-5)


def _trainings(quick: bool) -> Iterator[_Training]:
    if quick:
        case = replace(_paper()[0], end=1.0)
        yield _Training(_TOLERANCE, case, "chain", NetworkChain(), 1e-6)
        yield _Training(_ONE, case, "one network", NetworkChain(windows=1), 1e-6)
        yield _Training(_UNITS, next(_in_units()), "chain", NetworkChain(), 1e-6)
        small = LevenbergMarquardt(hidden=(10,), points=20, iterations=20)
        yield _Training(_ABLATION, case, "joint, 10", small, 1e-3)
        return
    chain = NetworkChain(time_limit=_LIMIT)
    for case in _to_tolerance():
        yield _Training(_TOLERANCE, case, "chain", chain)
    for case in _paper():
        yield _Training(_ONE, case, "one network, tol 1e-11", replace(chain, windows=1), 1e-11)
    for case in _in_units():
        yield _Training(_UNITS, case, "chain", chain)
    kinds: dict[str, Method] = {
        "chain": NetworkChain(),
        "chain, readouts only": NetworkChain(train_hidden=False),
        "one network": NetworkChain(windows=1),
        "joint, all weights": LevenbergMarquardt(iterations=_ITERATIONS),
    }
    for case in _paper():
        for words, kind in kinds.items():
            yield _Training(_ABLATION, case, words, kind)


def measure(quick: bool) -> Section:
    rows, certificates = [], []
    ready: set[str] = set()
    for training in _trainings(quick):
        case = training.case
        if case.label not in ready:
            # The first call generates the code of H.
            replace(case, end=case.end / 20).solve(1e-3, NetworkChain())
            ready.add(case.label)
        count = 1 if quick else 3 if training.table == _ABLATION else 5
        row, first = _row(training, count)
        rows.append(row)
        print(row, flush=True)
        if training.table == _ONE and first is not None:
            certificates.append({"problem": case.label, **_certificate(first)})
    return {"rows": rows, "certificates": certificates}


def _row(training: _Training, count: int) -> tuple[dict[str, Any], hamsym.Solution | None]:
    """Train from each seed; return the row and the solution of the first seed."""
    first = None
    row: dict[str, Any] = {
        "table": training.table,
        "problem": training.case.label,
        "training": training.words,
        "tol": training.tol,
        **{name: [] for name in ("success", "networks", "neurons", "hidden_steps")},
        **{name: [] for name in ("error", "cpu")},
    }
    for seed in range(count):
        used, found = cpu(functools.partial(_attempt, training, seed))
        row["cpu"].append(round(used, 4))
        row["success"].append(found is not None and found.success)
        if found is None:
            row["error"].append(None)
            continue
        first = found if seed == 0 else first
        record, form = found.record, packed(found.trial)[1]
        pieces = form.get("pieces", [form])
        row["networks"].append(len(pieces))
        row["neurons"].append(max(int(piece["sizes"][-2]) for piece in pieces))
        # Every iteration of a joint training changes all weights.
        steps = getattr(record, "hidden_steps", record.iterations)
        row["hidden_steps"].append(int(np.sum(steps)))
        row["error"].append(training.case.error(found))
    return row, first


def _attempt(training: _Training, seed: int) -> hamsym.Solution | None:
    try:
        return training.case.solve(training.tol, training.method, seed)
    except hamsym.InputError as refusal:
        print(f"{training.case.label}, {training.words}, seed {seed}: {refusal}", flush=True)
        return None


def _certificate(solution: hamsym.Solution) -> dict[str, Any]:
    try:
        used, found = cpu(solution.certify)
    except hamsym.CertificationError as refusal:
        return {"refusal": str(refusal)}
    return {"bound": found.bound, "lower": found.lower, "cpu": used}


def table(section: Section) -> str:
    parts = []
    for kind, caption in _CAPTIONS.items():
        chosen = [row for row in section["rows"] if row["table"] == kind]
        head = ["problem", "training", "success", "networks", "neurons", "true error", "errors"]
        head += ["CPU s", "range", "hidden steps"]
        count = len(chosen[0]["success"])
        parts.append(f"{caption} {count} seed{'s' if count > 1 else ''}.")
        parts.append(markdown.table(head, [_cells(row) for row in chosen], left=2))
        if kind == _ONE:
            parts += [_words(found) for found in section["certificates"]]
    parts.append(
        "True errors are medians, with their range, of all runs that reached the end of the span, "
        "refused ones included: the largest of any component, relative to its size. Neurons are "
        "those of the last hidden layer; hidden steps are the least-squares steps that changed "
        "hidden layers, in the windows that were kept. One network of the default layers becomes "
        f"as wide as the motion needs, others keep their width. {_promise(section['rows'])}"
    )
    return "\n\n".join(parts)


def _cells(row: dict[str, Any]) -> list[str]:
    errors = sorted(error for error in row["error"] if error is not None)
    seconds = sorted(row["cpu"])
    return [
        row["problem"],
        row["training"],
        f"{sum(row['success'])} of {len(row['success'])}",
        _range(row["networks"]),
        _range(row["neurons"]),
        markdown.plain(median(errors)) if errors else "-",
        f"{markdown.plain(errors[0])} to {markdown.plain(errors[-1])}" if errors else "-",
        markdown.number(median(seconds), 2),
        f"{markdown.number(seconds[0], 2)} to {markdown.number(seconds[-1], 2)}",
        _range(row["hidden_steps"]),
    ]


def _range(counts: Sequence[int]) -> str:
    if not counts:
        return "-"
    low, high = min(counts), max(counts)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _words(found: dict[str, Any]) -> str:
    if "refusal" in found:
        return f"{found['problem']}, first seed: no proof, {found['refusal']}."
    return (
        f"{found['problem']}, first seed: the error is proven to be at most "
        f"{markdown.plain(found['bound'])}, {found['bound'] / found['lower']:.3f} times the proven "
        f"lower bound, in {markdown.number(found['cpu'], 2)} CPU s."
    )


def _promise(rows: Sequence[dict[str, Any]]) -> str:
    """How far the errors of the successful runs are from their tolerances."""
    shares = [
        error / row["tol"]
        for row in rows
        for error, success in zip(row["error"], row["success"], strict=True)
        if success and error is not None
    ]
    worst = markdown.number(max(shares, default=math.nan), 2)
    return f"The largest true error of {len(shares)} successful runs is {worst} of its tolerance."
