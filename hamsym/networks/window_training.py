"""Training of one network on one window: readouts eliminated, hidden layers by Gauss-Newton.

On a window from z_a at t_a of length h, with u = (t - t_a)/h in [0, 1], the trial solution is

    z^ = z_a + S f(s) N(s),    s = R u,

S the diagonal matrix of the sizes of the components, so that weights have no units. The residual in
u is r = d(z^)/du / S - h F(z^) / S. For given hidden layers the features of the last layer, times
f, span a space of functions; d/du of its basis is made orthonormal at the points, U, so that

    r(a) = U a - h F(z_a + S B a) / S,

and the readouts follow from a. They are eliminated (variable projection, Golub & Pereyra 1973):

1. a is found by fixed-point iteration, a <- U^T h F(z^)/S, and where that does not converge, as on
   long windows, by Gauss-Newton with a damping that vanishes.
2. If the rest, which no readout can remove, exceeds the tolerance, all weights are changed together
   by a Gauss-Newton step: P J_h d = -P r with P the projection on the complement of the readouts'
   derivatives and J_h the derivative in the hidden layers, damped as by Levenberg and Marquardt.
   The readouts are solved for again after each step, so that only the hidden layers, in which the
   network is nonlinear, need the damping.

Normal equations of all weights, which square the condition, are thus formed for the hidden layers
only; the readouts, which carry the last digits, come from orthonormal columns.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from hamsym.networks.network import Network
from hamsym.networks.sensitivities import backward, forward, weight_rows
from hamsym.networks.trial import ENVELOPES
from hamsym.numerics.collocation import chebyshev_points

_RANK = 1e-13  # singular values of the features' rates, relative to the largest, that are used
_PASSES = 60  # of the fixed-point iteration
_NEWTON_STEPS = 25
_DAMPINGS = (0.0, 1e-8, 1e-4, 1e-2, 1.0)  # of a Gauss-Newton step, relative
_MU_FIRST, _MU_LEAST = 1e-6, 1e-16  # of a step of the hidden layers, relative
_ATTEMPTS = 6
_PATIENCE = 3  # steps of the hidden layers over which the residual must fall to a third
_CONVERGED = 1e-2  # largest residual of readouts that converged to the motion
_LARGEST_SYSTEM = 4_000  # rows of a dense system of equations
_LARGEST_TRAINED = 2_000  # rows for which the hidden layers are trained
_REFINEMENTS, _MORE = 3, 1.5  # sets of points, and the growth of their number
_ROUGH = 4.0  # largest residual between the points, relative to that at the points


@dataclass(frozen=True)
class Equations:
    """Hamilton's equations on a window, in dimensionless variables y = (z - z_a)/S and u."""

    #: (u, y) -> dy/du, shapes (K,), (K, dim) -> (K, dim).
    rates: Callable[[Tensor, Tensor], Tensor]
    #: (u, y) -> derivative of the rates in y, shape (K, dim, dim).
    jacobian: Callable[[Tensor, Tensor], Tensor]
    #: u -> the nearest u whose times are float64 numbers, (K,) -> (K,). A rounded time far from 0
    #: changes rates that depend on it by far more than the tolerance.
    places: Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Settings:
    """Settings of the training of windows."""

    #: Largest residual r at the points and between them.
    tolerance: float
    #: Largest number of Gauss-Newton steps of the hidden layers.
    hidden_steps: int
    envelope: str
    #: Of :func:`time.perf_counter`: no further step is begun after it.
    deadline: float | None = None


@dataclass(frozen=True)
class Fit:
    """Outcome of a window: the network holds the weights, its readouts in units of S.

    Attributes
    ----------
    residual : float
        Largest residual at the points and between them; infinite or NaN if it diverged.
    steps, hidden_steps, evaluations : int
        Least-squares steps, those that changed hidden layers, and evaluations of F at one point.
    points : int
        Collocation points of the last solution.
    """

    residual: float
    steps: int
    hidden_steps: int
    evaluations: int
    points: int


class _Columns:
    """Features of the last layer at points u, in a basis whose rates are orthonormal."""

    def __init__(self, network: Network, u: Tensor, reach: float, envelope: str) -> None:
        s = reach * u.unsqueeze(1)
        self.f, self.f_dot = ENVELOPES[envelope](s)
        self.layers = forward(network.layers, network.activation, s, torch.ones_like(s))
        last = self.layers[-1]
        features = torch.cat((last.x, torch.ones_like(s)), 1)
        slopes = torch.cat((last.xd, torch.zeros_like(s)), 1)
        rates = reach * (self.f_dot * features + self.f * slopes)
        self.reach = reach
        left, sizes, right = torch.linalg.svd(rates, full_matrices=False)
        used = sizes > _RANK * sizes[0]
        self.rates = left[:, used]  # U
        self.to_readouts = right[used].T / sizes[used]
        self.from_readouts = sizes[used].unsqueeze(1) * right[used]
        self.values = (self.f * features) @ self.to_readouts  # B


