"""A trained trajectory: a function of time that can say how well it solves the equations."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import torch
from torch import Tensor

import hamsym
from hamsym.errors import InputError, VacuousBoundWarning
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.training import History, Training
from hamsym.networks.trial import TrialSolution
from hamsym.numerics.scales import SMALLEST, coupled_sizes
from hamsym.numerics.symplectic import generators
from hamsym.numerics.tangent_maps import TangentMaps
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.error_estimate import MarchError, estimate_error
from hamsym.random_features.flow import flow_of
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.analysis import Analysis
from hamsym.solution.error_equation import integrated_error
from hamsym.solution.events import Event, Events, find_events

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hamsym.proof.certificate import Certificate

__all__ = ["Solution"]

_CHUNK = 4_096  # points evaluated at once, to bound the memory of the hidden layers
_TANGENT_WINDOWS = 1_024  # for which tangent maps are held at once
_SCAN = 4_001  # points of the scan that precedes the search for an extremum over time


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
    trial : TrialSolution or FeatureTrial
        The trial solution with its weights.
    method : str
    training : Training or March
        How the weights were found.
    energy_weight : float
    march_error : MarchError or None
        Estimated error of a march.
    success : bool
        Whether the stopping criterion was met.
    message : str
        What happened, in words.
    """

    def __init__(
        self,
        H: Hamiltonian,
        z0: np.ndarray,
        span: tuple[float, float],
        trial: TrialSolution | FeatureTrial,
        *,
        method: str,
        training: Training | March,
        energy_weight: float = 0.0,
        march_error: MarchError | None = None,
    ) -> None:
        self.H, self.z0, self.span, self.trial = H, z0, span, trial
        self.method, self.energy_weight, self.training = method, energy_weight, training
        self.success, self.message = False, ""
        self._system = H.compile("numpy")
        self._dtype = next(iter(trial.state_dict().values())).dtype
        self.march_error = march_error

    def __repr__(self) -> str:
        start, end = self.span
        return (
            f"Solution({self.H.formula!r}, t from {start:.6g} to {end:.6g}, {self.method}, "
            f"success={self.success})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        from hamsym.archive import assembled, parts

        return assembled, parts(self)

    @property
    def points(self) -> int:
        """Collocation points K of the training."""
        return self.training.points

    @property
    def evaluations(self) -> int:
        """Evaluations of the vector field, each at one point, of the march or of the training."""
        if isinstance(self.training, Training):
            return self.training.iterations * self.training.points
        return self.training.evaluations * self.training.points_per_window

    @property
    def history(self) -> History | March:
        """Loss and ell_max in the course of the training, or the windows of a march."""
        return self.training.history if isinstance(self.training, Training) else self.training

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
        if not (isinstance(t, Tensor) and isinstance(z0, Tensor)):
            raise InputError("z0 takes part in gradients only if t and z0 are both tensors")
        if not torch.equal(z0.detach().cpu(), torch.from_numpy(self.z0).to(z0.dtype)):
            raise InputError("z0 is not the initial state of this solution; solve again from there")
        change = (z0 - z0.detach()).to(self._dtype)
        return self._state(t, extrapolate) + self.sensitivity(t).to(self._dtype) @ change

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
        if isinstance(t, Tensor):
            return torch.from_numpy(self.sensitivity(t.detach().cpu().numpy()))
        times = _times(t)
        self._check_times(times, extrapolate=False)
        flat = np.atleast_1d(times)
        parts = [self._sensitivity(flat[k : k + _CHUNK]) for k in range(0, len(flat), _CHUNK)]
        return np.concatenate(parts).reshape(*times.shape, self.H.dim, self.H.dim)

    def _sensitivity(self, times: np.ndarray) -> np.ndarray:
        edges = self._tangent_edges
        times = times - self._tangent_origin
        sign = np.sign(edges[-1] - edges[0])
        window = np.searchsorted(sign * edges, sign * times, side="right") - 1
        window = np.clip(window, 0, len(edges) - 2)
        s = (times - edges[window]) / np.diff(edges)[window]
        values = np.empty((len(times), self.H.dim, self.H.dim))
        used = np.unique(window)
        for first in range(0, len(used), _TANGENT_WINDOWS):
            some = used[first : first + _TANGENT_WINDOWS]
            here = np.isin(window, some)
            maps = self._tangent_maps(some)
            series = np.einsum("ln,inaw->wlia", maps.rule.to_series, maps.inside)
            angles = np.arccos(np.clip(2 * s[here] - 1, -1, 1))
            basis = np.cos(np.multiply.outer(angles, np.arange(len(maps.nodes))))
            place = np.searchsorted(some, window[here])
            inside = np.einsum("kl,klia->kia", basis, series[place])
            values[here] = inside @ self._tangent_starts[window[here]]
        units = self._units
        return values * (units[:, None] / units)

    def residual(self, t: Any, *, extrapolate: bool = False) -> Any:
        """ell(t) = dz^/dt - J grad H(z^), shaped as the state (the paper's eq. partial_loss)."""
        z, dz = self.evaluate(t, extrapolate=extrapolate)
        system = self.H.compile("torch") if isinstance(t, Tensor) else self._system
        return system.residual(z, *system.arguments(dz, t))

    def energy(self, t: Any, *, extrapolate: bool = False) -> Any:
        """H along the trajectory; shape (n,), or a scalar for a scalar t."""
        z, _ = self.evaluate(t, extrapolate=extrapolate)
        system = self.H.compile("torch") if isinstance(t, Tensor) else self._system
        return system.energy(*system.arguments(z, t))

    def _state(self, t: Any, extrapolate: bool) -> Any:
        return self._apply(lambda times: (self.trial.value(times),), t, extrapolate)[0]

    def evaluate(self, t: Any, *, extrapolate: bool = False) -> tuple[Any, Any]:
        """The state and its time derivative together, as from :meth:`derivative`."""
        z, dz = self._apply(self.trial, t, extrapolate)
        return z, dz

    def _apply(
        self, function: Callable[[Tensor], tuple[Tensor, ...]], t: Any, extrapolate: bool
    ) -> tuple[Any, ...]:
        """Values of a function of times, shape (K,) -> (K, dim) each, in the caller's terms."""
        if isinstance(t, Tensor):
            times = t.to(self._dtype)
            self._check_times(times.detach().cpu().numpy(), extrapolate)
            return tuple(value.reshape(*t.shape, -1) for value in function(times.reshape(-1)))
        array = _times(t)
        self._check_times(array, extrapolate)
        flat = torch.from_numpy(np.array(array, ndmin=1)).to(self._dtype)
        with torch.no_grad():
            parts = [function(chunk) for chunk in flat.split(_CHUNK)]
        values = (torch.cat(part).numpy() for part in zip(*parts, strict=True))
        return tuple(value[0] if array.ndim == 0 else value for value in values)

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
        if isinstance(t, Tensor):
            return torch.from_numpy(self.error_estimate(t.detach().cpu().numpy()))
        times = _times(t)
        self._check_times(times, extrapolate=False)
        if self.march_error is not None:
            return self.march_error(times)
        return self._error(times)

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
        if isinstance(self.training, March):
            basis = feature_basis(self.training.seed)
            return estimate_error(self.training, basis, flow_of(self.H), resolution=1).error
        return integrated_error(self, resolution=1)

    @cached_property
    def largest_error(self) -> np.ndarray:
        """max_t of the estimated error of each component, round-off included, shape (dim,)."""
        if self.march_error is not None:
            return self.march_error.largest
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
    def _error(self) -> Callable[[np.ndarray], np.ndarray]:
        return integrated_error(self)

    # -- how nearby solutions move -------------------------------------------------------------

    @cached_property
    def _units(self) -> np.ndarray:
        """Units of the components for the tangent maps, each its own."""
        units = np.maximum(self.scale, SMALLEST * self._coupled_scales)
        return np.where(units > 0, units, 1.0)

    @cached_property
    def _tangent_edges(self) -> np.ndarray:
        """Windows short enough for polynomials: those of the march, or by the size of J Hess."""
        if isinstance(self.training, March):
            return self.training.edges
        start, end = self.span
        # J Hess in units of the scales has the size of the rates at which nearby states part.
        units = self._units
        sizes = np.abs(generators(self.hessians(self.scan_times)) * units / units[:, None])
        wanted = float(sizes.sum(axis=-1).max()) * abs(end - start) / 2
        return np.linspace(start, end, 2 + int(min(np.nan_to_num(wanted), 100_000)))

    @property
    def _tangent_origin(self) -> float:
        return self.training.origin if isinstance(self.training, March) else 0.0

    @cached_property
    def _tangent_starts(self) -> np.ndarray:
        """Phi at the start of each window, shape (windows, dim, dim), in units of the scales."""
        count, dim = len(self._tangent_edges) - 1, self.H.dim
        starts = np.empty((count + 1, dim, dim))
        starts[0] = np.eye(dim)
        for first in range(0, count, _TANGENT_WINDOWS):
            windows = np.arange(first, min(first + _TANGENT_WINDOWS, count))
            for k, end in zip(windows, self._tangent_maps(windows).ends, strict=True):
                starts[k + 1] = end @ starts[k]
        return starts

    def _tangent_maps(self, windows: np.ndarray) -> TangentMaps:
        edges, dim = self._tangent_edges, self.H.dim
        lengths = np.diff(edges)[windows]
        times = edges[windows, None] + lengths[:, None] * TangentMaps.nodes + self._tangent_origin
        hessians = self.hessians(times.ravel()).reshape(*times.shape, dim, dim)
        return TangentMaps(generators(hessians), lengths, self._units)

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
        matrices = self._system.hessian(*self._system.arguments(self(t), t))
        return np.asarray(matrices, dtype=float)

    @cached_property
    def scan_times(self) -> np.ndarray:
        """Times close enough to see what happens in between: thousands, more with more windows."""
        if not isinstance(self.training, March):
            return np.linspace(*self.span, _SCAN)
        return self.training.times(max(9, _SCAN // len(self.training.edges)))

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
    ) -> Certificate:
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
