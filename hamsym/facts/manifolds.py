"""Facts of stable and unstable manifolds and of connections."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.orbits import complex_text
from hamsym.facts.wording import (
    counted,
    error_text,
    facts_of,
    silent,
    time_fact,
    units_of,
)

if TYPE_CHECKING:
    from hamsym.invariant_manifolds.connection import Connection, Connections
    from hamsym.invariant_manifolds.manifold import Manifold, Manifolds

_POINTS = 1_000  # of a trajectory that a figure evaluates


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
