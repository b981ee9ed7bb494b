"""The methods that train all weights of a deep network, each by the optimizer of its name.

Stage 1  A network and the envelope make a trial solution that starts at z0.
Stage 2  The generated residual and loss are the objective of the trainer, which does not depend on
         H otherwise.
Stage 3  The best weights are judged by the estimated error and become a Solution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.codegen.system import System
from hamsym.description import settings_text
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.chain_method import solve_by_chain
from hamsym.networks.checkpoint import Checkpoint
from hamsym.networks.devices import available_device
from hamsym.networks.levenberg_marquardt import LevenbergMarquardt
from hamsym.networks.module_trial import ModuleTrial, checked_copy, rate_defect
from hamsym.networks.network import ComponentNetworks, Network
from hamsym.networks.objective import Objective, Regularizer
from hamsym.networks.optimizers import LBFGS, Adam
from hamsym.networks.options import (
    CONVERGED,
    AdamOptions,
    DeepOptions,
    LBFGSOptions,
    LevenbergMarquardtOptions,
    SelfScaledBroydenOptions,
    precision_name,
)
from hamsym.networks.points import checked_points
from hamsym.networks.progress import training_progress
from hamsym.networks.record import Stopped, Training
from hamsym.networks.rules import Criterion, Stages, Stopping
from hamsym.networks.self_scaled_broyden import SelfScaledBroyden
from hamsym.networks.training import Optimizer, train
from hamsym.networks.trial import TrialSolution
from hamsym.problem import InitialValueProblem
from hamsym.solution.digest import digest
from hamsym.solution.discontinuities import first_jump, unresolved
from hamsym.solution.solution import Solution
from hamsym.support.validation import require_positive

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# Largest input of the network for methods of second order, on any span.
_INPUT_RANGE = 4 * math.pi
_STALLED_AFTER = 60  # iterations of Levenberg-Marquardt on one span
# Reasons for which a training stopped without a target, as they end its message.
_REASONS = {
    Stopped.ITERATIONS: "",
    Stopped.PATIENCE: "; the loss did not fall in the last {patience} {unit}",
    Stopped.TIME_LIMIT: "; the time limit of {time_limit:g} s was reached",
    Stopped.STALLED: "; the optimizer stalled",
}


def solve_by_training(problem: InitialValueProblem, options: DeepOptions) -> Solution:
    """Train a deep network, or a chain of them; options as in :func:`hamsym.solve`."""
    if isinstance(options, LevenbergMarquardtOptions) and not options.joint:
        return solve_by_chain(problem, options)
    H, (start, end) = problem.H, problem.span
    if not (
        isinstance(options.regularizers, Sequence)
        and all(isinstance(r, Regularizer) for r in options.regularizers)
    ):
        raise InputError(
            "regularizers is not a list of Regularizer objects; give e.g. "
            "[Regularizer(weight, function)]"
        )
    points = checked_points(options.points, problem.span)
    options = replace(options, points=points)
    tau = abs(end - start) / _INPUT_RANGE if options.tau is None else options.tau
    precision = _DTYPES[precision_name(options.dtype)]
    device = available_device(options.device, precision)
    # Random numbers are drawn on the CPU, so that a seed means the same on every device.
    generator = torch.Generator("cpu").manual_seed(problem.seed)
    form: dict[str, Any] = {
        "z0": torch.tensor(problem.z0, dtype=precision, device="cpu"),
        "t0": start,
        "tau": math.copysign(tau, end - start),
        "envelope": options.envelope,
    }
    trial: TrialSolution | ModuleTrial
    if options.trial is None:
        trial = TrialSolution(_network(H.dim, options, generator, precision), **form)
    else:
        longest = abs(end - start) / tau
        trial = ModuleTrial(checked_copy(options.trial, H.dim, longest, precision), **form)
    if options.initial is not None:
        _take_over(options.initial, trial)
    trial.hold([H.dof + H.q.index(q) for q in H.cyclic_coordinates])  # their momenta
    trial.to(device)
    if isinstance(trial, ModuleTrial):
        trial.check_evaluation()

    def solution(training: Training) -> Solution:
        return Solution(
            H,
            problem.z0,
            problem.span,
            trial,
            method=options.method,
            record=training,
            energy_weight=options.energy_weight,
        )

    stopping = _stopping(options, solution)
    with training_progress(options.total, problem.progress) as callbacks:
        training = train(
            trial,
            _objective(
                H,
                _penalties(problem, options),
                tuple(options.regularizers),
            ),
            problem.span,
            _optimizer(options, points),
            stopping,
            generator=generator,
            stages=_stages(options, trial),
            callbacks=callbacks,
            checkpoint=_checkpoint(problem, options),
        )
    trial.requires_grad_(False).to("cpu")
    if isinstance(trial, TrialSolution):
        trial.release()
    found = solution(training)
    return found.judged(*_verdict(found, training, options))


def _stopping(options: DeepOptions, solution: Callable[[Training], Solution]) -> Stopping:
    """Return the rules for stopping; criteria judge the solution with the best weights so far."""
    criteria = []
    if (target := options.target_error) is not None:
        require_positive("target_error", target)
        criteria.append(
            Criterion(
                Stopped.TARGET_ERROR,
                target,
                lambda _, record: solution(record).relative_error <= target,
            )
        )
    if (accuracy := options.accuracy) is not None:
        require_positive("accuracy", accuracy)
        criteria.append(
            Criterion(
                Stopped.ACCURACY,
                accuracy,
                lambda _, record: _is_accurate(solution(record), accuracy),
            )
        )
    return Stopping(
        iterations=options.total,
        target_loss=options.target_loss,
        target_ell_max=options.target_ell_max,
        patience=options.patience,
        time_limit=options.time_limit,
        criteria=tuple(criteria),
    )


def _is_accurate(solution: Solution, accuracy: float) -> bool:
    """Return whether ell_max <= sigma_min * accuracy, the paper's rule for stopping."""
    return solution.ell_max_regularized <= solution.sigma_min * accuracy


