"""Facts of solutions, one or many: the largest error against what was asked, then the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    against,
    conservation_facts,
    error_text,
    facts_of,
    formulas_of,
    largest_share,
    problem_facts,
    span_fact,
    time_fact,
    units_of,
)
from hamsym.numerics.scales import ratios
from hamsym.problems.conservation import KnownInvariants
from hamsym.proof.arithmetic.balls import decimal
from hamsym.solution.acceptance import judged_by_invariants
from hamsym.support.text_tables import share

if TYPE_CHECKING:
    from hamsym.families.solutions import Solutions
    from hamsym.proof.windows.certificate import Certificate
    from hamsym.solution.solution import Solution

_LONG = 2e9  # operations of an analysis that takes longer than a reader waits


def solution_facts(solution: Solution, certificate: Certificate | None = None) -> Facts:
    """Describe a solution.

    - certificate: Of this solution, in place of its own.
    """
    certificate = certificate or solution.certificate
    H = solution.H
    return Facts(
        "Solution",
        against(H, solution.largest_error, solution.allowed_error),
        solution.message,
        bool(solution.success),
        "converged" if solution.success else "failed",
        formulas_of(H),
        (*problem_facts(H), *_settings(solution)),
        (
            _components(solution, certificate),
            lambda: _conserved(solution),
            *([] if certificate is None else [_proof(solution, certificate)]),
            lambda: _bound(solution),
            *_cost(solution),
        ),
        solution.scan_times.size * H.dim if solution.error is not None else math.inf,
    )


def _settings(solution: Solution) -> list[Fact]:
    """What was asked beside H and the start."""
    given, unit = solution.settings, solution.H.units.get("t", "")
    found = [span_fact(solution.span, unit)]
    method = Fact("method", "method", solution.method, solution.method)
    if tuple(given.span) != tuple(solution.span):
        found.append(Fact("span_asked", "span asked", given.span, span_fact(given.span, unit).text))
    options = dict(given.options)
    texts = [f"{name} = {value}" for name, value in options.items()]
    if given.breakpoints:
        texts.append(f"breakpoints = {list(given.breakpoints)}")
    texts += [f"{name} = an object of the caller's program" for name in given.missing]
    return [
        *found,
        method,
        Fact("options", "options", options, ", ".join(texts)),
        Fact("seed", "seed", given.seed, str(given.seed), brief=False),
        _tolerance(solution),
        Fact("atol", value=given.atol),
        Fact("prove", "proof asked", given.prove, "yes" if given.prove else "no", brief=False),
    ]


def _tolerance(solution: Solution) -> Fact:
    given = solution.settings
    text = f"an error of at most {given.tol:g} of the largest value of each component"
    if any(given.atol):
        text += f", and {', '.join(f'{value:g}' for value in given.atol)} more"
    return Fact("tol", "tolerance", given.tol, text)


def _components(solution: Solution, certificate: Certificate | None) -> Table:
    H, asked, errors = solution.H, solution.allowed_error, solution.largest_error
    ends = solution(solution.span[1])
    columns = [
        units_of(H),
        Column("at the start", solution.z0, lambda value: repr(float(value)), "start", brief=False),
        Column("at the end", ends, ".12g", "end", brief=False),
        Column("largest value", solution.scale, ".4g", "largest_value"),
        Column("estimated error", errors, error_text, "error"),
        Column("asked", asked, ".1e", "asked"),
        Column("of it", [share(*pair) for pair in zip(errors, asked, strict=True)]),
    ]
    if certificate is not None:
        bounds = certificate.component_bounds
        columns.append(Column("proven at most", bounds, decimal, "proven_error", brief=False))
    order = np.argsort(-ratios(errors, asked), kind="stable").tolist()
    return Table(
        "components with smaller errors", H.names, tuple(columns), choose=lambda n: order[:n]
    )


def _conserved(solution: Solution) -> Sequence[Fact]:
    with np.errstate(all="ignore"):
        drift = np.abs(solution.energy_drift(solution.scan_times))
    largest = float(np.nan_to_num(drift, nan=np.inf).max())
    energies = float(solution.energy(solution.span[0])), largest
    drifts, given = solution.invariant_drift, solution.settings
    if not drifts and given.invariants:  # they are not part of files
        known = KnownInvariants(solution.H, list(given.invariants))
        drifts = judged_by_invariants(solution, known).invariant_drift
    return conservation_facts(solution.H, energies, drifts)


def _bound(solution: Solution) -> Sequence[Fact]:
    """The paper's bound, in short where it says something: finite, not violated, not too large."""
    label = "the paper's bound ell_max/sigma_min:"
    if not len(solution.scan_times) * float(solution.H.dim) ** 3 <= _LONG:
        text = "not computed, because the trajectory is long"
        return [Fact("error_bound", label, None, text, brief=False)]
    sigma, ell, bound = solution.sigma_min, solution.ell_max, solution.analysis.bound
    units = {solution.H.units.get(name, "1") for name in solution.H.names}
    says = len(units) == 1 and solution.largest_error.max() <= bound < solution.scale.max()
    text = f"{bound:.2e} (heuristic)" if bound < math.inf else solution.analysis.vacuous
    return [
        Fact("error_bound", label, bound, text, brief=bool(says)),
        Fact("ell_max", "largest residual ell_max", ell, f"{ell:.2e}", brief=False),
        Fact("sigma_min", "smallest singular value of the Hessian sigma_min", sigma, f"{sigma:.3g}",
             brief=False),
    ]  # fmt: skip


