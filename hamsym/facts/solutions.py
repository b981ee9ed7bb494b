"""Facts of solutions and trajectories: the largest error against what was asked, then the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    against,
    by_name,
    conservation_facts,
    error_text,
    facts_of,
    formulas_of,
    largest_share,
    problem_facts,
    silent,
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
    from hamsym.integrators.trajectory import Trajectory
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


# -- trajectories by time stepping -----------------------------------------------------------------


def _trajectory(trajectory: Trajectory) -> Facts:
    members, found = trajectory.ensemble, trajectory.verdicts
    varied = members.columns if members.shape else {}
    given = () if found is None else (Fact("tol", "tolerance", found.tol, f"{found.tol:g}"),)
    cost = f"{trajectory.evaluations:,} evaluations, {trajectory.seconds:.3g} s"
    return facts_of(
        trajectory,
        _headline(trajectory),
        _ends(trajectory),
        _kept(trajectory),
        lambda: _conserved_by_steps(trajectory),
        *silent(trajectory, "steps evaluations"),
        Fact("seconds", "", trajectory.seconds, cost),
        varied=varied,
        given=given,
        drawn=trajectory.z.size,
        members=len(members),
    )


def _headline(trajectory: Trajectory) -> str:
    """The largest estimated error and its share of the tolerance; "" without a tolerance."""
    found = trajectory.verdicts
    if found is None:
        return ""
    member, place = _worst(trajectory)
    name, worst = trajectory.names[place], float(found.largest.max())
    if not math.isfinite(worst):
        return f"the error is not known, in {name}"
    error = trajectory.ensemble.flat(trajectory.largest_error)[member, place]
    where = f" of trajectory {member:,}" if len(trajectory.ensemble) > 1 else ""
    return (
        f"largest estimated error {trajectory.H.quantity(name, error)} in {name}{where}, "
        f"{share(worst, found.tol)} of tol {found.tol:.1e}"
    )


def _kept(trajectory: Trajectory) -> Fact:
    """How well H is kept relative to its scale, where there is no estimate of the error."""
    drift, text = trajectory.drift, ""
    if trajectory.verdicts is None and not math.isnan(drift):
        kept = f"to {drift:.1e} of its scale" if drift else "to round-off"
        kept = kept if math.isfinite(drift) else "nowhere: it is not finite"
        text = f"{kept}; no error estimate, give tol for one"
    return Fact("drift", "H kept", drift, text)


def _worst(trajectory: Trajectory) -> tuple[int, int]:
    """The trajectory with the largest error, and its component; without a tolerance the first."""
    if trajectory.verdicts is None:
        return 0, 0
    member = int(np.argmax(trajectory.verdicts.largest))
    errors = trajectory.ensemble.flat(trajectory.largest_error)[member]
    with np.errstate(all="ignore"):
        sizes = np.nan_to_num(np.abs(trajectory.ensemble.flat(trajectory.z)[member])).max(axis=0)
    return member, int(np.argmax(ratios(errors, sizes)))


def _ends(trajectory: Trajectory) -> Table:
    """The states at both ends of one trajectory."""
    H, count, number = trajectory.H, len(trajectory.ensemble), _worst(trajectory)[0]
    z, energy = (trajectory.ensemble.flat(own)[number] for own in (trajectory.z, trajectory.energy))
    errors = trajectory.largest_error
    own = [""] * H.dim
    if errors is not None:
        own = [error_text(value) for value in trajectory.ensemble.flat(errors)[number]]
    start, end = ([trajectory.t[k], *z[k], energy[k]] for k in (0, -1))
    units = [H.units.get(name, "") for name in ("t", *H.names)]
    title = f"{count:,} trajectories, number {number:,} of them:" if count > 1 else ""
    return Table(
        "components",
        ["t", *H.names, "H"],
        (
            Column("unit", [*units, ""]),
            Column("start", start, ".15g"),
            Column("end", end, ".15g"),
            Column("error", ["", *own, ""]),
        ),
        title=title,
        choose=lambda rows: [0, *range(1, rows - 1), H.dim + 1],
    )


def _conserved_by_steps(trajectory: Trajectory) -> Sequence[Fact]:
    """How well H is kept, and each trajectory on its own."""
    H, count = trajectory.H, len(trajectory.ensemble)
    z = trajectory.ensemble.flat(trajectory.z)
    with np.errstate(all="ignore"):
        drifts = np.abs(trajectory.ensemble.flat(trajectory.energy_drift))
        # Rows after the end of a trajectory are nan and are ignored; nan of H at a state is not.
        largest = np.where(np.isnan(z).any(axis=-1), -np.inf, drifts).max(axis=-1)
    success = np.broadcast_to(trajectory.success, trajectory.ensemble.shape).ravel()
    errors = trajectory.largest_error
    errors = None if errors is None else trajectory.ensemble.flat(errors)
    each = [
        {
            "success": bool(success[k]),
            "start": by_name(H.names, z[k, 0]),
            "end": by_name(H.names, z[k, -1]),
            "error": None if errors is None else by_name(H.names, errors[k]),
            "energy_error": largest[k],
        }
        for k in range(count)
    ]
    energies = float(trajectory.energy.ravel()[0]), float(largest.max())
    found = conservation_facts(H, energies, trajectory.invariant_drift)
    return [*found, Fact("trajectories", value=each)]
