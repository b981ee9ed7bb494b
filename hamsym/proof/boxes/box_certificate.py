"""Certificates of flow maps: a proven bound for all starts in a box, as data and as JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from hamsym.flow_maps.box import Box
from hamsym.flow_maps.compiled_piece import MAPS
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.proof.arithmetic.balls import decimal_above
from hamsym.support.record_fields import Count, Size
from hamsym.support.records import digest_of
from hamsym.support.sealed_text import SealedText
from hamsym.support.suggestions import suggest_attributes


@suggest_attributes
@dataclass(frozen=True)
class BoxCertificate(SealedText):
    """A proven bound on the error of a flow map, for all starts and parameters in a box.

    ``plot()`` draws the proven bound of each component.

    Attributes
    ----------
    bound : tuple of float
        For each component i: |z^_i(t) - z_i(t)| <= bound[i] for every t of the span and every start
        and parameter in the box.
    components : tuple of str
        Names of the components.
    box : dict of str to (float, float)
        Interval of each input.
    fixed : dict of str to float
        Components of z0 and parameters that do not vary.
    expressions : dict of str to str
        Components of z0 that are functions of inputs.
    span : (float, float)
    formula : str
        H.
    parts : int
        Cells into which the box was cut.
    digest : str
        SHA-256 of what defines the map: H, its parameters, the box and all its numbers.
    seconds : float
        Run time of the proof. ``parts`` and ``seconds`` are not part of the claim.
    """

    _KIND = "hamsym flow map certificate"
    _VERSION = 3
    _LONGEST = 2**20
    _OF = " of a flow map"

    bound: tuple[Size, ...]
    components: tuple[str, ...]
    box: dict[str, tuple[float, float]]
    fixed: dict[str, float]
    expressions: dict[str, str]
    span: tuple[float, float]
    formula: str
    parts: Count
    digest: str = field(repr=False)
    seconds: Size = field(compare=False)

    def check(self) -> None:
        """Raise ValueError unless each component has a bound, and each interval two ends."""
        if not len(self.bound) == len(self.components) > 0:
            raise ValueError("its bounds are not one for each component")
        if not all(low < high for low, high in self.box.values()):
            raise ValueError("its intervals are not in order")

    def __repr__(self) -> str:
        box = ", ".join(f"{name} in [{a!r}, {b!r}]" for name, (a, b) in self.box.items())
        return f"BoxCertificate({self.formula!r}, {box}: {self.bounds})"

    @property
    def bounds(self) -> str:
        """The bound of each component, in words."""
        pairs = zip(self.components, self.bound, strict=True)
        return "errors at most " + ", ".join(f"{n} {decimal_above(value)}" for n, value in pairs)

    @property
    def statement(self) -> str:
        """The claim in words."""
        starts = " and ".join(
            f"every {name} from {low!r} to {high!r}" for name, (low, high) in self.box.items()
        )
        known = {name: repr(value) for name, value in self.fixed.items()} | self.expressions
        fixed = "".join(f", {name} = {text}" for name, text in known.items())
        bounds = " and ".join(
            f"|{name}^(t) - {name}(t)| <= {decimal_above(value)}"
            for name, value in zip(self.components, self.bound, strict=True)
        )
        return (
            f"Proven: for {starts}{fixed} and every t from {self.span[0]!r} to {self.span[1]!r}, "
            f"{bounds}. Here z is the exact solution of Hamilton's equations with "
            f"H = {self.formula}, and z^ the real function that the stored numbers of the flow map "
            "define, without the rounding of its evaluation in floating point, which comes on top; "
            "where two pieces of the map meet it holds for both. All stored numbers are taken as "
            "the exact binary fractions that they are, numbers in the formula of H as the exact "
            "numbers written there. The proof encloses the defect of the map by Taylor models, "
            "every rounding outward, and its growth by the linear equation of the error with a "
            f"bound on the second order, on {self.parts} parts of the box; verify() runs it again. "
            f"SHA-256 of the map: {self.digest}."
        )


def map_digest(flow: FlowMap) -> str:
    """SHA-256 of a flow map as a function."""
    kind = tuple[Box, tuple[float, float], Annotated[Any, MAPS]]
    return digest_of((flow.region, flow.span, flow.map), kind)
