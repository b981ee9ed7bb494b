"""What a worker sends to the page: plain data."""

from __future__ import annotations

from dataclasses import dataclass


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

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return len(self.names) // 2


@dataclass(frozen=True)
class Verdict:
    """What is known of the solution of a setting."""

    success: bool
    message: str
    #: The largest estimated error against what was asked.
    headline: str
    #: Largest |H - E0|, without the work of forces and of a changing H, relative to the size of the
    #: terms of H, the largest sum of |z_i dH/dz_i|.
    energy_error: float
    #: Time of solve.
    seconds: float


@dataclass(frozen=True)
class Motion:
    """A solution, and what the player of the page needs of it."""

    verdict: Verdict
    #: JavaScript of the system, and the problem as JSON.
    code: str = ""
    problem: str = ""
    #: Why there are none, e.g. a function that JavaScript lacks.
    refusal: str = ""


@dataclass(frozen=True)
class JobResult:
    """The answer to a button."""

    statement: str
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    success: bool = True
