"""Cards of solutions, trajectories, comparisons and sweeps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hamsym.numerics.scales import ratios
from hamsym.workbench.notebooks.cards import (
    ROWS,
    Card,
    counted,
    cut,
    energy_formulas,
    error_text,
    interval,
    judged,
    number,
    of_type,
    parameter_facts,
    seconds_text,
    with_table,
)
from hamsym.workbench.notebooks.proof_cards import bound_text

if TYPE_CHECKING:
    from hamsym import Comparison, Hamiltonian, Solution, Solutions, StoredSweep, Sweep, Trajectory

__all__: list[str] = []


@of_type("Solution")
def _solution(solution: Solution) -> Card:
    H, error = solution.H, solution.error
    card = judged(
        Card("Solution", formulas=energy_formulas(H)), solution.success, "converged", "failed"
    )
    card.facts = [
        ("outcome", cut(solution.message)),
        ("span", f"t from {interval(solution.span)}"),
        ("method", f"{solution.method}, {seconds_text(solution.record.seconds)}"),
        *parameter_facts(H),
    ]
    header, rows = ["component", "at the start"], [[H.labelled(n)] for n in H.names]
    for row, value in zip(rows, solution.z0, strict=True):
        row.append(number(value))
    if error is not None:
        largest, scale = np.asarray(error.largest), np.asarray(error.scale)
        settings = solution.settings
        asked = None if settings is None else settings.allowed(scale)
        worst = int(np.argmax(ratios(largest, scale if asked is None else asked)))
        card.headline = _largest_error(
            H, worst, largest[worst], scale[worst], None if asked is None else asked[worst]
        )
        header += ["largest value", "largest estimated error"]
        for row, size, each in zip(rows, scale, largest, strict=True):
            row += [number(size, 4), error_text(each)]
        if asked is not None:
            header.append("asked")
            for row, each in zip(rows, asked, strict=True):
                row.append(error_text(each))
    else:
        loss = getattr(solution.record, "best_loss", math.nan)
        card.headline = f"best loss {number(loss, 3)}"
    for formula, change in solution.invariant_drift.items():
        card.facts.append((f"change of {cut(formula)}", error_text(change)))
    if solution.certificate is not None:
        card.facts.append(("proven", bound_text(solution.certificate)))
    card.numbers_drawn = solution.scan_times.size * H.dim if error is not None else math.inf
    return with_table(card, header, rows, "component")


def _largest_error(
    H: Hamiltonian, component: int, error: float, scale: float, asked: float | None
) -> str:
    name = H.names[component]
    unit = "" if H.units.get(name, "1") == "1" else f" {H.units[name]}"
    if not math.isfinite(error):
        return f"the error of {name} is not known"
    text = f"largest estimated error {error_text(error)}{unit} in {name}"
    if asked is not None and asked > 0:
        return f"{text}, {100 * error / asked:.2g} % of the {error_text(asked)}{unit} asked"
    return f"{text}, whose largest value is {number(scale, 4)}{unit}"


@of_type("Solutions")
def _solutions(many: Solutions) -> Card:
    success = many.success
    solved, size = int(success.sum()), many.size
    card = judged(
        Card("Solutions", formulas=energy_formulas(many.H)),
        solved == size,
        f"all {size:,} converged",
        f"{size - solved:,} of {size:,} failed",
    )
    if solved:
        worst = float(np.nanmax(np.where(success, many.excess, np.nan)))
        card.headline = (
            f"estimated errors up to {worst:.2g} of what the tolerance {many.tol:.1e} allows"
        )
    card.facts = [
        ("shape", " x ".join(map(str, many.shape))),
        ("span", f"t from {interval(many.span)}"),
        *(
            (name, f"{number(own.min())} to {number(own.max())}")
            for name, own in many.parameters.items()
            if own.size
        ),
        *parameter_facts(many.H, tuple(many.parameters)),
    ]
    failed = np.argwhere(~success)
    rows = []
    for place in failed[:ROWS]:
        member = int(many.members[tuple(place)])
        rows.append([", ".join(map(str, place)), cut(many._message(member))])
    card.left, card.header, card.rows = 2, ["failed member", "reason"], rows
    if len(failed) > ROWS:
        card.left_out = f"... and {counted(len(failed) - ROWS, 'failed member')}"
    card.numbers_drawn = size * many.H.dim * 100
    return card


@of_type("Trajectory")
def _trajectory(trajectory: Trajectory) -> Card:
    members, success = trajectory.ensemble, np.asarray(trajectory.success)
    H, t, z, found = members.H, trajectory.t, trajectory.z, trajectory.verdicts
    card = Card("Trajectory", formulas=energy_formulas(H), headline=_accuracy(trajectory))
    good = int(success.sum()) if success.ndim else len(members) * bool(success)
    failed = f"{len(members) - good:,} of {len(members):,} failed" if success.ndim else "failed"
    judged(card, good == len(members), "reached the end" if found is None else "met tol", failed)
    card.facts = [
        ("outcome", cut(trajectory.message)),
        ("saved", f"{len(t):,} states, t from {number(t[0])} to {number(t[-1])}"),
        (
            "method",
            f"{trajectory.method}, {trajectory.steps:,} steps, "
            f"{trajectory.evaluations:,} evaluations, {seconds_text(trajectory.seconds)}",
        ),
        *parameter_facts(H, members.varied if members.shape else ()),
    ]
    if members.shape:
        card.facts.insert(1, ("members", " x ".join(map(str, members.shape))))
        for name, own in members.columns.items():
            card.facts.append((name, f"{number(own.min())} to {number(own.max())}"))
    card.numbers_drawn = z.size
    if members.shape:
        return card
    header, columns = ["component", "start", "end"], [z[0], z[-1]]
    rows = [[H.labelled(name)] for name in trajectory.names]
    if trajectory.error_estimate is not None:
        header.append("estimated error")
        columns.append(trajectory.error_estimate[-1])
    for k, column in enumerate(columns):
        for row, value in zip(rows, column, strict=True):
            row.append(error_text(value) if k == 2 else number(value))
    return with_table(card, header, rows, "component")


def _accuracy(trajectory: Trajectory) -> str:
    """The largest error, or how well H is conserved, in words."""
    if (found := trajectory.verdicts) is not None:
        good = np.ravel(trajectory.success)
        if not good.any():
            return "the error is not within the tolerance"
        whose = "" if good.all() else " of those that succeeded"
        error = error_text(found.largest[good].max())
        return f"largest estimated relative error{whose} {error}, tol {found.tol:.1e} asked"
    drift = trajectory.drift
    if math.isnan(drift):
        return "no error estimate; give tol for one"
    kept = "to round-off" if drift == 0 else f"to {drift:.1e} of its scale"
    kept = kept if math.isfinite(drift) else "nowhere: it is not finite"
    return f"H kept {kept}; no error estimate, give tol for one"


@of_type("Comparison")
def _comparison(comparison: Comparison) -> Card:
    first = comparison.rows[0]
    card = Card("Comparison", headline=f"the network's largest error is {error_text(first.error)}")
    rows = []
    for row in comparison.rows:
        points = f"{row.points:,}" if row.tolerance is None else f"rtol {row.tolerance:.0e}"
        errors = error_text(row.error), error_text(row.energy_error)
        rows.append([row.label, points, f"{row.evaluations:,}", *errors, seconds_text(row.seconds)])
    header = ["method", "points", "evaluations", "max |dz|", "max |dE|", "time"]
    with_table(card, header, rows, "row")
    card.notes.append(f"Errors are against {comparison.reference.text}.")
    reached = [
        f"{name}: {match.reason or str(match)}" for name, match in comparison.matches.items()
    ]
    if reached:
        card.notes.append(cut(f"For the error of the network: {'; '.join(reached)}."))
    card.numbers_drawn = sum(trajectory.z.size for trajectory in comparison.trajectories)
    return card


@of_type("Sweep")
def _sweep(sweep: Sweep) -> Card:
    card = Card("Sweep", headline=f"t from {interval(sweep.span)}")
    if sweep.swept:
        card.facts = [("settings differ in", ", ".join(sweep.swept))]
    rows = []
    for name, solutions in sweep.solutions.items():
        solved = sum(bool(solution.success) for solution in solutions)
        errors = [np.max(each.error.largest) for each in solutions if each.error is not None]
        proven = [entry for entry in sweep.certificates.get(name, ()) if not isinstance(entry, str)]
        rows.append(
            [
                str(name),
                f"{solved} of {len(solutions)}",
                error_text(max(errors)) if errors else "",
                f"{len(proven)}" if name in sweep.certificates else "",
                seconds_text(sum(solution.record.seconds for solution in solutions)),
            ]
        )
    return with_table(
        card, ["settings", "converged", "largest estimated error", "proven", "time"], rows, "row"
    )


@of_type("StoredSweep")
def _stored_sweep(sweep: StoredSweep) -> Card:
    size = math.prod(sweep.shape)
    card = Card("StoredSweep", headline=f"{sweep.done:,} of {size:,} points")
    judged(card, sweep.complete, "complete", "interrupted" if sweep.interrupted else "open")
    sizes = zip(sweep.store.axes, sweep.shape, strict=True)
    axes = ", ".join(f"{name}: {counted(length, 'value')}" for name, length in sizes)
    card.facts = [("store", sweep.path.name), ("grid", axes)]
    return card
