"""Training of a chain of networks over a span, window by window.

A window's length follows from the motion: it grows while readouts converge quickly, and a window
whose network does not reach the tolerance is trained again, shorter. All windows begin with the
same random hidden layers, and inputs cover the same range in each, so that weights depend on the
units neither of time nor of the components.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import MAX_WINDOWS, Chain, ChainTraining
from hamsym.networks.chain_checks import ChainChecks
from hamsym.networks.network import Network
from hamsym.networks.trial import TrialSolution
from hamsym.networks.window_training import Equations, Fit, Settings, late, train_window
from hamsym.numerics.scales import coupled_sizes

#: Largest input of the network of a window whose length is free.
REACH = 3.0
_WIDTH = 50  # narrower layers, with fewer functions, represent shorter windows
_POINTS = 48  # of such a window
_TIME = 2.0  # length of the first window, in units of the fastest time of the motion
_SHRINK = 0.5
_GROWTH = 1.5
_ORDER = 10  # of the residual in the length of a window, roughly
_SHORTEST = 1e-11  # length of a window, relative to the span
_MOST_FAILURES = 4  # of one window, while its hidden layers are trained
_SETTLED = 50  # windows after which their length says how many are needed
_PER_REACH = 20  # neurons of the last layer, and points, for each unit of the input's range
_QUICK = 40  # fixed-point passes of readouts that converge quickly


@dataclass(frozen=True)
class Layout:
    """Form of the networks of a chain."""

    hidden: Sequence[int]
    activation: str
    envelope: str
    frequency: float | None

    def network(self, dim: int, generator: torch.Generator) -> Network:
        """Return a network with random hidden layers."""
        network = Network(
            dim, self.hidden, self.activation, frequency=self.frequency, generator=generator
        )
        network.requires_grad_(False)
        _rest(network)
        return network


@dataclass(frozen=True)
class ChainSettings:
    """Settings of the training of a chain."""

    #: Largest residual in a window, relative to the size of the motion.
    tolerance: float
    #: Largest number of steps of the hidden layers in a window.
    hidden_steps: int
    #: Times at which a window must end, in the order of the span.
    stops: Sequence[float]
    #: Length of the longest window.
    longest: float
    #: Of :func:`time.perf_counter`.
    deadline: float | None = None
    #: Residual of what a window of given length may miss between its points; its own residual is at
    #: most ten times that.
    limit: float = math.inf

    def of_window(self, layout: Layout, hidden_steps: int) -> Settings:
        """Return the settings of a window with this number of steps of the hidden layers."""
        return Settings(self.tolerance, hidden_steps, layout.envelope, self.deadline)


@dataclass(frozen=True)
class TrainedChain:
    """A chain and its record."""

    chain: Chain | None
    training: ChainTraining | None
    #: Why it ends before the span does, "" if not.
    reason: str
    #: End of its last window.
    reached: float
    #: What a window misses between its points, "" if nothing is known.
    doubt: str = ""


class Flow:
    """Hamilton's equations of H in dimensionless variables."""

    def __init__(self, H: Hamiltonian) -> None:
        self.H = H
        self.numpy, self.torch = H.compile("numpy"), H.compile("torch")

    def equations(self, z: np.ndarray, t: float, h: float, size: np.ndarray) -> Equations:
        """Return the equations in y = (z - z_a)/S and u = (t - t_a)/h."""
        system = self.torch
        start, unit = torch.from_numpy(z), torch.from_numpy(size)
        ratio = unit / unit.unsqueeze(1)

        def arguments(u: Tensor, y: Tensor) -> tuple[Tensor, ...]:
            return tuple(system.arguments(start + unit * y, t + h * u))

        def rates(u: Tensor, y: Tensor) -> Tensor:
            return h * (system.vector_field(*arguments(u, y)) / unit)

        def jacobian(u: Tensor, y: Tensor) -> Tensor:
            return h * ratio * system.jacobian(*arguments(u, y))

        def places(u: Tensor) -> Tensor:
            return ((t + h * u) - t) / h

        return Equations(rates, jacobian, places)

    def rates(self, z: np.ndarray, t: float) -> np.ndarray:
        return np.asarray(self.numpy.vector_field(*self.numpy.arguments(z, t)), dtype=float)

    def generator(self, z: np.ndarray, t: float) -> np.ndarray:
        """Return J Hess at a state."""
        return np.asarray(self.numpy.jacobian(*self.numpy.arguments(z, t)), dtype=float)


