"""Equilibria: points where the gradient of H vanishes, with their stability.

Output of :func:`hamsym.equilibria`: :class:`Equilibria`, a sequence of :class:`Equilibrium`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.dynamics.linear_stability import LinearStability
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.ball import Ball
from hamsym.support.shown import Drawn, Listed, Shown
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.validation import require_whole

if TYPE_CHECKING:
    import sympy


#: Words of stability for the parts of a type.
_WORDS = {"centre": "elliptic", "saddle": "hyperbolic", "focus-focus": "complex unstable"}


@suggest_attributes
@dataclass(frozen=True, eq=False)
class Equilibrium(Drawn, Shown):
    """An equilibrium of a Hamiltonian.

    ``plot()`` draws the eigenvalues in the complex plane, with Krein signatures of the frequencies,
    if every parameter has a value.

    Attributes
    ----------
    names : tuple of str
        Components of z.
    z : numpy.ndarray
        The state, shape (dim,); of a continuum of equilibria one point. NaN where a parameter has
        no value.
    energy : float
        H there.
    how : str
        ``"proven"``: it exists, and is the only one in ``enclosure`` if that is given;
        ``"symbolic"``: ``exact`` was verified by substitution; ``"numerical"``: neither.
    enclosure : Ball or None
        Contains exactly one equilibrium, shape (dim,); None if that is not proven.
    exact : sympy matrix or None
        The state in closed form, a column.
    family : str
        Empty for an isolated equilibrium or one that was not found to be part of a continuum; else
        what is known of the continuum.
    on_edge : bool
        Whether it may be on the edge of the box that was searched, or outside within ``radius``.
    linear : LinearStability or None
        None where a parameter has no value.
    H : Hamiltonian or None
        The one whose equilibrium it is.
    """

    names: tuple[str, ...]
    z: np.ndarray
    energy: float
    how: str
    enclosure: Ball | None = field(default=None, repr=False)
    exact: sympy.ImmutableDenseMatrix | None = field(default=None, repr=False)
    family: str = ""
    on_edge: bool = False
    linear: LinearStability | None = field(default=None, repr=False)
    H: Hamiltonian | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return f"Equilibrium({self.lines[0]}, {self.how})"

    @property
    def radius(self) -> float:
        """A proven bound on the distance of z from the true equilibrium, in the 2-norm; or inf."""
        if self.enclosure is None:
            return math.inf
        size = math.hypot(*self.enclosure.radius)
        return math.nextafter(size * (1 + 1e-15), math.inf) if size else 0.0

    @property
    def type(self) -> str:
        """Type of the linearised motion, for example ``"saddle-centre"``, or ``"degenerate"``."""
        return "unknown" if self.linear is None else self.linear.type

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of J Hess, shape (dim,)."""
        return self._linear.eigenvalues

    @property
    def frequencies(self) -> np.ndarray:
        """Angular frequencies of the centres, ascending, shape (k,)."""
        return self._linear.frequencies

    @property
    def signatures(self) -> np.ndarray:
        """Krein signatures of these modes: the signs of their energies, shape (k,)."""
        return self._linear.signatures

    @property
    def modes(self) -> np.ndarray:
        """Vectors v of these modes with \\|v* J v\\| = 1, columns of shape (dim, k)."""
        return self._linear.modes

    @property
    def stable(self) -> bool | None:
        """Whether the linearised motion is bounded; None if that is not decided."""
        return None if self.linear is None else self.linear.stable

    @property
    def lyapunov_stable(self) -> bool | None:
        """Whether the motion itself is stable.

        True where the Hessian is definite (Dirichlet), False where an eigenvalue has a positive
        real part, None in between: linear stability does not decide.
        """
        if self.linear is None:
            return None
        if self.linear.definite:
            return True
        return False if self.linear.stable is False else None

    @property
    def _linear(self) -> LinearStability:
        if self.linear is None:
            raise AttributeError("the stability is unknown, because a parameter has no value")
        return self.linear

    def normal_form(self, degree: int = 6) -> hamsym.NormalForm:
        """Compute the Birkhoff normal form: H in actions, and whether the equilibrium is stable.

        Parameters
        ----------
        degree : int
            Of H in the coordinates, 2 to 12. With two degrees of freedom degree 6 takes a second,
            and each further degree about twice as long; stability needs degree 4.

        Returns
        -------
        NormalForm

        Raises
        ------
        CertificationError
            If the equilibrium is not proven, or not elliptic, or frequencies of coupled modes are
            equal.

        Examples
        --------
        >>> pendulum = hamsym.equilibria("p**2/2 - cos(x)")[0]
        >>> pendulum.normal_form(6).formula
        -0.00390625*I_1**3 - 0.0625*I_1**2 + 1.0*I_1
        """
        return hamsym.normal_form(self, degree)

    def manifolds(self, **options: Any) -> hamsym.Manifolds:
        """Compute the stable and the unstable manifold; see :func:`hamsym.manifolds`."""
        return hamsym.manifolds(self, **options)

    def __str__(self) -> str:
        return self.summary(rows=None)

    def coordinates(self, digits: int = 10) -> list[str]:
        """Return the components as text, in closed form where a parameter has no value."""
        require_whole("digits", digits, 1, 17)
        values = self.z if self.exact is None or self.linear is not None else list(self.exact)
        return [f"{v + 0.0:.{digits}g}" if isinstance(v, float) else str(v) for v in values]

    @property
    def lines(self) -> list[str]:
        """What is known of it, in words: a line each."""
        pairs = zip(self.names, self.coordinates(), strict=True)
        state = ", ".join(f"{name} = {value}" for name, value in pairs)
        lines = [f"{self.type} at {state}"]
        if self.linear is not None:
            definite = ", stable (the Hessian is definite)" if self.lyapunov_stable else ""
            lines += [f"energy {self.energy:.10g}, {self.stability}{definite}", self.spectrum]
        lines += [self.evidence]
        if self.family:
            lines += [f"part of a continuum: {self.family}"]
        return lines

    @property
    def stability(self) -> str:
        """Linear stability, in the words of :attr:`hamsym.PeriodicOrbit.stability`.

        "elliptic" if all parts of ``type`` are centres, "hyperbolic" if they are saddles, "complex
        unstable" if they are foci, else "mixed"; where the type is degenerate, "unstable" if an
        eigenvalue has a positive real part, else "undecided".
        """
        known = "" if self.linear is None else self.type
        kinds = [word for part, word in _WORDS.items() if part in known]
        if kinds:
            return kinds[0] if len(kinds) == 1 else "mixed"
        return "unstable" if self.stable is False else "undecided"

    @property
    def spectrum(self) -> str:
        """Frequencies with their signatures, and exponents, in words."""
        parts = []
        if len(self.frequencies):
            found = [
                f"{w:.8g} ({'+' if s > 0 else '-'})"
                for w, s in zip(self.frequencies, self.signatures, strict=True)
            ]
            parts.append(f"frequencies {', '.join(found)}")
        others = [k for k in self.eigenvalues if k.real > 0 and k.imag >= 0]
        if self.type == "degenerate":
            return "eigenvalues near " + ", ".join(_complex(k) for k in self.eigenvalues)
        if others:
            parts.append(f"exponents +-{', +-'.join(_complex(k) for k in others)}")
        return "; ".join(parts)

    @property
    def evidence(self) -> str:
        """How it was found, in words."""
        if self.enclosure is not None:
            text = f"proven, to {self.radius:.1e}"
        elif self.how == "proven":
            text = "proven"
        elif self.how == "symbolic":
            text = "exact"
        else:
            text = "found numerically, not proven"
        if self.exact is not None:
            text += ": " + ", ".join(
                f"{name} = {value}" for name, value in zip(self.names, self.exact, strict=True)
            )
        return text + (" (on the edge of the box)" if self.on_edge else "")


