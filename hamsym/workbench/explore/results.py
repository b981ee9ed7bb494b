"""What a worker sends to the page: plain data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Derivation:
    """What follows from the formula alone.

    Attributes
    ----------
    names, parameter_names : tuple of str
    equations, hessian : str
        MathML, for an element of a page.
    facts : tuple of str
        Sentences on the structure of H.
    has_energy : bool
        Whether H is conserved.
    surface : str
        A surface for a section, empty if there is none.
    """

    names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    equations: str
    hessian: str
    facts: tuple[str, ...]
    has_energy: bool
    separable: bool
    surface: str

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return len(self.names) // 2


@dataclass(frozen=True)
class Picture:
    """A solution, sampled for the page.

    Attributes
    ----------
    success : bool
    message : str
    t : numpy.ndarray
        Shape (n,).
    z : numpy.ndarray
        Shape (n, dim).
    energy_error, error : numpy.ndarray
        |H - E0|, without the work of forces and of a changing H, relative to the size of the terms
        of H, the largest sum of |z_i dH/dz_i|; the largest estimated error relative to the size of
        its component. Both have shape (n,).
    levels : list of arrays
        Level sets of H around the orbit, each of shape (m, 2); for one degree of freedom.
    box : tuple of float
        Their range: q and p, each from and to.
    largest : float
        The largest estimated error relative to the size of its component.
    seconds : float
        Time of solve and of sampling.
    coarse : bool
        Whether the motion may be too fast for the times that are drawn.
    """

    success: bool
    message: str
    t: np.ndarray
    z: np.ndarray
    energy_error: np.ndarray
    error: np.ndarray
    levels: list[np.ndarray]
    box: tuple[float, float, float, float] | None
    largest: float
    seconds: float
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
    """The answer to a button.

    Attributes
    ----------
    statement : str
    header : tuple of str
    rows : list of tuple of str
    success : bool
    """

    statement: str
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    success: bool = True
