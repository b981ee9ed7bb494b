"""Checkpoints: files from which an interrupted training is resumed."""

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


@dataclass(frozen=True)
class Checkpoint:
    """A file from which a training is resumed, to the same bits as without an interruption."""

    #: Replaced in one step, periodically and at the end; read if it exists.
    path: str | os.PathLike[str]
    #: Settings that determine the training; a file with other settings is refused.
    settings: Mapping[str, Any]
    #: Seconds between two writes.
    every: float = 10.0

    def read(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Return the tensors and values of the file, or None if it does not exist.

        Raise FileError if the file cannot be read, or belongs to a training with other settings.
        """
        if not isinstance(self.path, (str, os.PathLike)):
            raise InputError(f"checkpoint={self.path!r} is not a path; give a str or path-like")
        try:
            if not Path(self.path).exists():
                if not Path(self.path).absolute().parent.is_dir():
                    raise FileError(f"directory of '{self.path}' does not exist; create it first")
                return None
        except (OSError, TypeError, ValueError) as error:
            raise FileError(f"'{self.path}' cannot be read: {one_line(error)}") from None
        arrays, values = read_tensors(self.path, "checkpoint")
        saved = values.get("settings")
        if not isinstance(saved, dict):
            raise FileError(f"'{self.path}' is damaged; give another file")
        for name in sorted({*saved, *self.settings}):
            if saved.get(name) != self.settings.get(name):
                raise FileError(
                    f"'{self.path}' belongs to a training with {name}={saved.get(name)}, not "
                    f"{self.settings.get(name)}; give another file"
                )
        return {name: torch.from_numpy(array) for name, array in arrays.items()}, values

    def write(self, tensors: Mapping[str, Tensor], values: Mapping[str, Any]) -> None:
        """Replace the file.

        Raise FileError if the file cannot be written.
        """
        arrays = {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}
        write_tensors(self.path, "checkpoint", arrays, {"settings": dict(self.settings), **values})
