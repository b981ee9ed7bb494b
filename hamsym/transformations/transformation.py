"""Hamiltonians in other variables: hamsym.transform.

Input:  a Hamiltonian and formulas of its variables in new ones, or a generating function.
Output: a :class:`Transformation` with the new Hamiltonian and the way there and back.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from sympy.functions.elementary.hyperbolic import HyperbolicFunction
from sympy.functions.elementary.trigonometric import TrigonometricFunction

from hamsym.codegen.functions import compile_observable
from hamsym.errors import InputError, VariableError
from hamsym.formula.parser import canonical_name, check_name, parse_expression
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.support.shown import Shown
from hamsym.support.suggestions import checked_keywords, did_you_mean, suggest_attributes
from hamsym.support.validation import checked_numbers, shown
from hamsym.symbolic.checks import as_list, checked_expression, name_of, real_symbols
from hamsym.symbolic.pairing import find_pairs, natural_order
from hamsym.symbolic.variables import TIME
from hamsym.transformations.canonical_maps import (
    GENERATING,
    CanonicalMap,
    OldVariables,
    full_map,
    generated_map,
    point_map,
    transformed,
)

_ITERATIONS = 60  # of Newton's method
_STARTS = 200  # random starts of it
_EPS, _TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
_NEAR = 64 * _EPS  # relative distance of a solution
_COARSE = 1e-12  # part of the sizes that round-off of the new variables may be


@suggest_attributes
@dataclass(frozen=True)
class Transformation(Shown):
    """A canonical transformation of a Hamiltonian, from :meth:`hamsym.Hamiltonian.transformed`.

    Attributes
    ----------
    H : Hamiltonian
        In the new variables, with the term that a transformation in time adds.
    original : Hamiltonian
    formulas : mapping of str to sympy.Expr
        Each old variable, of those that change, in the new variables.
    positive : tuple of str
        New variables that stay above zero: H holds only there. Trajectories of H are not stopped
        where they leave it, but :meth:`to_old` refuses them.
    """

    H: Hamiltonian
    original: Hamiltonian
    formulas: Mapping[str, sympy.Expr]
    positive: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Transformation({self.original.formulas!r} -> {self.H.formulas!r})"

    def to_old(self, z: Any, t: Any = 0.0) -> np.ndarray:
        """Compute the old variables of states in the new ones.

        Parameters
        ----------
        z : array or mapping
            Shape (..., dim), in the order of ``H.z``.
        t : float or array
            Times, shape (...), if the transformation depends on time.

        Returns
        -------
        numpy.ndarray
            Shape (..., dim), in the order of ``original.z``.

        Raises
        ------
        InputError
            If a variable that is positive is not: H does not hold for what led there. If an old
            variable is not finite, as at the pole of polar coordinates.

        Examples
        --------
        >>> import hamsym
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> polar = H.transformed({"x": "r*cos(phi)", "y": "r*sin(phi)"}, positive="r")
        >>> solution = hamsym.solve(polar.H, polar.to_new([1, 0, 0, 1.1]), (0, 10))
        >>> direct = hamsym.solve(H, [1, 0, 0, 1.1], (0, 10))
        >>> bool(np.abs(polar.to_old(solution(10.0)) - direct(10.0)).max() < 1e-8)
        True
        """
        states = self.H.states_from(z)
        for name in self.positive:
            least = np.min(states[..., self.H.names.index(name)], initial=np.inf)
            if not least > 0:
                raise InputError(
                    f"{name} is {least:g}, and the new H holds only while it is above zero; give "
                    "states before it gets there"
                )
        times = _times(t, states.shape[:-1])
        found = self._values(states, times)
        lost = np.argwhere(~np.isfinite(found))
        if len(lost):
            *place, column = lost[0]
            state = dict(zip(self.H.names, states[tuple(place)].tolist(), strict=True))
            raise InputError(
                f"{self.original.names[column]} is {found[tuple(lost[0])]} at {state}; give states "
                "at which the transformation is finite"
            )
        return found

    def to_new(self, z: Any, t: Any = 0.0, near: Any = None) -> np.ndarray:
        """Compute the new variables of states in the old ones, by Newton's method.

        Where several states in the new variables are one in the old, as for angles, each is
        searched from the one before it: those of a trajectory are continuous.

        Parameters
        ----------
        z : array or mapping
            Shape (dim,) or (n, dim), in the order of ``original.z``.
        t : float or array
            Times, of shape (n,), if the transformation depends on time.
        near : sequence or mapping, optional
            New variables near the first of them; by default they are searched.

        Raises
        ------
        InputError
            If no new variables are found.
        """
        states = self.original.states_from(z)
        rows = np.atleast_2d(states)
        times = _times(t, rows.shape[:1])
        last = None if near is None else self.H.state_from(near)
        found = np.empty_like(rows)
        for n, (row, time) in enumerate(zip(rows, times, strict=True)):
            starts = [last] if last is not None else self._starts(row)
            solutions = (self._solved(start, row, float(time)) for start in starts)
            with np.errstate(all="ignore"):  # far from a solution values overflow
                last = next((one for one in solutions if one is not None), None)
            if last is None:
                known = dict(zip(self.original.names, row.tolist(), strict=True))
                raise InputError(
                    f"no new variables are found for {known} at t = {time:g}; give near=, a state "
                    f"of {', '.join(self.H.names)} not far from them"
                )
            found[n] = last
        return found.reshape(states.shape)

    @cached_property
    def _values(self) -> OldVariables:
        return OldVariables(self.original, self.H, self.formulas)

    @cached_property
    def _slopes(self) -> list[Any]:
        """The derivatives of the old variables by the new ones, row by row."""
        own = self.H.real_equations
        return [
            compile_observable(sympy.diff(expression, symbol), own)
            for expression in self._values.expressions
            for symbol in own.z
        ]

    def _starts(self, row: np.ndarray) -> Iterator[np.ndarray]:
        """Random states, whose coordinates have powers of the old ones as sizes.

        The product of a coordinate and its momentum is an action, of one unit in all variables.
        """
        random = np.random.default_rng(0)
        dof = len(row) // 2
        q, p = np.split(np.abs(row), 2)
        anything = 2.0 ** random.uniform(-120, 120, _STARTS)
        for k in range(_STARTS):
            known = q[q > 0] if q.any() else anything[k : k + 1]
            action = float((q * p).max() or known.max() * (p.max() or anything[k]))
            shape = (2, dof if k % 2 else 1)  # the same for all of them in every other start
            sizes = random.choice(known, shape)[0] ** random.choice([0, 0.5, 1, 2], shape)[0]
            sizes = np.where(self._angles, 1.0, sizes)
            units = np.concatenate([sizes, action / sizes])
            yield random.uniform(0.05, 1, len(row)) * units

    @cached_property
    def _angles(self) -> np.ndarray:
        """Whether a new coordinate is only in arguments of functions, which have no unit."""
        pure = (TrigonometricFunction, HyperbolicFunction, sympy.exp)
        bare: set[Any] = set()
        for expression in self._values.expressions:
            inside = {function: sympy.Dummy() for function in expression.atoms(*pure)}
            bare |= expression.xreplace(inside).free_symbols
        return np.array([s not in bare for s in self.H.real_equations.z[: self.H.dof]])

    def _solved(self, start: np.ndarray, row: np.ndarray, time: float) -> np.ndarray | None:
        """The state whose old variables are a row; None if the iteration does not end there."""
        z, t = start.copy(), np.asarray(time)
        for _ in range(_ITERATIONS):
            rest = self._values(z, t) - row
            slopes = np.array([float(f(z, t)) for f in self._slopes]).reshape(len(z), -1)
            room = self._room(z, row, np.abs(slopes))
            excess = np.abs(rest) / room
            if (excess <= 1).all():
                return self._allowed(z)
            try:
                step = np.linalg.solve(slopes, rest)
            except np.linalg.LinAlgError:
                return None
            # halved until the distance falls
            for halvings in range(12):
                trial = z - step / 2**halvings
                after = np.abs(self._values(trial, t) - row) / room
                if after.max() < excess.max():
                    z = trial
                    break
            else:
                return self._allowed(z) if (excess <= 16).all() else None
        return None

    def _room(self, z: np.ndarray, row: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return the distance of each old variable that is round-off, shape (dim,).

        Each has its own unit. Beside its own round-off it has that of z, which counts where terms
        cancel, but no more than a share of its size and of those that depend on the same variables:
        an angle of many turns has lost the digits of its direction.
        """
        sizes = np.where(self._related, np.abs(row), 0.0).max(axis=1)
        most = _COARSE * (sizes + slopes @ np.minimum(np.abs(z), 1.0))
        return _NEAR * np.abs(row) + np.minimum(_EPS * (slopes @ np.abs(z)), most) + _TINY

    @cached_property
    def _related(self) -> np.ndarray:
        """Whether all new variables of an old one are among those of another, (other, one)."""
        new = {*self.H.real_equations.z}
        needs = [expression.free_symbols & new for expression in self._values.expressions]
        return np.array([[one <= other for one in needs] for other in needs])

    def _allowed(self, z: np.ndarray) -> np.ndarray | None:
        """The state, unless a variable that is positive is not."""
        places = [self.H.names.index(name) for name in self.positive]
        return z if (z[places] > 0).all() else None


