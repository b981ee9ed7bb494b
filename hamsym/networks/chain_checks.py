"""Checks of windows of a chain at times that its training did not use."""

from __future__ import annotations

import math

import numpy as np

from hamsym.bounds.residual import Parts, Places
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import Chain
from hamsym.networks.trial import TrialSolution
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.window_checks import Pieces, WindowChecks, places_of
from hamsym.random_features.windows import Windows


class ChainChecks(WindowChecks):
    """The checks of :mod:`hamsym.random_features.window_checks`, of networks instead of features.

    - seed: Of the basis, whose tables are not used.
    """

    def __init__(self, H: Hamiltonian, seed: int) -> None:
        super().__init__(flow_of(H), feature_basis(seed), math.nan)
        self._chain: Chain

    def failure(
        self,
        piece: TrialSolution,
        end: float,
        sizes: np.ndarray,
        tolerance: float,
    ) -> str:
        """Return what a window misses between its points, "" if it passes.

        - end: End of its window.
        - sizes: Sizes of the components, shape (dim,).
        - tolerance: Of the residual, relative to the sizes.
        """
        self.tolerance = tolerance
        chain = Chain((piece,), end)
        windows = Windows(chain.edges, chain.states_at(chain.edges), np.empty((1, 0, len(sizes))))
        self._chain = chain
        with np.errstate(all="ignore"):
            found = self.first_failure(windows, sizes)
        if found is None:
            return ""
        return (
            f"near t = {found.times[0]:.6g}, between the points of collocation, {found.cause} "
            f"changes by {found.excess:.0e} times the tolerance"
        )

    def _at(self, pieces: Pieces, parts: Parts, x: np.ndarray) -> Places:
        return places_of(self._chain.states_and_rates, pieces, parts, x)
