"""Cards of certificates and enclosures: bounds are rounded outward."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, Context, Decimal, localcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.proof.balls import decimal_above, decimal_below
from hamsym.workbench.notebooks.cards import (
    ROWS,
    Card,
    counted,
    cut,
    energy_formulas,
    judged,
    of_type,
    parameter_facts,
    seconds_text,
    with_details,
    with_table,
)

if TYPE_CHECKING:
    from hamsym import BoxCertificate, Certificate, Enclosure, OrbitCertificate
    from hamsym.families.proofs import Proofs

_THREE_DIGITS = Context(prec=3, rounding=ROUND_CEILING)


def bound_text(certificate: Certificate) -> str:
    """What a certificate bounds, rounded outward."""
    start, end = certificate.edges[0], certificate.edges[-1]
    return (
        f"|z^(t) - z(t)| is at most {decimal_above(certificate.bound)} and somewhere at least "
        f"{decimal_below(certificate.lower)}, t from {start!r} to {end!r}"
    )


@of_type("Certificate")
def _certificate(certificate: Certificate) -> Card:
    card = Card("Certificate", headline=bound_text(certificate))
    judged(card, True, "proven")
    bounds = (
        ("error of H", certificate.energy_bound),
        ("residual", certificate.ell_max_bound),
    )
    card.facts = [
        (name, f"at most {decimal_above(value)}") for name, value in bounds if math.isfinite(value)
    ]
    if certificate.asked is not None:
        card.facts.append(("asked", ", ".join(map(repr, certificate.asked[:ROWS]))))
    card.facts += [
        ("time of the proof", seconds_text(certificate.seconds)),
        ("SHA-256 of the solution", certificate.digest),
    ]
    rows = [
        [name, decimal_below(low), decimal_above(high)]
        for name, low, high in zip(
            certificate.components,
            certificate.component_lowers,
            certificate.component_bounds,
            strict=True,
        )
    ]
    with_table(card, ["component", "error at least", "at most"], rows, "component")
    return with_details(card, "what is proven, and on what it rests", certificate.statement)


@of_type("BoxCertificate")
def _box_certificate(certificate: BoxCertificate) -> Card:
    card = Card("BoxCertificate", headline="the error over the whole box")
    judged(card, True, "proven")
    card.facts = [
        ("box", ", ".join(f"{n} from {a!r} to {b!r}" for n, (a, b) in certificate.box.items())),
        ("span", f"t from {certificate.span[0]!r} to {certificate.span[1]!r}"),
        ("parts", f"{certificate.parts:,}"),
        ("time of the proof", seconds_text(certificate.seconds)),
        ("SHA-256 of the map", certificate.digest),
    ]
    pairs = zip(certificate.components, certificate.bound, strict=True)
    with_table(
        card, ["component", "error at most"], [[n, decimal_above(b)] for n, b in pairs], "component"
    )
    return with_details(card, "what is proven, and on what it rests", certificate.statement)


@of_type("OrbitCertificate")
def _orbit_certificate(certificate: OrbitCertificate) -> Card:
    period = certificate.period
    card = Card(
        "OrbitCertificate",
        headline=f"a periodic orbit exists, with the period {_ball(period.mid, period.radius)}",
    )
    judged(card, True, "proven")
    card.facts = [
        ("stability", certificate.stability),
        (
            "distance from the numerical orbit",
            f"at most {decimal_above(certificate.bound)} of its size",
        ),
        ("unique within", decimal_below(certificate.unique_within)),
        ("time of the proof", seconds_text(certificate.seconds)),
    ]
    balls = zip(np.ravel(certificate.z0.mid), np.ravel(certificate.z0.radius), strict=True)
    rows = [[f"{k + 1}", _ball(*ball)] for k, ball in enumerate(balls)]
    with_table(card, ["component", "start"], rows, "component")
    return with_details(card, "what is proven, and on what it rests", certificate.statement)


def _ball(mid: Any, radius: Any) -> str:
    """A ball to the digits that its radius leaves; what is written contains it."""
    mid, radius = float(mid), float(radius)
    digits = 17
    if radius > 0 and math.isfinite(radius) and mid:
        digits = math.ceil(math.log10(abs(mid) / radius)) + 2 if radius < abs(mid) else 2
    text = f"{mid:.{min(max(digits, 2), 17)}g}"
    if not math.isfinite(radius):
        return f"{text} +- {radius}"
    with localcontext(prec=1_500):  # exact for all float64 numbers
        whole = Decimal(radius) + abs(Decimal(mid) - Decimal(text))
    if not whole:
        return text
    return f"{text} +- {float(_THREE_DIGITS.plus(whole)):.2e}"


@of_type("Enclosure")
def _enclosure(enclosure: Enclosure) -> Card:
    H, (start, end) = enclosure.H, enclosure.span
    last = enclosure(end)
    card = Card("Enclosure", formulas=energy_formulas(H))
    judged(card, True, "proven")
    card.headline = "the true state at every time of the span"
    card.facts = [
        ("span", f"t from {start!r} to {end!r}"),
        ("windows", f"{len(enclosure.windows):,}, {seconds_text(enclosure.seconds)}"),
        *parameter_facts(H, tuple(enclosure.parameters)),
        *((name, _ball(ball.mid, ball.radius)) for name, ball in enclosure.parameters.items()),
    ]
    rows = [
        [H.labelled(name), _ball(*first), _ball(*final)]
        for name, first, final in zip(
            H.names,
            zip(enclosure.z0.mid, enclosure.z0.radius, strict=True),
            zip(last.mid, last.radius, strict=True),
            strict=True,
        )
    ]
    return with_table(card, ["component", "start", "end"], rows, "component")


@of_type("Proofs")
def _proofs(proofs: Proofs) -> Card:
    count, size = int(proofs.proven.sum()), proofs.proven.size
    card = Card("Proofs", headline=f"{count:,} of {size:,} members")
    judged(card, count == size, "all proven", "not all proven")
    failed = np.argwhere(~proofs.proven)
    rows = [[", ".join(map(str, p)), cut(proofs.message[tuple(p)])] for p in failed[:ROWS]]
    card.left, card.header, card.rows = 2, ["member", "reason"], rows
    if len(failed) > ROWS:
        card.left_out = f"... and {counted(len(failed) - ROWS, 'member')}"
    return card
