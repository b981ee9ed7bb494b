"""Files that hold data and nothing to execute: tensors and JSON in one safetensors file.

Numbers are kept to the last bit. A file is replaced in one step, so that at any moment there is
either the old one or the new one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor

from hamsym.atomic import write_atomically
from hamsym.errors import FileError

__all__ = ["read_tensors", "write_tensors"]

_VERSION = 1
_KEY = "hamsym"


def write_tensors(
    path: str | os.PathLike[str],
    kind: str,
    tensors: Mapping[str, Tensor],
    values: Mapping[str, Any],
) -> None:
    """Write named tensors, and values that JSON can hold, as a file of the given kind.

    Raises
    ------
    FileError
        If the file cannot be written; what was there before is still there.
    """
    header = json.dumps({"version": _VERSION, "kind": kind, **values})
    content = safetensors.torch.save(
        {name: tensor.detach().contiguous() for name, tensor in tensors.items()},
        metadata={_KEY: header},
    )
    try:
        write_atomically(Path(path), content)
    except (OSError, ValueError, TypeError) as error:
        raise FileError(f"'{path}' cannot be written: {_reason(error)}") from None


def read_tensors(
    path: str | os.PathLike[str], kind: str
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and values of a file that :func:`write_tensors` wrote.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, of another kind or of a later version.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except safetensors.SafetensorError as error:
        raise FileError(f"'{path}' is damaged or no file of hamsym: {error}") from None
    except (OSError, ValueError, TypeError) as error:
        raise FileError(f"'{path}' cannot be read: {_reason(error)}") from None
    try:
        values = json.loads(metadata[_KEY])
        version, found = values.pop("version"), values.pop("kind")
    except (KeyError, AttributeError, TypeError, ValueError, RecursionError):
        raise FileError(f"'{path}' is not a file of hamsym") from None
    if found != kind:
        raise FileError(f"'{path}' holds a {found}, not a {kind}")
    if version != _VERSION:
        raise FileError(f"'{path}' is of version {version}; this hamsym reads version {_VERSION}")
    return tensors, values


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