class _Training:
    """The training of one network on points of one window."""

    def __init__(
        self, equations: Equations, network: Network, reach: float, settings: Settings
    ) -> None:
        self.equations, self.network = equations, network
        self.reach, self.settings = reach, settings
        self.steps = self.hidden_steps = self.evaluations = 0

    def use(self, count: int) -> None:
        """Use this number of points from now on."""
        self.u = self.equations.places(_points(count, self.network.theta))
        self.renew()

    def renew(self) -> None:
        """Make the columns of the present hidden layers."""
        self.columns = _Columns(self.network, self.u, self.reach, self.settings.envelope)

    # -- readouts --------------------------------------------------------------------------------

    @property
    def readouts(self) -> Tensor:
        """Readouts and biases of the network, shape (neurons + 1, dim)."""
        matrix, bias = self.network.layers[-1]
        return torch.cat((matrix, bias.unsqueeze(1)), 1).T

    def put(self, coefficients: Tensor) -> None:
        """Set the readouts of the network from coefficients of the orthonormal columns."""
        matrix, bias = self.network.layers[-1]
        readouts = (self.columns.to_readouts @ coefficients).T
        matrix.copy_(readouts[:, :-1])
        bias.copy_(readouts[:, -1])

    def flow(self, coefficients: Tensor) -> Tensor:
        self.evaluations += len(self.u)
        return self.equations.rates(self.u, self.columns.values @ coefficients)

    def solve_readouts(
        self, guess: Callable[[Tensor], Tensor] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return coefficients that minimise the residual, and the residual.

        The search starts from a guess of y, or from the readouts of the network.
        """
        columns = self.columns
        if guess is None:
            start = columns.from_readouts @ self.readouts
        else:
            start = columns.rates.T @ self.equations.rates(self.u, guess(self.u))
        a, previous = start, math.inf
        for count in range(_PASSES):
            flow = self.flow(a)
            moved = columns.rates.T @ flow
            change = float((moved - a).abs().max())
            a = moved
            if not change < 1e6:
                break
            if change <= 1e-15 * max(1.0, float(a.abs().max())) or (
                change < 1e-12 and change > 0.5 * previous
            ):
                self.steps += 1
                return a, columns.rates @ a - self.flow(a)
            if count >= 12 and change > previous:
                break
            previous = change
        # It diverges or is too slow; its last state is a worse start than the first.
        return self._newton(start)

    def _newton(self, a: Tensor) -> tuple[Tensor, Tensor]:
        columns = self.columns
        residual = columns.rates @ a - self.flow(a)
        square = float(residual.square().sum())
        if residual.numel() > _LARGEST_SYSTEM:
            return a, residual
        first = 2
        for _ in range(_NEWTON_STEPS):
            if late(self.settings.deadline):
                break
            matrix = self.derivative(a)
            for position in range(first, len(_DAMPINGS)):
                step = _damped(matrix, residual, _DAMPINGS[position])
                if step is None:
                    continue
                moved = a - step.view_as(a)
                new = columns.rates @ moved - self.flow(moved)
                left = float(new.square().sum())
                if left < square:
                    break
            else:
                break
            self.steps += 1
            slow = left > 0.25 * square
            a, residual, square = moved, new, left
            if slow and first == 0:
                break
            first = max(position - 1, 0)
            if float(residual.abs().max()) <= 0.1 * self.settings.tolerance:
                break
        return a, residual

    def derivative(self, a: Tensor) -> Tensor:
        """Return the derivative of the residual in the coefficients, (K dim, m dim)."""
        columns = self.columns
        jacobian = self.equations.jacobian(self.u, columns.values @ a)
        count, dim = len(self.u), jacobian.shape[1]
        matrix = -torch.einsum("kij,km->kimj", jacobian, columns.values)
        for i in range(dim):
            matrix[:, i, :, i] += columns.rates
        return matrix.reshape(count * dim, -1)

    # -- hidden layers -----------------------------------------------------------------------

    def train(self, a: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
        """Change all weights until the residual is below the tolerance or falls no more."""
        mu, history = _MU_FIRST, [float(residual.abs().max())]
        readouts = self.readouts.numel()
        for _ in range(self.settings.hidden_steps):
            if history[-1] <= self.settings.tolerance or late(self.settings.deadline):
                break
            if len(history) > _PATIENCE and not history[-1] <= history[-1 - _PATIENCE] / 3:
                break
            own = self.derivative(a)
            basis = torch.linalg.qr(own).Q
            rows = self._hidden_rows(a)[:, :-readouts]
            if not bool(torch.isfinite(basis).all() and torch.isfinite(rows).all()):
                break

            def rest(x: Tensor, basis: Tensor = basis) -> Tensor:
                return x - basis @ (basis.T @ x)

            right, projected = rest(residual.reshape(-1)), rest(rows)
            sizes, vectors = torch.linalg.eigh(projected @ projected.T)
            turned, top = vectors.T @ right, float(sizes[-1])
            if not (math.isfinite(top) and top > 0):
                break
            weights, columns = self.network.theta.clone(), self.columns
            square = float(residual.square().sum())
            for _ in range(_ATTEMPTS):
                y = vectors @ (turned / (sizes.clamp(min=0) + mu * top))
                step = -(projected.T @ y)
                if not bool(torch.isfinite(step).all()):
                    mu *= 30
                    continue
                shift = _damped(own, residual.reshape(-1) + rows @ step, 1e-30)
                self.put(a if shift is None else a - shift.view_as(a))
                self.network.theta[:-readouts] += step
                self.renew()
                moved, new = self.solve_readouts()
                left = float(new.square().sum())
                if left < square:
                    break
                mu *= 30
                self.network.theta.copy_(weights)
                self.columns = columns
            else:
                break
            self.hidden_steps += 1
            mu = max(mu / (30 if left < 0.1 * square else 3), _MU_LEAST)
            a, residual = moved, new
            self.put(a)
            history.append(float(residual.abs().max()))
        return a, residual

    def _hidden_rows(self, a: Tensor) -> Tensor:
        """Return the derivative of the residual in all weights, shape (K dim, weights)."""
        columns = self.columns
        self.put(a)
        count = len(self.u)
        jacobian = self.equations.jacobian(self.u, columns.values @ a)
        dim = jacobian.shape[1]
        unit = torch.eye(dim, dtype=a.dtype, device=a.device)
        # (row of the residual, point, output of the network)
        in_rate = self.reach * unit.unsqueeze(1)
        to_value = columns.f_dot * in_rate - columns.f * jacobian.transpose(0, 1)
        to_rate = columns.f * in_rate
        # The matrices of the layers are views of the weights, which have the readouts of a.
        rows = weight_rows(backward(columns.layers, to_value, to_rate))
        return rows.transpose(0, 1).reshape(count * dim, -1)

    def between(self) -> float:
        """Return the largest residual of the network at points between those of the training."""
        ends = self.u.new_tensor((0.0, 1.0))
        u = self.equations.places(torch.cat((_points(2 * len(self.u) + 1, self.u), ends)))
        s = self.reach * u
        f, f_dot = (part.unsqueeze(1) for part in ENVELOPES[self.settings.envelope](s))
        value, rate = self.network(s)
        self.evaluations += len(u)
        residual = self.reach * (f_dot * value + f * rate) - self.equations.rates(u, f * value)
        return float(residual.abs().max())


def late(deadline: float | None) -> bool:
    """Return whether a deadline of :func:`time.perf_counter` has passed."""
    return deadline is not None and time.perf_counter() > deadline


def _points(count: int, like: Tensor) -> Tensor:
    return torch.from_numpy(chebyshev_points(count)).to(like)


def _damped(matrix: Tensor, right: Tensor, damping: float) -> Tensor | None:
    """Return the least-squares solution of matrix x = right with a relative damping.

    None if there is none: an entry is not finite, or the damped matrix lacks full rank.
    """
    right = right.reshape(-1, 1)
    if damping:
        columns = matrix.shape[1]
        size = float(matrix.square().sum(0).max().sqrt())
        unit = torch.eye(columns, dtype=matrix.dtype, device=matrix.device)
        matrix = torch.cat((matrix, math.sqrt(damping) * size * unit))
        right = torch.cat((right, right.new_zeros(columns, 1)))
    if not bool(torch.isfinite(matrix).all() and torch.isfinite(right).all()):
        return None
    # Torch's default on a CPU, gelsy, pivots by memory that torch does not initialise, so that the
    # last bits differ from run to run.
    try:
        return torch.linalg.lstsq(matrix, right, driver="gels").solution
    # The matrix lacks full rank.
    except torch.linalg.LinAlgError:  # type: ignore[attr-defined]
        return None


@torch.no_grad()
def train_window(
    equations: Equations,
    network: Network,
    reach: float,
    points: int,
    settings: Settings,
    guess: Callable[[Tensor], Tensor],
) -> Fit:
    """Train a network on a window; its weights are changed in place.

    - reach: Largest input R of the network.
    - points: Collocation points, Chebyshev points of the window; more are used if the residual
      between them is larger.
    - guess: u -> y from which the search starts, (K,) -> (K, dim).
    """
    training = _Training(equations, network, reach, settings)
    try:
        residual = _trained(training, points, guess)
    # Features that are not finite have no singular values.
    except torch.linalg.LinAlgError:  # type: ignore[attr-defined]
        residual = math.nan
    return Fit(
        residual,
        training.steps,
        training.hidden_steps,
        training.evaluations,
        len(training.u),
    )


def _trained(training: _Training, points: int, guess: Callable[[Tensor], Tensor]) -> float:
    """Return the largest residual at the points and between them."""
    training.use(points)
    a, residual = training.solve_readouts(guess)
    for left in reversed(range(_REFINEMENTS)):
        if residual.numel() <= _LARGEST_TRAINED and float(residual.abs().max()) <= _CONVERGED:
            a, residual = training.train(a, residual)
        training.put(a)
        inside, between = float(residual.abs().max()), training.between()
        smooth = between <= max(training.settings.tolerance, _ROUGH * inside)
        if smooth or not left or not inside <= _CONVERGED or late(training.settings.deadline):
            break
        training.use(math.ceil(_MORE * len(training.u)))
        a, residual = training.solve_readouts()
    return math.nan if math.isnan(between) else max(inside, between)
