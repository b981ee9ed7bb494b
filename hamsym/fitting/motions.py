"""States at given times, and their derivatives in free quantities, for many values of these.

A source of motions evaluates rows of values. There are three: :class:`SolvedMotions` solves one
row at a time, with :meth:`Solution.sensitivity`; :class:`LiftedMotions` solves all rows and all
derivatives in one call of :func:`hamsym.solve_many`; :class:`MappedMotions` evaluates a flow map.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import sympy

from hamsym.errors import HamsymError, InputError
from hamsym.families.many import solve_many
from hamsym.families.solutions import Solutions
from hamsym.fitting.unknowns import Unknowns
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import coupled_sizes
from hamsym.random_features.members import MemberSolver
from hamsym.solution.solution import Solution
from hamsym.solving.solve import solve
from hamsym.symbolic import derivatives

if TYPE_CHECKING:
    from hamsym.flow_maps.flow_map import FlowMap

_ROWS = 256  # that are solved together, to bound the memory
_FAST = 2e4  # radians in the span, from which a motion takes a second
_FASTER = 10  # times the first guess: also too fast
_LARGEST = 1e100  # change of a parameter that a response can need
_SMALL = 1e-3  # size of the response to a parameter, relative to that to the start


class Motions(Protocol):
    """Source of states and their derivatives."""

    def __call__(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (n, times, dim) and derivatives (n, times, dim, k) for values (n, k).

        Rows that have no motion over all times are nan.
        """

    def states(self, values: np.ndarray) -> np.ndarray:
        """States alone, for a part of the time."""

    def reason(self, values: np.ndarray) -> str:
        """Return why values of shape (k,) have no motion."""