def _checkpoint(problem: InitialValueProblem, options: DeepOptions) -> Checkpoint | None:
    """Return the checkpoint with all settings that determine the weights, if it has a path."""
    if options.checkpoint is None:
        return None
    require_positive("checkpoint_every", options.checkpoint_every)
    if options.regularizers:
        raise InputError("regularizers cannot be serialised; train without checkpoint")
    rules = {"target_loss", "target_ell_max", "target_error", "accuracy", "patience", "time_limit"}
    without = {*rules, "regularizers", "checkpoint", "checkpoint_every", "iterations", "initial"}
    settings = settings_text(
        problem.H, problem.z0, problem.span, problem.seed, options, without=without
    )
    settings["initial"] = "None" if options.initial is None else digest(options.initial)
    settings |= {"dtype": precision_name(options.dtype), "device": str(options.device)}
    settings |= {"method": options.method, "torch": torch.__version__}
    return Checkpoint(options.checkpoint, settings, options.checkpoint_every)


@dataclass(frozen=True)
class _Penalty:
    """The penalty weight * mean((I - I(start))^2) on changes of the energy or an invariant."""

    system: System
    start: float
    weight: float

    def change(self, z: Tensor, t: Tensor) -> Tensor:
        """Return sqrt(weight) * (I - I(start)), shape (K,)."""
        value = self.system.energy(*self.system.arguments(z, t))
        return math.sqrt(self.weight) * (value - self.start)

    def slope(self, z: Tensor, t: Tensor) -> Tensor:
        """Return the derivative of the change in z, shape (K, dim)."""
        gradient: Tensor = self.system.gradient(*self.system.arguments(z, t))
        return math.sqrt(self.weight) * gradient


def _penalties(problem: InitialValueProblem, options: DeepOptions) -> list[_Penalty]:
    """Return the penalty on the energy, which has weight 0 by default, and those on invariants."""
    found = [_Penalty(problem.H.compile("torch"), problem.energy_0, options.energy_weight)]
    functions = options.invariants.functions if options.invariants is not None else ()
    for function in functions:
        exact = function.compile("numpy")
        start = float(exact.energy(*exact.arguments(problem.z0, problem.span[0])))
        found.append(_Penalty(function.compile("torch"), start, options.invariant_weight))
    return found


