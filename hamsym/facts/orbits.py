"""Facts of periodic orbits, their families, their manifolds and connections."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    counted,
    error_text,
    evenly,
    facts_of,
    formulas_of,
    interval,
    number,
    problem_facts,
    silent,
    time_fact,
    units_of,
)

if TYPE_CHECKING:
    from hamsym.invariant_manifolds.connection import Connection, Connections
    from hamsym.invariant_manifolds.manifold import Manifold, Manifolds
    from hamsym.orbits.family import OrbitFamily
    from hamsym.orbits.orbit import PeriodicOrbit

_POINTS = 1_000  # of a trajectory that a figure evaluates


def _periodic_orbit(orbit: PeriodicOrbit) -> Facts:
    H, isolated = orbit.H, orbit.is_isolated
    multipliers = ", ".join(map(complex_text, orbit.multipliers))
    error = f"largest estimated error {error_text(orbit.relative_error)} of each component's size"
    return facts_of(
        orbit,
        error if orbit.success else "",
        *silent(orbit, "relative_error"),
        Fact("period", "period", orbit.period, f"{orbit.period:.15g}"),
        Fact("energy", "energy", orbit.energy, f"{orbit.energy:.15g}"),
        Fact("stability", "stability:", orbit.stability, orbit.stability),
        Fact("multipliers", "multipliers:", orbit.multipliers, multipliers),
        Fact("isolated", "isolated:", isolated, "yes" if isolated else "no", brief=False),
        Table("components", H.names, (units_of(H), Column("start", orbit.z0, " .16g", "start"))),
        Fact("seconds", "time", orbit.seconds, f"{orbit.seconds:.2g} s", brief=False),
        verdict="converged" if orbit.success else "failed",
        drawn=1_000 * H.dim,
    )


def complex_text(value: complex) -> str:
    """Return a complex number as text, without an imaginary part of round-off."""
    if abs(value.imag) < 1e-12 * abs(value):
        return f"{value.real:.8g}"
    return f"{value.real:.8g}{value.imag:+.8g}i"


def _orbit_family(family: OrbitFamily) -> Facts:
    count, found = len(family), family.bifurcations
    energies, headline = family.energies, "no orbits"
    if count:
        headline = f"{count:,} orbits, energy {interval((energies.min(), energies.max()))}"

    kinds = [{"kind": one.kind, "energy": one.orbit.energy} for one in found]
    labels = [number(value, 10) for value in energies]
    columns = (
        Column("period", family.periods, ".10g"),
        Column("stability", family.stabilities),
    )

    return Facts(
        "OrbitFamily",
        headline,
        family.message,
        bool(family.success),
        "family",
        formulas_of(family.H) if count else (),
        problem_facts(family.H, [family.parameter or ""]) if count else (),
        (
            Table(
                "orbits between them", labels, columns, "energy", choose=lambda n: evenly(count, n)
            ),
            *(Fact("", f"{one.kind}:", None, f"energy {one.orbit.energy:.10g}") for one in found),
            Fact("energy", value=energies),
            Fact("period", value=family.periods),
            *([Fact(family.parameter, value=family.values)] if family.parameter and count else []),
            Fact("stability", value=family.stabilities),
            Fact("bifurcations", value=kinds),
        ),
        1_000 * count,
    )


# -- manifolds -------------------------------------------------------------------------------------


def _rates(part: Any) -> tuple[str, str]:
    """What the rates of a manifold are called, and their text."""
    name = "exponents" if part.departure.period is None else "multipliers"
    return name, ", ".join(map(complex_text, part.rates))


def _manifold(part: Manifold) -> Facts:
    name, rates = _rates(part)
    ends = np.abs(part.ends - part.departure.start)
    columns = (Column("time", ends, ".6g"), Column("length", part.lengths, ".6g"))
    return facts_of(
        part,
        f"{part.kind}, of dimension {part.dimension}, local error {error_text(part.local_error)}",
        Fact("dimension", "dimension", part.dimension, str(part.dimension)),
        Fact("rates", name, part.rates, rates),
        Fact("local_error", "error of the starts", part.local_error, error_text(part.local_error)),
        Fact("gap", "largest gap of neighbours", part.gap, f"{part.gap:.2g} of the extent"),
        Table("trajectories", [str(k) for k in range(len(part))], columns, "number"),
        time_fact(part.seconds),
        verdict="grown" if part.success else "incomplete",
        drawn=_POINTS * len(part),
    )


def _manifolds(found: Manifolds) -> Facts:
    parts = found.unstable, found.stable
    columns = (
        Column("dimension", [part.dimension for part in parts]),
        Column("trajectories", [len(part) for part in parts]),
        Column("rates", [_rates(part)[1] for part in parts]),
        Column("local error", [part.local_error for part in parts], ".1e"),
    )
    errors = [error_text(part.local_error) for part in parts]
    return facts_of(
        found,
        f"stable and unstable manifold, local errors {errors[0]} and {errors[1]}",
        Table("manifolds", ["unstable", "stable"], columns, "manifold"),
        time_fact(found.seconds),
        verdict="grown" if found.success else "incomplete",
        drawn=_POINTS * sum(map(len, parts)),
    )


def _connection(one: Connection) -> Facts:
    return facts_of(
        one,
        f"both parts meet to {error_text(one.mismatch)}, estimated error {error_text(one.error)}",
        Fact("surface", "section", one.surface, one.surface),
        Fact("mismatch", "mismatch", one.mismatch, error_text(one.mismatch)),
        Fact("error", "estimated error", one.error, error_text(one.error)),
        Fact("transversality", "transversality", one.transversality, f"{one.transversality:.3g}"),
        Fact("energy", "energy", one.energy, f"{one.energy:.15g}"),
        Table("components", one.H.names, (units_of(one.H), Column("state", one.z, " .16g", "z"))),
        verdict="converged" if one.success else "failed",
        drawn=_POINTS * one.H.dim,
    )


def _connections(found: Connections) -> Facts:
    columns = [Column("mismatch", [one.mismatch for one in found], ".1e")]
    columns += [Column("transversality", [one.transversality for one in found], ".3g")]
    columns += [
        Column(name, [float(one.z[k]) for one in found], ".10g")
        for k, name in enumerate(found.H.names)
    ]
    return facts_of(
        found,
        f"{counted(len(found), 'connection')} on {found.surface}",
        Table("connections", [str(k) for k in range(len(found))], tuple(columns), "number"),
        *silent(found, "success"),
        time_fact(found.seconds),
        given=[Fact("surface", "section", found.surface, found.surface)],
        verdict="found" if found.success else "none",
        drawn=10 * (len(found.cuts[0].t) + len(found.cuts[1].t)),
    )
