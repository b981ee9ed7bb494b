"""The methods "adam", "lbfgs" and "levenberg-marquardt": a deep network, all weights trained.

Stage 1  A network and the envelope make a trial solution that starts at z0.
Stage 2  The generated residual and loss, as an objective, are handed to the trainer, which knows
         nothing else of H.
Stage 3  The best weights are judged by the estimated error and become a Solution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.checkpoint import Checkpoint
from hamsym.networks.levenberg_marquardt import LevenbergMarquardt
from hamsym.networks.network import ComponentNetworks, Network
from hamsym.networks.objective import Objective, Regularizer
from hamsym.networks.optimizers import LBFGS, Adam
from hamsym.networks.options import (
    AdamOptions,
    DeepOptions,
    LBFGSOptions,
    LevenbergMarquardtOptions,
    precision_name,
)
from hamsym.networks.progress import training_progress
from hamsym.networks.training import (
    Criterion,
    History,
    Optimizer,
    Stages,
    Stopping,
    Training,
    train,
)
from hamsym.networks.trial import TrialSolution
from hamsym.problem import InitialValueProblem
from hamsym.solution.digest import digest
from hamsym.solution.discontinuities import first_jump, unresolved
from hamsym.solution.solution import Solution
from hamsym.support.validation import plain, require_positive

__all__ = ["solve_by_training"]

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# A trajectory that is estimated to be off by more than this part of its scale is no solution.
_CONVERGED = 0.01
# Of the methods of second order: the network's input runs from 0 to this, whatever the span.
_INPUT_RANGE = 4 * math.pi
_STALLED_AFTER = 60  # iterations of Levenberg-Marquardt on one span
_UNFINISHED = Training(History(*[np.empty(0)] * 5), 0, 0, 0, math.inf, math.inf, "", 0.0, 0.0)


def solve_by_training(problem: InitialValueProblem, options: DeepOptions) -> Solution:
    """Train a deep network; options as in :func:`hamsym.solve`."""
    H, (start, end) = problem.H, problem.span
    if not (
        isinstance(options.regularizers, Sequence)
        and all(isinstance(r, Regularizer) for r in options.regularizers)
    ):
        raise InputError("regularizers is not a list of Regularizer(weight, function); give one")
    tau = abs(end - start) / _INPUT_RANGE if options.tau is None else options.tau
    precision = _DTYPES[precision_name(options.dtype)]
    generator = torch.Generator().manual_seed(problem.seed)
    trial = TrialSolution(
        _network(H.dim, options, generator, precision),
        torch.tensor(problem.z0, dtype=precision),
        t0=start,
        tau=math.copysign(tau, end - start),
        envelope=options.envelope,
    )

    if options.initial is not None:
        _take_over(options.initial, trial)

    def solution(training: Training = _UNFINISHED) -> Solution:
        return Solution(
            H,
            problem.z0,
            problem.span,
            trial,
            method=options.method,
            record=training,
            energy_weight=options.energy_weight,
        )

    criteria = []
    if (wanted := options.target_error) is not None:
        require_positive("target_error", wanted)
        criteria.append(
            Criterion(
                "target error", wanted, lambda _: solution().relative_error_estimate <= wanted
            )
        )
    if (accuracy := options.accuracy) is not None:
        require_positive("accuracy", accuracy)
        criteria.append(Criterion("accuracy", accuracy, lambda _: _accurate(solution(), accuracy)))
    stopping = Stopping(
        iterations=options.total,
        target_loss=options.target_loss,
        target_ell_max=options.target_ell_max,
        patience=options.patience,
        time_limit=options.time_limit,
        criteria=tuple(criteria),
    )
    with training_progress(options.total, problem.progress) as callbacks:
        training = train(
            trial,
            _objective(H, problem.energy_0, options.energy_weight, tuple(options.regularizers)),
            problem.span,
            _optimizer(options),
            stopping,
            generator=generator,
            stages=_stages(options),
            callbacks=callbacks,
            checkpoint=_checkpoint(problem, options),
        )
    trial.requires_grad_(False)
    found = solution(training)
    return found.judged(*_verdict(found, training, options))


def _accurate(solution: Solution, accuracy: float) -> bool:
    """The paper's rule for an accuracy chosen beforehand: ell_max <= sigma_min * accuracy."""
    return solution.ell_max_regularized <= solution.sigma_min * accuracy


def _checkpoint(problem: InitialValueProblem, options: DeepOptions) -> Checkpoint | None:
    """The file to go on from, with all that the weights depend on but the rules of the end."""
    if options.checkpoint is None:
        return None
    require_positive("checkpoint_every", options.checkpoint_every)
    if options.regularizers:
        raise InputError("regularizers are functions, which no file can hold; leave checkpoint out")
    ends = {"target_loss", "target_ell_max", "target_error", "accuracy", "patience", "time_limit"}
    apart = {*ends, "regularizers", "checkpoint", "checkpoint_every", "iterations"}
    settings = {
        entry.name: getattr(options, entry.name)
        for entry in fields(options)
        if entry.name not in apart
    }
    if options.initial is not None:
        settings["initial"] = digest(options.initial)
    H = problem.H
    settings |= {
        "H": H.formula,
        "names": H.names,
        "parameters": dict(H.parameters),
        "z0": problem.z0.tolist(),
        "span": problem.span,
        "method": options.method,
        "seed": problem.seed,
        "dtype": f"torch.{precision_name(options.dtype)}",
        "torch": torch.__version__,
    }
    text = {name: repr(plain(value)) for name, value in settings.items()}
    return Checkpoint(options.checkpoint, text, options.checkpoint_every)


