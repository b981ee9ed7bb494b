"""Unknowns of a fit: parameters and components of the start, with first guesses and bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from hamsym.errors import InputError, ParameterError
from hamsym.formula.parser import canonical_name
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.record_fields import floats
from hamsym.support.validation import checked_mapping, shown
from hamsym.symbolic.checks import name_of


@dataclass(frozen=True)
class Unknowns:
    """The free quantities, and the values of all others."""

    #: With a value for every parameter: fixed, or the first guess.
    H: Hamiltonian
    #: Components of the start: fixed, or first guesses.
    start: Annotated[np.ndarray, floats("dim")]
    #: The free quantities.
    names: tuple[str, ...]
    #: guesses, low, high: Their first guesses and bounds; infinite where there are none.
    guesses: Annotated[np.ndarray, floats("free")]
    low: Annotated[np.ndarray, floats("free", finite=False)]
    high: Annotated[np.ndarray, floats("free", finite=False)]

    def check(self) -> None:
        """Raise ValueError unless the names are those of H, and the guesses within the bounds."""
        self.H.require_parameters()
        if not {*self.names} <= {*self.H.names, *self.H.parameter_names}:
            raise ValueError("it varies what H does not have")
        if len(self.names) != len(self.guesses):
            raise ValueError("its first guesses are not one for each free quantity")
        if not ((self.low <= self.guesses) & (self.guesses <= self.high)).all():
            raise ValueError("a first guess is not within its bounds")

    @property
    def components(self) -> dict[int, int]:
        """Places of free components: in the names -> in the state."""
        return {j: self.H.names.index(n) for j, n in enumerate(self.names) if n in self.H.names}

    @property
    def free_parameters(self) -> tuple[str, ...]:
        return tuple(name for name in self.names if name not in self.H.names)

    def starts(self, values: np.ndarray) -> np.ndarray:
        """Return the starts for values (n, k), shape (n, dim)."""
        found = np.tile(self.start, (len(values), 1))
        for j, i in self.components.items():
            found[:, i] = values[:, j]
        return found

    def parameters(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Return all parameters of H for values (n, k), each of shape (n,)."""
        found = {name: np.full(len(values), value) for name, value in self.H.parameters.items()}
        for j, name in enumerate(self.names):
            if name in found:
                found[name] = values[:, j].copy()
        return found

    def parameter_rows(self, values: np.ndarray) -> np.ndarray:
        """Return all parameters of H in their order for values (n, k), shape (n, parameters)."""
        columns = self.parameters(values)
        rows = [columns[name] for name in self.H.parameter_names]
        return np.array(rows).T if rows else np.empty((len(values), 0))

    def hamiltonian(self, values: np.ndarray) -> Hamiltonian:
        """Return H with the values of one row, shape (k,)."""
        row = self.parameters(values[None])
        return self.H.with_parameters(**{name: float(value[0]) for name, value in row.items()})

    def text(self, values: np.ndarray) -> str:
        """Return the values of one row as text."""
        return ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.names, values, strict=True))

    def draw(self, count: int, seed: int, sizes: np.ndarray) -> np.ndarray:
        """Return the guesses and further ones at random, shape (count, k).

        Uniform between the bounds, or where there are not two within ``sizes`` (k,) of the guess.
        """
        bounded = np.isfinite(self.low) & np.isfinite(self.high)
        low = np.where(bounded, self.low, np.maximum(self.guesses - sizes, self.low))
        high = np.where(bounded, self.high, np.minimum(self.guesses + sizes, self.high))
        shares = np.random.default_rng(seed).random((count - 1, len(self.names)))
        return np.vstack((self.guesses, low + shares * (high - low)))


