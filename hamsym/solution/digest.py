"""SHA-256 digest of a solution, and the check that precedes it."""

from __future__ import annotations

import hashlib
import json
import math
import sys

from hamsym.description import MALFORMED, described
from hamsym.errors import InputError
from hamsym.solution.solution import Solution
from hamsym.support.checked_data import require_array


def digest(solution: Solution) -> str:
    """Compute SHA-256 of a solution as a function: of H, z0, the span and the trial solution.

    It includes types, shapes and bytes of the numbers, but not the method, its cost or the verdict.

    Raise InputError if the solution is invalid: a part has another type, shape or order, is not
    finite, or contradicts another part.
    """
    try:
        check_definition(solution)
    except MALFORMED as error:
        raise InputError(
            f"the solution is not valid: {' '.join(str(error).split())[:200]}"
        ) from None
    values = {
        "version": 2,
        "H": described(solution.H),
        "span": [float(time).hex() for time in solution.span],
        "trial": solution.trial.describe(),
    }
    found = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for name, numbers in sorted({"z0": solution.z0, **solution.trial.arrays()}.items()):
        found.update(f"{name} {numbers.dtype.name} {list(numbers.shape)} ".encode())
        found.update((numbers if sys.byteorder == "little" else numbers.byteswap()).tobytes())
    return found.hexdigest()


def check_definition(solution: Solution) -> None:
    """Raise ValueError unless H, z0, span and trial solution fit together and are finite."""
    start, end = solution.span
    if not (math.isfinite(start) and math.isfinite(end) and start != end):
        raise ValueError("its span is not two different finite times")
    solution.H.require_parameters()
    require_array("z0", solution.z0, (solution.H.dim,))
    solution.trial.check(solution.z0, solution.span)
