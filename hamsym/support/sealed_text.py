"""Certificates as text: JSON with the SHA-256 of its content, which is checked when it is read.

The checksum finds edits and damage. It proves nothing: whoever writes false claims can compute it,
too, and only :func:`hamsym.verify`, which proves the claims again, refuses those.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any, ClassVar, Self

from hamsym.errors import FileError
from hamsym.support.records import MALFORMED, as_json, from_json
from hamsym.support.shown import Drawn, Saved

_CHECKSUM = "sha256"


class SealedText(Drawn, Saved):
    """A certificate, whose files are text.

    A class defines the kind and the version of its text, how long it may be, what it certifies, and
    has a digest and a statement, which is checked against its numbers where it follows from them.
    """

    _KIND: ClassVar[str]
    _VERSION: ClassVar[int]
    _LONGEST: ClassVar[int]
    _OF: ClassVar[str]
    digest: Any
    statement: Any

    def to_json(self) -> str:
        """Write the certificate as text.

        Numbers have all digits. Bounds of solutions are decimals of nine digits, upper bounds
        rounded up, lower bounds down; they hold as written.
        """
        head = {"kind": self._KIND, "version": self._VERSION, "statement": self.statement}
        return sealed(head | as_json(self))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read a certificate that :meth:`to_json` wrote; nothing is proven.

        Raises
        ------
        FileError
            If the text is not a certificate of this kind, or is one of another version.
        """
        try:
            values = opened(text, cls._LONGEST)
            if values.pop("kind") != cls._KIND:
                raise ValueError(f"its kind is not '{cls._KIND}'")
            version = values.pop("version", None)
            if type(version) is not int or version != cls._VERSION:
                raise ValueError(f"its version is not {cls._VERSION}; make it again by certify")
            derived = hasattr(cls, "statement")  # a property, not a field
            claimed = values.pop("statement", None) if derived else values.get("statement")
            found = from_json(cls, values)
            if not re.fullmatch("[0-9a-f]{64}", found.digest):
                raise ValueError("its digest is not a SHA-256")
            if claimed != found.statement:
                raise ValueError("its statement does not match its numbers")
            return found
        except MALFORMED as error:
            raise FileError(
                f"the text is not a certificate{cls._OF} of this version: {error}"
            ) from None


def sealed(values: dict[str, Any]) -> str:
    """Write values of JSON as text, with their checksum.

    Examples
    --------
    >>> text = sealed({"kind": "example", "bound": 0.1})
    >>> opened(text, 1_000)
    {'kind': 'example', 'bound': 0.1}
    >>> opened(text.replace("0.1", "0.01"), 1_000)
    Traceback (most recent call last):
    ...
    ValueError: its checksum does not match its content: it was edited or damaged
    """
    return json.dumps({**values, _CHECKSUM: _checksum(values)}, indent=1)


def opened(text: Any, longest: int) -> dict[str, Any]:
    """Read values that :func:`sealed` wrote.

    Raise ValueError if the text is not JSON of an object, is too long, or was edited.
    """
    if not isinstance(text, str) or len(text) > longest:
        raise ValueError(f"expected a str of up to {longest} characters")
    values = json.loads(text, object_pairs_hook=_without_repetition, parse_constant=_no_number)
    if not isinstance(values, dict) or "kind" not in values:
        raise ValueError("it has no kind")
    claimed = values.pop(_CHECKSUM, None)
    if claimed is None:
        raise ValueError("it has no checksum")
    if claimed != _checksum(values):
        raise ValueError("its checksum does not match its content: it was edited or damaged")
    return values


def kind_of_text(text: Any) -> str:
    """Return the kind that a text states; empty if it states none."""
    try:
        kind = json.loads(text)["kind"]
    except (ValueError, TypeError, LookupError, RecursionError):
        return ""
    return kind if isinstance(kind, str) else ""


def _checksum(values: dict[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _no_number(text: str) -> float:
    raise ValueError(f"'{text}' is not a number in the form of a certificate")


def _without_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) != len(pairs):
        raise ValueError("a name occurs twice")
    return dict(pairs)
