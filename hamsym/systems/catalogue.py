"""Entries of the catalogue: problems, their reference states, and the list of all systems."""

from __future__ import annotations

import functools
import importlib.resources
import inspect
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.suggestions import did_you_mean, suggest_attributes
from hamsym.support.validation import require_number, require_positive


@dataclass(frozen=True)
class Reference:
    """The state of a problem of the catalogue at one time, to 30 digits.

    It belongs to the initial state, the parameters and the time as exact float64 numbers.

    Attributes
    ----------
    t : float
        The end of the default span.
    z : tuple of str
        Decimal numbers, in the order of H.z.
    digits : int
        Number of correct digits, relative to the largest magnitude of each component on the way.
    growth : float
        How much a small change of the start has grown at time t, relative to these magnitudes.
    source : str
        Where the state is from.
    method : str
        How it was computed.

    Examples
    --------
    >>> from hamsym import systems
    >>> systems.henon_heiles().reference.z[0]
    '0.237771127128492333707940079150'
    """

    t: float
    z: tuple[str, ...]
    digits: int
    growth: float
    source: str
    method: str

    @property
    def state(self) -> np.ndarray:
        """The state as float64 numbers, shape (dim,)."""
        return np.array([float(value) for value in self.z])


@suggest_attributes
@dataclass(frozen=True)
class Problem:
    """An initial-value problem of the catalogue.

    Attributes
    ----------
    name : str
    H : Hamiltonian
        With values for all parameters.
    z0 : tuple of float
        Default initial state, in the order of H.z.
    span : (float, float)
        Default time span.
    source : str
        Reference for the system and its initial state.
    exact : callable, optional
        Exact solution, t of shape (n,) -> states of shape (n, dim); None if unknown.
    period : float, optional
        Period of the motion; None if unknown.
    conserved : tuple of str
        Formulas of first integrals other than H, in the names of H and the time t, valid for these
        values of the parameters.
    start : str
        Name of the initial state, if the system has several.
    starts : tuple of str
        All names that the function of the system takes as ``start``.
    reference : Reference, optional
        State at the end of the span, to 30 digits; None if the arguments are not the usual ones.

    Examples
    --------
    >>> from hamsym import systems
    >>> problem = systems.charged_particle()
    >>> problem.conserved
    ('p_x - B*y/2', 'p_y + B*x/2', 'x*p_y - y*p_x')
    >>> all(map(problem.H.is_conserved, problem.conserved))
    True
    >>> systems.henon_heiles().starts[:2]
    ('E = 0.128, the paper', 'E = 1/12, regular')
    """

    name: str
    H: Hamiltonian
    z0: tuple[float, ...]
    span: tuple[float, float]
    source: str
    exact: Callable[[np.ndarray], np.ndarray] | None = field(default=None, repr=False)
    period: float | None = None
    conserved: tuple[str, ...] = ()
    start: str = ""
    starts: tuple[str, ...] = ()
    reference: Reference | None = field(default=None, repr=False)


#: The functions of the catalogue, by name; each works without arguments.
CATALOGUE: dict[str, Callable[..., Problem]] = {}


def listed(function: Callable[..., Problem]) -> Callable[..., Problem]:
    """Add a function to the catalogue; its problems of usual arguments get their references."""
    signature = inspect.signature(function)
    usual = {name: each.default for name, each in signature.parameters.items() if name != "start"}
    floats = {name for name, each in signature.parameters.items() if each.annotation == "float"}

    @functools.wraps(function)
    def made(*arguments: Any, **options: Any) -> Problem:
        given = dict(zip(signature.parameters, arguments, strict=False)) | options
        for name in floats & given.keys():
            require_number(name, given[name])
        problem = function(*arguments, **options)
        if any(given.get(name, value) != value for name, value in usual.items()):
            return problem
        return _with_reference(function.__name__, problem)

    CATALOGUE[function.__name__] = made
    return made


@functools.cache
def _references() -> list[dict[str, Any]]:
    text = importlib.resources.files(__package__).joinpath("references.json").read_text("utf-8")
    return json.loads(text)


def _with_reference(system: str, problem: Problem) -> Problem:
    """The problem with its stored state, from the stored numbers of the start and the end.

    A computed start has other last digits on another processor; the state is that of these.
    """
    for row in _references():
        if (row["system"], row["start"]) == (system, problem.start):
            fields = (row[name] for name in ("digits", "growth", "source", "method"))
            reference = Reference(row["t"], tuple(row["z"]), *fields)
            span = (problem.span[0], row["t"])
            return replace(problem, z0=tuple(row["z0"]), span=span, reference=reference)
    return problem


# -- arguments and formulas ----------------------------------------------------------------------


def check_positive(**values: float) -> None:
    """Raise InputError unless all values are positive and finite."""
    for name, value in values.items():
        require_positive(name, value)


def check_start(start: str, starts: Iterable[str]) -> None:
    """Raise InputError unless a start is one of those of the system."""
    if start not in (known := list(starts)):
        names = ", ".join(f"'{name}'" for name in known)
        hint = did_you_mean(start, known)
        raise InputError(f"start={start!r} cannot be used{hint}; give one of {names}")


def numbered(letter: str, n: int) -> list[str]:
    """Names with the numbers 1 to n: q1, q2, ..."""
    return [f"{letter}{i}" for i in range(1, n + 1)]


def kinetic(n: int) -> str:
    """Formula of the kinetic energy of n unit masses with momenta p1, p2, ..."""
    return " + ".join(f"{p}**2/2" for p in numbered("p", n))
