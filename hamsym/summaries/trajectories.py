"""Summary of a trajectory as text: the largest error against what was asked, then the rest."""

from __future__ import annotations

import math

import numpy as np

from hamsym.integrators.trajectory import Trajectory
from hamsym.numerics.scales import ratios
from hamsym.support.text_tables import ROWS, left_out, share, table, wrapped


def trajectory_summary(
    trajectory: Trajectory,
    rows: int | None = ROWS,
    *,
    number: int = 0,
) -> str:
    """Return what :meth:`hamsym.Trajectory.summary` describes.

    - rows: Most components in the table; None for all.
    - number: Of the trajectory in the table.
    """
    verdict = [trajectory.message]
    if (error := _error(trajectory)) is not None:
        verdict = [error, *verdict] if np.all(trajectory.success) else [*verdict, error]
    lines = [wrapped(text) for text in verdict]
    count = len(trajectory.ensemble)
    if count > 1:
        lines += ["", f"{count:,} trajectories, number {number:,} of them:"]
    lines += ["", *_ends(trajectory, rows, number), ""]
    lines += [wrapped(text) for text in _conserved(trajectory)]
    lines.append(f"{trajectory.evaluations:,} evaluations, {trajectory.seconds:.3g} s")
    return "\n".join(lines)


def largest_errors(trajectory: Trajectory) -> np.ndarray | None:
    """Return the largest estimated error of each component, shape (*shape, dim), or None."""
    return None if trajectory.error_estimate is None else trajectory.error_estimate[..., -1, :]


def sizes(trajectory: Trajectory) -> np.ndarray:
    """Return the largest saved magnitude of each component, shape (*shape, dim)."""
    with np.errstate(all="ignore"):
        return np.asarray(np.nan_to_num(np.abs(trajectory.z)).max(axis=-2))


def _error(trajectory: Trajectory) -> str | None:
    """The largest estimated error and its share of the tolerance; None without a tolerance."""
    errors = largest_errors(trajectory)
    if trajectory.verdicts is None or errors is None:
        return None
    tol, worst = trajectory.verdicts.tol, float(trajectory.verdicts.largest.max())
    member = int(np.argmax(trajectory.verdicts.largest))
    flat, scale = errors.reshape(-1, errors.shape[-1]), sizes(trajectory)
    place = int(np.argmax(ratios(flat[member], scale.reshape(flat.shape)[member])))
    name = trajectory.names[place]
    if not math.isfinite(worst):
        return f"the error is not known, in {name}"
    unit = trajectory.ensemble.H.units.get(name, "1")
    value = f"{flat[member, place]:.1e}" + ("" if unit == "1" else f" {unit}")
    where = f" of trajectory {member:,}" if len(trajectory.ensemble) > 1 else ""
    return f"largest estimated error {value} in {name}{where}, {share(worst, tol)} of tol {tol:.1e}"


def _ends(trajectory: Trajectory, rows: int | None, number: int) -> list[str]:
    """The states at both ends of one trajectory."""
    H, count = trajectory.ensemble.H, len(trajectory.ensemble)
    z = trajectory.z.reshape(count, -1, H.dim)[number]
    energy = trajectory.energy.reshape(count, -1)[number]
    errors = largest_errors(trajectory)
    values = None if errors is None else errors.reshape(count, H.dim)[number]
    listed = []
    shown = H.dim if rows is None else min(rows, H.dim)
    for k, name in enumerate(H.names[:shown]):
        error = "" if values is None else f"{values[k]:.1e}"
        unit = H.units.get(name, "")
        listed.append([name, unit, f"{z[0, k]:.15g}", f"{z[-1, k]:.15g}", error])
    for name, ends in (("t", trajectory.t), ("H", energy)):
        listed.append([name, "", f"{ends[0]:.15g}", f"{ends[-1]:.15g}", ""])
    listed.insert(0, listed.pop(-2))
    lines = table(["", "unit", "start", "end", "error"], listed)
    return lines + left_out(H.dim - shown, "components")


def _conserved(trajectory: Trajectory) -> list[str]:
    if not trajectory.ensemble.H.conserves_energy:
        drift = float(np.nanmax(np.abs(trajectory.energy_drift)))
        return [f"|H - E0 - work| at most {drift:.1e}, with the work between saved states"]
    # Rows after the end of a trajectory are nan and are ignored; nan of H at a state is reported.
    exists = np.isfinite(trajectory.z).all(axis=-1)
    change = np.abs(trajectory.energy - trajectory.energy[..., :1])[exists].max()
    start = float(trajectory.energy.ravel()[0])
    lines = [f"energy error {change:.1e}, with H = {start:.6g} at the start"]
    for formula, drift in trajectory.invariant_drift.items():
        lines.append(f"largest change of {formula}: {np.max(drift):.1e}")
    return lines