class ChainRun:
    """The training of a chain of networks whose windows follow the motion.

    - z0: Shape (dim,).
    - generator: Source of the initial weights.
    """

    def __init__(
        self,
        H: Hamiltonian,
        z0: np.ndarray,
        span: tuple[float, float],
        layout: Layout,
        settings: ChainSettings,
        generator: torch.Generator,
    ) -> None:
        self.flow, self.span = Flow(H), span
        self.layout, self.settings = layout, settings
        self.random = generator
        self.checks = ChainChecks(H, generator.initial_seed())
        self.began = time.perf_counter(), time.process_time()
        self.z, self.time = np.array(z0, dtype=float), float(span[0])
        self.sizes = np.abs(self.z)
        self.direction = math.copysign(1.0, span[1] - span[0])
        self.network = layout.network(H.dim, generator)
        self.stops = list(settings.stops)
        self.reach = REACH * min(1.0, layout.hidden[-1] / _WIDTH)
        self.pieces: list[TrialSolution] = []
        self.counts: list[tuple[int, int, float]] = []
        self.points = self.evaluations = self.rejected = self.failures = 0
        self.reason = ""
        self.longest = settings.longest
        self.length = self._first_length()

    def trained(self, advance: Callable[[float], None] = lambda _: None) -> TrainedChain:
        """Train all windows; ``advance`` is called with the share of the span that each adds."""
        start, end = self.span
        with np.errstate(all="ignore"):
            try:
                while self.time != end and not self.reason:
                    before = self.time
                    self.step()
                    advance(abs(self.time - before) / abs(end - start))
            except KeyboardInterrupt:
                self.reason = "interrupted"
        return self.result()

    def _first_length(self) -> float:
        matrix = self.flow.generator(self.z, self.time)
        if not np.isfinite(matrix).all():
            self.reason = "H has no finite second derivatives at the initial state"
            return self.longest
        fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
        return min(self.longest, _TIME / fastest) if fastest > 0 else self.longest

    def step(self) -> None:
        """Train the next window, shorter as often as needed."""
        span = abs(self.span[1] - self.span[0])
        failed, self.failures = "", 0
        while True:
            if late(self.settings.deadline):
                self.reason = "the time limit was reached"
                return
            if self._too_many():
                self.reason = (
                    f"it needs more than {MAX_WINDOWS:,} windows, now of length "
                    f"{self.length:.1e}; give wider layers, a larger tol or a shorter span"
                )
                return
            end, h = self._end()
            if not abs(h) > _SHORTEST * span or self.time + h / 2 in (self.time, end):
                self.reason = "the windows became too short, as at a singularity or a jump of H"
                if self.flow.H.time is not None:
                    self.reason += " (give the times at which t switches H as breakpoints)"
                self.reason += f": {failed}" if failed else ""
                return
            trained = self._trained(end, h)
            if isinstance(trained, str):
                failed = trained
                self.failures += 1
                continue
            self._keep(*trained, end)
            return

    def _too_many(self) -> bool:
        """Whether the span needs too many windows, by their lengths so far and now."""
        count = len(self.pieces)
        if count < _SETTLED:
            return False
        # The mean of the last windows: a few short ones at a pulse do not count.
        mean = abs(self.time - self.pieces[-_SETTLED].t0) / _SETTLED
        left = abs(self.span[1] - self.time)
        return not count + left / max(mean, self.length) <= MAX_WINDOWS

    def _end(self) -> tuple[float, float]:
        """Return the end of the next window, and its length with its sign."""
        stop = self.stops[0] if self.stops else self.span[1]
        left = abs(stop - self.time)
        # No short window is left over at the end.
        count = math.ceil(left / self.length * (1 - 1e-12))
        if count <= 1:
            return float(stop), float(stop - self.time)
        length = left / count if count <= 3 else self.length
        end = self.time + self.direction * length
        return end, end - self.time

    def _trained(self, end: float, h: float) -> tuple[TrialSolution, Fit, np.ndarray] | str:
        """Train a window of this length; return the piece, or why it failed."""
        size = self._size(h)
        equations = self.flow.equations(self.z, self.time, h, size)
        network = copy.deepcopy(self.network)
        # Where several windows in a row failed, for example at a jump, training is in vain.
        hidden_steps = self.settings.hidden_steps if self.failures < _MOST_FAILURES else 0
        settings = self.settings.of_window(self.layout, hidden_steps)
        fit = train_window(equations, network, self.reach, _POINTS, settings)
        self.evaluations += fit.evaluations
        if not fit.residual <= self.settings.tolerance:
            ratio = self.settings.tolerance / fit.residual if fit.residual > 0 else 0.0
            power = ratio ** (1 / _ORDER) if fit.residual < 1 else 0.0
            self._reject(h, min(max(power, _SHRINK), 0.8))
            if self.rejected % 5 == 0:
                # Hidden layers that fail repeatedly may be the reason.
                self.network = self.layout.network(len(self.z), self.random)
            if not math.isfinite(fit.residual):
                return "the rates are not finite"
            return f"the residual stays at {fit.residual:.1e} of the motion"
        piece = piece_of(network, self.z, size, self.time, h, self.layout.envelope, self.reach)
        state = piece.states_at(np.array([end]))[0]
        if not np.isfinite(state).all():
            self._reject(h)
            return "the state is not finite"
        sizes = np.maximum(size, np.abs(state))
        if missed := self.checks.failure(piece, end, sizes, self.settings.tolerance):
            self._reject(h)
            return missed
        room = self.settings.tolerance / max(fit.residual, 1e-300)
        factor = min(max(0.9 * room ** (1 / _ORDER), 1.0), _GROWTH)
        if fit.hidden_steps or fit.passes > _QUICK:
            factor = 1.0
        self.length = min(abs(h) * factor, self.longest)
        return piece, fit, state

    def _reject(self, h: float, factor: float = _SHRINK) -> None:
        """Count a window of length h as rejected; the next one is shorter by a factor."""
        self.rejected += 1
        self.length = abs(h) * factor

    def _size(self, h: float) -> np.ndarray:
        """Return the sizes of the components from here on, shape (dim,)."""
        rates = np.abs(self.flow.rates(self.z, self.time))
        own = np.maximum(self.sizes, np.abs(h) * np.where(np.isfinite(rates), rates, 0.0))
        sizes = coupled_sizes(own, np.abs(self.flow.generator(self.z, self.time)), abs(h))
        sizes = np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)
        return np.asarray(sizes)

    def _keep(self, piece: TrialSolution, fit: Fit, state: np.ndarray, end: float) -> None:
        self.pieces.append(piece)
        self.counts.append((fit.steps, fit.hidden_steps, fit.residual))
        self.points += fit.points
        self.z, self.time = state, end
        self.sizes = np.maximum(self.sizes, np.abs(state))
        if self.stops and end == self.stops[0]:
            self.stops.pop(0)

    def result(self) -> TrainedChain:
        return assembled(
            self.pieces,
            self.time,
            self.counts,
            (self.points, self.evaluations, self.rejected),
            self.began,
            self.reason,
        )