def _objective(
    H: Hamiltonian, penalties: Sequence[_Penalty], regularizers: tuple[Regularizer, ...]
) -> Objective:
    """Return the objective made of the functions generated for H."""
    system, (energy, *others) = H.compile("torch"), penalties
    weighted = [*([energy] if energy.weight else []), *others]

    def residual(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        return system.residual(z, *system.arguments(dz, t))

    def loss(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        constants = (energy.start, energy.weight) if H.conserves_energy else ()
        value: Tensor = system.loss(z, *system.arguments(dz, t), *constants)
        for penalty in others:
            value = value + penalty.change(z, t).square().mean()
        return value

    def rows(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        changes = [penalty.change(z, t).unsqueeze(-1) for penalty in weighted]
        ell = residual(t, z, dz)
        return torch.cat((ell, *changes), -1) if changes else ell

    def slopes(t: Tensor, z: Tensor, dz: Tensor) -> tuple[Tensor, Tensor]:
        in_z = -system.jacobian(*system.arguments(z, t))
        in_dz = torch.eye(H.dim, dtype=z.dtype, device=z.device).expand_as(in_z)
        if weighted:
            own = torch.stack([penalty.slope(z, t) for penalty in weighted], 1)
            in_z = torch.cat((in_z, own), 1)
            in_dz = torch.cat((in_dz, torch.zeros_like(own)), 1)
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
def _take_over(initial: Solution, trial: TrialSolution | ModuleTrial) -> None:
    """Copy the weights of a trained solution into the trial solution."""
    kinds = (TrialSolution, ModuleTrial)
    if not isinstance(initial, Solution) or not isinstance(initial.trial, kinds):
        raise InputError(
            "initial is not a trained network; give a Solution of a method that trains one"
        )
    own, other = (isinstance(part, ModuleTrial) for part in (trial, initial.trial))
    if own != other or (own and _shapes(initial.trial) != _shapes(trial)):
        raise InputError(
            "initial has another network than this training; give the same trial to both"
        )
    if isinstance(trial, ModuleTrial) or isinstance(initial.trial, ModuleTrial):
        trial.network.load_state_dict(initial.trial.network.state_dict())
        return
    given, expected = _layout(initial.trial), _layout(trial)
    if given != expected:
        raise InputError(
            f"initial has {given}, this training {expected}; "
            "give the same hidden, activation and shared_weights"
        )
    trial.network.load_state_dict(initial.trial.network.state_dict())


def _shapes(trial: TrialSolution | ModuleTrial) -> dict[str, torch.Size]:
    return {name: tensor.shape for name, tensor in trial.network.state_dict().items()}


def _layout(trial: TrialSolution) -> str:
    """Return the layer widths and the activation, as in "1-50-50-2 sin"."""
    sizes = " + ".join("-".join(map(str, part.sizes)) for part in trial.parts)
    return f"{sizes} {trial.network.activation}"


def _verdict(solution: Solution, training: Training, options: DeepOptions) -> tuple[bool, str]:
    """Return success and message of a solution by the way its training ended."""
    done = f"{training.iterations:,} {options.unit}"
    if training.restarts:
        done += f" with {training.restarts} restart{'s' if training.restarts > 1 else ''}"
    if training.stopped == Stopped.DIVERGED:
        return False, f"the loss was not finite after {done}; reduce the learning rate"
    if isinstance(solution.trial, ModuleTrial) and not _rates_agree(solution, solution.trial):
        return False, (
            f"no error can be estimated after {done}: the derivative of the trained network in "
            "forward mode is not that of its values; give another trial"
        )
    relative = solution.relative_error
    state = (
        f"loss {training.best_loss:.2e}, ell_max {solution.ell_max:.2e}, "
        f"estimated error {relative:.1e} of the motion"
    )
    if training.stopped == Stopped.INTERRUPTED:
        return False, f"interrupted after {done}: {state}"
    targets = _targets(options)
    reached = targets.get(training.stopped)
    # Estimated errors are not valid beyond a discontinuity of H.
    if training.stopped == Stopped.TARGET_ERROR or (not targets and relative <= CONVERGED):
        jump = first_jump(solution, solution.scan_times, unresolved(solution))
        if jump is not None:
            return False, f"{jump} ({state})"
    if reached is not None:
        return True, f"{training.stopped} {reached:.2e} reached after {done}: {state}"
    reason = _REASONS[Stopped(training.stopped)].format(**vars(options), unit=options.unit)
    if targets:
        missed = " and ".join(f"{name} {value:.2e}" for name, value in targets.items())
        if options.accuracy is not None and solution.sigma_min == 0:
            reason += "; accuracy is undefined: sigma_min = 0 on this trajectory"
        return False, f"{missed} not reached after {done}: {state}{reason}"
    if relative <= CONVERGED:
        return True, f"error below {CONVERGED:.0%} of the motion after {done}: {state}{reason}"
    return False, f"not converged after {done}: {state}, more than {CONVERGED:g}{reason}"


def _rates_agree(solution: Solution, trial: ModuleTrial) -> bool:
    """Return whether dz^/dt, from which errors are estimated, is the derivative of z^."""
    allowed = 0.1 * solution.largest_error + 1e-8 * np.abs(solution(solution.scan_times)).max()
    return bool((rate_defect(trial, solution.span) <= allowed).all())


def _targets(options: DeepOptions) -> dict[str, float]:
    """Return the targets that are set, by the names of the rules that they end a training by."""
    targets = {
        Stopped.TARGET_LOSS: options.target_loss,
        Stopped.TARGET_ELL_MAX: options.target_ell_max,
        Stopped.TARGET_ERROR: options.target_error,
        Stopped.ACCURACY: options.accuracy,
    }
    return {name: value for name, value in targets.items() if value is not None}


def _optimizer(options: DeepOptions, points: int | np.ndarray) -> Optimizer:
    match options:
        case AdamOptions():
            return Adam(
                learning_rate=options.learning_rate,
                betas=options.betas,
                schedule=options.schedule,
                points=points,
                noise=options.noise,
            )
        case LBFGSOptions():
            return LBFGS(points=points)
        case SelfScaledBroydenOptions():
            return SelfScaledBroyden(points=points)
        case _:
            return LevenbergMarquardt(points=points)


def _stages(options: DeepOptions, trial: TrialSolution | ModuleTrial) -> Stages:
    # Without new weights a training cannot restart.
    drawn = not isinstance(trial, ModuleTrial) or trial.can_be_drawn
    if isinstance(options, LevenbergMarquardtOptions) and drawn:
        return Stages(options.stages, restart_after=_STALLED_AFTER, restarts=options.restarts)
    return Stages(options.stages)
