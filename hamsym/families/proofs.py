"""Proofs of the members of an ensemble."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import hamsym
from hamsym.errors import CertificationError
from hamsym.support.progress import stepping_progress
from hamsym.support.shown import Shown


@dataclass(frozen=True, eq=False)
class Proofs(Shown):
    """Which members of an ensemble are proven, from :meth:`Solutions.certify`.

    Attributes
    ----------
    proven : numpy.ndarray
        Whether the errors of a member are below the bound, shape (...).
    bounds : numpy.ndarray
        Proven bounds on the error of each component, shape (..., dim); infinite without a proof.
    certificates : numpy.ndarray
        A :class:`hamsym.Certificate` or None for each member, shape (...).
    message : numpy.ndarray
        Reason why there is no proof, or an empty text, shape (...).
    """

    proven: np.ndarray
    bounds: np.ndarray
    certificates: np.ndarray = field(repr=False)
    message: np.ndarray = field(repr=False)

    def __repr__(self) -> str:
        count = int(self.proven.sum())
        return f"Proofs({count:,} proven, {self.proven.size - count:,} not)"


def prove_members(many: Any, bound: Any, progress: bool | None) -> Proofs:
    """Prove that errors of all members are below a bound; see :meth:`Solutions.certify`."""
    shape, dim = many.shape, many.H.dim
    certificates, messages = np.empty(many.size, dtype=object), np.empty(many.size, dtype=object)
    bounds = np.full((many.size, dim), np.inf)
    messages[:] = ""
    successes = many.success.ravel()
    with stepping_progress(many.size, progress, "proving") as advance:
        for k, place in enumerate(np.ndindex(shape)):
            try:
                if not successes[k]:
                    raise CertificationError("the member has no solution within the tolerance")
                solution = many[place]
                own = solution.allowed_error.tolist() if bound is None else bound
                found = hamsym.certify(solution, progress=False, bound=own)
                certificates[k], bounds[k] = found, found.component_bounds
            except CertificationError as error:
                messages[k] = str(error)
            advance(1)
    proven = np.array([entry is not None for entry in certificates], dtype=bool)
    return Proofs(
        proven.reshape(shape),
        bounds.reshape(*shape, dim),
        certificates.reshape(shape),
        messages.reshape(shape),
    )