@dataclass(frozen=True)
class Region:
    """A part of a box in which equilibria could be neither found nor excluded."""

    #: Components of z.
    names: tuple[str, ...]
    #: low, high: Its corners.
    low: tuple[float, ...]
    high: tuple[float, ...]
    #: Undecided boxes in it.
    boxes: int
    reason: str

    def __str__(self) -> str:
        ends = zip(self.names, self.low, self.high, strict=True)
        return ", ".join(itertools.starmap(_interval, ends)) + f": {self.reason}"


@suggest_attributes
@dataclass(frozen=True, eq=False, repr=False)
class Equilibria(Drawn, Shown, Listed[Equilibrium]):
    """Equilibria of a Hamiltonian, in the order of their energies; a sequence.

    ``plot()`` draws them with their types and numbers in the plane of the first two coordinates, or
    of coordinate and momentum, ``plot("x", "y")`` in that of two components. Behind them are level
    sets: of H with one degree of freedom, and with two, if H is quadratic in the momenta, of its
    value at zero velocity, in the plane of the coordinates.

    Attributes
    ----------
    H : Hamiltonian
    found : tuple of Equilibrium
    complete : bool
        Whether these are proven to be all equilibria in the box that was given; False without one.
    message : str
    undecided : tuple of Region
        The parts of the box that could not be decided.
    boxes : int
        Boxes that were examined.
    seconds : float
        Run time.
    """

    H: Hamiltonian
    found: tuple[Equilibrium, ...]
    complete: bool
    message: str
    undecided: tuple[Region, ...] = ()
    boxes: int = 0
    seconds: float = 0.0

    def __repr__(self) -> str:
        return f"Equilibria({self.H.formula!r}: {self.message})"

    @property
    def z(self) -> np.ndarray:
        """The states, shape (n, dim)."""
        return np.array([each.z for each in self.found]).reshape(len(self.found), self.H.dim)

    @property
    def energies(self) -> np.ndarray:
        """Their energies, shape (n,)."""
        return np.array([each.energy for each in self.found])

    def __str__(self) -> str:
        return self.summary(rows=None)


def _interval(name: str, low: float, high: float) -> str:
    """An interval with as many digits as its width has."""
    middle, half = (low + high) / 2, (high - low) / 2
    if not half < 1e-3 * abs(middle):
        return f"{name} from {low:.3g} to {high:.3g}"
    return f"{name} = {middle:.8g} +- {half:.1g}"


def _complex(value: complex) -> str:
    if value.imag == 0:
        return f"{value.real:.8g}"
    if value.real == 0:
        return f"{value.imag:.8g}i"
    return f"({value.real:.8g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.8g}i)"
