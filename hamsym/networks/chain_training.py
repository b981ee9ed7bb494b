"""Training of a chain of networks on windows of a march by features, or on equal ones.

A march gives the first guess of the motion. On its windows, a window whose network does not reach
the tolerance is divided in two; equal windows are kept as they are. Inputs cover a range that
follows from the motion, so that weights depend on the units neither of time nor of the components.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import MAX_WINDOWS, Chain
from hamsym.networks.chain_checks import ChainChecks
from hamsym.networks.methods import NetworkChain
from hamsym.networks.network import Network
from hamsym.networks.trial import TrialSolution
from hamsym.networks.window_training import Equations, Fit, Settings, late, train_window
from hamsym.numerics.scales import coupled_sizes
from hamsym.random_features.window_checks import SLACK
from hamsym.solution.path import Trial

_REACH = 3.0  # least range of the inputs of a network
_WIDTH = 50  # narrower layers, with fewer functions, represent a smaller range
_POINTS = 48  # of a window, at least
_PER_REACH = 20  # neurons of the last layer, and points, for each unit of the input's range
_WIDEST = 1_000  # neurons of the last layer of an equal window
_SAMPLES = 65  # times at which the motion in a window is looked at
_SHORTEST = 1e-11  # length of a window, relative to the span
_TRAINED = 4  # divisions of a window after which training of its hidden layers is in vain
_SETTLED = 50  # windows after which their number says how many are needed


@dataclass(frozen=True)
class ChainSettings(Settings):
    """Settings of the training of a chain."""

    #: Residual of what an equal window may miss between its points; its own residual is at most ten
    #: times that.
    limit: float = field(kw_only=True)


@dataclass(frozen=True)
class TrainedChain:
    """A chain, which may have no networks, and how it was trained."""

    chain: Chain
    #: Of each window.
    fits: tuple[Fit, ...]
    #: Evaluations of the vector field, each at one point, and windows that were divided.
    evaluations: int
    rejected: int
    #: Why it ends before its last window does, "" if not.
    reason: str
    #: End of its last window.
    reached: float
    #: What an equal window misses between its points, "" if nothing is known.
    doubt: str

    @property
    def points(self) -> int:
        """Collocation points of all windows."""
        return sum(fit.points for fit in self.fits)


class _Flow:
    """Hamilton's equations of H in dimensionless variables."""

    def __init__(self, H: Hamiltonian) -> None:
        self.numpy, self._torch = H.compile("numpy"), H.compile("torch")

    def equations(self, z: np.ndarray, t: float, h: float, size: np.ndarray) -> Equations:
        """Return the equations in y = (z - z_a)/S and u = (t - t_a)/h."""
        system = self._torch
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


class _Window:
    """A window, and the guess of the motion in it."""

    def __init__(self, start: float, end: float, guess: Trial) -> None:
        self.start, self.end, self.h = start, end, end - start
        self.times = np.linspace(start, end, _SAMPLES)
        self.samples = guess.states_at(self.times)
        self._guess = guess

    def states(self, z: np.ndarray, size: np.ndarray) -> Callable[[Tensor], Tensor]:
        """Return y = (z^ - z)/S of the guess as a function of u = (t - start)/h."""
        origin, unit = torch.from_numpy(z), torch.from_numpy(size)

        def states(u: Tensor) -> Tensor:
            return (self._guess.tensors(self.start + self.h * u)[0] - origin) / unit

        return states


