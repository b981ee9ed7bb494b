"""A chain of networks: z^(t) = z_a + f(s) N_a(s) on each window, joined exactly, and its record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import torch
from torch import Tensor

from hamsym.networks.trial import TrialSolution
from hamsym.numerics.windows import locate, times_in_windows
from hamsym.support.record_fields import Count, Limit, Size, counts, floats

#: Most windows of a chain.
MAX_WINDOWS = 50_000

# Difference of a joint, in units of the round-off of the terms of z^: the sums of one network
# have other last digits on another processor.
_JOINT = 1e3


@dataclass(frozen=True, eq=False)
class Chain:
    """One trial solution for each window; each starts at the end of the one before."""

    #: In the order of the span. Piece k is used from its own ``t0`` to that of the next.
    pieces: Annotated[tuple[TrialSolution, ...], Limit(most=MAX_WINDOWS)] = field(repr=False)
    #: End of the last window.
    end: float

    @property
    def edges(self) -> np.ndarray:
        """Ends of the windows, shape (n + 1,)."""
        return np.array([*(piece.t0 for piece in self.pieces), self.end])

    @property
    def dtype(self) -> np.dtype:
        """Type of the weights and of z0."""
        return self.pieces[0].dtype

    def states_and_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""
        times = torch.from_numpy(np.ascontiguousarray(t, dtype=float))
        with torch.no_grad():
            z, dz = self.tensors(times)
        return z.numpy(), dz.numpy()

    def states_at(self, t: np.ndarray) -> np.ndarray:
        """Return z^ at times t of shape (K,), shape (K, dim)."""
        return self.states_and_rates(t)[0]

    def tensors(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Return z^ and dz^/dt at times t of shape (K,), differentiable in t."""
        window, _ = locate(self.edges, t.detach().cpu().numpy())
        order = np.argsort(window, kind="stable")
        used, first = np.unique(window[order], return_index=True)
        parts = [
            self.pieces[k].tensors(t[torch.from_numpy(places)])
            for k, places in zip(used, np.split(order, first[1:]), strict=True)
        ]
        back = torch.from_numpy(np.argsort(order, kind="stable"))
        z, dz = (torch.cat(columns)[back] for columns in zip(*parts, strict=True))
        return z, dz

    def check(self) -> None:
        """Raise ValueError unless it has pieces of float64."""
        if not self.pieces:
            raise ValueError("its chain has no pieces")
        if any(piece.dtype != np.float64 for piece in self.pieces):
            raise ValueError("its weights are not float64")

    def require_path(self, z0: np.ndarray, span: tuple[float, float]) -> None:
        """Raise ValueError unless this is a chain from z0 over the span."""
        start, allowed = z0, np.zeros(len(z0))
        edges = self.edges
        if not np.isfinite(edges).all() or edges[0] != span[0] or edges[-1] != span[1]:
            raise ValueError("its span differs from that of its windows")
        steps = np.diff(edges)
        if not ((steps > 0).all() or (steps < 0).all()):
            raise ValueError("its windows are not in order")
        for piece, low, high in zip(self.pieces, edges[:-1], edges[1:], strict=True):
            own = piece.z0.numpy()
            piece.require_path(own, (float(low), float(high)))
            if not (np.abs(own - start) <= allowed).all():
                raise ValueError("a window of its chain does not start at the end of that before")
            start = piece.states_at(np.array([high]))[0]
            allowed = _JOINT * np.finfo(float).eps * _terms(piece, float(high))


def _terms(piece: TrialSolution, t: float) -> np.ndarray:
    """Return the size of the terms whose sum is z^(t), shape (dim,)."""
    rows = [row for part in piece.parts for row in zip(*part.layers[-1], strict=True)]
    sizes = [float(weights.abs().sum() + bias.abs()) for weights, bias in rows]
    factor = float(piece.envelope_at(torch.tensor(t, dtype=torch.float64))[1])
    return np.abs(piece.z0.numpy()) + factor * np.array(sizes)


@dataclass(frozen=True)
class ChainTraining:
    """Record of the training of a chain."""

    #: Ends of the windows.
    edges: Annotated[np.ndarray, floats("windows + 1")] = field(repr=False)
    #: Least-squares steps of each window.
    steps: Annotated[np.ndarray, counts("windows")] = field(repr=False)
    #: Those of them that changed the hidden layers.
    hidden_steps: Annotated[np.ndarray, counts("windows")] = field(repr=False)
    #: Largest residual between the points in each window, relative to the size of the motion.
    residuals: Annotated[np.ndarray, floats("windows", least=0)] = field(repr=False)
    #: Collocation points of all windows.
    points: Count
    #: Evaluations of the vector field, each at one point, those of rejected windows included.
    point_evaluations: Count
    #: Windows that were trained in vain and tried again, shorter.
    rejected: Count
    #: Chains trained until one met the tolerance.
    passes: Count
    seconds: Size
    cpu_seconds: Size
    origin: float = 0.0

    @property
    def history(self) -> ChainTraining:
        """The windows themselves."""
        return self

    @property
    def iterations(self) -> int:
        """Least-squares steps of all windows that were kept."""
        return int(self.steps.sum())

    def times(self, span: tuple[float, float], count: int) -> np.ndarray:
        """Return about ``count`` times: at least nine per window, its start first, and the end."""
        return times_in_windows(self.edges, max(9, count // len(self.edges)))

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError if this is not the record of a chain."""
        if not isinstance(trial, Chain) or not np.array_equal(self.edges, trial.edges):
            raise ValueError("the windows of its training differ from those of its chain")
        if self.origin != 0:
            raise ValueError("its windows are not counted from zero")
