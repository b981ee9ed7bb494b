"""SHA-256 digest of a solution, and the check that precedes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.solution.path import TRIALS, Trial
from hamsym.support.record_fields import NotDataError, floats
from hamsym.support.records import MALFORMED, digest_of

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution


@dataclass(frozen=True, eq=False)
class Definition:
    """What defines a solution as a function, but not the method, its cost or the verdict."""

    H: Hamiltonian
    z0: Annotated[np.ndarray, floats("dim")]
    span: tuple[float, float]
    trial: Annotated[Trial, TRIALS]

    @classmethod
    def of(cls, solution: Solution) -> Definition:
        return cls(solution.H, solution.z0, solution.span, solution.trial)

    def check(self) -> None:
        """Raise ValueError unless H, z0, span and trial solution fit together."""
        start, end = self.span
        if start == end:
            raise ValueError("its span is not two different times")
        self.H.require_parameters()
        self.trial.require_path(self.z0, self.span)


def digest(solution: Solution) -> str:
    """Compute SHA-256 of a solution as a function.

    Raise InputError if the solution is invalid: a part has another type, shape or order, is not
    finite, or contradicts another part.
    """
    try:
        return digest_of(Definition.of(solution))
    except NotDataError:
        raise
    except MALFORMED as error:
        raise InputError(
            f"the solution is not valid: {' '.join(str(error).split())[:200]}"
        ) from None
