"""Certificates: proven bounds on the error of a solution, as data and as JSON."""

from __future__ import annotations

import math
import re
import reprlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import FileError, InputError
from hamsym.formula.parser import check_name
from hamsym.proof.balls import decimal, decimal_above, decimal_below
from hamsym.proof.certificate_text import opened, sealed
from hamsym.suggestions import suggest_attributes
from hamsym.support.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KIND = "hamsym certificate"
_VERSION = 3

# Difference of upper and lower bounds that is always small enough, in units of the components.
FLOOR = 2.0**-60

LEAST_RTOL, MOST_RTOL = 1e-6, 1e6
_MOST_EDGES = 200_000  # times that divide the span
_LONGEST_TEXT = 16 * 2**20  # characters of a certificate with so many edges


@suggest_attributes
@dataclass(frozen=True)
class Certificate(Shown):
    """Proven two-sided bounds on the error of one solution, the largest over its span.

    Attributes
    ----------
    bound, lower : float
        Bounds on the largest |z^(t) - z(t)| over the span, in the 2-norm.
    component_bounds, component_lowers : tuple of float
        The same for each of the dim components.
    energy_bound, energy_lower : float
        For max_t |H(z^(t)) - H(z(t))|; the bound is infinite where H is singular along z^.
    ell_max_bound, ell_max_lower : float
        For max_t |dz^/dt - J grad H(z^)|, the 2-norm.
    edges : tuple of float
        Distinct times that divide the span into pieces, in its direction.
    piece_bounds : tuple of float
        A bound on |z^(t) - z(t)| on each piece, both edges included. Where two windows of a
        solution meet, z^ has two values, which differ by round-off: at such an edge the bound of a
        piece applies to the value of the window in that piece, and :meth:`bound_at` bounds both.
    rtol : float
        Relative tolerance of the difference between upper and lower bounds.
    digest : str
        SHA-256 of what defines the solution: H, its parameters, z0, the span and all weights.
    seconds : float
        Run time of the proof. ``rtol`` and ``seconds`` are not part of the claim.
    components : tuple of str
        Names of the components, for texts and figures.
    asked : tuple of float or None
        The bound on each component's error that was asked for, and is proven.
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
    digest: str = field(repr=False)
    seconds: float = field(compare=False)
    components: tuple[str, ...] = field(compare=False)
    asked: tuple[float, ...] | None = None

    def __repr__(self) -> str:
        start, end = self.edges[0], self.edges[-1]
        return (
            f"Certificate(error at least {decimal(self.lower)} and at most {decimal(self.bound)}, "
            f"t from {start:.6g} to {end:.6g})"
        )

    @property
    def span(self) -> tuple[float, float]:
        """First and last of the edges."""
        return self.edges[0], self.edges[-1]

    def bound_at(self, t: Any) -> Any:
        """A proven bound on |z^(t) - z(t)|, the 2-norm, at times t of the span.

        Parameters
        ----------
        t : float or array

        Returns
        -------
        float or numpy.ndarray
            Shaped as t; at an edge the larger bound of the two pieces that meet there.

        Raises
        ------
        InputError
            If a time is outside the span.
        """
        try:
            times = np.asarray(t, dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise InputError("t must be a number or an array of numbers") from None
        values = np.array([self._bound_at(float(time)) for time in times.ravel()])
        return float(values[0]) if times.ndim == 0 else values.reshape(times.shape)

    def _bound_at(self, t: float) -> float:
        direction = 1 if self.edges[-1] > self.edges[0] else -1
        edges = [direction * edge for edge in self.edges]
        # At an edge both neighbours count, because z^ may have the values of two windows.
        first = bisect_left(edges, direction * t) - 1
        last = bisect_right(edges, direction * t) - 1
        if last < 0 or first >= len(self.piece_bounds) or not math.isfinite(t):
            raise InputError(
                f"t = {t:.6g} is outside the span from {self.edges[0]:.6g} to {self.edges[-1]:.6g}"
            )
        places = range(max(first, 0), min(last, len(self.piece_bounds) - 1) + 1)
        return max(self.piece_bounds[place] for place in places)

    def plot(self, *names: Any, ax: Any = None) -> Figure:
        """Draw the proven bound over time, and the bounds of each component.

        Parameters
        ----------
        *names : {"bound", "components"}
            One of these panels alone.
        ax : matplotlib.axes.Axes, optional
            Axes to draw one panel into, in your own style.

        Raises
        ------
        InputError
            If a name is unknown, or ``ax`` is given for two panels.
        """
        return hamsym.plot(self, *names, ax=ax)

    @property
    def statement(self) -> str:
        """The claim in words."""
        asked = ""
        if self.asked is not None:
            asked = (
                "As asked, the error of each component is proven to be at most "
                f"{', '.join(map(decimal, self.asked))}. "
            )
        return (
            f"Proven: the largest |z^(t) - z(t)| (2-norm) for t from {self.edges[0]!r} to "
            f"{self.edges[-1]!r} is at least {decimal(self.lower)} and at most "
            f"{decimal(self.bound)}. {asked}Here z is the exact solution of Hamilton's equations "
            "from z0, and z^ the real function that the stored weights of the solution define, "
            "without the rounding of its evaluation in floating point, which comes on top. z0, the "
            "span, the parameters and all weights are taken as the exact binary fractions that "
            "they are, numbers in the formula of H as the exact numbers written there. The proof "
            "solves the equation once more: on windows, polynomials near the exact solution and "
            "its derivatives with rigorous bounds on their distance (defect, logarithmic norm, "
            "sets of Lohner), and Chebyshev models of z^, in sums of two float64 numbers, 106 "
            "bits, with bounds on every rounding. It rests on the correctness of float64 "
            "arithmetic (IEEE 754), of Arb for constants and of this program; verify() runs it "
            "again. "
            f"SHA-256 of the solution: {self.digest}."
        )

    # -- as text ---------------------------------------------------------------------------

    def to_json(self) -> str:
        """Write the certificate as text.

        Bounds are decimals of nine digits, upper bounds rounded up, lower bounds down. They hold as
        written; the attributes are the nearest float64 numbers.
        """
        values: dict[str, Any] = {"kind": _KIND, "version": _VERSION}
        values["statement"] = self.statement
        for name in (*UPPER, *LOWER):
            values[name] = _texts(getattr(self, name))
        values["edges"] = [repr(edge) for edge in self.edges]
        values |= {"rtol": repr(self.rtol), "seconds": repr(self.seconds)}
        values |= {"digest": self.digest, "components": list(self.components)}
        values["asked"] = None if self.asked is None else [repr(part) for part in self.asked]
        return sealed(values)

    @classmethod
    def from_json(cls, text: str) -> Certificate:
        """Read a certificate that :meth:`to_json` wrote.

        Raises
        ------
        FileError
            If the text is not a certificate, or is one of another version.
        """
        try:
            return _from_json(text)
        except (ValueError, RecursionError) as error:
            raise FileError(f"the text is not a certificate of this version: {error}") from None


UPPER = ("bound", "component_bounds", "energy_bound", "ell_max_bound", "piece_bounds")
LOWER = ("lower", "component_lowers", "energy_lower", "ell_max_lower")
LISTS = ("component_bounds", "component_lowers", "edges", "piece_bounds")
WRITTEN_OUT = ("edges", "rtol", "seconds")  # with all digits, as is asked
NAMES = {"kind", "version", "statement"} | {entry.name for entry in fields(Certificate)}
assert {*UPPER, *LOWER, *LISTS, *WRITTEN_OUT} < NAMES


def _from_json(text: str) -> Certificate:
    values = opened(text, _LONGEST_TEXT)
    if values["kind"] != _KIND:
        raise ValueError(f"its kind is not '{_KIND}'")
    if type(values.get("version")) is not int or values["version"] != _VERSION:
        raise ValueError(f"its version is not {_VERSION}")
    if values.keys() != NAMES:
        raise ValueError("it has missing or extra entries")
    known: dict[str, Any] = {name: _numbers(values[name]) for name in (*UPPER, *LOWER)}
    known |= {name: _numbers(values[name], repr) for name in WRITTEN_OUT}
    asked = values["asked"]
    known["asked"] = None if asked is None else _numbers(asked, repr)
    if not isinstance(values["components"], list):
        raise ValueError("its components are not a list of names")
    known["components"] = tuple(values["components"])
    certificate = Certificate(**known, digest=values["digest"])
    check(certificate)
    if values["statement"] != certificate.statement:
        raise ValueError("its statement does not match its numbers")
    return certificate


def check(certificate: Certificate) -> None:
    """Check types, ranges and order of the numbers in a certificate.

    Raises
    ------
    ValueError
        Naming the first entry that is not valid.
    """
    for entry in fields(certificate):
        value = getattr(certificate, entry.name)
        if entry.name in LISTS:
            valid = isinstance(value, tuple) and all(type(part) is float for part in value)
        elif entry.name == "components":
            valid = isinstance(value, tuple) and all(type(part) is str for part in value)
        elif entry.name == "digest":
            valid = type(value) is str
        elif entry.name == "asked":
            valid = value is None or (
                isinstance(value, tuple) and all(type(part) is float for part in value)
            )
        else:
            valid = type(value) is float
        if not valid:
            raise ValueError(f"its {entry.name} has another type than certify writes")
    if not LEAST_RTOL <= certificate.rtol <= MOST_RTOL:
        raise ValueError("its rtol is out of range")
    if not 0 <= certificate.seconds < math.inf:
        raise ValueError("its seconds are not a duration")
    if not re.fullmatch("[0-9a-f]{64}", certificate.digest):
        raise ValueError("its digest is not a SHA-256")
    if certificate.asked is not None:
        pairs = zip(certificate.component_bounds, certificate.asked, strict=True)
        if not all(0 <= bound <= asked < math.inf for bound, asked in pairs):
            raise ValueError("the bounds that it was asked for are not proven by its own")
    if len(certificate.components) != len(certificate.component_bounds) or (
        len({*certificate.components}) != len(certificate.components)
    ):
        raise ValueError("its components do not have a name each")
    for name in certificate.components:
        check_name(name)
    _check_pieces(certificate.edges, certificate.piece_bounds)
    _check_bounds(certificate)


def _check_pieces(edges: tuple[float, ...], bounds: tuple[float, ...]) -> None:
    if len(edges) != len(bounds) + 1 or not bounds or len(edges) > _MOST_EDGES:
        raise ValueError("the numbers of its edges and pieces do not match")
    direction = 1 if edges[-1] > edges[0] else -1
    if not all(
        math.isfinite(low) and math.isfinite(high) and direction * low < direction * high
        for low, high in pairwise(edges)
    ):
        raise ValueError("its edges are not in order")
    if not all(bound >= 0 for bound in bounds):
        raise ValueError("its bounds on pieces are not numbers from 0 on")


def _check_bounds(claims: Certificate) -> None:
    if len(claims.component_bounds) != len(claims.component_lowers):
        raise ValueError("the numbers of its component bounds do not match")
    lowers = (claims.lower, *claims.component_lowers, claims.energy_lower, claims.ell_max_lower)
    uppers = (claims.bound, *claims.component_bounds, claims.energy_bound, claims.ell_max_bound)
    if not all(
        0 <= low <= high and math.isfinite(low) for low, high in zip(lowers, uppers, strict=True)
    ):
        raise ValueError("its bounds are not in order")


def _texts(value: float | tuple[float, ...]) -> Any:
    return [decimal(number) for number in value] if isinstance(value, tuple) else decimal(value)


def _numbers(value: Any, written: Callable[[float], str] = decimal) -> float | tuple[float, ...]:
    if isinstance(value, list):
        return tuple(_number(text, written) for text in value)
    return _number(value, written)


def _number(text: Any, written: Callable[[float], str]) -> float:
    """A number in exactly the written form; extra digits would claim more than is checked."""
    try:
        value = float(text) if isinstance(text, str) else math.nan
    except ValueError:
        value = math.nan
    if written(value) != text:
        raise ValueError(f"{reprlib.repr(text)} is not a number in the form of a certificate")
    return value


def rounded_up(value: float) -> float:
    return float(decimal_above(value))


def rounded_down(value: float) -> float:
    return float(decimal_below(value))
