"""Certificates: proven bounds on what a neural trajectory is off by.

Stage 1  H, J grad H and Hess become functions of balls (:mod:`hamsym.enclosures`).
Stage 2  The equation is solved once more, with proof, to far more digits than the solution has
         (:mod:`hamsym.validated`).
Stage 3  The solution, as the real function that its weights define
         (:mod:`hamsym.trial_enclosures`), is compared with that
         (:mod:`hamsym.comparing_balls`).
Stage 4  Upper bounds are rounded up and lower bounds down to the decimals of a
         :class:`Certificate`.

The proof is in the docstrings of the modules of stages 2 and 3, with every inequality.

Checking a certificate (:func:`verify`) is doing all of this again from the solution itself, until
what the certificate claims is proven or refuted. Of the certificate only the working precision is
used for it.
"""

from __future__ import annotations

import json
import math
import os
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hamsym.archive import digest, load
from hamsym.comparing_balls import Comparison, Goal, Leaf, Quantity, Range, joints_of
from hamsym.enclosures import Enclosures
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.growth import Scout, scout
from hamsym.progress import stepping_progress
from hamsym.rounding import at_least, at_most, decimal, decimal_above, decimal_below
from hamsym.settings import require, require_number, require_positive, require_whole
from hamsym.solution import Solution
from hamsym.trial_enclosures import segments
from hamsym.validated import Deadline, PrecisionError, Reference, validated_reference

__all__ = ["Certificate", "certify", "verify"]

_KIND, _VERSION = "hamsym certificate", 1
_FEWEST_BITS, _MOST_BITS = 64, 2_048
_ACCURACY = 2.0**-62  # of the reference, in units of the components: finer than float64
# What bounds may differ by in any case, in the same units: nothing below it is of interest.
_FLOOR = 2.0**-60
_FLOOR_WITHOUT_REFERENCE = 2.0**-70  # the same of what the reference does not take part in
_PROGRESS = Fraction(1, 1_000)  # of the span, that half as many bits again have to bring
_SPARE_BITS = 4
_TICKS = 1_000  # of progress

_Found = TypeVar("_Found")


