"""Text of certificates: JSON with the SHA-256 of its content, which is checked when it is read.

The checksum finds edits and damage. It proves nothing: whoever writes false claims can compute it,
too, and only :func:`hamsym.verify`, which proves the claims again, refuses those.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

BOX_KIND = "hamsym flow map certificate"
ORBIT_KIND = "hamsym orbit certificate"

_CHECKSUM = "sha256"


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


def kind_of(text: Any) -> str:
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
