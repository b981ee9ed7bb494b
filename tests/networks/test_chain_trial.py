"""Chains of networks as data: joints, sizes and the error estimate of unequal windows."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hamsym import Hamiltonian
from hamsym.networks.chain import Chain
from hamsym.networks.chain_error import estimate_chain_error
from hamsym.networks.network import Network
from hamsym.networks.trial import TrialSolution
from hamsym.support.records import packed, unpacked

EPS = float(np.finfo(float).eps)


def piece(start: float, z: np.ndarray, *, seed: int = 0, tau: float = 1.0) -> TrialSolution:
    network = Network(len(z), (3,), "sin", generator=torch.Generator().manual_seed(seed))
    network.requires_grad_(False)
    return TrialSolution(network, torch.from_numpy(z), t0=start, tau=tau)


def two_pieces(shift: float) -> tuple[Chain, np.ndarray]:
    z0 = np.array([1.0, -0.5])
    first = piece(0.0, z0)
    end = first.states_at(np.array([2.0]))[0]
    return Chain((first, piece(2.0, end + shift, seed=1)), 3.0), z0


def test_joints_may_differ_by_round_off_of_another_processor() -> None:
    chain, z0 = two_pieces(20 * EPS)
    chain.require_path(z0, (0.0, 3.0))


@pytest.mark.parametrize("shift", [1e-9, -1e-3, np.nan])
def test_joints_that_jump_are_refused(shift: float) -> None:
    chain, z0 = two_pieces(shift)
    with pytest.raises(ValueError, match="start at the end of that before|not finite"):
        chain.require_path(z0, (0.0, 3.0))


def test_first_state_is_compared_exactly() -> None:
    chain, z0 = two_pieces(0.0)
    with pytest.raises(ValueError, match="start at"):
        chain.require_path(z0 + 2 * EPS, (0.0, 3.0))


def test_weights_of_another_precision_are_refused() -> None:
    z0 = np.array([1.0, 0.0], dtype=np.float32)
    network = Network(2, (3,), "sin", generator=torch.Generator(), dtype=torch.float32)
    single = TrialSolution(network.requires_grad_(False), torch.from_numpy(z0))
    with pytest.raises(ValueError, match="float64"):
        packed(Chain((single,), 1.0))


def test_more_than_ten_thousand_windows_are_read_back() -> None:
    values = {"end": 1.0, "pieces": [{}] * 50_000}
    with pytest.raises(ValueError, match="of its pieces.0 is missing"):
        unpacked(Chain, {}, values)
    with pytest.raises(ValueError, match="at most 50,000 entries"):
        unpacked(Chain, {}, {**values, "pieces": [{}] * 50_001})


def test_error_estimate_resolves_the_window_with_most_points() -> None:
    z0 = np.array([1.0, 0.0])
    pieces = [piece(float(k), z0, tau=1 / 3) for k in range(9)]
    chain = Chain((*pieces, piece(9.0, z0, tau=1 / 60)), 10.0)
    H = Hamiltonian("p**2/2 + q**2/2")
    edges = estimate_chain_error(H, chain, 9 * 60 + 1_200).error.edges
    assert (edges >= 9.0).sum() - 1 == 1_200 // 16
    assert np.isin(chain.edges, edges).all()
