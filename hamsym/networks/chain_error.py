"""Error estimate of a chain of networks: truncation and round-off.

The error delta = z - z^ obeys delta' = F(z^ + delta) - F(z^) - r with r the residual. With
A = J Hess along z^ it is delta' = A delta + q - r, q the terms of higher order, which are found by
iteration. Each window of the chain is divided until the residual, which oscillates about as often
as the network has collocation points, is resolved. In each part the equation is solved by
collocation (:mod:`hamsym.numerics.tangent_maps`), and the parts are joined by their tangent maps.

Round-off is moved with the error: at each joint a perturbation of the size of one unit in the last
place of the state and of the change that such a unit causes in F, with random signs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import Chain, ChainTraining
from hamsym.networks.chain_training import points_of
from hamsym.numerics.collocation import collocation
from hamsym.numerics.scales import resolved_sizes
from hamsym.numerics.tangent_maps import TangentMaps
from hamsym.solution.window_error import WindowError

_NODES, _FINE_NODES = 32, 48  # of a part: for the estimate, and for its check
_POINTS_PER_PART = 16  # collocation points of the network
_SETS = 4  # of random perturbations
_ROUND_OFF = 2.0  # size of a perturbation, in units in the last place
_EPS = float(np.finfo(float).eps)
_CORRECTIONS = 6  # iterations of the terms of higher order
_SETTLED = 0.01  # last change of the error by them, relative
_SMALL = 1e-6  # errors, relative to the motion, below which these terms are round-off
_TOO_LARGE = 0.1  # and above which there is no estimate


class ChainError(WindowError):
    """Estimated error of a chain of networks, on parts of its windows."""

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError unless it is the error of the trial solution."""
        if not isinstance(trial, Chain) or self.origin != 0:
            raise ValueError("its error is not that of its chain")
        if not np.isin(trial.edges, self.edges).all() or not np.array_equal(
            trial.edges[[0, -1]], self.edges[[0, -1]]
        ):
            raise ValueError("the windows of its error differ from those of its chain")

    def refined(self, path: Any) -> ChainError:
        """Estimate the error of the same chain with more nodes."""
        return estimate_chain_error(path.H, path.trial, path.record, nodes=_FINE_NODES).error


class ErrorOfChain(NamedTuple):
    """The error of a chain, and the reason where it has no estimate, "" if it has one."""

    error: ChainError
    limit: str


