"""Facts of certificates and enclosures: bounds hold as they are written."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, Context, Decimal, localcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.facts.facts import Column, Fact, Facts, Table
from hamsym.facts.wording import (
    by_name,
    error_text,
    formulas_of,
    given_of,
    largest_share,
    proven,
    seconds_text,
    silent,
    span_fact,
    units_of,
)
from hamsym.proof.arithmetic.balls import decimal, decimal_above, decimal_below

if TYPE_CHECKING:
    from hamsym.families.proofs import Proofs
    from hamsym.orbits.certificate import OrbitCertificate
    from hamsym.proof.boxes.box_certificate import BoxCertificate
    from hamsym.proof.windows.certificate import Certificate
    from hamsym.proof.windows.enclose import Enclosure

_BOUNDS = "bound lower energy_bound energy_lower ell_max_bound ell_max_lower"
_THREE_DIGITS = Context(prec=3, rounding=ROUND_CEILING)


def _certificate(certificate: Certificate) -> Facts:
    names, bounds, asked = certificate.components, certificate.component_bounds, certificate.asked
    worst = (
        int(np.argmax(bounds)) if asked is None else largest_share(*map(np.array, (bounds, asked)))
    )
    headline = f"error of {names[worst]} at most {decimal(bounds[worst])}"
    if asked is not None:
        headline += f", where {decimal(asked[worst])} was asked"
    headline += f"; of the state at most {decimal(certificate.bound)} (2-norm)"
    rows = ["|z|", *names, "H", "ell_max"]
    lowers = [certificate.lower, *certificate.component_lowers]
    lowers += [certificate.energy_lower, certificate.ell_max_lower]
    highs = [certificate.bound, *bounds, certificate.energy_bound, certificate.ell_max_bound]
    limits = [""] * len(names) if asked is None else list(map(decimal, asked))
    by_size = sorted(range(len(names)), key=bounds.__getitem__, reverse=True)
    order = [0, len(rows) - 2, len(rows) - 1, *(k + 1 for k in by_size)]
    table = Table(
        "components with smaller bounds",
        rows,
        (
            Column("at least", lowers, decimal),
            Column("at most", highs, decimal),
            Column("asked", ["", *limits, "", ""]),
        ),
        head="error of",
        choose=lambda count: sorted(order[:count]),
    )
    return proven(
        certificate,
        headline,
        table,
        *silent(certificate, _BOUNDS),
        Fact("component_bounds", value=by_name(names, bounds)),
        Fact("component_lowers", value=by_name(names, certificate.component_lowers)),
        Fact("asked", value=None if asked is None else by_name(names, asked)),
        *_proof(certificate),
        given=(span_fact(certificate.span),),
        drawn=len(certificate.edges),
    )


def _proof(certificate: Any) -> tuple[Fact, ...]:
    """What is proven, of what, and how long it took."""
    seconds = certificate.seconds
    return (
        Fact("statement", "", certificate.statement, certificate.statement),
        Fact("digest", value=certificate.digest),
        Fact("seconds", "proven in", seconds, f"{seconds:.2f} s"),
    )


def _box_certificate(certificate: BoxCertificate) -> Facts:
    ends = [f"{name} from {low!r} to {high!r}" for name, (low, high) in certificate.box.items()]
    bounds = Column("at most", certificate.bound, decimal_above, "component_bounds")
    return proven(
        certificate,
        f"{certificate.bounds} over the whole box",
        Table("components", certificate.components, (bounds,), "error of"),
        Fact("parts", "parts of the box", certificate.parts, f"{certificate.parts:,}"),
        *_proof(certificate),
        given=(
            Fact("H", "H =", certificate.formula, certificate.formula),
            Fact("box", "box", dict(certificate.box), ", ".join(ends)),
            span_fact(certificate.span),
        ),
        drawn=len(certificate.bound),
    )


def _orbit_certificate(certificate: OrbitCertificate) -> Facts:
    period, z0 = certificate.period, certificate.z0
    start = Column("start", list(map(ball_text, np.ravel(z0.mid), np.ravel(z0.radius))))
    away = f"at most {decimal_above(certificate.bound)} of its size"
    unique = certificate.unique_within
    return proven(
        certificate,
        f"a periodic orbit exists, with the period {ball_text(period.mid, period.radius)}",
        Table("components", list(certificate.components), (start,), "component"),
        Fact("stability", "stability:", certificate.stability, certificate.stability),
        Fact("bound", "distance from the numerical orbit", certificate.bound, away),
        Fact("unique_within", "unique within", unique, decimal_below(unique)),
        Fact("pieces", "pieces", certificate.pieces, f"{certificate.pieces:,}"),
        *_proof(certificate),
    )


def _enclosure(enclosure: Enclosure) -> Facts:
    H, last = enclosure.H, enclosure(enclosure.span[1])
    names, first = list(H.names), enclosure.z0
    width = last.width
    widest = int(np.argmax(last.radius))
    columns = [
        Column(label, list(map(ball_text, ball.mid, ball.radius)))
        for label, ball in (("start", first), ("end", last))
    ]
    balls = {name: ball_text(own.mid, own.radius) for name, own in enclosure.parameters.items()}
    count = len(enclosure.windows)
    parts = max(getattr(window, "parts", 0) for window in enclosure.windows)
    of_set = (Fact("parts", value=parts),) if parts else ()
    cost = f"{seconds_text(enclosure.seconds)} on {count:,} windows"
    return proven(
        enclosure,
        f"the true state at every time of the span, to {error_text(width)} at the end, the widest "
        f"in {names[widest]}",
        Table("components", names, (units_of(H), *columns)),
        Fact("width", value=width),
        Fact("windows", value=count),
        *of_set,
        Fact("seconds", "proven in", enclosure.seconds, cost),
        formulas=formulas_of(H),
        given=(
            *given_of(enclosure, tuple(enclosure.parameters)),
            *(Fact("", name, None, text) for name, text in balls.items()),
        ),
    )


def ball_text(mid: Any, radius: Any) -> str:
    """A ball to the digits that its radius leaves; what is written contains it."""
    mid, radius = float(mid), float(radius)
    digits = 17
    if radius > 0 and math.isfinite(radius) and mid:
        digits = (
            math.ceil(math.log10(abs(mid)) - math.log10(radius)) + 2 if radius < abs(mid) else 2
        )
    text = f"{mid:.{min(max(digits, 2), 17)}g}"
    if not math.isfinite(radius):
        return f"{text} +- {radius}"
    with localcontext(prec=1_500):  # exact for all float64 numbers
        whole = Decimal(radius) + abs(Decimal(mid) - Decimal(text))
    if not whole:
        return text
    return f"{text} +- {float(_THREE_DIGITS.plus(whole)):.2e}"


def _proofs(proofs: Proofs) -> Facts:
    count, size = int(proofs.proven.sum()), proofs.proven.size
    failed = np.argwhere(~proofs.proven)
    most = decimal_above(proofs.bounds[proofs.proven].max(initial=0.0))
    errors = f", errors at most {most}" if count else ""
    reasons = [" ".join(str(proofs.message[tuple(place)]).split()) for place in failed]
    places = [", ".join(map(str, place)) for place in failed]
    return proven(
        proofs,
        f"{count:,} of {size:,} members{errors}",
        Table("members", places, (Column("reason", reasons, left=True),), "member"),
        success=count == size,
        verdict="all proven" if count == size else "not all proven",
    )
