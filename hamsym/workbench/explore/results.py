"""What a worker sends to the page: plain data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Derivation:
    """What follows from the formula alone."""

    names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    #: equations, hessian: MathML, for an element of a page.
    equations: str
    hessian: str
    #: What the structure of H is, in words.
    facts: str
    #: Whether H is conserved.
    has_energy: bool
    #: A surface for a section, empty if there is none.
    surface: str

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return len(self.names) // 2


@dataclass(frozen=True)
class Picture:
    """A solution, sampled for the page."""

    success: bool
    message: str
    #: The largest estimated error against what was asked.
    headline: str
    #: Shape (n,).
    t: np.ndarray
    #: Shape (n, dim).
    z: np.ndarray
    #: energy_error, error: |H - E0|, without the work of forces and of a changing H, relative to
    #: the size of the terms of H, the largest sum of |z_i dH/dz_i|; the largest estimated error
    #: relative to the size of its component. Both have shape (n,).
    energy_error: np.ndarray
    error: np.ndarray
    #: Level sets of H around the orbit, each of shape (m, 2); for one degree of freedom.
    levels: list[np.ndarray]
    #: Their range: q and p, each from and to.
    box: tuple[float, float, float, float] | None
    #: Time of solve and of sampling.
    seconds: float
    #: Whether the motion may be too fast for the times that are drawn.
    coarse: bool


@dataclass(frozen=True)
class SectionPicture:
    """Crossings of a surface in a plane."""

    points: np.ndarray
    axes: tuple[str, str]
    success: bool
    message: str


@dataclass(frozen=True)
class JobResult:
    """The answer to a button."""

    statement: str
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    success: bool = True