def estimate_chain_error(
    H: Hamiltonian, chain: Chain, training: ChainTraining, *, nodes: int = _NODES
) -> ErrorOfChain:
    """Estimate the error of a chain from its residual.

    - nodes: Of each part of a window.
    """
    system, rule = H.compile("numpy"), collocation(nodes)
    edges = _parts(chain, training)
    lengths, dim = np.diff(edges), H.dim
    count = len(lengths)
    # Times inside a part belong to its window also where they round to its end.
    t = (edges[:-1, None] + lengths[:, None] * rule.nodes).ravel()

    with np.errstate(all="ignore"):
        z, dz = chain.states_and_rates(t)
        rates = system.at("vector_field", z, t)
        jacobians = system.at("jacobian", z, t)
        scale = resolved_sizes(
            np.abs(z).max(axis=0),
            np.abs(jacobians).mean(axis=0),
            abs(float(edges[-1] - edges[0])),
        )
        unit = np.where(scale > 0, scale, 1.0)
        signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(_SETS, count, dim))
        disturbed = z * (1 + _EPS * np.repeat(signs[0], nodes, axis=0))
        nearby = system.at("vector_field", disturbed, t)
        noise = np.abs(nearby - rates).reshape(count, nodes, dim).max(axis=1)
        kicks = _EPS * np.abs(z).reshape(count, nodes, dim).max(axis=1)
        kicks = _ROUND_OFF * (kicks + np.abs(lengths)[:, None] * noise) / unit
        residual = (rates - dz).reshape(count, nodes, dim)
        jacobians = jacobians.reshape(count, nodes, dim, dim)
        forcing, error = residual, np.zeros((count, nodes, dim))
        good, settled = count, False
        for _ in range(_CORRECTIONS):
            columns = np.concatenate((jacobians[:good], forcing[:good, :, :, None]), -1)
            maps = TangentMaps(columns, lengths[:good], unit)
            inside, ends = _joined(maps)
            sizes = np.abs(inside).max(axis=(1, 2))
            large = np.flatnonzero(~(sizes <= _TOO_LARGE))
            if len(large):
                good = int(large[0])
                if not good:
                    break
                continue
            change = np.abs(inside - error[:good] / unit).max()
            error = inside * unit
            if sizes.max() <= _SMALL or change <= _SETTLED * sizes.max():
                settled = True
                break
            moved = z[: good * nodes] + error.reshape(-1, dim)
            higher = system.at("vector_field", moved, t[: good * nodes])
            higher = higher.reshape(good, nodes, dim) - rates.reshape(count, nodes, dim)[:good]
            linear = np.einsum("wnij,wnj->wni", jacobians[:good], error)
            forcing = residual[:good] + higher - linear
        good = good if settled else 0
        series = np.full((count, nodes, dim), np.inf)
        floors, largest = np.full((count, dim), np.inf), np.full(dim, np.inf)
        if good:
            series[:good] = np.einsum("ln,wnd->wld", rule.to_series, error)
            floors[:good] = _floors(maps, kicks, signs) * unit
        if good == count:
            peaks = np.maximum(np.abs(error).max(axis=1), np.abs(ends[1:] * unit))
            largest = (peaks + floors).max(axis=0)
    limit = ""
    if not np.isfinite(largest).all():
        limit = f"errors grow too large for an estimate by t = {edges[good]:.6g}"
        if not np.isfinite(jacobians[good]).all():
            limit = f"the Hessian of H is not finite near t = {edges[good]:.6g}"
        largest = np.full(dim, np.inf)
    return ErrorOfChain(ChainError(edges, series, floors, largest, scale, np.zeros(())), limit)


def _parts(chain: Chain, training: ChainTraining) -> np.ndarray:
    """Return the edges of parts of windows in which the residual is resolved."""
    edges, mean = chain.edges, training.points / len(chain.pieces)
    inside = []
    for piece, start, end in zip(chain.pieces, edges[:-1], edges[1:], strict=True):
        points = max(mean, points_of((end - start) / piece.tau))
        count = math.ceil(points / _POINTS_PER_PART)
        inside.append(start + (end - start) * (np.arange(count) / count))
    return np.append(np.concatenate(inside), edges[-1])


def _joined(maps: TangentMaps) -> tuple[np.ndarray, np.ndarray]:
    """Return errors inside the parts (parts, nodes, dim) and at their edges (parts + 1, dim)."""
    count, dim, _ = maps.ends.shape
    ends = np.zeros((count + 1, dim))
    for k in range(count):
        ends[k + 1] = maps.ends[k, :, :dim] @ ends[k] + maps.ends[k, :, dim]
    inside = np.einsum("inkw,wk->wni", maps.inside[:, :, :dim], ends[:-1])
    return inside + maps.inside[:, :, dim].transpose(2, 1, 0), ends


def _floors(maps: TangentMaps, kicks: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Return the size of accumulated round-off in each part, shape (parts, dim)."""
    count, dim, _ = maps.ends.shape
    moved, floors = np.zeros((_SETS, dim)), np.empty((count, dim))
    for k in range(count):
        now = moved + signs[:, k] * kicks[k]
        within = np.einsum("ink,sk->sni", maps.inside[:, :, :dim, k], now)
        moved = now @ maps.ends[k, :, :dim].T
        floors[k] = np.maximum(np.abs(within).max(axis=(0, 1)), np.abs(moved).max(axis=0))
    return floors
