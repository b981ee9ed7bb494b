"""Facts of comparisons and sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    by_name,
    error_text,
    interval,
)

if TYPE_CHECKING:
    from hamsym.study.compare import Comparison, Row
    from hamsym.study.sweep import Sweep

_ERROR = ".2e"


def _comparison(comparison: Comparison) -> Facts:
    solution, network = comparison.solution, comparison.rows[0]
    H, own = solution.H, solution.facts
    worst = int(np.argmax(network.component_errors))
    name = H.names[worst]
    estimated = H.quantity(name, float(solution.largest_error[worst]))
    headline = (
        f"error {network.error:.2e} (2-norm) against {comparison.reference.text}; largest in "
        f"{name}, {H.quantity(name, network.component_errors[worst])}, where {estimated} was "
        f"estimated and {H.quantity(name, float(solution.allowed_error[worst]))} asked"
    )
    if not comparison.reference.judges(network.error):
        headline += (
            "; the reference is less than ten times better, so that steps for the network's error "
            "have only bounds"
        )
    names = "label", "points", "tolerance", "evaluations", "error", "energy_error", "seconds"
    rows = [
        {"method" if key == "label" else key: getattr(row, key) for key in names}
        | {"component_errors": by_name(H.names, row.component_errors)}
        for row in comparison.rows
    ]
    return replace(
        own,
        kind="Comparison",
        headline=headline,
        entries=(
            _rows(comparison.rows),
            _matches(comparison),
            Fact("solution", value=own.values()),
            Fact("rows", value=rows),
            Fact("matches", value={name: vars(own) for name, own in comparison.matches.items()}),
            Fact("reference", value=comparison.reference.text),
            Fact("reference_error", value=comparison.reference_error),
        ),
        drawn=sum(trajectory.z.size for trajectory in comparison.trajectories),
    )


def _rows(rows: Sequence[Row]) -> Table:
    points = [f"{r.points:,}" if r.tolerance is None else f"rtol {r.tolerance:.0e}" for r in rows]
    columns = (
        Column("points", points),
        Column("evaluations", [row.evaluations for row in rows], ","),
        Column("max |dz|", [row.error for row in rows], _ERROR),
        Column("max |dE|", [row.energy_error for row in rows], _ERROR),
        Column("time s", [row.seconds for row in rows], ".2g"),
    )
    return Table("rows", [row.label for row in rows], columns, "method", whole=True)


def _matches(comparison: Comparison) -> Table:
    """What each integrator needs for the error of the network, or why that is not known."""
    found = list(comparison.matches.values())

    def known(name: str, form: str) -> list[str]:
        return ["" if match.reason else format(getattr(match, name), form) for match in found]

    columns = (
        Column("evaluations", known("evaluations", ",")),
        Column("max |dz|", known("error", _ERROR)),
        Column("time s", known("seconds", ".2g")),
        Column("needs", [f"{match}" for match in found], left=True),
    )
    title = f"for the network's error, {comparison.rows[0].error:.2e}:"
    names = list(comparison.matches)
    return Table("integrators", names, columns, "method", title, whole=True)


def _sweep(sweep: Sweep) -> Facts:
    every = [solution for found in sweep.solutions.values() for solution in found]
    converged = sum(bool(solution.success) for solution in every)
    headline = f"{converged:,} of {len(every):,} runs converged, t from {interval(sweep.span)}"
    if sweep.swept:
        headline += f"; the settings differ in {', '.join(sweep.swept)}"
    return Facts(
        "Sweep",
        headline,
        sweep.message,
        sweep.success,
        entries=(_settings(sweep), Fact("swept", value=dict(sweep.swept))),
        members=len(every),
    )


def _settings(sweep: Sweep) -> Table:
    runs = list(sweep.solutions.values())
    converged = [f"{sum(bool(each.success) for each in own)} of {len(own)}" for own in runs]
    errors = [max(s.relative_error for s in own) for own in runs]
    columns = (
        Column("converged", converged),
        Column("error / size", errors, error_text, "relative_error"),
        Column("time s", [sum(s.seconds for s in own) for own in runs], ".2g", "seconds"),
    )
    return Table("settings", list(sweep.solutions), columns, "settings")
