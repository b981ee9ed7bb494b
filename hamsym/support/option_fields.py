"""Dataclass fields that carry the help text of an option.

The command line builds its options from them, so that names, types and defaults are written once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any


def option(
    default: Any,
    help: str,
    *,
    default_text: str | None = None,
    unit: str | None = None,
    choices: Sequence[str] | Mapping[str, Any] | None = None,
) -> Any:
    """Return a dataclass field with a default and metadata for the command line.

    - default_text: The default in words, where it is computed.
    - unit: Placeholder of the value in help texts.
    - choices: The texts that are accepted, or the values that they mean.
    """
    metadata = {"help": help, "default_text": default_text, "unit": unit, "choices": choices}
    return field(default=default, metadata=metadata)
