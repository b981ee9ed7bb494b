"""Checks of windows of a chain at times that its training did not use."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import Chain
from hamsym.networks.trial import TrialSolution
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.window_checks import WindowChecks

__all__ = ["ChainChecks"]


@dataclass(frozen=True)
class _Windows:
    """Windows of a chain, with the states at their ends, shape (n + 1, dim)."""

    chain: Chain
    edges: np.ndarray
    states: np.ndarray


class ChainChecks(WindowChecks):
    """The checks of :mod:`hamsym.random_features.window_checks`, of networks instead of features.

    Parameters
    ----------
    H : Hamiltonian
    seed : int
        Of the random places.
    """

    def __init__(self, H: Hamiltonian, seed: int) -> None:
        super().__init__(flow_of(H), feature_basis(seed), math.nan)

    def failure(
        self,
        piece: TrialSolution,
        end: float,
        sizes: np.ndarray,
        tolerance: float,
    ) -> str:
        """Return what a window misses between its points, "" if it passes.

        Parameters
        ----------
        piece : TrialSolution
        end : float
            End of its window.
        sizes : numpy.ndarray
            Sizes of the components, shape (dim,).
        tolerance : float
            Of the residual, relative to the sizes.
        """
        self.tolerance = tolerance
        chain = Chain((piece,), end)
        windows: Any = _Windows(chain, chain.edges, chain.states_at(chain.edges))
        with np.errstate(all="ignore"):
            found = self.first_failure(windows, sizes)
        if found is None:
            return ""
        return (
            f"near t = {found.times[0]:.6g}, between the points of collocation, {found.cause} "
            f"changes by {found.excess:.0e} times the tolerance"
        )

    def _sampled(self, windows: Any, window: np.ndarray, s: np.ndarray) -> np.ndarray:
        places = np.tile(s, len(window))
        z, _, _ = self._at(windows, np.repeat(window, len(s)), places)
        return np.asarray(z.reshape(len(window), len(s), -1))

    def _at(
        self, windows: Any, window: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t = windows.edges[window] + np.diff(windows.edges)[window] * s
        z, dz = windows.chain.states_and_rates(t)
        return z, dz, t
