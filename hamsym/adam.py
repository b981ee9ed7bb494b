"""The method "adam": a deep network, all weights trained on noisy points, as in the paper.

Stage 1  A network and the envelope make a trial solution that starts at z0.
Stage 2  The generated residual and loss, as an objective, are handed to the trainer, which knows
         nothing else of H.
Stage 3  The best weights are judged by the estimated error and become a Solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.problem import InitialValueProblem
from hamsym.progress import training_progress
from hamsym.solution import Solution
from hamsym.training import AdamOptions, Objective, Regularizer, Training, train_adam
from hamsym.trial import ComponentNetworks, Network, TrialSolution

__all__ = ["solve_by_adam"]

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# A trajectory that is estimated to be off by more than this part of its scale is no solution.
_CONVERGED = 0.01


def solve_by_adam(
    problem: InitialValueProblem,
    *,
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
    dtype: str | torch.dtype = "float64",
) -> Solution:
    """Train a network to satisfy Hamilton's equations; options as in :func:`hamsym.solve`."""
    H, (start, end) = problem.H, problem.span
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
    if not (
        isinstance(regularizers, Sequence) and all(isinstance(r, Regularizer) for r in regularizers)
    ):
        raise InputError("regularizers is not a list of Regularizer(weight, function); give one")
    precision = _precision(dtype)
    generator = torch.Generator().manual_seed(problem.seed)
    trial = TrialSolution(
        _network(H.dim, hidden, activation, shared_weights, generator, precision),
        torch.tensor(problem.z0, dtype=precision),
        t0=start,
        tau=math.copysign(tau, end - start),
        envelope=envelope,
    )
    objective = _objective(H, problem.energy_0, energy_weight, tuple(regularizers))
    with training_progress(epochs, problem.progress) as callbacks:
        training = train_adam(
            trial, objective, problem.span, options, generator=generator, callbacks=callbacks
        )
    trial.requires_grad_(False)
    solution = Solution(
        H,
        problem.z0,
        problem.span,
        trial,
        method="adam",
        training=training,
        energy_weight=energy_weight,
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


def _precision(dtype: str | torch.dtype) -> torch.dtype:
    found = _DTYPES.get(str(dtype).removeprefix("torch."))
    if found is None:
        raise InputError(f"dtype={dtype!r} cannot be used; choose float64 or float32")
    return found