def assembled(
    pieces: Sequence[TrialSolution],
    end: float,
    counts: Sequence[tuple[int, int, float]],
    totals: tuple[int, int, int],
    began: tuple[float, float],
    reason: str,
    doubt: str = "",
) -> TrainedChain:
    """Return a chain of pieces with its record.

    - end: End of the last one.
    - counts: Steps, those of hidden layers, and residual of each piece.
    - totals: Points, evaluations and rejected windows.
    - began: Wall and processor time of the beginning.
    - reason, doubt: As in :class:`TrainedChain`.
    """
    if not pieces:
        return TrainedChain(None, None, reason, end)
    chain = Chain(tuple(pieces), end)
    steps, hidden, residuals = zip(*counts, strict=True)
    training = ChainTraining(
        chain.edges,
        np.array(steps, dtype=np.int64),
        np.array(hidden, dtype=np.int64),
        np.array(residuals, dtype=float),
        *totals,
        1,
        time.perf_counter() - began[0],
        time.process_time() - began[1],
    )
    return TrainedChain(chain, training, reason, end, doubt)


def piece_of(
    network: Network,
    z: np.ndarray,
    size: np.ndarray,
    start: float,
    h: float,
    envelope: str,
    reach: float,
) -> TrialSolution:
    """Return the trial solution of a trained network, whose readouts get the units of z."""
    matrix, bias = network.layers[-1]
    unit = torch.from_numpy(size)
    matrix.mul_(unit.unsqueeze(1))
    bias.mul_(unit)
    return TrialSolution(
        network, torch.from_numpy(z.copy()), t0=start, tau=h / reach, envelope=envelope
    )


def points_of(reach: float) -> int:
    """Return the collocation points of a network with this largest input."""
    return max(_POINTS, math.ceil(_PER_REACH * reach))


def _rest(network: Network) -> None:
    """Set the readouts to zero."""
    matrix, bias = network.layers[-1]
    matrix.zero_()
    bias.zero_()
