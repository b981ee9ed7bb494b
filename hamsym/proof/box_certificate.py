"""Certificates of flow maps: a proven bound for all starts in a box, as data and as JSON."""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import hamsym
from hamsym.description import described
from hamsym.errors import FileError
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.proof.balls import decimal_above
from hamsym.proof.certificate_text import BOX_KIND, opened, sealed
from hamsym.suggestions import suggest_attributes
from hamsym.support.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_VERSION = 2
_LONGEST_TEXT = 2**20


@suggest_attributes
@dataclass(frozen=True)
class BoxCertificate(Shown):
    """A proven bound on the error of a flow map, for all starts and parameters in a box.

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

    bound: tuple[float, ...]
    components: tuple[str, ...]
    box: dict[str, tuple[float, float]]
    fixed: dict[str, float]
    expressions: dict[str, str]
    span: tuple[float, float]
    formula: str
    parts: int
    digest: str = field(repr=False)
    seconds: float = field(compare=False)

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the proven bound of each component.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into, in your own style.
        """
        return hamsym.plot(self, ax=ax)

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

    def to_json(self) -> str:
        """Write the certificate as text; numbers have all digits."""
        values: dict[str, Any] = {
            "kind": BOX_KIND,
            "version": _VERSION,
            "statement": self.statement,
        }
        values |= {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return sealed(values)

    @classmethod
    def from_json(cls, text: str) -> BoxCertificate:
        """Read a certificate that :meth:`to_json` wrote.

        Raises
        ------
        FileError
            If the text is not a certificate of a flow map, or is one of another version.
        """
        try:
            return _from_json(text)
        except (ValueError, TypeError, RecursionError, AttributeError) as error:
            raise FileError(
                f"the text is not a certificate of a flow map of this version: {error}"
            ) from None


def _from_json(text: str) -> BoxCertificate:
    values = opened(text, _LONGEST_TEXT)
    if values.pop("kind") != BOX_KIND:
        raise ValueError(f"its kind is not '{BOX_KIND}'")
    if values.pop("version", None) != _VERSION:
        raise ValueError(f"its version is not {_VERSION}")
    statement = values.pop("statement", None)
    if values.keys() != {entry.name for entry in fields(BoxCertificate)}:
        raise ValueError("it has missing or extra entries")
    values["box"] = {name: tuple(map(_number, ends)) for name, ends in values["box"].items()}
    values["fixed"] = {name: _number(value) for name, value in values["fixed"].items()}
    for name in ("bound", "span"):
        values[name] = tuple(map(_number, values[name]))
    if not isinstance(values["components"], list):
        raise ValueError("its components are not a list of names")
    values["components"] = tuple(values["components"])
    found = BoxCertificate(**values)
    texts = (*found.expressions, *found.expressions.values(), *found.box, *found.fixed)
    plain = (found.formula, found.digest, *found.components, *texts)
    if not all(isinstance(entry, str) for entry in plain) or type(found.parts) is not int:
        raise ValueError("an entry has another type than certify writes")
    if not (len(found.bound) == len(found.components) > 0 and min(found.bound) >= 0):
        raise ValueError("its bounds are not numbers from 0 on, one for each component")
    if len(found.span) != 2 or not all(
        len(ends) == 2 and ends[0] < ends[1] for ends in found.box.values()
    ):
        raise ValueError("its intervals are not in order")
    if not re.fullmatch("[0-9a-f]{64}", found.digest):
        raise ValueError("its digest is not a SHA-256")
    if not 0 <= _number(found.seconds) < math.inf or statement != found.statement:
        raise ValueError("its statement does not match its numbers")
    return found


def _number(value: Any) -> float:
    if type(value) is not float or not math.isfinite(value):
        raise ValueError(f"{str(value)[:40]} is not a finite number")
    return value


def map_digest(flow: FlowMap) -> str:
    """SHA-256 of a flow map as a function."""
    values = {
        "version": 1,
        "H": described(flow.H),
        "names": list(flow.inputs),
        "fixed": {name: float(value).hex() for name, value in flow.region.fixed.items()},
        "expressions": dict(flow.region.expressions),
        "span": [float(t).hex() for t in flow.span],
        "map": flow.map.describe(),
    }
    found = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for name, numbers in sorted(flow.map.arrays().items()):
        data = numbers.astype("<f8")
        found.update(f"{name} {list(data.shape)} ".encode())
        found.update(data.tobytes())
    return found.hexdigest()
