"""Facts of periodic orbits and of their families."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    error_text,
    facts_of,
    formulas_of,
    interval,
    number,
    problem_facts,
    silent,
    units_of,
)

if TYPE_CHECKING:
    from hamsym.orbits.family import OrbitFamily
    from hamsym.orbits.orbit import PeriodicOrbit


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

    def spread(rows: int) -> list[int]:
        return sorted({round(k * (count - 1) / max(rows - 1, 1)) for k in range(rows)})

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
                "orbits between them",
                [number(value, 10) for value in energies],
                (
                    Column("period", family.periods, ".10g"),
                    Column("stability", family.stabilities),
                ),
                "energy",
                choose=spread,
            ),
            *(Fact("", f"{one.kind}:", None, f"energy {one.orbit.energy:.10g}") for one in found),
            Fact("energy", value=energies),
            Fact("period", value=family.periods),
            *(
                Fact(name, value=family.values)
                for name in (family.parameter,)
                if name is not None and count
            ),
            Fact("stability", value=family.stabilities),
            Fact(
                "bifurcations",
                value=[{"kind": each.kind, "energy": each.orbit.energy} for each in found],
            ),
        ),
        1_000 * count,
    )
