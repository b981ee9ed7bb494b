"""Error estimate of a chain of networks: that of a march through the same motion.

Each window of the chain is divided until the residual, which oscillates about as often as the
network has collocation points, is resolved. In each part random features are fitted to the
networks, which gives J Hess along z^ and the round-off of F; the residual is that of the networks.
The equation of the error is solved as for a march
(:func:`hamsym.random_features.error_estimate.estimate_error`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import Chain
from hamsym.networks.chain_training import points_of
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.error_estimate import FINE, USUAL, error_tables, estimate_error
from hamsym.random_features.flow import flow_of
from hamsym.random_features.windows import March
from hamsym.solution.window_error import WindowError

_POINTS_PER_PART = 16  # collocation points of the network
_ROUND_OFF = 2.0  # of the states at which networks begin, in units in the last place
_EPS = float(np.finfo(float).eps)


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
        return estimate_chain_error(path.H, path.trial, path.points, resolution=FINE).error


class ErrorOfChain(NamedTuple):
    """The error of a chain, and the reason where it has no estimate, "" if it has one."""

    error: ChainError
    limit: str


def estimate_chain_error(
    H: Hamiltonian, chain: Chain, points: int, *, resolution: int = USUAL
) -> ErrorOfChain:
    """Estimate the error of a chain from its residual.

    - points: Collocation points of all windows.
    - resolution: Index of :data:`hamsym.random_features.error_estimate.RESOLUTIONS`.
    """
    flow, basis = flow_of(H), feature_basis()
    edges = _parts(chain, points / len(chain.pieces))
    lengths, count = np.diff(edges)[:, None], len(edges) - 1

    def at(places: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return states, rates and residuals at places of all parts, (parts, places, dim)."""
        # Times inside a part belong to its window also where they round to its end.
        t = (edges[:-1, None] + lengths * places).ravel()
        z, rates = chain.states_and_rates(t)
        residuals = rates - flow.vector_field(z, t)
        return tuple(a.reshape(count, len(places), H.dim) for a in (z, rates, residuals))

    with np.errstate(all="ignore"):
        z, rates, _ = at(basis.nodes)
        readouts = basis.fit @ (rates * lengths[:, None])
        states, end = chain.states_and_rates(edges)[0], basis.end.astype(float)
        # The windows join at the ends of the parts, as the networks do.
        gaps = np.diff(states, axis=0) - np.einsum("m,wmd->wd", end, readouts)
        readouts += (end / (end @ end))[:, None] * gaps[:, None]
        *_, residuals = at(error_tables(basis, resolution)["place"])
        path = March(edges, states, readouts, edges[-1], np.abs(z).max(axis=(0, 1)))
        found = estimate_error(
            path,
            basis,
            flow,
            resolution=resolution,
            residuals=residuals.transpose(0, 2, 1),
            late=_joints(chain, edges, states),
        )
    error = found.error
    return ErrorOfChain(
        ChainError(edges, error.series, error.floors, error.largest, error.scale, error.origin),
        found.limit,
    )


def _parts(chain: Chain, mean: float) -> np.ndarray:
    """Return the edges of parts of windows, with a mean number of points, for the residual."""
    edges, inside = chain.edges, []
    for piece, start, end in zip(chain.pieces, edges[:-1], edges[1:], strict=True):
        points = max(mean, points_of((end - start) / piece.tau))
        count = math.ceil(points / _POINTS_PER_PART)
        inside.append(start + (end - start) * (np.arange(count) / count))
    return np.append(np.concatenate(inside), edges[-1])


def _joints(chain: Chain, edges: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return roundings of the states at which networks begin, with random signs, (parts, dim)."""
    signs = np.random.default_rng(2).choice((-1.0, 1.0), size=states[:-1].shape)
    joints = np.isin(edges[:-1], chain.edges[1:-1])[:, None]
    return np.where(joints, _ROUND_OFF * _EPS * np.abs(states[:-1]) * signs, 0.0)
