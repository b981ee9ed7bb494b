"""The device of a training, which has to be present."""

from __future__ import annotations

import torch

from hamsym.errors import InputError
from hamsym.support.tensor_files import one_line


def available_device(device: str | torch.device, dtype: torch.dtype) -> torch.device:
    """Return a device on which tensors of this type can be used.

    Raise InputError if it is not a device, is not present, or lacks the type.

    Examples
    --------
    >>> available_device("cpu", torch.float64)
    device(type='cpu')
    """
    try:
        found = torch.device(device)
    except (RuntimeError, TypeError):
        raise InputError(
            f"device={device!r} is not a device of torch; give 'cpu', 'cuda' or 'mps'"
        ) from None
    if found.type == "mps" and dtype == torch.float64:
        raise InputError("device='mps' has no float64; give dtype='float32' with it")
    try:
        # What a training does: numbers in, a factor, a number out.
        matrix = torch.eye(2, dtype=dtype, device=found)
        present = float(torch.cholesky_solve(matrix, matrix).sum()) == 2
    except (AssertionError, NotImplementedError, RuntimeError, TypeError) as error:
        raise InputError(
            f"device={str(found)!r} cannot be used here ({one_line(error)}); give device='cpu'"
        ) from None
    if not present:
        raise InputError(f"device={str(found)!r} calculates wrongly; give device='cpu'")
    return found