@dataclass(frozen=True)
class Certificate:
    """Proven two-sided bounds on the error of one solution, the largest over its span.

    Attributes
    ----------
    bound, lower : float
        The largest |z^(t) - z(t)| over the span, in the 2-norm, is between lower and bound.
    component_bounds, component_lowers : tuple of float
        The same for each component, dim of them.
    energy_bound, energy_lower : float
        For max_t |H(z^(t)) - H(z(t))|; the bound is infinite where H is singular along z^.
    ell_max_bound, ell_max_lower : float
        For max_t |dz^/dt - J grad H(z^)|, the 2-norm.
    edges : tuple of float
        Times that divide the span into pieces, in its direction.
    piece_bounds : tuple of float
        On each piece, a bound on |z^(t) - z(t)|.
    rtol : float
        How close upper and lower bounds were to come.
    bits : int
        Working precision.
    digest : str
        SHA-256 of what defines the solution: H, its parameters, z0, the span and all weights.
    seconds : float
        What the proof took.
    """

    bound: float
    lower: float
    component_bounds: tuple[float, ...]
    component_lowers: tuple[float, ...]
    energy_bound: float
    energy_lower: float
    ell_max_bound: float
    ell_max_lower: float
    edges: tuple[float, ...] = field(repr=False)
    piece_bounds: tuple[float, ...] = field(repr=False)
    rtol: float
    bits: int
    digest: str = field(repr=False)
    seconds: float = field(compare=False)

    def bound_at(self, t: Any) -> Any:
        """A proven bound on |z^(t) - z(t)|, the 2-norm, at times t of the span.

        Parameters
        ----------
        t : float or array

        Returns
        -------
        float or numpy.ndarray
            Shaped as t.

        Raises
        ------
        InputError
            If a time is outside the span.
        """
        times = np.asarray(t, dtype=float)
        values = np.array([self._bound_at(float(time)) for time in times.ravel()])
        return float(values[0]) if times.ndim == 0 else values.reshape(times.shape)

    def _bound_at(self, t: float) -> float:
        direction = 1 if self.edges[-1] > self.edges[0] else -1
        edges = [direction * edge for edge in self.edges]
        # An edge is rounded to float64: at that very number both neighbours are asked.
        first = bisect_left(edges, direction * t) - 1
        last = bisect_right(edges, direction * t) - 1
        if last < 0 or first >= len(self.piece_bounds) or not math.isfinite(t):
            raise InputError(
                f"t = {t:.6g} is outside the span from {self.edges[0]:.6g} to {self.edges[-1]:.6g}"
            )
        places = range(max(first, 0), min(last, len(self.piece_bounds) - 1) + 1)
        return max(self.piece_bounds[place] for place in places)

    @property
    def statement(self) -> str:
        """What is proven, in words."""
        return (
            f"Proven: the largest |z^(t) - z(t)| (2-norm) for t from {self.edges[0]!r} to "
            f"{self.edges[-1]!r} is at least {decimal(self.lower)} and at most "
            f"{decimal(self.bound)}. Here z is the exact solution of Hamilton's equations "
            "from z0, and z^ the real function that the stored weights of the solution define, "
            "without the rounding of its evaluation in floating point, which comes on top. z0, the "
            "span, the parameters and all weights are taken as the exact binary fractions that "
            "they are, numbers in the formula of H as the exact numbers written there. The proof "
            "solves the equation once more: Taylor polynomials with a rigorous bound on their "
            "distance from the exact solution (defect and logarithmic norm), and Taylor expansions "
            f"of z^ with remainders, in ball arithmetic of {self.bits} bits (Arb), every rounding "
            "outward. It rests on the correctness of Arb and of this program; verify() runs it "
            f"again. SHA-256 of the solution: {self.digest}."
        )

    # -- as text ---------------------------------------------------------------------------

    def to_json(self) -> str:
        """The certificate as text.

        Its bounds are decimals of nine digits, upper bounds rounded up, lower bounds down: they
        hold as they are written, and the attributes are the float64 numbers nearest to them.
        """
        values: dict[str, Any] = {"kind": _KIND, "version": _VERSION, "statement": self.statement}
        for name in (*_UPPER, *_LOWER):
            values[name] = _texts(getattr(self, name))
        values["edges"] = [repr(edge) for edge in self.edges]
        values |= {"rtol": repr(self.rtol), "seconds": repr(self.seconds)}
        values |= {"bits": self.bits, "digest": self.digest}
        return json.dumps(values, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Certificate:
        """The certificate that :meth:`to_json` wrote.

        Raises
        ------
        FileError
            If the text is no certificate, or one of a later version.
        """
        try:
            values = json.loads(text, object_pairs_hook=_without_repetition)
            if values["kind"] != _KIND:
                raise ValueError("it is something else")
            if values["version"] != _VERSION:
                raise ValueError(f"it is of version {values['version']}")
            known: dict[str, Any] = {name: _numbers(values[name]) for name in (*_UPPER, *_LOWER)}
            known["edges"] = tuple(float(edge) for edge in values["edges"])
            known |= {name: float(values[name]) for name in ("rtol", "seconds")}
            certificate = cls(**known, bits=int(values["bits"]), digest=str(values["digest"]))
            certificate._check()
            if set(values) != {*json.loads(certificate.to_json())}:
                raise ValueError("it holds what no certificate has")
            if values["statement"] != certificate.statement:
                raise ValueError("its statement is not what its numbers say")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise FileError(f"this text is not a certificate that hamsym reads: {error}") from None
        return certificate

    def _check(self) -> None:
        """Refuse what cannot be a certificate."""
        pieces, edges = self.piece_bounds, self.edges
        if not isinstance(edges, tuple) or not isinstance(pieces, tuple):
            raise ValueError("its pieces are no lists")
        if len(edges) != len(pieces) + 1 or not pieces or not np.isfinite(edges).all():
            raise ValueError("its pieces do not fit together")
        differences = np.diff(edges)
        if not ((differences >= 0).all() or (differences <= 0).all()) or edges[0] == edges[-1]:
            raise ValueError("its edges are not in order")
        if not _FEWEST_BITS <= self.bits <= _MOST_BITS:
            raise ValueError("its precision is out of range")
        if len(self.component_bounds) != len(self.component_lowers):
            raise ValueError("its components do not fit together")
        lowers = (self.lower, *self.component_lowers, self.energy_lower, self.ell_max_lower)
        uppers = (self.bound, *self.component_bounds, self.energy_bound, self.ell_max_bound)
        if not all(
            0 <= low <= high and math.isfinite(low)
            for low, high in zip(lowers, uppers, strict=True)
        ):
            raise ValueError("its bounds are not in order")


_UPPER = ("bound", "component_bounds", "energy_bound", "ell_max_bound", "piece_bounds")
_LOWER = ("lower", "component_lowers", "energy_lower", "ell_max_lower")
assert {*_UPPER, *_LOWER} < {entry.name for entry in fields(Certificate)}


def _texts(value: float | tuple[float, ...]) -> Any:
    return [decimal(number) for number in value] if isinstance(value, tuple) else decimal(value)


def _numbers(value: Any) -> float | tuple[float, ...]:
    return tuple(map(_number, value)) if isinstance(value, list) else _number(value)


def _number(text: str) -> float:
    """A number as it is written; more digits than are written would claim more than is checked."""
    value = float(text)
    if decimal(value) != text:
        raise ValueError(f"'{text}' is not a decimal as certificates have them")
    return value


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) != len(pairs):
        raise ValueError("a name occurs twice")
    return dict(pairs)


