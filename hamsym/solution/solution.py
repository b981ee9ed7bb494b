"""Solution: a trajectory as a function of time, with its residual, energy and error."""

from __future__ import annotations

import math
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np

import hamsym
from hamsym.errors import InputError, VacuousBoundWarning
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import SMALLEST, coupled_sizes
from hamsym.numerics.symplectic import generators
from hamsym.solution.analysis import Analysis
from hamsym.solution.error_equation import integrated_error
from hamsym.solution.events import Event, Events, find_events
from hamsym.solution.path import ErrorEstimate, Record, Trial
from hamsym.solution.sensitivity import Sensitivity

if TYPE_CHECKING:  # torch and matplotlib are needed only by who has tensors or draws
    from matplotlib.figure import Figure
    from torch import Tensor

__all__ = ["Solution"]

_CHUNK = 4_096  # times evaluated at once, to bound the memory
_SCAN = 4_001  # times of the scan that precedes the search for an extremum over time


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """A closed-form trajectory z^(t) over a time span, from :func:`hamsym.solve`.

    Call it with times to get states: shape (n,) gives (n, dim), a scalar gives (dim,); numpy in,
    numpy out, torch in, torch out (differentiable in t).

    Attributes
    ----------
    H : Hamiltonian
    z0 : numpy.ndarray
        Initial state, shape (dim,), reproduced exactly.
    span : (float, float)
    trial : FeatureTrial or TrialSolution
        The trial solution with its weights.
    method : str
    record : March or Training
        How the weights were found, and what that took.
    error : MarchError or None
        Estimated error of a march; that of a network is integrated when it is asked for.
    energy_weight : float
        Weight of the energy penalty in the loss of a network.
    success : bool
        Whether the stopping criterion was met.
    message : str
        What happened, in words.
    """

    H: Hamiltonian
    z0: np.ndarray
    span: tuple[float, float]
    trial: Trial
    method: str
    record: Record
    error: ErrorEstimate | None = None
    energy_weight: float = 0.0
    success: bool = False
    message: str = ""

    def __repr__(self) -> str:
        start, end = self.span
        return (
            f"Solution({self.H.formula!r}, t from {start:.6g} to {end:.6g}, {self.method}, "
            f"success={self.success})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # Without what was computed of the fields, which may hold functions.
        return Solution, tuple(getattr(self, entry.name) for entry in fields(self))

    def judged(self, success: bool, message: str) -> Solution:
        """The same solution with a verdict; what was computed of it already is kept."""
        other = replace(self, success=success, message=message)
        names = {entry.name for entry in fields(self)}
        other.__dict__.update({n: v for n, v in self.__dict__.items() if n not in names})
        return other

    @property
    def points(self) -> int:
        """Collocation points K."""
        return self.record.points

    @property
    def evaluations(self) -> int:
        """Evaluations of the vector field, each at one point, of the march or of the training."""
        return self.record.point_evaluations

    @property
    def history(self) -> Any:
        """Loss and ell_max in the course of the training, or the windows of a march."""
        return self.record.history

    # -- evaluation --------------------------------------------------------------------------

    @overload
    def __call__(
        self, t: Tensor, *, extrapolate: bool = False, z0: Tensor | None = None
    ) -> Tensor: ...
    @overload
    def __call__(self, t: Any, *, extrapolate: bool = False, z0: None = None) -> np.ndarray: ...
    def __call__(self, t: Any, *, extrapolate: bool = False, z0: Tensor | None = None) -> Any:
        """The state at times t.

        Parameters
        ----------
        t : float, sequence, array or Tensor
        extrapolate : bool
            Allow times outside the span.
        z0 : Tensor, optional
            The initial state, equal to ``solution.z0``, as a tensor through which gradients flow:
            the result is differentiable in it, by :meth:`sensitivity`. For t as a tensor only.

        Raises
        ------
        InputError
            If a time is outside the span, unless ``extrapolate=True``, or z0 is another state.
        """
        if z0 is None:
            return self._state(t, extrapolate)
        if not (_is_tensor(t) and _is_tensor(z0)):
            raise InputError("z0 takes part in gradients only if t and z0 are both tensors")
        if not np.array_equal(z0.detach().cpu().numpy(), self.z0.astype(str(z0.dtype)[6:])):
            raise InputError("z0 is not the initial state of this solution; solve again from there")
        state = self._state(t, extrapolate)
        change = (z0 - z0.detach()).to(state.dtype)
        return state + self.sensitivity(t).to(state.dtype) @ change

    @overload
    def derivative(self, t: Tensor, *, extrapolate: bool = False) -> Tensor: ...
    @overload
    def derivative(self, t: Any, *, extrapolate: bool = False) -> np.ndarray: ...
    def derivative(self, t: Any, *, extrapolate: bool = False) -> Any:
        """dz^/dt at times t, exact for the network; shapes as for the state."""
        return self.evaluate(t, extrapolate=extrapolate)[1]

    @overload
    def sensitivity(self, t: Tensor) -> Tensor: ...
    @overload
    def sensitivity(self, t: Any) -> np.ndarray: ...
    def sensitivity(self, t: Any) -> Any:
        """dz(t)/dz0 along the trajectory, shape (n, dim, dim), or (dim, dim) for a scalar t.

        The solution Phi of Phi' = J Hess(z^(t)) Phi with Phi = 1 at the start: how the state at t
        changes with the initial state.

        Raises
        ------
        InputError
            If a time is outside the span.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 5))
        >>> solution.sensitivity(np.pi / 2).round(8) + 0.0
        array([[ 0.,  1.],
               [-1.,  0.]])
        """
        if _is_tensor(t):
            return _tensor(self.sensitivity(t.detach().cpu().numpy()))
        times = _times(t)
        self._check_times(times, extrapolate=False)
        values = self._sensitivity(np.atleast_1d(times))
        return values.reshape(*times.shape, self.H.dim, self.H.dim)

    @cached_property
    def _sensitivity(self) -> Sensitivity:
        # Each component has a unit of its own.
        units = np.maximum(self.scale, SMALLEST * self._coupled_scales)
        units = np.where(units > 0, units, 1.0)
        return Sensitivity(self, units, self.record.edges, self.record.origin)

    def residual(self, t: Any, *, extrapolate: bool = False) -> Any:
        """ell(t) = dz^/dt - J grad H(z^), shaped as the state (the paper's eq. partial_loss)."""
        z, dz = self.evaluate(t, extrapolate=extrapolate)
        system = self.H.compile("torch" if _is_tensor(t) else "numpy")
        return system.residual(z, *system.arguments(dz, t))

    def energy(self, t: Any, *, extrapolate: bool = False) -> Any:
        """H along the trajectory; shape (n,), or a scalar for a scalar t."""
        z, _ = self.evaluate(t, extrapolate=extrapolate)
        system = self.H.compile("torch" if _is_tensor(t) else "numpy")
        return system.energy(*system.arguments(z, t))

    def _state(self, t: Any, extrapolate: bool) -> Any:
        if _is_tensor(t):
            return self.evaluate(t, extrapolate=extrapolate)[0]
        return self._in_parts(lambda times: (self.trial.states_at(times),), t, extrapolate)[0]

    def evaluate(self, t: Any, *, extrapolate: bool = False) -> tuple[Any, Any]:
        """The state and its time derivative together, as from :meth:`derivative`."""
        if _is_tensor(t):
            self._check_times(t.detach().cpu().numpy(), extrapolate)
            z, dz = self.trial.tensors(t.reshape(-1))
            return z.reshape(*t.shape, -1), dz.reshape(*t.shape, -1)
        states, rates = self._in_parts(self.trial.states_and_rates, t, extrapolate)
        return states, rates

    def _in_parts(
        self, function: Callable[[np.ndarray], tuple[np.ndarray, ...]], t: Any, extrapolate: bool
    ) -> tuple[np.ndarray, ...]:
        """Values of a function (K,) -> (K, dim) at times, shape (*t.shape, dim)."""
        times = _times(t)
        self._check_times(times, extrapolate)
        flat = np.atleast_1d(times)
        parts = [function(flat[k : k + _CHUNK]) for k in range(0, len(flat), _CHUNK)]
        values = (np.concatenate(part) for part in zip(*parts, strict=True))
        return tuple(value[0] if times.ndim == 0 else value for value in values)

    def _check_times(self, t: np.ndarray, extrapolate: bool) -> None:
        if t.ndim > 1 or t.size == 0:
            raise InputError(f"t has shape {t.shape}; give one time or a list of times")
        if not np.all(np.isfinite(t)):
            raise InputError("t holds a value that is not finite; give finite times")
        low, high = min(self.span), max(self.span)
        slack = 4e-16 * max(abs(low), abs(high))
        outside = (t < low - slack) | (t > high + slack)
        if not extrapolate and outside.any():
            worst = float(np.atleast_1d(t)[np.atleast_1d(outside)][0])
            raise InputError(
                f"t = {worst:.6g} is outside the span from {low:.6g} to {high:.6g}; "
                "say extrapolate=True if that is meant"
            )

    # -- how good it is ------------------------------------------------------------------------

    @cached_property
    def scale(self) -> np.ndarray:
        """s_i = max_t |z^_i(t)| of each component, shape (dim,)."""
        return np.abs(self(self.scan_times)).max(axis=0)

    @cached_property
    def analysis(self) -> Analysis:
        """The paper's error analysis: ell(t), sigma_min, det Hess, and what follows from them."""
        return Analysis(self)

    @property
    def ell_max(self) -> float:
        """max_t |ell(t)|, the 2-norm, over continuous time and without the energy term."""
        return self.analysis.ell_max

    @property
    def ell_max_regularized(self) -> float:
        """The paper's ell_max with its energy term, sqrt(max_t |ell|^2 + lambda (H - E0)^2)."""
        return self.analysis.ell_max_regularized

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the Hessian along the trajectory; zero if it is singular."""
        return self.analysis.sigma_min

    @overload
    def error_estimate(self, t: Tensor) -> Tensor: ...
    @overload
    def error_estimate(self, t: Any) -> np.ndarray: ...
    def error_estimate(self, t: Any) -> Any:
        """The error z - z^ at times t, estimated; shapes as for the state.

        For a trained network it solves the equation of the error that the paper's eq. (ell)
        linearises, d(dz)/dt = J grad H(z^ + dz) - dz^/dt from dz = 0, with DOP853; it is infinite
        from where that equation can no longer be solved. For a march it solves eq. (ell) window
        by window (:mod:`hamsym.random_features.error_estimate`). It is an estimate, not a bound.
        """
        if _is_tensor(t):
            return _tensor(self.error_estimate(t.detach().cpu().numpy()))
        times = _times(t)
        self._check_times(times, extrapolate=False)
        return (self.error or self._integrated_error)(times)

    def error_estimate_check(self, t: Any) -> np.ndarray:
        """By how much the estimate changes at a finer resolution, at times t, shape (n, dim).

        For a march the residual is sampled at half as many nodes again, and the tangent maps are
        found with more; for a trained network the equation of the error is solved to a thousandth
        of the tolerance. What is large beside the estimate casts doubt on it; infinite where one
        of the two has no value. The round-off floor of a march is not part of it.

        Examples
        --------
        >>> import hamsym
        >>> H = hamsym.Hamiltonian("p**2/2 + x**2/2")
        >>> solution, t = hamsym.solve(H, [1, 0], (0, 10), tol=1e-6), np.linspace(0, 10, 101)
        >>> estimate, check = solution.error_estimate(t), solution.error_estimate_check(t)
        >>> bool(check.max() < 1e-3 * np.abs(estimate).max())
        True
        """
        times = _times(t)
        with np.errstate(invalid="ignore"):
            change = np.abs(self._finer_estimate(times) - self.error_estimate(times))
        return np.nan_to_num(change, nan=np.inf, posinf=np.inf)

    @cached_property
    def _finer_estimate(self) -> Callable[[np.ndarray], np.ndarray]:
        if self.error is not None:
            return self.error.refined(self)
        return integrated_error(self, resolution=1)

    @cached_property
    def largest_error(self) -> np.ndarray:
        """max_t of the estimated error of each component, round-off included, shape (dim,)."""
        if self.error is not None:
            return self.error.largest
        return np.asarray(np.abs(self.error_estimate(self.scan_times)).max(axis=0))

    @property
    def relative_error_estimate(self) -> float:
        """Largest estimated error, relative to the size of the motion, max_i |dz_i| / s_i.

        Here s_i is the largest |z^_i|, or the size that the terms of its own equation give the
        component (:func:`~hamsym.numerics.scales.coupled_sizes`) where that is larger. Infinite
        where it is unknown.
        """
        errors = self.largest_error
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.where(errors == 0, 0.0, errors / self._coupled_scales)
        return float(np.nan_to_num(ratios, nan=np.inf, posinf=np.inf).max())

    @cached_property
    def _coupled_scales(self) -> np.ndarray:
        start, end = self.span
        with np.errstate(all="ignore"):
            coupling = np.abs(generators(self.hessians(self.scan_times))).mean(axis=0)
        # Of a short span the motion is what it would be in a longer one.
        return coupled_sizes(self.scale, coupling, 10 * abs(end - start))

    @cached_property
    def _integrated_error(self) -> Callable[[np.ndarray], np.ndarray]:
        return integrated_error(self)

    @property
    def error_bound(self) -> float:
        """The paper's bound ell_max / sigma_min on every component of the error (eq. dz).

        It is a heuristic: it assumes that the error sits in one component, is violated by a
        residual in resonance with the motion, and mixes the units of q and p. It is infinite,
        with a :class:`~hamsym.errors.VacuousBoundWarning`, where the Hessian is singular along
        the trajectory, as for every system with a cyclic coordinate.
        """
        if self.sigma_min > 0:
            return self.analysis.bound
        warnings.warn(
            "the bound ell_max/sigma_min is infinite: the Hessian is singular on the trajectory",
            VacuousBoundWarning,
            stacklevel=2,
        )
        return math.inf

    def hessians(self, t: np.ndarray) -> np.ndarray:
        """The Hessian of H along the trajectory, shape (*t.shape, dim, dim)."""
        system = self.H.compile("numpy")
        matrices = system.hessian(*system.arguments(self(t), t))
        return np.asarray(matrices, dtype=float)

    @cached_property
    def scan_times(self) -> np.ndarray:
        """Times close enough to see what happens in between: thousands, more with more windows."""
        return self.record.times(self.span, _SCAN)

    def events(self, events: Event | Sequence[Event]) -> Events:
        """Times and states at which something happens, located to round-off.

        Parameters
        ----------
        events : str, callable, or a sequence of them
            A surface such as ``"x = 0, p_x > 0"``, or a function as scipy's ``solve_ivp`` takes
            it: called with (t, z), z of shape (dim,), it is zero at the event; its attribute
            ``direction`` asks for rising (above zero) or falling zeros, and ``terminal`` (True or
            a number) ends the search for all events after so many of this one. A zero at the very
            start is no event, unlike there.

        What goes unseen: between two neighbouring ``scan_times``, of which there are thousands
        and at least nine in every window of a march, a pair of zeros if the event turns around
        there more than once, and a third zero.

        Returns
        -------
        Events
            With ``t_events`` and ``y_events``, a list with an array for each event.

        Raises
        ------
        InputError
            If an event cannot be used, or is not a number somewhere.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 10))
        >>> (solution.events("x = 0, p > 0").t_events[0] / np.pi).round(9)
        array([1.5])
        """
        return find_events(self, events, self.scan_times)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything into one file, from which :func:`hamsym.load` makes it again.

        The file is safetensors with JSON: numbers to the last bit, nothing to execute. It is
        replaced in one step.

        Raises
        ------
        FileError
            If it cannot be written.

        Examples
        --------
        >>> import hamsym, tempfile
        >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 5))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     solution.save(folder + "/circle.hamsym")
        ...     again = hamsym.load(folder + "/circle.hamsym")
        >>> bool((again([1.0, 2.0]) == solution([1.0, 2.0])).all())
        True
        """
        hamsym.save(self, path)

    def certify(
        self,
        rtol: float = 0.02,
        time_limit: float | None = None,
        bits: int | None = None,
        progress: bool | None = None,
    ) -> hamsym.Certificate:
        """Prove how large the error is, from both sides, or say why that cannot be done.

        The equation is solved once more for it, in ball arithmetic, where every rounding is
        accounted for (:mod:`hamsym.proof.prove`).

        Parameters
        ----------
        rtol : float
            How close upper and lower bounds are to come, relative to the lower ones.
        time_limit : float, optional
            Seconds.
        bits : int, optional
            Working precision; by default what the growth of errors along the motion asks for.
        progress : bool, optional
            Draw progress on standard error; by default where that is a terminal.

        Returns
        -------
        Certificate

        Raises
        ------
        CertificationError
            If nothing can be proven: the trajectory escapes or collides, H is not smooth along it,
            or the time limit is reached. The message says when and what may help.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 5))
        >>> certificate = solution.certify()
        >>> certificate.lower <= certificate.bound < 1e-9
        True
        """
        return hamsym.certify(self, rtol, time_limit, bits, progress)

    def plot(self) -> Figure:
        """A figure of the trajectory, its residual, its energy and the training.

        Returns
        -------
        matplotlib.figure.Figure
            To show, or to save with ``.savefig(path)``.
        """
        return hamsym.plot(self)


def _times(t: Any) -> np.ndarray:
    try:
        return np.asarray(t, dtype=float)
    except (TypeError, ValueError):
        raise InputError("t holds something that is not a number; give times") from None


def _is_tensor(value: Any) -> bool:
    """Whether it is a tensor of torch, which must not be imported to find that out."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def _tensor(values: np.ndarray) -> Tensor:
    import torch

    return torch.from_numpy(values)
