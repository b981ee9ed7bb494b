"""What the page and its workers send each other: plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from hamsym.workbench.lessons.start import usual_state


@dataclass(frozen=True)
class Setting:
    """A problem as the page has it, ready to be sent to a worker."""

    #: formula, q, p: H; coordinates and momenta between commas, or empty to find them from the
    #: names.
    formula: str
    q: str = ""
    p: str = ""
    #: Lines such as ``p = -c*p``.
    forces: str = ""
    z0: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 20.0)
    tol: float = 1e-9

    def with_names(self, names: Sequence[str], parameter_names: Sequence[str]) -> Setting:
        """Return the setting of an H with these names: values of names that stay are kept.

        Examples
        --------
        >>> Setting("p**2/2 + k*x**2/2", z0={"x": 2.0}).with_names(("x", "p"), ("k",)).z0
        {'x': 2.0, 'p': 0.0}
        """
        usual = usual_state(names)
        return replace(
            self,
            z0={name: self.z0.get(name, usual[name]) for name in names},
            parameters={name: self.parameters.get(name, 1.0) for name in parameter_names},
        )

    def summary(self) -> str:
        """Return the values in one line, of many the first six.

        Examples
        --------
        >>> Setting("p**2/2 + x**2/2", z0={"x": 1.3, "p": 1.0}).summary()
        'x = 1.3, p = 1, t from 0 to 20, tol 1e-09'
        """
        values = {**self.z0, **self.parameters}
        shown = [f"{name} = {value:g}" for name, value in list(values.items())[:6]]
        if len(values) > 6:
            shown.append(f"{len(values) - 6} more values")
        start, end = self.span
        return ", ".join([*shown, f"t from {start:g} to {end:g}", f"tol {self.tol:g}"])


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
