"""Fixed-step integration with the generated loops, for one trajectory or an ensemble.

Input:  a Hamiltonian, a method with fixed steps, states of shape (n, dim) and the parameter values
        of each.
Output: states of shape (n, 1 + saves, dim), and the number of steps of each trajectory.

The work is divided into pieces of about a tenth of a second, so that progress can be shown and an
interruption keeps the steps done so far. Ensembles are divided between the processor's cores. The
results are bit-identical for every division.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.adaptive import Adaptive
from hamsym.integrators.coefficients import Doubled, RungeKutta, Scheme, Splitting
from hamsym.integrators.step_scales import fastest_rates
from hamsym.integrators.table import INTEGRATORS, usable_method
from hamsym.numerics.scales import tangent_scales
from hamsym.parallel.threads import Threads, slices
from hamsym.problems.ensemble import Ensemble
from hamsym.support.machine import memory_size
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require_number

#: Reason of an early end by Ctrl-C.
INTERRUPTED = "interrupted"

# Component updates in a piece: about a tenth of a second of the loops.
_PIECE_WORK = 20_000_000
# Component updates in all steps from which a second thread gains more than it costs to start.
_MIN_THREADED_WORK = 200_000
# Trajectories from which the loop that applies each flow to a block of them is faster.
_MIN_ENSEMBLE = 4


@dataclass
class Stepping:
    """Result of :meth:`Stepper.advance`."""

    #: States before the steps and after every save_every of them, shape (n, 1 + saves, dim); nan
    #: after the last completed step.
    path: np.ndarray = field(repr=False)
    #: Completed steps of each trajectory, shape (n,).
    steps: np.ndarray
    #: Evaluations of the force, the gradient or the vector field, summed over trajectories.
    evaluations: int
    #: Whether Ctrl-C ended the run.
    interrupted: bool = False

    @property
    def states(self) -> np.ndarray:
        """States after every save_every steps, shape (n, saves, dim)."""
        return self.path[:, 1:]


class Stepper:
    """Fixed-step integrator of an ensemble; it keeps the states between calls.

    Raise InputError if the method is unknown, adaptive, or does not apply to this H.

    - states: Shape (n, dim).
    - starts, sizes: First time and step size of each trajectory, shape (n,).
    - parameters: Values of each trajectory in the order of ``H.parameter_names``, shape (n, k), by
      default those of H.
    - compensated: Whether to use compensated summation.
    - tangents: Tangent vectors, propagated in place by the derivative of the steps, shape (n,
      width, k); width is dim, or 2 dim for a :class:`Doubled` scheme.
    - omega: Coupling of a :class:`Doubled` scheme; by default from the rates at the states.
    """

    def __init__(
        self,
        H: Hamiltonian,
        method: str,
        states: np.ndarray,
        starts: np.ndarray,
        sizes: np.ndarray,
        *,
        parameters: np.ndarray | None = None,
        compensated: bool = False,
        tangents: np.ndarray | None = None,
        omega: float | None = None,
    ) -> None:
        name = usable_method(H, method)
        scheme = INTEGRATORS[name].scheme
        if isinstance(scheme, Adaptive):
            fixed = ", ".join(key for key, row in INTEGRATORS.items() if not row.adaptive)
            raise InputError(f"{method} is adaptive; give a method with fixed steps: {fixed}")
        count, self._dim = states.shape
        self.scheme: Scheme = scheme
        loop = _loop(H, scheme, count, 0 if tangents is None else tangents.shape[2])
        self._loop = H.kernels.function(loop)
        self._states = np.zeros((count, scheme.width(self._dim)))
        self._states[:, : self._dim] = states
        if isinstance(scheme, Doubled):
            self._states[:, self._dim :] = states
        self._compensated = compensated or isinstance(scheme, RungeKutta)
        self._low = np.zeros_like(self._states)
        self.tangents = np.zeros((count, 1, 0)) if tangents is None else tangents
        self._done = np.zeros((count, 2), dtype=np.int64)
        self._starts, self._sizes = np.ascontiguousarray(starts), np.ascontiguousarray(sizes)
        if parameters is None:
            values = [H.parameters[name] for name in H.parameter_names]
            parameters = np.tile(np.array(values, dtype=float), (count, 1))
        self._parameters = np.ascontiguousarray(parameters)
        self._first = 0
        implicit_euler = isinstance(scheme, Splitting) and not H.is_separable
        #: Whether a step solves nonlinear equations, which may have no solution.
        self.is_implicit = implicit_euler or isinstance(scheme, RungeKutta)
        self._constants: list[Any] = (
            [name == "symplectic_euler"] if implicit_euler else [*scheme.arrays]
        )
        if isinstance(scheme, Doubled):
            self._constants += _coupling(H, states, starts, parameters, omega)
        if self.is_implicit:
            jacobians = H.compile("numpy").at("jacobian", states, starts, parameters)
            self._constants.append(tangent_scales(jacobians, float(np.abs(sizes).max())))

    @property
    def states(self) -> np.ndarray:
        """Current states of the trajectories, shape (n, dim)."""
        return self._states[:, : self._dim]

    def step(self, count: int) -> np.ndarray:
        """Do ``count`` steps in one call of the loop and return the states, shape (n, dim)."""
        out = np.empty((len(self._states), 1, self._dim))
        self._run(None, out, 0, 1, count)
        return np.array(self.states)

    def advance(self, saves: int, save_every: int = 1, *, show: bool | None = None) -> Stepping:
        """Do saves*save_every steps and return the states after every save_every steps.

        Ensembles with enough work are divided between the available cores.
        """
        count = len(self._states)
        before = self._done.copy()
        path = np.empty((count, 1 + saves, self._dim))
        path[:, 0] = self.states
        interrupted, reached = False, 0
        work = count * self._dim * self.scheme.stages
        most = count if work * saves * save_every > _MIN_THREADED_WORK else 1
        with stepping_progress(saves * save_every, show) as progress, Threads(most) as threads:
            try:
                for save, part, every in _pieces(saves, save_every, max(1, _PIECE_WORK // work)):
                    self._run(threads, path, 1 + save, part, every)
                    reached += part * every
                    progress(part * every)
                    lost = not np.isfinite(self._states).all(axis=1).any()
                    if reached < saves * save_every and lost:
                        break
            except KeyboardInterrupt:
                interrupted = True
        steps = self._done[:, 0] - before[:, 0]
        completed = 1 + np.minimum(steps, reached) // save_every
        for trajectory in np.flatnonzero(completed <= saves):
            path[trajectory, completed[trajectory] :] = np.nan
        return Stepping(path, steps, self._evaluations(self._done - before), interrupted)

    @property
    def evaluations(self) -> int:
        """Evaluations of the force, the gradient or the vector field so far."""
        return self._evaluations(self._done)

    def _evaluations(self, done: np.ndarray) -> int:
        # The loops count evaluations only where the number depends on iterations.
        steps, counted = done.sum(axis=0)
        return int(counted or steps * self.scheme.stages)

    def _run(
        self, threads: Threads | None, out: np.ndarray, offset: int, saves: int, every: int
    ) -> None:
        """Do saves*every steps; states are written to out[:, offset : offset + saves]."""
        before = self._done[:, 0].copy()

        def advance(group: slice) -> None:
            self._loop(
                self._states[group],
                self._low[group] if self._compensated else None,
                self.tangents[group],
                out[group],
                offset,
                self._done[group],
                self._starts[group],
                self._sizes[group],
                self._first,
                saves,
                every,
                *self._constants,
                self._parameters[group],
            )

        if threads is None:
            advance(slice(None))
        else:
            deque(threads.results(advance, slices(len(before), threads.cores)), maxlen=0)
        self._first += saves * every
        if self.is_implicit:  # a trajectory whose step was not solved ends there
            self._states[self._done[:, 0] - before < saves * every] = np.nan


def _coupling(
    H: Hamiltonian,
    states: np.ndarray,
    starts: np.ndarray,
    parameters: np.ndarray,
    omega: float | None,
) -> tuple[float, np.ndarray]:
    """The coupling of a doubled phase space, given or chosen, and units of q over those of p.

    The units are those of :func:`tangent_scales`.
    """
    if omega is not None:
        require_number("omega", omega, 0)
        coupling = float(omega)
    else:
        rate = float(fastest_rates(H, states, starts, parameters).max())
        if not math.isfinite(rate):
            raise InputError("the Hessian of H is not finite at z0; give omega")
        coupling = 2 * rate if rate > 0 else 1.0
    jacobians = H.compile("numpy").at("jacobian", states, starts, parameters)
    q, p = np.split(tangent_scales(jacobians), 2)
    return coupling, q / p


def _loop(H: Hamiltonian, scheme: Scheme, count: int, vectors: int) -> str:
    """Name of the generated loop for a scheme and a number of tangent vectors."""
    if isinstance(scheme, RungeKutta):
        return "implicit"
    if isinstance(scheme, Doubled):
        return "doubled"
    if not H.is_separable:
        return "euler"
    # Kernels that loop over terms gain nothing from blocks of trajectories.
    together = count >= _MIN_ENSEMBLE and not H.kernels.is_looped
    if vectors:
        # The processor vectorises over trajectories only without a loop over their vectors.
        together = together and vectors == 1
        return "splitting_tangent_ensemble" if together else "splitting_tangent"
    return "splitting_ensemble" if together else "splitting"


def _pieces(saves: int, save_every: int, piece: int) -> Iterator[tuple[int, int, int]]:
    """Yield (row of the first save, saves, steps per save); parts of a save have its row."""
    if save_every <= piece:
        together = piece // save_every
        for save in range(0, saves, together):
            yield save, min(together, saves - save), save_every
        return
    for save in range(saves):
        for step in range(0, save_every, piece):
            yield save, 1, min(piece, save_every - step)


# -- runs over a span ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """States of an ensemble over a whole span."""

    #: Equally spaced, shape (n,); a run with twice the steps has these times among its own.
    times: np.ndarray
    #: States, shape (count, n, dim); nan after the end of a trajectory.
    z: np.ndarray
    interrupted: bool
    evaluations: int
    #: Reason for an early stop, or "".
    problem: str


def run_steps(
    members: Ensemble,
    method: str,
    span: tuple[float, float],
    steps: int,
    save_every: int,
    *,
    compensated: bool = False,
    omega: float | None = None,
    progress: bool | None = None,
) -> Run:
    """Integrate an ensemble with equal steps.

    Raise InputError if the states do not fit into memory, or as :class:`Stepper`.
    """
    saves, (start, end), count = steps // save_every, span, len(members)
    require_memory(saves, members)
    stepper = Stepper(
        members.H,
        method,
        members.states,
        np.full(count, start),
        np.full(count, (end - start) / steps),
        compensated=compensated,
        omega=omega,
        parameters=members.parameters,
    )
    done = stepper.advance(saves, save_every, show=progress)
    problem = ""
    if done.interrupted:
        problem = INTERRUPTED
    elif stepper.is_implicit and done.steps.min() < steps:
        problem = "the implicit step could not be solved; take more steps"
    times = np.linspace(start, end, saves + 1)
    return Run(times, done.path, done.interrupted, done.evaluations, problem)


def require_memory(saves: int, members: Ensemble) -> None:
    """Raise InputError if saved states and their energies need more than half of the memory."""
    count, there = len(members), memory_size()
    wanted = (saves + 1) * (members.H.dim + 1) * 8 * count
    if wanted > there / 2:
        states = f"{saves:,} states" + (f" of {count:,} trajectories" if count > 1 else "")
        raise InputError(
            f"{states} need {wanted / 2**30:.1f} GiB, more than half of the memory of "
            f"{there / 2**30:.1f} GiB; save fewer with a larger save_every"
        )
