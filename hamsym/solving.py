"""solve: from a Hamiltonian and an initial state to a trained trajectory.

Stage 1  H is compiled for torch, and its initial energy evaluated.
Stage 2  A network and the envelope make a trial solution that starts at z0.
Stage 3  The generated residual and loss, as an objective, are handed to a trainer, which knows
         nothing else of H.
Stage 4  The best weights are judged between the points and become a Solution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators import checked_span
from hamsym.progress import training_progress
from hamsym.solution import Solution
from hamsym.training import AdamOptions, Objective, Regularizer, Training, train_adam
from hamsym.trial import ComponentNetworks, Network, TrialSolution

__all__ = ["METHODS", "solve"]

#: Methods of solution and what they do.
METHODS: dict[str, str] = {
    "adam": "a deep network trained by Adam on noisy points, as in the paper"
}

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# A trajectory that is estimated to be off by more than this part of its scale is no solution.
_CONVERGED = 0.01


def solve(
    H: Hamiltonian,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    *,
    method: str | None = None,
    epochs: int = 50_000,
    learning_rate: float = 8e-3,
    betas: tuple[float, float] = (0.9, 0.999),
    schedule: str = "cosine",
    hidden: Sequence[int] = (50, 50),
    activation: str = "sin",
    envelope: str = "exponential",
    tau: float = 1.0,
    shared_weights: bool = True,
    points: int = 200,
    noise: float | None = None,
    energy_weight: float = 0.0,
    regularizers: Sequence[Regularizer] = (),
    target_loss: float | None = None,
    seed: int = 0,
    dtype: str | torch.dtype = "float64",
    progress: bool | None = None,
) -> Solution:
    """Train a network z^(t) = z0 + f(t) N(t) to satisfy Hamilton's equations over a time span.

    Parameters
    ----------
    H : Hamiltonian
        With a value for every parameter.
    z0 : sequence or mapping
        Initial state, in the order of H.z or by name.
    span : (float, float)
        Start and end time; the end may be the earlier one.
    method : {"adam"}
    epochs, learning_rate, betas, schedule, points, noise, target_loss
        See :class:`~hamsym.training.AdamOptions`.
    hidden : sequence of int
        Neurons of each hidden layer.
    activation : {"sin", "sigmoid", "tanh"}
    envelope : {"exponential", "linear"}
        f(s) = 1 - exp(-s) or f(s) = s, with s = |t - t_start| / tau.
    tau : float
        Unit of time of the network's input, in the units of H; the paper's is 1.
    shared_weights : bool
        One network with dim outputs; otherwise one network for each component.
    energy_weight : float
        Weight lambda of the mean of (H - E0)^2 in the loss (the paper's eq. regLoss).
    regularizers : sequence of Regularizer
        Further terms of the loss.
    seed : int
        Of the initial weights and the noise: same seed, same machine, same result.
    dtype : {"float64", "float32"}
    progress : bool, optional
        Draw progress on standard error; by default where that is a terminal.

    Returns
    -------
    Solution
        ``success`` tells whether the target loss was reached or, without one, whether the
        estimated error stays below 1 % of the motion; the best weights found are returned either
        way.

    Raises
    ------
    InputError
        If a setting, a name, the state or the span cannot be used.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> solution = solve(H, [1.0, 0.0], (0, 1), method="adam", epochs=400, points=20)
    >>> solution(0.0)
    array([1., 0.])
    >>> bool(abs(solution(1.0)[0] - np.cos(1.0)) < 0.05)
    True
    """
    if method not in METHODS:
        known = " or ".join(f"method='{name}'" for name in METHODS)
        problem = "no method is given" if method is None else f"'{method}' is not a known method"
        raise InputError(f"{problem}; say {known}")
    H.require_parameters()
    state = H.state_from(z0)
    start, end = checked_span(span)
    _check_weights(H, energy_weight, tau)
    options = AdamOptions(
        epochs=epochs,
        learning_rate=learning_rate,
        betas=betas,
        schedule=schedule,
        points=points,
        noise=noise,
        target_loss=target_loss,
    )
    precision = _precision(dtype)
    energy_0 = _initial_energy(H, state, start)

    generator = torch.Generator().manual_seed(_checked_seed(seed))
    trial = TrialSolution(
        _network(H.dim, hidden, activation, shared_weights, generator, precision),
        torch.tensor(state, dtype=precision),
        t0=start,
        tau=math.copysign(tau, end - start),
        envelope=envelope,
    )
    objective = _objective(H, energy_0, energy_weight, tuple(regularizers))
    with training_progress(epochs, progress) as callbacks:
        training = train_adam(
            trial, objective, (start, end), options, generator=generator, callbacks=callbacks
        )
    trial.requires_grad_(False)
    solution = Solution(
        H,
        state,
        (start, end),
        trial,
        method=method,
        energy_weight=energy_weight,
        training=training,
        success=False,
        message="",
    )
    solution.success, solution.message = _verdict(solution, training, target_loss)
    return solution


def _objective(
    H: Hamiltonian,
    energy_0: float,
    energy_weight: float,
    regularizers: tuple[Regularizer, ...],
) -> Objective:
    system = H.compile("torch")
    if system.time_dependent:
        return Objective(
            residual=lambda t, z, dz: system.residual(z, dz, t),
            loss=lambda t, z, dz: system.loss(z, dz, t),
            regularizers=regularizers,
        )
    return Objective(
        residual=lambda t, z, dz: system.residual(z, dz),
        loss=lambda t, z, dz: system.loss(z, dz, energy_0, energy_weight),
        regularizers=regularizers,
    )


def _network(
    dim: int,
    hidden: Sequence[int],
    activation: str,
    shared_weights: bool,
    generator: torch.Generator,
    dtype: torch.dtype,
) -> Network | ComponentNetworks:
    def network(outputs: int) -> Network:
        return Network(outputs, hidden, activation, generator=generator, dtype=dtype)

    return network(dim) if shared_weights else ComponentNetworks([network(1) for _ in range(dim)])


def _verdict(solution: Solution, training: Training, target_loss: float | None) -> tuple[bool, str]:
    done = f"{training.epochs:,} epochs"
    if training.stopped == "diverged":
        return False, f"the loss was no longer finite after {done}; lower the learning rate"
    relative = solution.relative_error_estimate
    state = (
        f"loss {training.best_loss:.2e}, ell_max {solution.ell_max:.2e}, "
        f"estimated error {relative:.1e} of the motion"
    )
    if training.stopped == "interrupted":
        return False, f"interrupted after {done}: {state}"
    if target_loss is not None:
        if training.reached_target:
            return True, f"target loss {target_loss:.2e} reached after {done}: {state}"
        return False, f"target loss {target_loss:.2e} not reached in {done}: {state}"
    if relative <= _CONVERGED:
        return True, f"{done}: {state}"
    return False, f"not converged after {done}: {state}, more than {_CONVERGED:g}"


def _initial_energy(H: Hamiltonian, state: np.ndarray, start: float) -> float:
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        energy = float(system.energy(*system.arguments(state, start)))
        rates = system.vector_field(*system.arguments(state, start))
    if not (math.isfinite(energy) and np.all(np.isfinite(rates))):
        raise InputError("H or its gradient is not finite at z0; start elsewhere")
    return energy


def _check_weights(H: Hamiltonian, energy_weight: float, tau: float) -> None:
    if not (math.isfinite(energy_weight) and energy_weight >= 0):
        raise InputError(f"energy_weight={energy_weight!r} cannot be used; give 0 or more")
    if energy_weight and H.time is not None:
        raise InputError(
            f"energy_weight={energy_weight!r} penalises changes of an energy that is not "
            "conserved, because H depends on t; leave it at 0"
        )
    if not (math.isfinite(tau) and tau > 0):
        raise InputError(f"tau={tau!r} cannot be used; give a time above 0")


def _checked_seed(seed: int) -> int:
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or not 0 <= seed < 2**63:
        raise InputError(f"seed={seed!r} cannot be used; give a whole number from 0")
    return int(seed)


def _precision(dtype: str | torch.dtype) -> torch.dtype:
    found = _DTYPES.get(str(dtype).removeprefix("torch."))
    if found is None:
        raise InputError(f"dtype={dtype!r} cannot be used; choose float64 or float32")
    return found
