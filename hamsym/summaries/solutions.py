"""Summary of a solution as text: the largest error against what was asked, then the rest."""

from __future__ import annotations

import math

import numpy as np

from hamsym.numerics.scales import ratios
from hamsym.solution.solution import Solution
from hamsym.support.text_tables import ROWS, left_out, share, table, wrapped


def solution_summary(
    solution: Solution,
    rows: int | None = ROWS,
    *,
    analysis: bool = False,
) -> str:
    """Return what :meth:`hamsym.Solution.summary` describes.

    - rows: Most components in the table; None for all.
    - analysis: Whether the paper's bound is given also where it is infinite or says nothing.
    """
    lines = [wrapped(text) for text in _verdict(solution)]
    lines += ["", *_components(solution, rows), ""]
    lines += [wrapped(text) for text in _conserved(solution)]
    lines += [wrapped(text) for text in _bound(solution, analysis)]
    lines.append(_time(solution))
    return "\n".join(lines)


def largest_share(solution: Solution) -> int:
    """Return the component whose error is the largest share of what was asked, or of its size."""
    return int(_order(solution)[0])


def _limits(solution: Solution) -> np.ndarray:
    """What errors are compared with: what was asked, else the sizes of the components."""
    return solution.scale if solution.allowed_error is None else solution.allowed_error


def _order(solution: Solution) -> np.ndarray:
    return np.argsort(-ratios(solution.largest_error, _limits(solution)), kind="stable")


def _verdict(solution: Solution) -> list[str]:
    worst = largest_share(solution)
    name, error = solution.H.names[worst], float(solution.largest_error[worst])
    limit = float(_limits(solution)[worst])
    if math.isfinite(error):
        size = solution.H.quantity(name, limit)
        whole = f"of its size {size}" if solution.allowed_error is None else f"of the {size} asked"
        text = (
            f"largest estimated error {solution.H.quantity(name, error)} in {name}, "
            f"{share(error, limit)} {whole}"
        )
    else:
        text = f"the error is not known, in {name}"
    if solution.success:
        return [f"converged: {text}", solution.message]
    return [solution.message, text]


def _components(solution: Solution, rows: int | None) -> list[str]:
    H, errors, asked = solution.H, solution.largest_error, solution.allowed_error
    order = _order(solution)
    shown = order if rows is None or len(order) <= rows else order[:rows]
    listed = []
    for k in sorted(shown) if len(shown) == len(order) else shown:
        unit = H.units.get(H.names[k], "")
        limit = "" if asked is None else f"{asked[k]:.1e}"
        ratio = "" if asked is None else share(errors[k], asked[k])
        listed.append(
            [H.names[k], unit, f"{solution.scale[k]:.4g}", f"{errors[k]:.1e}", limit, ratio]
        )
    header = ["", "unit", "largest value", "estimated error", "asked", "of it"]
    lines = table(header, listed)
    return lines + left_out(len(order) - len(shown), "components with smaller errors")


def _conserved(solution: Solution) -> list[str]:
    H, times = solution.H, solution.scan_times
    with np.errstate(all="ignore"):
        drift = float(np.abs(solution.energy_drift(times)).max())
    if H.conserves_energy:
        start = float(solution.energy(solution.span[0]))
        lines = [f"energy error {drift:.1e}, with H = {start:.6g} at the start"]
    else:
        lines = [f"|H - E0 - work| at most {drift:.1e}"]
    for formula, change in solution.invariant_drift.items():
        lines.append(f"largest change of {formula}: {change:.1e}")
    return lines


def _bound(solution: Solution, analysis: bool) -> list[str]:
    """The paper's bound where it says something: finite, not violated, below the motion."""
    H = solution.H
    sigma = solution.sigma_min
    bound = solution.analysis.bound
    largest, scale = float(solution.largest_error.max()), float(solution.scale.max())
    units = {H.units.get(name, "1") for name in H.names}
    if not analysis and not (len(units) == 1 and sigma > 0 and largest <= bound < scale):
        return []
    text = f"{bound:.2e} (heuristic)"
    if not sigma > 0:
        forced = "it does not hold with forces"
        reason = forced if H.forces else "the Hessian is singular on the trajectory"
        text = f"infinite: {reason}"
    lines = [f"the paper's bound ell_max/sigma_min: {text}"]
    return [*lines, f"ell_max {solution.ell_max:.2e}, sigma_min {sigma:.3g}"] if analysis else lines


def _time(solution: Solution) -> str:
    record = solution.record
    iterations = getattr(record, "iterations", None)  # of a training
    if iterations is None:
        return f"time {record.seconds:.3f} s for the last march"
    each = 1e3 * record.cpu_seconds / max(iterations, 1)
    unit = "epoch" if solution.method == "adam" else "iteration"
    return f"time {record.seconds:.1f} s, {each:.2f} ms of CPU per {unit}"
