"""Checkpoints: files from which a training goes on."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from hamsym.errors import FileError, InputError
from hamsym.support.tensor_files import one_line, read_tensors, write_tensors

__all__ = ["Checkpoint"]


@dataclass(frozen=True)
class Checkpoint:
    """A file from which a training that was killed goes on as if it had not been.

    Attributes
    ----------
    path : path-like
        Written in one step, now and then and at the end; read if it is there.
    settings : mapping
        What the training is of; a file with other settings is refused.
    every : float
        Seconds between writing.
    """

    path: str | os.PathLike[str]
    settings: Mapping[str, Any]
    every: float = 10.0

    def read(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """What was written last, if anything was.

        Raises
        ------
        FileError
            If the file cannot be read, or is of a training with other settings.
        """
        if not isinstance(self.path, (str, os.PathLike)):
            raise InputError(f"checkpoint={self.path!r} is not a path; give one")
        try:
            if not Path(self.path).exists():
                if not Path(self.path).absolute().parent.is_dir():
                    raise FileError(
                        f"'{self.path}' has no folder to stand in; make the folder first"
                    )
                return None
        except (OSError, TypeError, ValueError) as error:
            raise FileError(f"'{self.path}' cannot be read: {one_line(error)}") from None
        arrays, values = read_tensors(self.path, "checkpoint")
        theirs = values.get("settings")
        if not isinstance(theirs, dict):
            raise FileError(f"'{self.path}' is damaged; give another file")
        for name in sorted({*theirs, *self.settings}):
            if theirs.get(name) != self.settings.get(name):
                raise FileError(
                    f"'{self.path}' is of a training with {name}={theirs.get(name)}, this one has "
                    f"{self.settings.get(name)}; give another file"
                )
        return {name: torch.from_numpy(array) for name, array in arrays.items()}, values

    def write(self, tensors: Mapping[str, Tensor], values: Mapping[str, Any]) -> None:
        """Replace the file."""
        arrays = {name: tensor.detach().numpy() for name, tensor in tensors.items()}
        write_tensors(self.path, "checkpoint", arrays, {"settings": dict(self.settings), **values})