# -- proving ------------------------------------------------------------------------------------


def certify(
    solution: Solution,
    rtol: float = 0.02,
    time_limit: float | None = None,
    bits: int | None = None,
    progress: bool | None = None,
) -> Certificate:
    """Prove how large the error of a solution is; see :meth:`hamsym.Solution.certify`."""
    require_number("rtol", rtol, 1e-6)
    require(rtol <= 1e6, "rtol", rtol, "a number such as 0.02")
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    if bits is not None:
        require_whole("bits", bits, _FEWEST_BITS, _MOST_BITS)
    began = time.monotonic()
    proof = _Proof(solution, Deadline.after(time_limit), progress)
    goal = Goal(rtol)

    def attempt(comparison: Comparison) -> tuple[list[Range], list[Leaf]]:
        found: list[Range] = []
        kept: list[Leaf] = []
        leaves: list[Leaf] | None = None
        for quantity in comparison.quantities(proof.floors):
            found.append(comparison.refine(quantity, comparison.leaves(quantity, leaves), goal))
            leaves = found[-1].leaves
            kept = leaves if quantity.name == "norm" else kept
        return found, kept

    used, (found, kept) = proof.run(attempt, bits, _ACCURACY * min(1.0, 50 * rtol))
    uppers = [_rounded_up(entry.upper) for entry in found]
    lowers = [_rounded_down(entry.lower) for entry in found]
    edges, pieces = proof.profile(kept)
    return Certificate(
        bound=uppers[0],
        lower=lowers[0],
        component_bounds=tuple(uppers[1:-2]),
        component_lowers=tuple(lowers[1:-2]),
        energy_bound=uppers[-2],
        energy_lower=lowers[-2],
        ell_max_bound=uppers[-1],
        ell_max_lower=lowers[-1],
        edges=edges,
        piece_bounds=tuple(_rounded_up(upper) for upper in pieces),
        rtol=float(rtol),
        bits=used,
        digest=digest(solution),
        seconds=time.monotonic() - began,
    )


