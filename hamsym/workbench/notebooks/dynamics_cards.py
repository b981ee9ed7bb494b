"""Cards of fits, flow maps, exponents, sections, equilibria and periodic orbits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

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

if TYPE_CHECKING:
    from hamsym import (
        ChaosIndicators,
        Equilibria,
        Equilibrium,
        Fit,
        FlowMap,
        LyapunovExponents,
        LyapunovMap,
        OrbitFamily,
        PeriodicOrbit,
        Section,
    )

__all__: list[str] = []


@of_type("Fit")
def _fit(fit: Fit) -> Card:
    card, H = Card("Fit", formulas=energy_formulas(fit.H)), fit.H
    several = bool(np.ndim(fit.success))
    header = ["quantity", "estimate", "standard error", f"{fit.confidence:.0%} interval"]
    errors, rows = fit.standard_errors, []
    if several:
        good = int(np.sum(fit.success))
        judged(card, good == len(fit.success), "all sets", f"{len(fit.success) - good:,} failed")
        card.headline = f"{good:,} of {len(fit.success):,} sets of data"
        header = ["quantity", "median estimate", "median standard error", "smallest to largest"]
        with np.errstate(all="ignore"):
            for name, own in fit.parameters.items():
                middle, spread = np.median(own), np.median(errors[name])
                ends = interval((np.min(own), np.max(own)))
                rows.append([H.labelled(name), number(middle), number(spread, 2), ends])
    else:
        judged(card, fit.success)
        ratio = f"chi-square {number(fit.chi_square, 4)} for {fit.degrees_of_freedom} degrees"
        p = "" if math.isnan(fit.p_value) else f", p = {number(fit.p_value, 2)}"
        card.headline = f"{ratio} of freedom{p}"
        card.facts = [("outcome", cut(fit.message))]
        for name, own in fit.parameters.items():
            ends = interval(fit.confidence_intervals[name])
            rows.append([H.labelled(name), number(own, 8), number(errors[name], 2), ends])
    data = f"{len(fit.t):,} times, t from {number(fit.t.min())} to {number(fit.t.max())}"
    card.facts += [("data", f"{', '.join(fit.data)}: {data}"), *parameter_facts(H, fit.names)]
    card.numbers_drawn = 400 * H.dim * np.size(fit.success)
    return with_table(card, header, rows, "quantity")


@of_type("FlowMap")
def _flow_map(flow: FlowMap) -> Card:
    H = flow.H
    card = judged(Card("FlowMap", formulas=energy_formulas(H)), flow.success)
    card.headline = f"estimated errors up to {flow.excess:.2g} of what tol {flow.tol:.1e} allows"
    card.facts = [
        ("outcome", cut(flow.message)),
        ("box", ", ".join(f"{name} from {interval(ends)}" for name, ends in flow.box.items())),
        ("span", f"t from {interval(flow.span)}"),
        ("size", f"{flow.nbytes:,} bytes, {seconds_text(flow.seconds)}"),
        *((name, number(value)) for name, value in flow.fixed.items()),
    ]
    if flow.symplecticity is not None:
        card.facts.append(("M^T J M - J", f"at most {error_text(flow.symplecticity)}"))
    pairs = zip(H.names, flow.error_estimate, strict=True)
    rows = [[H.labelled(name), error_text(error)] for name, error in pairs]
    card.numbers_drawn = 5e4 * H.dim
    return with_table(card, ["component", "largest estimated error"], rows, "component")


@of_type("LyapunovExponents")
def _lyapunov(found: LyapunovExponents) -> Card:
    card = judged(Card("LyapunovExponents"), found.success)
    card.headline = f"largest exponent {number(found.maximal, 4)} per unit of time"
    card.facts = [("H", cut(found.title)), ("method", cut(found.message))]
    if math.isfinite(found.energy_error):
        card.facts.append(("change of H", error_text(found.energy_error)))
    last = found.exponents[-1]
    if len(last) > 1:
        rows = [[f"{k + 1}", number(value, 4)] for k, value in enumerate(last)]
        with_table(card, ["", "exponent"], rows, "exponent")
    card.notes.append(cut(found.statement))
    card.numbers_drawn = found.exponents.size
    return card


@of_type("LyapunovMap")
def _lyapunov_map(found: LyapunovMap) -> Card:
    good, size = int(found.success.sum()), found.success.size
    card = Card("LyapunovMap")
    judged(card, good == size, f"all {size:,}", f"{size - good:,} of {size:,} failed")
    if good:
        own = found.maximal[found.success]
        card.headline = f"largest exponents from {interval((own.min(), own.max()))}"
    card.facts = [("H", cut(found.title)), ("method", f"{found.method}, t to {found.span[1]:.6g}")]
    card.notes.append(cut(found.statement))
    card.numbers_drawn = found.exponents.size
    return card


@of_type("ChaosIndicators")
def _chaos_indicators(found: ChaosIndicators) -> Card:
    card = judged(Card("ChaosIndicators"), found.success)
    mean, sali = found.mean_megno[-1], found.sali[-1]
    card.headline = f"mean MEGNO {number(mean, 4)}, SALI {number(sali, 2)}"
    card.facts = [("H", cut(found.title)), ("method", cut(found.message))]
    card.notes.append(cut(found.statement))
    card.numbers_drawn = found.megno.size
    return card


@of_type("Section")
def _section(section: Section) -> Card:
    card = judged(Card("Section"), section.success)
    starts = len(np.unique(section.trajectory))
    count = counted(len(section.t), "crossing")
    card.headline = (
        f"{count} of {section.surface} by {counted(starts, 'trajectory', 'trajectories')}"
    )
    card.facts = [("outcome", cut(section.message))]
    if section.H is not None:
        card.facts.insert(0, ("H", cut(section.H.formulas)))
    if math.isfinite(section.energy_error):
        card.facts.append(("change of H", error_text(section.energy_error)))
    card.facts.append(("method", f"{section.method}, {seconds_text(section.seconds)}"))
    card.numbers_drawn = section.z.size
    return card


@of_type("Equilibria")
def _equilibria(found: Equilibria) -> Card:
    card = Card("Equilibria", headline=cut(found.message), formulas=energy_formulas(found.H))
    words = {True: "yes", False: "no", None: "?"}
    H, rows = found.H, []
    shown = H.names[:ROWS]
    for place, each in enumerate(found.found[:ROWS], 1):
        exact = each.exact if each.linear is None else None
        values = each.z if exact is None else list(exact)
        state = [number(v) if isinstance(v, float) else str(v) for v in values][:ROWS]
        rows.append([f"{place}", each.type, *state, number(each.energy, 8), words[each.stable]])
    more = [f"and {H.dim - ROWS} more"] if H.dim > ROWS else []
    if more:
        rows = [[*row[:-2], "", *row[-2:]] for row in rows]
    card.left, card.rows = 2, rows
    card.header = ["", "type", *map(H.labelled, shown), *more, "energy", "stable"]
    if len(found.found) > ROWS:
        card.left_out = f"... and {counted(len(found.found) - ROWS, 'equilibrium', 'equilibria')}"
    if found.undecided:
        card.notes.append(f"{counted(len(found.undecided), 'region')} could not be decided.")
    return card


@of_type("Equilibrium")
def _equilibrium(found: Equilibrium) -> Card:
    head, *rest = found.lines
    card = Card("Equilibrium", headline=cut(head))
    card.notes = [cut(line) for line in rest]
    return card


@of_type("PeriodicOrbit")
def _periodic_orbit(orbit: PeriodicOrbit) -> Card:
    H = orbit.H
    card = judged(Card("PeriodicOrbit", formulas=energy_formulas(H)), orbit.success)
    card.headline = f"period {number(orbit.period, 12)}, {orbit.stability}"
    card.facts = [
        ("outcome", cut(orbit.message)),
        ("energy", number(orbit.energy, 12)),
        ("estimated relative error", error_text(orbit.error_estimate)),
        ("isolated", "yes" if orbit.is_isolated else "no"),
        *parameter_facts(H),
    ]
    pairs = zip(H.names, orbit.z0, strict=True)
    rows = [[H.labelled(name), number(value, 12)] for name, value in pairs]
    card.numbers_drawn = 1_000 * H.dim
    return with_table(card, ["component", "start"], rows, "component")


@of_type("OrbitFamily")
def _orbit_family(family: OrbitFamily) -> Card:
    card = judged(Card("OrbitFamily"), family.success)
    card.headline = counted(len(family), "orbit")
    card.facts = [("outcome", cut(family.message))]
    if len(family):
        energies, periods = family.energies, family.periods
        card.facts.append(("energy", interval((energies.min(), energies.max()))))
        card.facts.append(("period", interval((periods.min(), periods.max()))))
        if family.parameter is not None:
            values = family.values
            card.facts.append((family.parameter, interval((values.min(), values.max()))))
    rows = [
        [each.kind, number(each.orbit.energy, 8), number(each.orbit.period, 8)]
        for each in family.bifurcations[: ROWS + 1]
    ]
    card.numbers_drawn = 1_000 * len(family)
    return with_table(card, ["bifurcation", "energy", "period"], rows, "bifurcation")