def _objective(
    H: Hamiltonian,
    energy_0: float,
    energy_weight: float,
    regularizers: tuple[Regularizer, ...],
) -> Objective:
    system, half = H.compile("torch"), H.dof

    def arguments(z: Tensor, t: Tensor) -> tuple[Any, ...]:
        return system.arguments(z, t)

    def residual(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        return system.residual(z, *arguments(dz, t))

    def loss(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        if system.time_dependent:
            return system.loss(z, dz, t)
        return system.loss(z, dz, energy_0, energy_weight)

    def rows(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        ell = residual(t, z, dz)
        if not energy_weight:
            return ell
        change = system.energy(*arguments(z, t)) - energy_0
        return torch.cat((ell, math.sqrt(energy_weight) * change.unsqueeze(-1)), -1)

    def slopes(t: Tensor, z: Tensor, dz: Tensor) -> tuple[Tensor, Tensor]:
        hessian = system.hessian(*arguments(z, t))
        in_z = torch.cat((-hessian[:, half:], hessian[:, :half]), 1)
        in_dz = torch.eye(2 * half, dtype=z.dtype).expand_as(in_z)
        if energy_weight:
            slope = math.sqrt(energy_weight) * system.gradient(*arguments(z, t))
            in_z = torch.cat((in_z, slope.unsqueeze(1)), 1)
            in_dz = torch.cat((in_dz, torch.zeros_like(slope).unsqueeze(1)), 1)
        return in_z, in_dz

    return Objective(residual, loss, regularizers, rows, slopes)


def _network(
    dim: int, options: DeepOptions, generator: torch.Generator, dtype: torch.dtype
) -> Network | ComponentNetworks:
    def network(outputs: int) -> Network:
        return Network(
            outputs,
            options.hidden,
            options.activation,
            frequency=options.frequency,
            generator=generator,
            dtype=dtype,
        )

    if options.shared_weights:
        return network(dim)
    return ComponentNetworks([network(1) for _ in range(dim)])


@torch.no_grad()
def _take_over(initial: Solution, trial: TrialSolution) -> None:
    """Give the trial solution the weights of a solution that was trained before."""
    if not isinstance(initial, Solution) or not isinstance(initial.trial, TrialSolution):
        raise InputError(
            "initial is not a trained network; give a Solution of a method that trains one"
        )
    theirs, own = initial.trial.network, trial.network
    if _layout(theirs) != _layout(own):
        raise InputError(
            f"initial has {_layout(theirs)}, this training {_layout(own)}; "
            "give the same hidden, activation and shared_weights"
        )
    own.load_state_dict(theirs.state_dict())


def _layout(network: Any) -> str:
    parts = getattr(network, "networks", [network])
    sizes = " + ".join("-".join(map(str, part.sizes)) for part in parts)
    return f"{sizes} {network.activation}"


def _verdict(solution: Solution, training: Training, options: DeepOptions) -> tuple[bool, str]:
    done = f"{training.iterations:,} {options.unit}"
    if training.restarts:
        done += f" with {training.restarts} restart{'s' if training.restarts > 1 else ''}"
    if training.stopped == "diverged":
        return False, f"the loss was no longer finite after {done}; lower the learning rate"
    relative = solution.relative_error_estimate
    state = (
        f"loss {training.best_loss:.2e}, ell_max {solution.ell_max:.2e}, "
        f"estimated error {relative:.1e} of the motion"
    )
    if training.stopped == "interrupted":
        return False, f"interrupted after {done}: {state}"

    def jump() -> str | None:
        return first_jump(solution, solution.scan_times, unresolved(solution))

    targets = {
        "target loss": options.target_loss,
        "target ell_max": options.target_ell_max,
        "target error": options.target_error,
        "accuracy": options.accuracy,
    }
    asked = {name: value for name, value in targets.items() if value is not None}
    if training.stopped in asked:
        value = asked[training.stopped]
        if training.stopped == "target error" and (found := jump()) is not None:
            return False, f"{found} ({state})"
        return True, f"{training.stopped} {value:.2e} reached after {done}: {state}"
    ends = {
        "iterations": f"in {done}",
        "patience": f"in {done}, the last {options.patience} without a better loss",
        "time limit": f"in {options.time_limit:g} s, {done}" if options.time_limit else "",
        "stalled": f"in {done}, after which no step was of use",
    }
    end = ends[training.stopped]
    if asked:
        missed = " and ".join(f"{name} {value:.2e}" for name, value in asked.items())
        if options.accuracy is not None and solution.sigma_min == 0:
            state += (
                "; the accuracy means nothing here, because sigma_min is 0 along the trajectory"
            )
        return False, f"{missed} not reached {end}: {state}"
    if relative <= _CONVERGED and (found := jump()) is not None:
        return False, f"{found} ({state})"
    if relative <= _CONVERGED:
        return True, f"{end.removeprefix('in ')}: {state}"
    return False, f"not converged {'after' + end[2:]}: {state}, more than {_CONVERGED:g}"


def _optimizer(options: DeepOptions) -> Optimizer:
    match options:
        case AdamOptions():
            return Adam(
                learning_rate=options.learning_rate,
                betas=options.betas,
                schedule=options.schedule,
                points=options.points,
                noise=options.noise,
            )
        case LBFGSOptions():
            return LBFGS(points=options.points)
        case _:
            return LevenbergMarquardt(points=options.points)


def _stages(options: DeepOptions) -> Stages:
    if isinstance(options, LevenbergMarquardtOptions):
        return Stages(options.stages, restart_after=_STALLED_AFTER, restarts=options.restarts)
    return Stages(options.stages)