def _cost(solution: Solution) -> list[Fact]:
    record, relative = solution.record, solution.relative_error
    iterations = getattr(record, "iterations", None)  # of a training
    time = f"{record.seconds:.3f} s for the last march"
    if iterations is not None:
        each = 1e3 * record.cpu_seconds / max(iterations, 1)
        unit = "epoch" if solution.method == "adam" else "iteration"
        time = f"{record.seconds:.1f} s, {each:.2f} ms of CPU per {unit}"
    edges = record.edges
    weight, windows = solution.energy_weight, 1 if edges is None else len(edges) - 1
    counts = (
        ("windows", "windows", windows),
        ("points", "collocation points", solution.points),
        ("evaluations", "evaluations of the vector field", solution.evaluations),
    )
    return [
        Fact("relative_error", "error relative to the motion", relative, error_text(relative),
             brief=False),
        *(Fact(name, label, value, f"{value:,}", brief=False) for name, label, value in counts),
        *([Fact("energy_weight", "energy weight", weight, f"{weight:g}")] if weight else []),
        Fact("seconds", "time", record.seconds, time),
    ]  # fmt: skip


def _proof(solution: Solution, certificate: Certificate) -> Fact:
    """What a certificate bounds, rounded outward: the component that is nearest to its limit."""
    start, end = certificate.span
    bounds = np.array(certificate.component_bounds)
    worst = largest_share(bounds, solution.allowed_error)
    name, H = solution.H.names[worst], solution.H
    text = (
        f"the error of {name} is at most {H.quantity(name, float(bounds[worst]), '.9g')}, that of "
        f"the state at most {decimal(certificate.bound)} (2-norm) and somewhere at least "
        f"{decimal(certificate.lower)}, t from {start!r} to {end!r}"
    )
    return Fact("proven", "proven:", certificate.bound, text)


def proof_sentence(solution: Solution, certificate: Certificate) -> str:
    """Say what a certificate proves of a solution, against what was asked of it."""
    bounds, allowed = np.array(certificate.component_bounds), solution.allowed_error
    what = "the largest error at most"
    largest = against(solution.H, bounds, allowed, what=what)
    if (bounds <= allowed).all():
        return f"Proven: every error is within what was asked, {largest}"
    return f"Proven, but not that every error is within what was asked: {largest}"


def _solutions(many: Solutions) -> Facts:
    good, size, success = int(many.success.sum()), many.size, many.success
    failed, headline = np.argwhere(~success), ""
    if good:
        worst = float(np.nanmax(np.where(success, many.excess, np.nan)))
        headline = f"estimated errors up to {share(worst, 1.0)} of what tol {many.tol:.1e} allows"
    message = f"all {size:,} trajectories converged"
    if len(failed):
        place = ", ".join(map(str, failed[0]))
        message = f"{len(failed):,} of {size:,} trajectories failed, the first is [{place}]: "
        message += _reason(many, failed[0])
    places = [", ".join(map(str, place)) for place in failed]
    reasons = Column("reason", failed, lambda place: _reason(many, place), left=True)
    return facts_of(
        many,
        headline,
        Table("failed members", places, (reasons,), "failed member"),
        _member_errors(many),
        time_fact(many.seconds),
        message=message,
        varied=many.parameters,
        drawn=size * many.H.dim * 100,
        members=size,
    )


def _reason(many: Solutions, place: np.ndarray) -> str:
    """Why a member failed; the messages of all members would take long."""
    return " ".join(many._message(int(many.members[tuple(place)])).split())


def _member_errors(many: Solutions) -> Table:
    """The largest error of each component that is known."""
    H, errors = many.H, many.largest_error.reshape(-1, many.H.dim)
    largest = np.where(np.isfinite(errors), errors, 0.0).max(axis=0, initial=0.0)
    columns = (
        units_of(H),
        Column("largest estimated error", largest, error_text, "error"),
    )
    return Table("components", H.names, columns)
