"""Words and numbers that descriptions share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from hamsym.facts.facts import Column, Entry, Fact, Facts, Formula
from hamsym.formula.parser import parse_expression
from hamsym.formula.printer import FormulaPrinter
from hamsym.numerics.scales import ratios
from hamsym.support.text_tables import ROWS, share

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


def number(value: Any, digits: int = 6) -> str:
    """A number with some digits."""
    return f"{float(value):.{digits}g}"


def error_text(value: Any) -> str:
    """An error with two digits."""
    value = float(value)
    return f"{value:.1e}" if math.isfinite(value) else "unknown"


def counted(number: int, one: str, many: str = "") -> str:
    """A number of things, in the singular or the plural."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def listed(texts: Sequence[str]) -> str:
    """Texts between commas, of many the first and a count."""
    more = f" and {len(texts) - ROWS:,} more" if len(texts) > ROWS else ""
    return ", ".join(texts[:ROWS]) + more


def interval(ends: Sequence[float]) -> str:
    """The ends of an interval."""
    return f"{number(ends[0])} to {number(ends[1])}"


def seconds_text(value: float) -> str:
    """A time in seconds."""
    return f"{value:.2g} s" if value < 100 else f"{value:,.0f} s"


def evenly(total: int, most: int) -> np.ndarray:
    """Return at most so many numbers from 0 on, evenly chosen, with the first and the last."""
    return np.unique(np.linspace(0, total - 1, min(total, most)).round().astype(int))


def by_name(names: Sequence[str], values: Any) -> dict[str, Any]:
    """Return the components of a state by their names."""
    return dict(zip(names, values, strict=True))


# -- errors against what was asked -----------------------------------------------------------------


def largest_share(errors: np.ndarray, limits: np.ndarray) -> int:
    """Return the component whose error is the largest share of its limit."""
    return int(np.argsort(-ratios(errors, limits), kind="stable")[0])


def against(
    H: Hamiltonian,
    errors: Any,
    limits: Any,
    *,
    what: str = "largest estimated error",
) -> str:
    """Say how large the largest error is against what was asked.

    - errors, limits: Of each component, the limits as they were asked.

    Examples
    --------
    >>> import hamsym
    >>> H = hamsym.Hamiltonian("p**2/2 + x**2/2")
    >>> against(H, [1e-9, 2e-10], [1e-8, 1e-9])
    'largest estimated error 2.0e-10 in p, 20 % of the 1.0e-09 asked'
    """
    errors, limits = np.asarray(errors, dtype=float), np.asarray(limits, dtype=float)
    worst = largest_share(errors, limits)
    name, error, limit = H.names[worst], float(errors[worst]), float(limits[worst])
    if not math.isfinite(error):
        return f"the error is not known, in {name}"
    asked = f"{share(error, limit)} of the {H.quantity(name, limit)} asked"
    return f"{what} {H.quantity(name, error)} in {name}, {asked}"


# -- what was asked --------------------------------------------------------------------------------


def formulas_of(H: Hamiltonian) -> tuple[Formula, ...]:
    """H and the forces."""
    forces = ((f"force of {name}", force) for name, force in H.forces.items())
    return tuple(
        Formula(left, expr, H.notation.text(expr), H.notation)
        for left, expr in (("H", H.expr), *forces)
    )


def problem_facts(H: Hamiltonian, varied: Sequence[str] = ()) -> tuple[Fact, ...]:
    """H with its parameters and units, but for parameters that vary.

    The formulas have no text here, because they are typeset.
    """
    values = {name: value for name, value in H.parameters.items() if name not in varied}
    listed = (f"{name} = {H.quantity(name, value, '')}" for name, value in values.items())
    units = (f"{name} in {unit}" for name, unit in H.units.items())
    facts = [Fact("H", value=H.formula)]
    if H.forces:
        facts.append(Fact("forces", value=dict(H.force_texts)))
    facts.append(Fact("parameters", "parameters", dict(values), ", ".join(listed)))
    if H.units:
        facts.append(Fact("units", "units", dict(H.units), ", ".join(units)))
    return tuple(facts)