def _times(t: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Times of states, one or one for each; raise InputError unless they have this shape."""
    times = checked_numbers("t", t)
    if times.shape not in ((), shape):
        raise InputError(f"t has shape {times.shape}; give one time, or one for each state")
    return np.broadcast_to(times, shape)


@checked_keywords
def transform(
    H: HamiltonianLike,
    formulas: Mapping[Any, Any] | None = None,
    *,
    new: Sequence[str] | Mapping[str, str] | None = None,
    positive: str | Sequence[str] = (),
    F1: str | sympy.Expr | None = None,
    F2: str | sympy.Expr | None = None,
    F3: str | sympy.Expr | None = None,
    F4: str | sympy.Expr | None = None,
) -> Transformation:
    """Write a Hamiltonian in other coordinates and momenta; see Hamiltonian.transformed.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> transform(H, {"x": "sqrt(2*J)*sin(w)", "p": "sqrt(2*J)*cos(w)"}, new={"w": "J"}).H
    Hamiltonian('J', pairs (w, J))
    """
    H = Hamiltonian.of(H, bound=False)
    given = {"F1": F1, "F2": F2, "F3": F3, "F4": F4}
    functions = {kind: value for kind, value in given.items() if value is not None}
    if (formulas is not None) + len(functions) != 1:
        raise InputError(
            "give the old variables as formulas of new ones, or one generating function: "
            "F1(q, Q), F2(q, P), F3(p, Q) or F4(p, P)"
        )
    reader = _Reader(H, positive)
    found = reader.generated(*functions.popitem(), new) if functions else reader.read(formulas, new)
    return _with_hamiltonian(H, found)


class _Reader:
    """Formulas and names as canonical maps, in symbols with what is known of their signs."""

    def __init__(self, H: Hamiltonian, positive: str | Sequence[str]) -> None:
        self._H = H
        self._positive = {canonical_name(name_of(name)) for name in as_list(positive, "positive")}

    def read(self, formulas: Any, new: Any) -> CanonicalMap:
        """The map of formulas of coordinates, or of coordinates and momenta."""
        H = self._H
        if not isinstance(formulas, Mapping) or not formulas:
            raise InputError(
                f"{shown(formulas)} is not a mapping of old variables to formulas; give for "
                'example {"x": "r*cos(phi)", "y": "r*sin(phi)"}'
            )
        spelled = {canonical_name(name): name for name in H.names}
        known: dict[str, sympy.Expr] = {}
        for key, value in formulas.items():
            name = spelled.get(canonical_name(name_of(key)))
            if name is None:
                hint = did_you_mean(name_of(key), H.names)
                raise VariableError(f"H has no variable '{name_of(key)}'{hint}")
            known[name] = self._expression(value)
        moved = self._moved(known.keys())
        whole = all(q in known and p in known for q, p in moved)
        if not whole and any(p in known for _, p in moved):
            raise InputError(
                "give formulas of coordinates alone, whose momenta follow, or of all: "
                + ", ".join(name for pair in moved for name in pair)
            )
        old = [q for q, _ in moved] + [p for _, p in moved]
        coordinates, momenta = self._new_names(known.values(), new, len(moved), old, whole)
        symbols = self._symbols([*coordinates, *momenta])
        values = [self._in(symbols, known[name]) for name in old[: len(known)]]
        reals = [sympy.Symbol(name, real=True) for name in old]
        return (full_map if whole else point_map)(reals, symbols, values)

    def generated(self, kind: str, function: Any, new: Any) -> CanonicalMap:
        """The map of a generating function."""
        expr = self._expression(function)
        names = {symbol.name for symbol in expr.free_symbols}
        moved = self._moved(names)
        old = [q for q, _ in moved] + [p for _, p in moved]
        if not moved:
            raise InputError(f"{kind} contains no variable of H")
        if new is None:
            raise InputError(
                f'name the new variables of {kind}: new={{"Q": "P"}} for coordinate and momentum'
            )
        coordinates, momenta = self._new_names([], new, len(moved), [], True)
        symbols = self._symbols([*coordinates, *momenta])
        of_old, of_new = GENERATING[kind]
        half = len(moved)
        allowed = {*(old[:half] if of_old == "q" else old[half:])}
        allowed |= {*(coordinates if of_new == "Q" else momenta), *self._H.parameter_names, TIME}
        for name in sorted(names - allowed):
            raise VariableError(
                f"{kind} is a function of ({of_old}, {of_new}), which '{name}' is none of; give it "
                f"in {', '.join(sorted(allowed - {TIME}))}"
            )
        reals = [sympy.Symbol(name, real=True) for name in old]
        return generated_map(kind, self._in(symbols, expr), reals, symbols)

    def _moved(self, names: Collection[str]) -> list[tuple[str, str]]:
        """The pairs of H of which a component is among some names."""
        names_of_H, dof = self._H.names, self._H.dof
        pairs = zip(names_of_H[:dof], names_of_H[dof:], strict=True)
        return [pair for pair in pairs if {*pair} & {*names}]

    def _expression(self, value: Any) -> sympy.Expr:
        if isinstance(value, str):
            return _plain(parse_expression(value))
        return _plain(checked_expression(value, "a formula"))

    def _symbols(self, names: Sequence[str]) -> list[sympy.Symbol]:
        unknown = self._positive - {canonical_name(name) for name in names}
        if unknown:
            raise InputError(
                f"positive={min(unknown)!r} is no new variable; these are {', '.join(names)}"
            )
        return [
            sympy.Symbol(name, positive=True)
            if canonical_name(name) in self._positive
            else sympy.Symbol(name, real=True)
            for name in names
        ]

    @staticmethod
    def _in(symbols: Sequence[sympy.Symbol], expr: sympy.Expr) -> sympy.Expr:
        """The expression with some symbols in place of those of the same names."""
        own = {symbol.name: symbol for symbol in symbols}
        return expr.xreplace({s: own[s.name] for s in expr.free_symbols if s.name in own})

    def _new_names(
        self, values: Any, new: Any, count: int, old: Sequence[str], whole: bool
    ) -> tuple[list[str], list[str]]:
        """Names of the new coordinates and momenta."""
        H = self._H
        if isinstance(new, Mapping):
            coordinates, momenta = [*map(name_of, new)], [*map(name_of, new.values())]
        elif new is not None:
            coordinates = [*map(name_of, as_list(new, "new"))]
            momenta = [f"p_{name}" for name in coordinates]
        else:
            names = {symbol.name for value in values for symbol in value.free_symbols}
            names -= {*H.parameter_names, TIME} | ({*H.names} - {*old})
            if whole:
                pairs = find_pairs(names)
                coordinates, momenta = [q for q, _ in pairs], [p for _, p in pairs]
            else:
                coordinates = sorted(names, key=natural_order)
                momenta = [f"p_{name}" for name in coordinates]
        every = [*coordinates, *momenta]
        for name in every:
            check_name(name)
            if name in {*H.names, *H.parameter_names, TIME}:
                raise VariableError(
                    f"'{name}' is a name of H; new variables need names of their own"
                )
        if len(coordinates) != count or len({*every}) != 2 * count:
            changing = "coordinates change" if count > 1 else "coordinate changes"
            raise VariableError(
                f"{count} {changing}, and the new ones are {', '.join(coordinates) or 'none'}; "
                "name as many with new="
            )
        for value in values:
            known = {*every, *H.parameter_names, TIME, *({*H.names} - {*old})}
            for symbol in sorted(value.free_symbols, key=str):
                if symbol.name not in known:
                    raise VariableError(
                        f"'{symbol.name}' is neither a new variable nor a parameter of H; the new "
                        f"ones are {', '.join(every)}"
                    )
        return coordinates, momenta


def _plain(expr: sympy.Expr) -> sympy.Expr:
    """The expression in real symbols."""
    return expr.xreplace(real_symbols(expr.free_symbols))


def _with_hamiltonian(H: Hamiltonian, found: CanonicalMap) -> Transformation:
    """The transformation with its Hamiltonian, whose other pairs stay."""
    form, half = H.real_equations, len(found.old) // 2
    replaced = dict(zip((s.name for s in found.old), found.new, strict=True))
    z = [replaced.get(name, sympy.Symbol(name, real=True)) for name in H.names]
    q, p = z[: H.dof], z[H.dof :]
    expr = _plain(transformed(form.expr, found) + found.rest)
    forces = {}
    if H.forces:
        old = {s.name: f for s, f in zip(found.old, found.formulas, strict=True)}
        if any(f.has(*found.new[half:]) for f in found.formulas[:half]):
            raise InputError("forces need a transformation of coordinates alone")
        acting = {s.name: f for s, f in zip(form.z[H.dof :], form.forces, strict=True)}
        for name, momentum in zip(H.names[: H.dof], p, strict=True):
            if name not in old:
                forces[momentum.name] = _plain(transformed(acting[_pair(H, name)], found))
        for Q, P in zip(found.new[:half], found.new[half:], strict=True):
            work = sympy.Add(
                *(
                    acting[_pair(H, symbol.name)] * sympy.diff(old[symbol.name], Q)
                    for symbol in found.old[:half]
                )
            )
            forces[P.name] = _plain(transformed(work, found))
    names = {s.name for s in expr.free_symbols}.union(
        *({s.name for s in force.free_symbols} for force in forces.values())
    )
    new = Hamiltonian(
        expr,
        q=[_plain(symbol) for symbol in q],
        p=[_plain(symbol) for symbol in p],
        parameters={name: value for name, value in H.parameters.items() if name in names},
        forces=forces,
    )
    formulas = {s.name: _plain(f) for s, f in zip(found.old, found.formulas, strict=True)}
    return Transformation(new, H, formulas, tuple(s.name for s in found.new if s.is_positive))


def _pair(H: Hamiltonian, coordinate: str) -> str:
    """The name of the momentum of a coordinate."""
    return H.names[H.dof + H.names.index(coordinate)]