def verify(
    certificate: Certificate | str,
    solution: Solution | str | os.PathLike[str],
    time_limit: float | None = None,
    progress: bool | None = None,
) -> None:
    """Run the proof again, from the solution, and compare it with what a certificate claims.

    Parameters
    ----------
    certificate : Certificate or str
        Or its text (:meth:`Certificate.to_json`).
    solution : Solution or path
        Or a file that :meth:`hamsym.Solution.save` wrote.
    time_limit : float, optional
        Seconds.
    progress : bool, optional

    Raises
    ------
    CertificationError
        Naming the first claim that is not implied by what could be proven.
    FileError
        If the text is no certificate, or the file cannot be read.
    """
    if isinstance(certificate, str):
        certificate = Certificate.from_json(certificate)
    if not isinstance(solution, Solution):
        solution = load(Path(solution))
    claims = certificate
    try:
        claims._check()
    except (ValueError, TypeError, AttributeError) as error:
        raise CertificationError(f"this is no certificate: {error}") from None
    if digest(solution) != claims.digest:
        raise CertificationError("the certificate is of another solution: the digests differ")
    if (claims.edges[0], claims.edges[-1]) != tuple(float(edge) for edge in solution.span):
        raise CertificationError("the certificate is of another span than the solution's")
    if len(claims.component_bounds) != solution.H.dim:
        raise CertificationError("the certificate is of a solution of another dimension")
    proof = _Proof(solution, Deadline.after(time_limit), progress)
    pairs = [
        (claims.bound, claims.lower),
        *zip(claims.component_bounds, claims.component_lowers, strict=True),
        (claims.energy_bound, claims.energy_lower),
        (claims.ell_max_bound, claims.ell_max_lower),
    ]

    def attempt(comparison: Comparison) -> None:
        leaves: list[Leaf] | None = None
        norm: Quantity | None = None
        for quantity, pair in zip(comparison.quantities(proof.floors), pairs, strict=True):
            norm = norm or quantity
            found = _implied(comparison, quantity, comparison.leaves(quantity, leaves), pair)
            leaves = found.leaves
        assert norm is not None
        _verify_pieces(comparison, norm, leaves, claims, proof)

    proof.run(attempt, claims.bits, math.inf)


def _implied(
    comparison: Comparison, quantity: Quantity, leaves: list[Leaf], pair: tuple[float, float]
) -> Range:
    """Bounds at least as good as those claimed."""
    upper, lower = at_most(pair[0]), at_least(pair[1])
    try:
        found = comparison.refine(quantity, leaves, Goal(0.0, (upper, lower)))
        if not (found.upper <= upper and found.lower >= lower):  # as where H is singular along z^
            raise CertificationError("refuted")
        return found
    except (CertificationError, PrecisionError) as error:
        if isinstance(error, CertificationError) and str(error) != "refuted":
            raise
        raise CertificationError(
            f"the certificate does not hold: what it says of the {quantity.name} is not implied by "
            "the proof"
        ) from None


def _verify_pieces(
    comparison: Comparison,
    norm: Quantity,
    leaves: list[Leaf] | None,
    claims: Certificate,
    proof: _Proof,
) -> None:
    ordered = sorted(comparison.leaves(norm, leaves), key=lambda leaf: leaf.centre)
    intervals = list(pairwise([proof.elapsed(edge) for edge in claims.edges]))
    parts = _within(ordered, intervals)
    for (low, high), inside, claimed in zip(intervals, parts, claims.piece_bounds, strict=True):
        if cut := comparison.cut(norm, inside, low, high):
            _implied(comparison, norm, cut, (claimed, 0.0))


def _within(
    ordered: list[Leaf], intervals: Iterable[tuple[Fraction, Fraction]]
) -> Iterator[list[Leaf]]:
    """For intervals that follow each other, the leaves that have more than an end in them."""
    first = 0
    for low, high in intervals:
        while first < len(ordered) and ordered[first].end <= low:
            first += 1
        last = first
        while last < len(ordered) and ordered[last].start < high:
            last += 1
        yield ordered[first:last]