def span_fact(span: Sequence[float], unit: str = "") -> Fact:
    """The span of times."""
    start, end = map(float, span)
    text = f"t from {start!r} to {end!r}" + ("" if unit in ("", "1") else f" {unit}")
    return Fact("span", "span", (start, end), text)


def given_of(result: Any, varied: Any = ()) -> tuple[Fact, ...]:
    """What was asked of a result: H, what varies, the span, the method and the tolerance.

    - varied: Names of parameters that differ, with their values where these are known.
    """
    H, ranges = result.H, varied if isinstance(varied, Mapping) else {}
    facts = [*problem_facts(H, tuple(varied))]
    facts += [
        Fact("", name, None, f"{number(own.min())} to {number(own.max())}")
        for name, own in ranges.items()
        if own.size
    ]
    if span := getattr(result, "span", None):
        facts.append(span_fact(span, H.units.get("t", "")))
    if method := getattr(result, "method", ""):
        facts.append(Fact("method", "method", method, method))
    if tol := getattr(result, "tol", None):
        facts.append(Fact("tol", "tolerance", tol, f"{tol:g}"))
    if shape := getattr(result, "shape", ()):
        facts.append(Fact("shape", "shape", shape, " x ".join(map(str, shape))))
    return tuple(facts)


def facts_of(
    result: Any, headline: str, *entries: Entry, varied: Any = (), given: Any = (), **others: Any
) -> Facts:
    """Describe a result that has H, success and a message, and perhaps a span.

    - varied, given: As of :func:`given_of`, and what else was asked.
    - others: Further fields of the facts, or others for these.
    """
    known: dict[str, Any] = {
        "kind": type(result).__name__,
        "message": result.message,
        "success": bool(np.all(result.success)),
        "formulas": formulas_of(result.H),
        "given": (*given_of(result, varied), *given),
    }
    return Facts(headline=headline, entries=entries, **known | others)


def proven(proof: Any, headline: str, *entries: Entry, **others: Any) -> Facts:
    """Describe a proof; ``others`` are further fields of the facts, or others for these."""
    known: dict[str, Any] = {"kind": type(proof).__name__, "success": True, "verdict": "proven"}
    return Facts(headline=headline, entries=entries, **known | others)


def silent(result: Any, names: str) -> tuple[Fact, ...]:
    """Attributes of a result that only JSON has, by their names between spaces."""
    return tuple(Fact(name, value=getattr(result, name)) for name in names.split())


def units_of(H: Hamiltonian) -> Column:
    """The column of the units of the components."""
    return Column("unit", [H.units.get(name, "") for name in H.names])


def time_fact(seconds: float) -> Fact:
    """The run time; without a text if it is not known."""
    return Fact("seconds", "time", seconds, "" if math.isnan(seconds) else seconds_text(seconds))


def energy_unit(H: Hamiltonian) -> str:
    """The unit of H, that of a product of a pair over the time; "" without units."""
    if not H.units:
        return ""
    names = H.q[0].name, H.p[0].name, "t"
    q, p, t = (H.units.get(name, "1") for name in names)
    expr = parse_expression(f"({q})*({p})/({t})")
    angles = {symbol: sympy.Integer(1) for symbol in expr.free_symbols if symbol.name == "rad"}
    unit = FormulaPrinter()(expr.xreplace(angles))
    return "J" if unit == "kg*m**2/s**2" else "" if unit == "1" else unit


def conservation_facts(
    H: Hamiltonian, energies: tuple[float, float], invariants: Mapping[str, Any]
) -> list[Fact]:
    """How well H and the invariants are kept.

    - energies: H at the start, and its largest change without the work of forces.
    """
    start, drift = energies
    unit = f" {energy_unit(H)}".rstrip()
    fact = Fact("energy_error", "|H - E0 - work|", drift, f"at most {drift:.1e}{unit}")
    if H.conserves_energy:
        text = f"{drift:.1e}{unit}, with H = {start:.6g}{unit} at the start"
        fact = Fact("energy_error", "energy error", drift, text)
    lines = (
        Fact("", f"largest change of {formula}:", None, f"{np.max(change):.1e}")
        for formula, change in invariants.items()
    )
    return [fact, Fact("invariants", value=dict(invariants)), *lines]