def checked_unknowns(H: Hamiltonian, free: Any, z0: Any, parameters: Any, bounds: Any) -> Unknowns:
    """Assign a fixed value or a first guess to every parameter and component of the start.

    Raise InputError if a name is unknown, is missing, or is both free and fixed, or a value is not
    a finite number.
    """
    state = {canonical_name(name): name for name in H.names}
    known = state | {canonical_name(name): name for name in H.parameter_names}
    example = f'{{"{(*H.parameter_names, *H.names)[0]}": 1.0}}'
    guesses = _by_name("free", free, known, example)
    if not guesses:
        raise InputError(f"free={free!r} names no quantity; give for example {example}")
    fixed = _by_name("z0", z0, state, f'{{"{H.names[0]}": 1.0}}')
    own = {n: known[n] for n in known if n not in state}
    values = _by_name("parameters", parameters, own, '{"k": 1.0}')
    for argument, given in (("z0", fixed), ("parameters", values)):
        if twice := [name for name in guesses if name in given]:
            raise InputError(
                f"'{twice[0]}' is in free and in {argument}; leave it out of one of them"
            )
    if missing := [name for name in H.names if name not in guesses and name not in fixed]:
        raise InputError(
            f"'{missing[0]}' is in neither free nor z0; give a first guess in free, or its value "
            "at the start in z0"
        )
    numbers = {**H.parameters, **values, **{n: g for n, g in guesses.items() if n not in H.names}}
    if missing := [name for name in H.parameter_names if name not in numbers]:
        raise ParameterError(
            f"'{missing[0]}' is in neither free nor parameters; give a first guess in free, or "
            "its value in parameters"
        )
    low, high = _bounds(bounds, guesses, known)
    start = np.array([guesses.get(name, fixed.get(name, math.nan)) for name in H.names])
    return Unknowns(
        H.with_parameters(**numbers),
        start,
        tuple(guesses),
        np.array(list(guesses.values())),
        low,
        high,
    )


def _by_name(argument: str, given: Any, known: Mapping[str, str], example: str) -> dict[str, float]:
    """Return finite numbers by the names in H."""
    found: dict[str, float] = {}
    for key, value in checked_mapping(argument, given, example).items():
        name = known.get(canonical_name(name_of(key)))
        if name is None:
            listed = ", ".join(known.values()) or "none"
            raise InputError(f"'{name_of(key)}' in {argument} is unknown; H has {listed}")
        if name in found:
            raise InputError(f"'{name}' occurs twice in {argument}; give it once")
        found[name] = _number(f"{name} in {argument}", value)
    return found


def _number(name: str, value: Any) -> float:
    try:
        number = float(value) if not isinstance(value, (str, bool)) else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} is {shown(value)}; give a finite number")
    return number


def _bounds(
    bounds: Any, guesses: Mapping[str, float], known: Mapping[str, str]
) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full(len(guesses), -np.inf), np.full(len(guesses), np.inf)
    for key, pair in checked_mapping("bounds", bounds, '{"g": (0, None)}').items():
        name = known.get(canonical_name(name_of(key)), "")
        if name not in guesses:
            raise InputError(
                f"'{name_of(key)}' in bounds is not free; free are {', '.join(guesses)}"
            )
        j = list(guesses).index(name)
        low[j], high[j] = bound_ends(name, pair)
        if not low[j] < high[j]:
            raise InputError(f"bounds of '{name}' are {pair!r}; give the lower one first")
        if not low[j] <= guesses[name] <= high[j]:
            raise InputError(
                f"the first guess {name} = {guesses[name]:.16g} is outside its bounds "
                f"{pair!r}; give one inside them"
            )
    return low, high


def bound_ends(name: str, pair: Any) -> list[float]:
    """Return the bounds of a quantity, infinite for None; raise InputError unless they are two."""
    if not isinstance(pair, Sequence | np.ndarray) or isinstance(pair, str) or len(pair) != 2:
        raise InputError(f"bounds of '{name}' are {pair!r}; give (low, high), or None for one")
    return [
        end if value is None or _is_open(value, end) else _number(f"a bound of '{name}'", value)
        for value, end in zip(pair, (-math.inf, math.inf), strict=True)
    ]


def _is_open(value: Any, end: float) -> bool:
    """Return whether a bound is infinite on its side."""
    return isinstance(value, (float, np.floating)) and float(value) == end