class ChainRun:
    """The training of a chain of networks.

    - guess: The motion, roughly.
    - edges: Ends of the windows.
    - equal: Whether windows are kept as they are; others are divided where that is needed.
    - widen: Make the last layer as wide as the motion in a window needs.
    - generator: Source of the initial weights.
    """

    def __init__(
        self,
        H: Hamiltonian,
        guess: Trial,
        edges: np.ndarray,
        method: NetworkChain,
        settings: ChainSettings,
        generator: torch.Generator,
    ) -> None:
        self._flow, self._method, self._settings = _Flow(H), method, settings
        self._equal, self._random = method.windows is not None, generator
        self._checks = ChainChecks(H, generator.initial_seed())
        self._guess, self._edges = guess, edges
        # Ends of the windows that are left, the next one last, and how often each was divided.
        self._left = [(*ends, 0) for ends in itertools.pairwise(edges.tolist())][::-1]
        self._z, self._time = guess.states_at(edges[:1])[0], float(edges[0])
        self._sizes = np.abs(self._z)
        self._pieces: list[TrialSolution] = []
        self._fits: list[Fit] = []
        self._evaluations = self._rejected = 0
        self._reason = self._doubt = ""

    @torch.no_grad()
    def trained(self, advance: Callable[[float], None] = lambda _: None) -> TrainedChain:
        """Train all windows; ``advance`` is called with the share of the span that is done."""
        start, whole = self._time, float(self._edges[-1] - self._edges[0])
        with np.errstate(all="ignore"):
            try:
                while self._left and not self._reason:
                    before = self._time
                    self._step()
                    if self._time != before:
                        advance((self._time - start) / whole)
            except KeyboardInterrupt:
                self._reason = "interrupted"
        return self._result()

    def _step(self) -> None:
        """Train the next window, and keep its network or divide it."""
        start, end, divisions = self._left.pop()
        window = _Window(start, end, self._guess)
        size = self._size(window)
        hidden, reach, points = self._form(window)
        network = self._network(len(size), hidden)
        steps = self._settings.hidden_steps if divisions < _TRAINED else 0
        fit = train_window(
            self._flow.equations(self._z, start, window.h, size),
            network,
            reach,
            points,
            replace(self._settings, hidden_steps=steps),
            window.states(self._z, size),
        )
        self._evaluations += fit.evaluations
        piece = _piece(network, self._z, size, window, self._settings.envelope, reach)
        state = piece.states_at(np.array([end]))[0]
        missed = self._missed(piece, fit, window, np.maximum(size, np.abs(state)))
        if not missed or (self._equal and np.isfinite(state).all()):
            self._pieces.append(piece)
            self._fits.append(fit)
            self._z, self._time = state, end
            self._sizes = np.maximum(self._sizes, np.abs(state))
            self._doubt = self._doubt or missed
        else:
            self._rejected += 1
            middle = start + window.h / 2
            self._left += [(middle, end, divisions + 1), (start, middle, divisions + 1)]
        self._reason = self._limit(missed)

    def _limit(self, missed: str) -> str:
        """Return why no further window is trained, "" if one may be."""
        if late(self._settings.deadline) and (self._left or missed):
            return "the time limit was reached"
        if not self._left:
            return ""
        start, end, divisions = self._left[-1]
        if self._equal and divisions:
            return "the state is not finite"
        whole = float(abs(self._edges[-1] - self._edges[0]))
        if divisions and not abs(end - start) > _SHORTEST * whole:
            return f"the windows became too short: {missed}"
        sign = np.sign(self._edges[-1] - self._edges[0])
        shares = np.linspace(0, 1, len(self._edges))
        done = np.interp(sign * self._time, sign * self._edges, shares)
        count = len(self._pieces)
        if count > _SETTLED and not count <= MAX_WINDOWS * done + 1:
            reason = f"it needs more than {MAX_WINDOWS:,} windows, now of length {end - start:.1e}"
            return f"{reason}; give wider layers, a larger tol or a shorter span"
        return ""

    def _size(self, window: _Window) -> np.ndarray:
        """Return the sizes of the components up to the end of a window, shape (dim,)."""
        h, rates = abs(window.h), np.abs(self._flow.numpy.at("vector_field", self._z, window.start))
        own = np.maximum(self._sizes, h * np.where(np.isfinite(rates), rates, 0.0))
        seen = np.abs(window.samples).max(axis=0)
        generator = self._flow.numpy.at("jacobian", self._z, window.start)
        sizes = coupled_sizes(np.maximum(own, seen), np.abs(generator), h)
        return np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)

    def _network(self, dim: int, hidden: Sequence[int]) -> Network:
        """Return a network with random hidden layers, whose readouts are zero."""
        method = self._method
        network = Network(
            dim, hidden, method.activation, frequency=method.frequency, generator=self._random
        )
        network.requires_grad_(False)
        for readouts in network.layers[-1]:
            readouts.zero_()
        return network

    def _form(self, window: _Window) -> tuple[Sequence[int], float, int]:
        """Return the layers of the network of a window, the range of its inputs, and its points.

        Raise InputError if the motion in an equal window needs too large a network.
        """
        hidden = self._method.hidden
        matrices = self._flow.numpy.at("jacobian", window.samples, window.times)
        matrices = matrices[np.isfinite(matrices).all(axis=(1, 2))]
        rates = np.abs(np.linalg.eigvals(matrices)).max(axis=1, initial=0.0)
        fastest = float(rates.mean()) if len(rates) else 0.0
        least = _REACH * min(1.0, hidden[-1] / _WIDTH)
        reach = max(least, abs(window.h) * fastest / 2)
        points = points_of(reach)
        if self._equal and points > _WIDEST:
            count = len(self._edges) - 1
            raise InputError(
                f"windows={count} needs networks of {points:,} neurons in a layer, more than "
                f"{_WIDEST:,}; give windows={math.ceil(count * points / _WIDEST)} or more"
            )
        if self._equal and "hidden" not in self._method.given:
            hidden = (*hidden[:-1], max(hidden[-1], points))
        return hidden, reach, points

    def _missed(self, piece: TrialSolution, fit: Fit, window: _Window, size: np.ndarray) -> str:
        """Return why the error of a window may be too large, "" if nothing is known."""
        tolerance, limit = self._settings.tolerance, self._settings.limit
        if not fit.residual <= (max(tolerance, SLACK * limit) if self._equal else tolerance):
            return (
                f"the residual stays at {fit.residual:.1e} of the motion between t = "
                f"{window.start:.6g} and t = {window.end:.6g}; give more windows or wider layers"
            )
        if self._equal:
            tolerance = max(tolerance, min(fit.residual, limit))
        found = self._checks.failure(piece, window.end, size, tolerance)
        return found and f"{found}: a narrow pulse, a step or a jump"

    def _result(self) -> TrainedChain:
        chain, fits = Chain(tuple(self._pieces), self._time), tuple(self._fits)
        cost = self._evaluations, self._rejected
        return TrainedChain(chain, fits, *cost, self._reason, self._time, self._doubt)


def _piece(
    network: Network, z: np.ndarray, size: np.ndarray, window: _Window, envelope: str, reach: float
) -> TrialSolution:
    """Return the trial solution of a trained network, whose readouts get the units of z."""
    matrix, bias = network.layers[-1]
    unit = torch.from_numpy(size)
    matrix.mul_(unit.unsqueeze(1))
    bias.mul_(unit)
    tau = window.h / reach
    return TrialSolution(
        network, torch.from_numpy(z.copy()), t0=window.start, tau=tau, envelope=envelope
    )


def points_of(reach: float) -> int:
    """Return the collocation points of a network with this largest input."""
    return max(_POINTS, math.ceil(_PER_REACH * reach))
