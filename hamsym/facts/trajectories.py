"""Facts of trajectories by time stepping: the largest error against what was asked, the ends."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    by_name,
    conservation_facts,
    error_text,
    facts_of,
    silent,
)
from hamsym.numerics.scales import ratios
from hamsym.support.text_tables import share

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hamsym.integrators.trajectory import Trajectory


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
        lambda: _conserved(trajectory),
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


def _conserved(trajectory: Trajectory) -> Sequence[Fact]:
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
