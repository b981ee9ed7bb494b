"""The boundary-value problem of a connection, and Newton's method for it.

A connection begins on the unstable manifold of one origin and ends on the stable manifold of
another one. Unknowns are a start on each local manifold, by its direction and phase, and the times
from there to a section. Equations are that both trajectories meet, and that they do so on the
section:

    phi(T_u, W_u(c_u)) = phi(-T_s, W_s(c_s)),   g = 0.

Where H depends on time both times are equal, too, up to whole periods of the orbits.
Derivatives come from the variational equation. Where energy is conserved one equation follows from
the others, so that Gauss-Newton steps converge quadratically.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from hamsym.invariant_manifolds.origins import Departure
from hamsym.problems.surface import Surface
from hamsym.solution.solution import Solution
from hamsym.solving.solve import solve

_NEWTON = 15  # iterations
_TOLERANCES = (1e-12, 1e-11, 1e-10, 1e-9)  # of trajectories, the first that is met
_PHASE, _ANGLE, _TIME = 0.25, 0.3, 0.2  # largest steps; of a time as a share of it
_ASIDE = 1e-6  # of the motion: distance over which slopes of the section are measured
_CLOSE = 1e-4  # difference of unknowns, relative for times, from which Newton's method converges
_ENOUGH = 1e-3  # of the tolerance: mismatch that needs no further iteration
_RANK = 1e-11  # singular values, relative to the largest, that count as zero


@dataclass(frozen=True, eq=False)
class Side:
    """A trajectory from a local manifold to the section."""

    leaving: Departure
    direction: np.ndarray
    phase: float
    #: Positive.
    time: float

    def moved(self, change: np.ndarray) -> Side:
        """The side with changed unknowns: along directions, of the phase, and of the time."""
        direction = self.direction + self._basis.T @ change[: len(self._basis)]
        phase = self.phase + (change[-2] if self.leaving.period is not None else 0.0)
        side = replace(
            self,
            direction=direction / np.linalg.norm(direction),
            phase=float(phase),
            time=float(self.time + change[-1]),
        )
        return side.within()

    def within(self) -> Side:
        """The same trajectory with a phase from 0 to 1, as long as it leaves a time."""
        period, turn = self.leaving.period, 1.0 if self.leaving.rates[0].real > 0 else 2.0
        if period is None:
            return self
        turns = math.floor(self.phase / turn) * turn
        if not self.time - turns * period > 0:
            return self
        return replace(self, phase=self.phase - turns, time=self.time - turns * period)

    @property
    def unknowns(self) -> int:
        """Number of unknowns: directions, a phase, a time."""
        return len(self._basis) + (self.leaving.period is not None) + 1

    @property
    def steps(self) -> np.ndarray:
        """Largest changes of the unknowns in one iteration."""
        found = [_ANGLE] * len(self._basis)
        found += [] if self.leaving.period is None else [_PHASE]
        return np.array([*found, _TIME * self.time])

    @property
    def _basis(self) -> np.ndarray:
        """Directions across this one, rows."""
        if len(self.direction) == 1:
            return np.empty((0, 1))
        return np.asarray(scipy.linalg.null_space(self.direction[None]).T)

    def start(self) -> np.ndarray:
        """State on the local manifold."""
        return self.leaving.states(self.direction[None], np.array([self.phase]))[0]

    def local_error(self, least: float) -> float:
        """Error of the local manifold, also in the past of the start."""
        phases = np.array([self.phase])
        return self.leaving.followed(self.direction[None], phases, least).local.error

    def solved(self) -> Solution | None:
        """The trajectory, to the smallest tolerance that is met; None if none is."""
        leaving = self.leaving
        span = leaving.start, leaving.start + leaving.sign * self.time
        for tol in _TOLERANCES:
            least = (tol * leaving.local.scale).tolist()
            found = solve(leaving.H, self.start(), span, tol=tol, atol=least, progress=False)
            if found.success:
                return found
        return None

    def derivative(self, solution: Solution) -> np.ndarray:
        """Derivative of its end by its unknowns, shape (dim, unknowns)."""
        leaving, end = self.leaving, solution.span[1]
        columns = [leaving.by_direction(self.direction, self.phase, row) for row in self._basis]
        if leaving.period is not None:
            columns.append(leaving.by_phase(self.direction, self.phase))
        moved = np.asarray(solution.sensitivity(end)) @ np.array(columns).T if columns else None
        rates = leaving.H.compile("numpy").at("vector_field", solution(end), end)
        rate = leaving.sign * rates
        return rate[:, None] if moved is None else np.concatenate([moved, rate[:, None]], axis=1)


class Met(NamedTuple):
    """Two sides with their trajectories, and how well they meet."""

    sides: tuple[Side, Side]
    solutions: tuple[Solution, Solution]
    #: Largest difference of their ends, relative to the size of each component.
    mismatch: float
    #: Smallest singular value of the derivative of the equations by the unknowns, relative to the
    #: largest.
    transversality: float
    #: Sizes of the components.
    scale: np.ndarray


def meet(
    sides: tuple[Side, Side], surface: Surface, tol: float, known: Sequence[Met] = ()
) -> Met | None:
    """Solve for a connection near a guess; None if Newton's method does not converge to anything.

    The iteration goes on below the tolerance while the mismatch falls, and the best iterate is
    returned, whether or not it meets the tolerance. Sizes of components are those along both
    trajectories, and on the local manifolds.

    - known: Solutions at which the iteration ends with None.
    """
    best: Met | None = None
    worse = 0
    for _ in range(_NEWTON):
        first, second = sides[0].solved(), sides[1].solved()
        if first is None or second is None:
            return best
        ends = first(first.span[1]), second(second.span[1])
        local = [side.leaving.local.scale for side in sides]
        scale = np.max([first.scale, second.scale, *local], axis=0)
        slope, value = _slope(surface, ends[0], first.span[1], scale)
        size = float(np.abs(slope * scale).max())
        rest = np.append((ends[0] - ends[1]) / scale, [value / size, *_clocks(sides)])
        left, right = sides[0].derivative(first), sides[1].derivative(second)
        rows = np.concatenate([left, -right], axis=1) / scale[:, None]
        section = np.concatenate([slope @ left, np.zeros(right.shape[1])]) / size
        matrix = np.concatenate([rows, section[None], _clock_rows(sides)])
        if not (np.isfinite(rest).all() and np.isfinite(matrix).all()):
            return best
        units = np.linalg.norm(matrix, axis=0)
        scaled = matrix / np.where(units > 0, units, 1.0)
        singular = np.linalg.svd(scaled, compute_uv=False)
        mismatch = float(np.abs(rest).max())
        if best is None or mismatch < best.mismatch:
            share = float(singular[-1] / singular[0])
            best = Met(sides, (first, second), mismatch, share, scale)
            worse = 0
        else:
            worse += 1
        if best.mismatch <= _ENOUGH * tol or worse > (0 if best.mismatch <= tol else 2):
            break
        step = -np.linalg.lstsq(scaled, rest, rcond=_RANK)[0] / np.where(units > 0, units, 1.0)
        limits = np.concatenate([sides[0].steps, sides[1].steps])
        step /= max(1.0, float((np.abs(step) / limits).max()))
        count = sides[0].unknowns
        sides = sides[0].moved(step[:count]), sides[1].moved(step[count:])
        if any(_alike(sides, met.sides) for met in known):
            return None
    return best


def _clocks(sides: tuple[Side, Side]) -> list[float]:
    """The difference of the times on the section, in periods of the orbits, if H depends on it."""
    leaving, other = sides[0].leaving, sides[1].leaving
    if leaving.H.time is None or leaving.period is None:
        return []
    ends = leaving.start + sides[0].time, other.start - sides[1].time
    apart = (ends[0] - ends[1]) / leaving.period
    return [apart - round(apart)]


def _clock_rows(sides: tuple[Side, Side]) -> np.ndarray:
    """The derivative of the difference of times by the unknowns."""
    count = sides[0].unknowns
    rows = np.zeros((len(_clocks(sides)), count + sides[1].unknowns))
    rows[:, [count - 1, -1]] = 1 / (sides[0].leaving.period or 1.0)
    return rows


def _alike(sides: tuple[Side, Side], others: tuple[Side, Side]) -> bool:
    """Whether a guess is so near a solution that Newton's method goes there."""
    return all(
        abs(one.phase - other.phase) <= _CLOSE
        and abs(one.time - other.time) <= _CLOSE * other.time
        and bool((np.abs(one.direction - other.direction) <= _CLOSE).all())
        for one, other in zip(sides, others, strict=True)
    )


def _slope(
    surface: Surface, state: np.ndarray, t: float, scale: np.ndarray
) -> tuple[np.ndarray, float]:
    """Gradient of the surface's function by central differences, and its value."""
    aside = np.diag(_ASIDE * scale)
    times = np.full(len(state), t)
    ahead, behind = surface.value(state + aside, times), surface.value(state - aside, times)
    value = float(np.asarray(surface.value(state[None], np.array([t])))[0])
    return np.asarray((ahead - behind) / (2 * _ASIDE * scale)), value