@dataclass
class SolvedMotions:
    """Motions of one solution for each row."""

    unknowns: Unknowns
    t: np.ndarray
    span: tuple[float, float]
    tol: float
    _last: dict[bytes, Solution] = field(default_factory=dict, repr=False)

    def solution(self, values: np.ndarray) -> Solution:
        """Return the solution with values of shape (k,); the last one is kept.

        Raise InputError if there is none.
        """
        key = values.tobytes()
        if key not in self._last:
            self._last = {key: self._solved(values)}
        return self._last[key]

    def _solved(self, values: np.ndarray) -> Solution:
        H, start = self.unknowns.hamiltonian(values), self.unknowns.starts(values[None])[0]
        return solve(H, start, self.span, tol=self.tol)

    def solutions(self, values: np.ndarray) -> Solutions:
        """Return the solutions with values of shape (n, k), solved together."""
        return solve_many(
            self.unknowns.H,
            self.unknowns.starts(values),
            self.span,
            tol=self.tol,
            parameters=self.unknowns.parameters(values),
            progress=False,
        )

    def __call__(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states, slopes = self._unknown(values)
        for row in self._slow(values):
            with contextlib.suppress(HamsymError):
                states[row], slopes[row] = self._motion(values[row])
        return states, slopes

    def states(self, values: np.ndarray) -> np.ndarray:
        states, _ = self._unknown(values)
        for row in self._slow(values):
            with contextlib.suppress(HamsymError):
                solution = self._solved(values[row])
                if solution.span[1] == self.span[1]:
                    states[row] = solution(self.t)
        return states

    def _unknown(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states and derivatives of rows without a motion."""
        shape = (len(values), len(self.t), self.unknowns.H.dim)
        return np.full(shape, np.nan), np.full((*shape, values.shape[1]), np.nan)

    def _slow(self, values: np.ndarray) -> np.ndarray:
        """Return the rows with motions that are not too fast."""
        return np.flatnonzero(~_is_too_fast(self.unknowns, values, self.span))

    def _motion(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unknowns, solution = self.unknowns, self.solution(values)
        if solution.span[1] != self.span[1]:
            raise InputError(solution.message)
        slopes = np.empty((len(self.t), unknowns.H.dim, len(values)))
        places, free = unknowns.components, unknowns.free_parameters
        if places:
            slopes[:, :, list(places)] = solution.sensitivity(self.t)[:, :, list(places.values())]
        if free:
            columns = [j for j in range(len(values)) if j not in places]
            slopes[:, :, columns] = solution.sensitivity(self.t, parameters=list(free))
        return solution(self.t), slopes

    def reason(self, values: np.ndarray) -> str:
        if _is_too_fast(self.unknowns, values[None], self.span)[0]:
            return "it is too fast for the span"
        try:
            self._motion(values)
        except HamsymError as error:
            return str(error)
        return "the motion or an observable is not finite"


def _is_too_fast(unknowns: Unknowns, values: np.ndarray, span: tuple[float, float]) -> np.ndarray:
    """Return whether motions would take long, so that a search does without them, shape (n,).

    By the eigenvalues of J Hess at the start. The first guess is never too fast.
    """
    every = rates(unknowns, np.vstack((unknowns.guesses, values)), span[0])
    limit = max(_FAST / abs(span[1] - span[0]), _FASTER * float(np.nan_to_num(every[0])))
    return every[1:] > limit


def state_sizes(unknowns: Unknowns, span: tuple[float, float]) -> np.ndarray:
    """Return the sizes of the components at the first guess, with those that others move, (dim,).

    They are 1 where nothing moves.
    """
    guess, length = unknowns.guesses[None], abs(span[1] - span[0])
    coupling = np.abs(_at(unknowns, "jacobian", guess, span[0]))[0]
    rate = np.nan_to_num(rates(unknowns, guess, span[0]))[0]
    moved = np.abs(_at(unknowns, "vector_field", guess, span[0])[0])
    moved = np.nan_to_num(moved * min(length, 1 / rate if rate > 0 else length), posinf=0.0)
    found = coupled_sizes(np.maximum(np.abs(unknowns.start), moved), coupling, length)
    return np.where((found > 0) & np.isfinite(found), found, 1.0)


def rates(unknowns: Unknowns, values: np.ndarray, start: float) -> np.ndarray:
    """Return the largest sizes of the eigenvalues of J Hess at starts, nan without one, (n,)."""
    matrices = _at(unknowns, "jacobian", values, start)
    shape = (len(values), unknowns.H.dim, unknowns.H.dim)
    matrices = np.broadcast_to(matrices, shape)
    finite = np.isfinite(matrices).all(axis=(1, 2))
    found = np.full(len(values), np.nan)
    found[finite] = np.abs(np.linalg.eigvals(matrices[finite])).max(axis=1)
    return found


def _at(unknowns: Unknowns, kind: str, values: np.ndarray, start: float) -> np.ndarray:
    """Return a function of the compiled H at starts of values (n, k), shape (n or 1, ...)."""
    system, rows = unknowns.H.compile("numpy"), unknowns.parameter_rows(values)
    return system.at(kind, unknowns.starts(values), np.full(len(values), start), rows)


@dataclass
class LiftedMotions(SolvedMotions):
    """Motions of the tangent lift, in which derivatives in one direction are further components.

    With a direction (dz, dk) the Hamiltonian K = dz . grad H + dk . dH/dk, with pairs (q, dp) and
    (dq, p), has the equations of z and the variational equations of dz: all rows and directions
    are members of one ensemble. Forces F of H act on p, and their changes dF on dp.
    """

    def __post_init__(self) -> None:
        unknowns = self.unknowns
        lifted = _lift(unknowns.H, unknowns.free_parameters)
        assert lifted is not None
        self._lifted, self._rates = lifted
        # Directions of parameters have a start too, whose motion is subtracted: a member that
        # starts with no deviation at all has components without a scale.
        self._directions = [i for _, i in sorted(unknowns.components.items())] or [0]
        _, exponents = np.frexp(state_sizes(unknowns, self.span))
        self._units = np.ldexp(1.0, exponents)
        self._sizes = {
            name: abs(unknowns.H.parameters[name]) or 1.0 for name in unknowns.free_parameters
        }

    @staticmethod
    def applies(unknowns: Unknowns) -> bool:
        """Return whether H and its lift are smooth."""
        return _lift(unknowns.H, unknowns.free_parameters) is not None

    def __call__(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states, slopes = self._unknown(values)
        slow = self._slow(values)
        for k in range(0, len(slow), _ROWS):
            rows = slow[k : k + _ROWS]
            states[rows], slopes[rows] = self._part(values[rows])
        return states, slopes

    def _part(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        unknowns, dim, dof = self.unknowns, self.unknowns.H.dim, self.unknowns.H.dof
        places, free = unknowns.components, unknowns.free_parameters
        columns = [j for j in range(values.shape[1]) if j not in places]
        shape = (len(values), len(self._directions) + len(free))
        # The components of the lift are (q, dq, dp, p).
        own = [*range(dof), *range(3 * dof, 4 * dof)]
        deviation = np.arange(dof, 3 * dof)
        starts = np.zeros((*shape, 2 * dim))
        starts[..., own] = unknowns.starts(values)[:, None]
        for member, i in enumerate(self._directions):
            starts[:, member, deviation[i]] = self._units[i]
        first = self._directions[0]
        starts[:, len(self._directions) :, deviation[first]] = self._units[first]
        while True:
            given: dict[str, Any] = {
                name: value[:, None] for name, value in unknowns.parameters(values).items()
            }
            for place, name in enumerate(free):
                rate = np.zeros(shape)
                rate[:, len(self._directions) + place] = self._sizes[name]
                given[self._rates[name]] = rate
            given = {n: v for n, v in given.items() if n in self._lifted.parameter_names}
            many = solve_many(
                self._lifted, starts, self.span, tol=self.tol, parameters=given, progress=False
            )
            found = many(self.t)
            moved = found[..., deviation]
            responses = moved[:, len(self._directions) :] - moved[:, :1]
            if not self._resized(responses, moved[:, :1]):
                break
        slopes = np.empty((len(values), len(self.t), dim, values.shape[1]))
        for member, j in enumerate(sorted(places)):
            slopes[..., j] = moved[:, member] / self._units[self._directions[member]]
        for place, (j, name) in enumerate(zip(columns, free, strict=True)):
            slopes[..., j] = responses[:, place] / self._sizes[name]
        return found[:, 0][..., own], slopes

    def states(self, values: np.ndarray) -> np.ndarray:
        (states, _), rows = self._unknown(values), self._slow(values)
        if len(rows):
            states[rows] = self.solutions(values[rows])(self.t)
        return states

    def _resized(self, responses: np.ndarray, reference: np.ndarray) -> bool:
        """Enlarge changes of parameters whose response is lost beside that of the start."""
        changed = False
        with np.errstate(all="ignore"):
            for place, name in enumerate(self._sizes):
                response = np.abs(responses[:, place] / self._units).max(axis=1)
                sizes = response / np.abs(reference[:, 0] / self._units).max(axis=1)
                ratio = np.where(np.isfinite(sizes), sizes, 0.0).max()
                if 1e-30 < ratio < _SMALL and self._sizes[name] < _LARGEST:
                    self._sizes[name] /= ratio
                    changed = True
        return changed


def _lift(H: Hamiltonian, free: tuple[str, ...]) -> tuple[Hamiltonian, Mapping[str, str]] | None:
    return _lift_of(H.with_parameters(**dict.fromkeys(H.parameters, 1.0)), free)


@functools.lru_cache(maxsize=64)
def _lift_of(H: Hamiltonian, free: tuple[str, ...]) -> tuple[Hamiltonian, Mapping[str, str]] | None:
    """Return the tangent lift of H without values, and the names of the changes of parameters.

    None where H is not smooth, or derivatives of its gradient are too large.
    """
    if not MemberSolver.applies(H):
        return None
    equations, taken = H.real_equations, {*H.names, *H.parameter_names, "t"}

    def unused(name: str) -> str:
        while name in taken:
            name += "_"
        taken.add(name)
        return name

    deviations = [sympy.Symbol(unused(f"d_{i}"), real=True) for i in range(H.dim)]
    rates = {name: unused(f"e_{i}") for i, name in enumerate(free)}
    terms = [slope * d for slope, d in zip(equations.gradient, deviations, strict=True)]
    for name, rate in rates.items():
        slope = sympy.diff(equations.expr, equations.parameters[name][0])
        terms.append(slope * sympy.Symbol(rate, real=True))
    z, dof = equations.z, H.dof
    forces = {}
    for i, force in enumerate(equations.forces):
        forces[z[dof + i]] = force
        slopes = derivatives.gradient(force, z)
        changes = [slope * d for slope, d in zip(slopes, deviations, strict=True)]
        for name, rate in rates.items():
            slope = derivatives.gradient(force, [equations.parameters[name][0]])[0]
            changes.append(slope * sympy.Symbol(rate, real=True))
        forces[deviations[dof + i]] = sympy.Add(*changes)
    try:
        lifted = Hamiltonian(
            sympy.Add(*terms),
            q=[*z[:dof], *deviations[:dof]],
            p=[*deviations[dof:], *z[dof:]],
            forces=forces,
        )
        if not MemberSolver.applies(
            lifted.with_parameters(**dict.fromkeys(lifted.parameter_names, 1.0))
        ):
            return None
    except HamsymError:
        return None
    return lifted, rates


@dataclass(frozen=True)
class MappedMotions:
    """Motions of a flow map."""

    flow: FlowMap
    unknowns: Unknowns
    t: np.ndarray

    def __call__(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = self.states(values)
        every = np.asarray(self.flow.jacobian(*self._arguments(values)))
        every = every.reshape(*states.shape, -1)
        columns = [self.flow.inputs.index(name) for name in self.unknowns.names]
        return states, every[..., columns]

    def _arguments(
        self, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        repeated = np.repeat(values, len(self.t), axis=0)
        parameters = self.unknowns.parameters(repeated)
        varied = {name: array for name, array in parameters.items() if name in self.flow.inputs}
        return np.tile(self.t, len(values)), self.unknowns.starts(repeated), varied

    def states(self, values: np.ndarray) -> np.ndarray:
        found = np.asarray(self.flow(*self._arguments(values)))
        return found.reshape(len(values), len(self.t), -1)

    def reason(self, values: np.ndarray) -> str:
        return "the map or an observable is not finite"
