"""Training of networks on a given number of equal windows, one of them for the whole span."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain import Chain
from hamsym.networks.chain_checks import ChainChecks
from hamsym.networks.chain_training import (
    REACH,
    ChainSettings,
    Flow,
    Layout,
    TrainedChain,
    assembled,
    piece_of,
    points_of,
)
from hamsym.networks.trial import TrialSolution
from hamsym.networks.window_training import Fit, late, train_window
from hamsym.random_features.window_checks import SLACK

_SAMPLES = 65  # times at which the motion in a given window is looked at
_WIDEST = 1_000  # neurons of the last layer in a given window


@torch.no_grad()
def train_windows(
    H: Hamiltonian,
    guess: Chain,
    count: int,
    layout: Layout,
    settings: ChainSettings,
    generator: torch.Generator,
    *,
    widen: bool = False,
) -> TrainedChain:
    """Train networks on a given number of equal windows; a chain gives the first guess.

    Raise InputError if the motion in a window needs too large a network.

    - guess: A chain over the whole span.
    - widen: Make the last layer as wide as the motion in a window needs.
    """
    began = time.perf_counter(), time.process_time()
    flow = Flow(H)
    checks = ChainChecks(H, generator.initial_seed())
    edges = np.linspace(guess.edges[0], guess.edges[-1], count + 1)
    z, reached = guess.pieces[0].z0.numpy().copy(), float(edges[0])
    pieces: list[TrialSolution] = []
    counts: list[tuple[int, int, float]] = []
    points = evaluations = 0
    reason = doubt = ""
    with np.errstate(all="ignore"):
        try:
            for start, end in itertools.pairwise(edges.tolist()):
                h = end - start
                times = np.linspace(start, end, _SAMPLES)
                samples = guess.states_at(times)
                reach = max(REACH, abs(h) * _fastest(flow, samples, times) / 2)
                width = points_of(reach)
                if width > _WIDEST:
                    raise InputError(
                        f"windows={count} needs networks of {width:,} neurons in a layer, more "
                        f"than {_WIDEST:,}; give windows={math.ceil(count * width / _WIDEST)} or "
                        "more"
                    )
                own = layout
                if widen:
                    last = max(layout.hidden[-1], width)
                    own = replace(layout, hidden=(*layout.hidden[:-1], last))
                size = np.abs(samples).max(axis=0)
                size = np.where(size > 0, size, 1.0)
                network = own.network(H.dim, generator)
                fit = train_window(
                    flow.equations(z, start, h, size),
                    network,
                    reach,
                    width,
                    settings.of_window(layout, settings.hidden_steps),
                    guess=_states(guess, z, size, start, h),
                )
                evaluations += fit.evaluations
                piece = piece_of(network, z, size, start, h, layout.envelope, reach)
                state = piece.states_at(np.array([end]))[0]
                if not np.isfinite(state).all():
                    reason = "the state is not finite"
                    break
                pieces.append(piece)
                counts.append((fit.steps, fit.hidden_steps, fit.residual))
                points += fit.points
                z, reached = state, end
                met = fit.residual <= max(settings.tolerance, SLACK * settings.limit)
                if late(settings.deadline) and not (met and end == edges[-1]):
                    reason = "the time limit was reached"
                    break
                doubt = doubt or _doubt(piece, fit, end, size, checks, settings)
        except KeyboardInterrupt:
            reason = "interrupted"
    return assembled(pieces, reached, counts, (points, evaluations, 0), began, reason, doubt)


def _doubt(
    piece: TrialSolution,
    fit: Fit,
    end: float,
    size: np.ndarray,
    checks: ChainChecks,
    settings: ChainSettings,
) -> str:
    """Return why the estimated error of a window of given length may be wrong, "" if not."""
    if not fit.residual <= max(settings.tolerance, SLACK * settings.limit):
        return (
            f"the residual stays at {fit.residual:.1e} of the motion between t = {piece.t0:.6g} "
            f"and t = {end:.6g}; give more windows or wider layers"
        )
    tolerance = max(settings.tolerance, min(fit.residual, settings.limit))
    missed = checks.failure(piece, end, size, tolerance)
    return missed and f"{missed}: a narrow pulse, a step or a jump"


def _states(
    chain: Chain, z: np.ndarray, size: np.ndarray, start: float, h: float
) -> Callable[[Tensor], Tensor]:
    """Return y = (z^ - z)/S of a chain as a function of u = (t - start)/h."""
    origin, unit = torch.from_numpy(z), torch.from_numpy(size)

    def states(u: Tensor) -> Tensor:
        return (chain.tensors(start + h * u)[0] - origin) / unit

    return states


def _fastest(flow: Flow, z: np.ndarray, t: np.ndarray) -> float:
    """Return the mean of the fastest rate of small changes along states."""
    matrices = [flow.generator(state, float(when)) for state, when in zip(z, t, strict=True)]
    rates = [float(np.abs(np.linalg.eigvals(a)).max()) for a in matrices if np.isfinite(a).all()]
    return float(np.mean(rates)) if rates else 0.0
