"""Facts of exponents, chaos indicators, sections and equilibria."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.facts.facts import Column, Entry, Fact, Facts, Table
from hamsym.facts.proofs import ball_text
from hamsym.facts.wording import (
    by_name,
    error_text,
    facts_of,
    formulas_of,
    problem_facts,
    proven,
    silent,
    time_fact,
)

if TYPE_CHECKING:
    from hamsym.dynamics.chaos_indicators import ChaosIndicators
    from hamsym.dynamics.equilibrium import Equilibria, Equilibrium
    from hamsym.dynamics.frequencies import Frequencies
    from hamsym.dynamics.lyapunov import LyapunovExponents
    from hamsym.dynamics.lyapunov_map import LyapunovMap
    from hamsym.dynamics.normal_forms import NormalForm
    from hamsym.dynamics.proven_sections import SectionCertificate
    from hamsym.dynamics.sections import Section

_WIDE = 4  # exponents and components in a short table
_REGIONS = 3  # undecided ones that are listed


def _kept(found: Any) -> Fact:
    """How well H was kept, where that is known."""
    error = np.asarray(found.energy_error)
    text = f"{np.nanmax(error):.1e}" if np.isfinite(error).any() else ""
    return Fact("energy_error", "energy error", found.energy_error, text)


def _over_time(
    found: LyapunovExponents | ChaosIndicators, columns: dict[str, np.ndarray]
) -> tuple[Entry, ...]:
    """A table of quantities over time, and their last values."""
    rows = _history_rows(found.t, found.span[0])
    shown = (Column(label, values[rows], ".4e") for label, values in columns.items())
    table = Table("times", [f"{t:.6g}" for t in found.t[rows]], tuple(shown), "t", wide=_WIDE)
    return table, Fact("t", value=found.t[-1]), time_fact(found.seconds)


def _lyapunov(found: LyapunovExponents) -> Facts:
    last = found.exponents[-1]
    several = ", ".join(f"{value:.4g}" for value in last) if len(last) > 1 else ""
    names = [f"exponent {k + 1}" for k in range(len(last))]
    return facts_of(
        found,
        found.statement,
        _kept(found),
        Fact("exponents", "at the end:", last, several),
        *silent(found, "trend"),
        *_over_time(found, dict(zip(names, found.exponents.T, strict=True))),
        drawn=found.exponents.size,
    )


def _chaos_indicators(found: ChaosIndicators) -> Facts:
    curves = {"megno": found.megno, "mean megno": found.mean_megno, "sali": found.sali}
    curves |= {f"gali {k + 2}": own for k, own in enumerate(found.gali.T) if k}
    return facts_of(
        found,
        found.statement,
        _kept(found),
        *(Fact(name.replace(" ", "_"), value=own[-1]) for name, own in curves.items()),
        *_over_time(found, curves),
        drawn=found.megno.size,
    )


def _lyapunov_map(found: LyapunovMap) -> Facts:
    places = list(np.ndindex(found.success.shape))
    columns = [
        Column(f"exponent {k + 1}", found.exponents[..., k].ravel(), ".4e")
        for k in range(found.exponents.shape[-1])
    ]
    failed = [place for place in places if not found.success[place]]
    reasons = (
        Fact("", f"trajectory {', '.join(map(str, place))}:", None, str(found.message[place]))
        for place in failed[:3]
    )
    names = [", ".join(map(str, place)) for place in places]
    return facts_of(
        found,
        found.statement,
        _kept(found),
        Table("trajectories", names, tuple(columns), "trajectory", wide=_WIDE),
        *reasons,
        *silent(found, "exponents"),
        Fact("successes", value=found.success),
        Fact("steps", "steps", found.steps, f"{found.steps.max(initial=0):,} or fewer"),
        time_fact(found.seconds),
        varied=found.parameters,
        message="",
        drawn=found.exponents.size,
        members=found.success.size,
    )


def _frequencies(found: Frequencies) -> Facts:
    fields = ("frequency", "amplitude", "phase", "error", "drift")
    places = [p for p in np.ndindex(found.frequency.shape) if np.isfinite(found.frequency[p])]
    forms = (".10g", ".4g", ".4f", ".1e", ".1e")
    arrays = {name: getattr(found, name) for name in fields}
    columns = [
        Column(name, [arrays[name][place] for place in places], form)
        for name, form in zip(fields, forms, strict=True)
    ]
    names = [", ".join([*map(str, place[:-2]), found.signals[place[-2]]]) for place in places]
    return facts_of(
        found,
        "",
        Table("terms", names, tuple(columns), "signal", wide=_WIDE),
        *(Fact(name, value=own) for name, own in arrays.items()),
        Fact("rest", "rest, relative", found.rest, error_text(np.nanmax(found.rest, initial=0.0))),
        time_fact(found.seconds),
        drawn=found.frequency.size,
    )


def _section(section: Section) -> Facts:
    columns = [Column("t", section.t, ".6g")]
    columns += [Column(n, own, ".5g") for n, own in zip(section.names, section.z.T, strict=True)]
    return facts_of(
        section,
        "",
        _kept(section) if len(section.t) else Fact("energy_error", value=math.nan),
        Table("crossings", section.trajectory, tuple(columns), "trajectory", wide=_WIDE + 1),
        *_proven_crossings(section),
        *silent(section, "dt trajectory t"),
        Fact("z", value=by_name(section.names, section.z.T)),
        Fact("z0", value=by_name(section.names, section.z0.T)),
        time_fact(section.seconds),
        varied=section.parameters,
        given=[Fact("surface", "surface", section.surface, section.surface)],
        drawn=section.z.size,
    )


def _proven_crossings(section: Section) -> list[Fact]:
    proof = section.certificate
    if proof is None:
        return []
    radii = {"t": proof.t.radius, **by_name(section.names, proof.z.radius.T)}
    widest = [f"{name} {error_text(own.max(initial=0.0))}" for name, own in radii.items()]
    return [
        Fact("statement", "proven", proof.statement, proof.statement),
        Fact("radii", "largest radii", radii, ", ".join(widest)),
    ]


def _normal_form(form: NormalForm) -> Facts:
    names = ["*".join(f"I_{k + 1}**{n}" for k, n in enumerate(p) if n) for p in form.coefficients]
    balls = [ball_text(ball.mid, ball.radius) for ball in form.coefficients.values()]
    table = Table("terms", names, (Column("coefficient", balls),), "term")
    omega = map(ball_text, form.frequencies.mid, form.frequencies.radius)
    listed = "; ".join(str(k) for k in form.resonances[:_WIDE])
    return proven(
        form,
        form.statement,
        table,
        Fact("frequencies", "frequencies", form.frequencies.mid, ", ".join(omega)),
        Fact("resonances", "resonant terms left", form.resonances, listed),
        Fact("domain", "estimated domain", form.domain, f"{form.domain:.3g}"),
        verdict="proven" if form.stable else "",
    )


def _section_certificate(found: SectionCertificate) -> Facts:
    balls = list(map(ball_text, found.t.mid, found.t.radius))
    names = [str(k + 1) for k in range(len(balls))]
    table = Table("crossings", names, (Column("t", balls),), "crossing")
    return proven(found, found.statement, table, time_fact(found.seconds))


def _equilibria(found: Equilibria) -> Facts:
    undecided = [Fact("", "undecided:", None, str(region)) for region in found.undecided[:_REGIONS]]
    if (more := len(found.undecided) - _REGIONS) > 0:
        undecided.append(Fact("", "", None, f"and {more:,} further undecided regions"))
    return Facts(
        "Equilibria",
        message=found.message,
        formulas=formulas_of(found.H),
        given=problem_facts(found.H),
        entries=(
            Fact("complete", value=found.complete),
            *undecided,
            _states(found),
            Fact("equilibria", value=[_equilibrium(each).values() for each in found]),
            Fact("undecided", value=[str(region) for region in found.undecided]),
            Fact("seconds", value=found.seconds),
        ),
        drawn=float(len(found)),
    )


def _states(found: Equilibria) -> Table:
    """Types, states and energies, with frequencies and exponents, to as many digits as fit."""
    exact = _table(found, 8)
    return exact if exact.fits else _table(found, 6)


def _table(found: Equilibria, digits: int) -> Table:
    H, each = found.H, found.found
    states = np.array([one.coordinates(digits) for one in each], dtype=object).reshape(-1, H.dim)
    words = {True: "yes", False: "no", None: "?"}
    columns = (
        Column("type", [one.type for one in each], left=True),
        *(Column(H.labelled(name), own) for name, own in zip(H.names, states.T, strict=True)),
        Column("energy", ["" if math.isnan(e) else f"{e:.{digits}g}" for e in found.energies]),
        Column("linearly stable", [words[one.stable] for one in each]),
    )
    names = [f"{place}" for place in range(1, len(each) + 1)]
    return Table("equilibria", names, columns, notes=[_note(one) for one in each])


def _note(each: Equilibrium) -> str:
    """Frequencies, and what is not proven."""
    notes = [
        "" if each.linear is None else each.spectrum,
        "not proven" if each.how == "numerical" else "",
        f"part of a continuum: {each.family}" if each.family else "",
        "on the edge of the box" if each.on_edge else "",
    ]
    return "; ".join(filter(None, notes))


def _equilibrium(found: Equilibrium) -> Facts:
    head, *rest = found.lines
    exact = None if found.exact is None else [str(value) for value in found.exact]
    return Facts(
        "Equilibrium",
        head,
        entries=(
            Fact("state", value=by_name(found.names, found.z)),
            Fact("exact", value=exact),
            *silent(found, "type energy stable how radius family"),
            *silent(found, "" if found.linear is None else "frequencies signatures eigenvalues"),
            *(Fact("", "", None, line) for line in rest),
        ),
    )


def _history_rows(t: np.ndarray, start: float) -> np.ndarray:
    """Return the rows of times of equal ratios: two for each of three decades, and the end.

    Examples
    --------
    >>> t = np.linspace(0.1, 100, 1000)
    >>> t[_history_rows(t, 0.0)].round(1)
    array([  0.1,   0.4,   1. ,   3.2,  10. ,  31.7, 100. ])
    """
    elapsed = np.abs(t - start)
    wanted = np.append(elapsed[-1] * 10.0 ** np.arange(-3, 0, 0.5), elapsed[-1] * (1 - 1e-12))
    rows = np.unique(np.searchsorted(elapsed, wanted))
    return rows[rows < len(t)]
