"""Facts of fits and of flow maps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    error_text,
    facts_of,
    interval,
    number,
    silent,
    time_fact,
    units_of,
)
from hamsym.support.text_tables import share

if TYPE_CHECKING:
    from hamsym.fitting.fitted import Fit
    from hamsym.flow_maps.flow_map import FlowMap


def _fit(fit: Fit) -> Facts:
    H, several = fit.H, bool(np.ndim(fit.success))
    data = f"{len(fit.t):,} times, t from {interval((fit.t.min(), fit.t.max()))}"
    headline, message, members = "", fit.message, 1
    if several:
        members, good = len(fit.success), int(np.sum(fit.success))
        headline = f"{', '.join(fit.names)} from {members:,} sets of data"
        message = f"{good:,} of {members:,} sets converged"
        if good < members:
            first = int(np.argmin(fit.success))
            message = f"{members - good:,} of {members:,} sets failed, number {first:,} first: "
            message += fit.message[first]
    return facts_of(
        fit,
        headline,
        _estimates(fit, several),
        *_quality(fit, several),
        *silent(fit, _NUMBERS),
        time_fact(fit.seconds),
        message=message,
        varied=fit.names,
        given=[Fact("", "data", None, f"{', '.join(fit.data)}: {data}")],
        drawn=400 * H.dim * np.size(fit.success),
        members=members,
    )


_NUMBERS = "confidence confidence_intervals covariance degrees_of_freedom p_value starts_reached"


def _estimates(fit: Fit, several: bool) -> Table:
    values, errors = fit.parameters, fit.standard_errors
    ends = [fit.confidence_intervals[name] for name in fit.names]
    labels = ("estimate", "standard error", f"{100 * fit.confidence:g} % interval")
    if several:
        labels = "median estimate", "median standard error", "smallest to largest"
        with np.errstate(all="ignore"):
            ends = [(np.min(own), np.max(own)) for own in values.values()]
    shown = (list(values.values()), [errors[name] for name in fit.names])
    columns = (
        Column("unit", [fit.H.units.get(name, "") for name in fit.names]),
        Column(labels[0], shown[0], lambda v: number(np.median(v), 8), "estimate"),
        Column(labels[1], shown[1], lambda v: number(np.median(v), 2), "standard_error"),
        Column(labels[2], ends, lambda pair: f"{pair[0]:.8g} to {pair[1]:.8g}"),
    )
    return Table("quantities", fit.names, columns)


def _quality(fit: Fit, several: bool) -> tuple[Fact, ...]:
    """Chi-square and the largest residuals."""
    if several:
        return (Fact("chi_square", value=fit.chi_square),)
    p = "" if math.isnan(fit.p_value) else f", p = {number(fit.p_value, 2)}"
    text = f"{number(fit.chi_square, 4)} for {fit.degrees_of_freedom} degrees of freedom{p}"
    worst = [
        f"{label} {np.nanmax(np.abs(values)):.2g}"
        for label, values in fit.weighted_residuals.items()
    ]
    return (
        Fact("chi_square", "chi-square", fit.chi_square, text),
        Fact("", "largest residuals in sigma:", None, ", ".join(worst)),
    )


def _flow_map(flow: FlowMap) -> Facts:
    H = flow.H
    box = [f"{name} from {low!r} to {high!r}" for name, (low, high) in flow.box.items()]
    kept: Any = flow.symplecticity
    fixed = {name: repr(own) for name, own in flow.fixed.items()}
    fixed |= dict(flow.region.expressions)
    errors = Column("largest estimated error", flow.largest_error, error_text, "error")
    fixed = {name: text for name, text in fixed.items() if name not in H.parameters}
    return facts_of(
        flow,
        f"estimated errors up to {share(flow.excess, 1.0)} of what tol {flow.tol:.1e} allows",
        Table("components", H.names, (units_of(H), errors)),
        Fact("symplecticity", "M^T J M - J", kept, "" if kept is None else error_text(kept)),
        Fact("bytes", "size", flow.nbytes, f"{flow.nbytes:,} bytes"),
        time_fact(flow.seconds),
        verdict="converged" if flow.success else "failed",
        varied=flow.inputs,
        given=[
            *(Fact("", name, None, text) for name, text in fixed.items()),
            Fact("box", "box", flow.box, ", ".join(box)),
        ],
        drawn=5e4 * H.dim,
    )