class _Proof:
    """What certifying and verifying have in common."""

    def __init__(self, solution: Solution, deadline: Deadline, progress: bool | None) -> None:
        self._solution, self._deadline, self._progress = solution, deadline, progress
        self._enclosures = Enclosures(solution.H)
        self._parts = segments(solution.trial, solution.span)
        self._z0 = np.asarray(solution.z0, dtype=float)
        self._scout: Scout = scout(solution.H, self._z0, solution.span, solution.scale)
        start, end = (Fraction(float(edge)) for edge in solution.span)
        self._start, self._direction = start, 1 if end > start else -1
        self._total = abs(end - start)

    @property
    def floors(self) -> dict[str, np.ndarray]:
        """Differences of bounds that do not matter, in the units of each quantity."""
        energy = _FLOOR if self._enclosures.time_dependent else _FLOOR_WITHOUT_REFERENCE
        return {
            "error": _FLOOR * np.array(self._scout.scales),
            "energy": np.array(energy * self._scout.energy_scale),
            "ell": np.array(_FLOOR_WITHOUT_REFERENCE * self._scout.rate_scale),
        }

    def profile(self, leaves: list[Leaf]) -> tuple[tuple[float, ...], list[float]]:
        """Times that divide the span into the pieces of the proof, and upper bounds there."""
        start, end = (float(edge) for edge in self._solution.span)
        joints = [self._start + self._direction * place for place in joints_of(leaves)]
        edges = (start, *(float(joint) for joint in joints), end)
        ordered = sorted(leaves, key=lambda leaf: leaf.centre)
        # Edges are rounded to floats: a sliver of the next piece may belong to this one.
        intervals = pairwise([self.elapsed(edge) for edge in edges])
        # Between two edges that are one float there is nothing.
        return edges, [
            max((leaf.upper for leaf in part), default=0.0) for part in _within(ordered, intervals)
        ]

    def elapsed(self, t: float) -> Fraction:
        return self._direction * (Fraction(t) - self._start)

    def run(
        self, attempt: Callable[[Comparison], _Found], bits: int | None, accuracy: float
    ) -> tuple[int, _Found]:
        """The result of an attempt at a precision that is high enough, and that precision."""
        used = self._scout.bits if bits is None else bits
        reached = Fraction(-1)
        while True:
            if used > _MOST_BITS:
                raise self._too_wild(self._scout.until(_MOST_BITS))
            try:
                reference = self._reference(used)
                reached_accuracy = reference.accuracy(self._scout.scales)
                if not reached_accuracy <= accuracy:
                    raise PrecisionError(missing=math.log2(reached_accuracy / accuracy))
                comparison = Comparison(
                    self._enclosures, self._z0, self._parts, reference, self._deadline
                )
                return used, attempt(comparison)
            except PrecisionError as error:
                if bits is not None:
                    raise CertificationError(
                        f"{bits} bits are not enough; leave out bits, or give more"
                    ) from None
                if error.elapsed is not None:
                    # As many bits again bring no progress: so near a singularity none will.
                    if error.elapsed - reached < _PROGRESS * self._total:
                        raise self._too_wild(float(error.elapsed)) from None
                    reached = error.elapsed
                missing = used / 2 if error.missing is None else error.missing + _SPARE_BITS
            used += 32 * math.ceil(missing / 32)

    def _too_wild(self, elapsed: float) -> CertificationError:
        t = self.time(Fraction(elapsed))
        return CertificationError(
            f"nothing can be proven beyond about t = {t:.6g}: nearby solutions part too fast "
            "there, as near a collision, in an escape to infinity or in long chaos; end the span "
            "before"
        )

    def time(self, elapsed: Fraction) -> float:
        return float(self._start + self._direction * elapsed)

    def _reference(self, bits: int) -> Reference:
        with stepping_progress(_TICKS, self._progress) as advance:
            done = 0

            def report(part: float) -> None:
                nonlocal done
                now = int(part * _TICKS)
                advance(now - done)
                done = now

            return validated_reference(
                self._enclosures,
                self._z0,
                self._solution.span,
                self._scout.units,
                bits,
                self._deadline,
                report,
            )


def _rounded_up(value: float) -> float:
    return float(decimal_above(value))


def _rounded_down(value: float) -> float:
    return float(decimal_below(value))
