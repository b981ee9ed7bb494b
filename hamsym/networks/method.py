"""The methods that train all weights of a deep network, each by the optimizer of its name.

Stage 1  A network and the envelope make a trial solution that starts at z0.
Stage 2  The generated residual and loss are the objective of the trainer, which does not depend on
         H otherwise.
Stage 3  The best weights are judged by the estimated error and become a Solution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.codegen.system import System
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks import levenberg_marquardt, optimizers
from hamsym.networks.devices import available_device
from hamsym.networks.hidden_residual import hidden_residual
from hamsym.networks.methods import LBFGS, Adam, JointTraining, LevenbergMarquardt, SSBroyden
from hamsym.networks.module_trial import ModuleTrial, checked_copy, rate_defect
from hamsym.networks.network import ComponentNetworks, Network
from hamsym.networks.objective import Objective, Regularizer
from hamsym.networks.progress import training_progress
from hamsym.networks.record import Stopped, Training
from hamsym.networks.rules import Stages
from hamsym.networks.self_scaled_broyden import SelfScaledBroyden
from hamsym.networks.training import train
from hamsym.networks.trial import TrialSolution
from hamsym.problems.problem import InitialValueProblem
from hamsym.solution.acceptance import accepted, excess
from hamsym.solution.discontinuities import first_jump, unresolved
from hamsym.solution.settings import Settings
from hamsym.solution.solution import Solution

_OPTIMIZERS: dict[type[JointTraining], type[optimizers.Optimizer]] = {
    Adam: optimizers.Adam,
    LBFGS: optimizers.LBFGS,
    SSBroyden: SelfScaledBroyden,
    LevenbergMarquardt: levenberg_marquardt.LevenbergMarquardt,
}
# Largest input of the network for methods of second order, on any span.
_INPUT_RANGE = 4 * math.pi
_STALLED_AFTER = 60  # iterations of Levenberg-Marquardt on one span


def solve_by_training(problem: InitialValueProblem, method: JointTraining) -> Solution:
    """Train a deep network, judged by the tolerance of the problem."""
    H, (start, end) = problem.H, problem.span
    if not (
        isinstance(method.regularizers, Sequence)
        and all(isinstance(r, Regularizer) for r in method.regularizers)
    ):
        raise InputError(
            "regularizers is not a list of Regularizer objects; give e.g. "
            "[Regularizer(weight, function)]"
        )
    tau = abs(end - start) / _INPUT_RANGE if method.tau is None else method.tau
    precision: torch.dtype = getattr(torch, str(method.dtype))
    device = available_device(method.device, precision)
    # Random numbers are drawn on the CPU, so that a seed means the same on every device.
    generator = torch.Generator("cpu").manual_seed(problem.seed)
    form: dict[str, Any] = {
        "z0": torch.tensor(problem.z0, dtype=precision, device="cpu"),
        "t0": start,
        "tau": math.copysign(tau, end - start),
        "envelope": method.envelope,
    }
    trial: TrialSolution | ModuleTrial
    if method.trial is None:
        trial = TrialSolution(_network(H.dim, method, generator, precision), **form)
    else:
        longest = abs(end - start) / tau
        trial = ModuleTrial(checked_copy(method.trial, H.dim, longest, precision), **form)
    if method.initial is not None:
        _take_over(method.initial, trial)
    trial.hold([H.dof + H.q.index(q) for q in H.cyclic_coordinates])  # their momenta
    trial.to(device)
    if isinstance(trial, ModuleTrial):
        trial.check_evaluation()

    settings = Settings.of(problem, method)

    def solution(training: Training) -> Solution:
        return Solution(
            H,
            problem.z0,
            problem.span,
            trial,
            method=method.name,
            record=training,
            settings=settings,
            energy_weight=method.energy_weight,
        )

    objective = _objective(H, _penalties(problem, method), tuple(method.regularizers))
    optimizer = next(own for kind, own in _OPTIMIZERS.items() if isinstance(method, kind))
    with training_progress(method.total, problem.progress) as tell:
        training = train(
            trial,
            objective,
            problem.span,
            optimizer(method),
            generator=generator,
            stages=_stages(method, trial),
            criteria=_criteria(problem, method, solution),
            tell=tell,
        )
    trial.requires_grad_(False).to("cpu")
    if isinstance(trial, TrialSolution):
        trial.release()
    return _judged(solution(training), training, method)


def _criteria(
    problem: InitialValueProblem, method: JointTraining, solution: Callable[[Training], Solution]
) -> dict[str, Callable[[Training], bool]]:
    """Return the rules for stopping that judge the solution with the best weights so far."""
    criteria: dict[str, Callable[[Training], bool]] = {}
    if problem.tol_given:
        criteria[Stopped.TOLERANCE] = lambda record: excess(solution(record)) <= 1
    if (accuracy := method.accuracy) is not None:

        def is_accurate(record: Training) -> bool:
            found = solution(record)  # by the paper's rule for stopping
            return found.ell_max_regularized <= found.sigma_min * accuracy

        criteria[Stopped.ACCURACY] = is_accurate
    return criteria


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


def _penalties(problem: InitialValueProblem, method: JointTraining) -> list[_Penalty]:
    """Return the penalty on the energy, which has weight 0 by default, and those on invariants."""
    found = [_Penalty(problem.H.compile("torch"), problem.energy_0, method.energy_weight)]
    functions = problem.invariants.functions if method.invariant_weight else ()
    for function in functions:
        start = float(function.compile("numpy").at("energy", problem.z0, problem.span[0]))
        found.append(_Penalty(function.compile("torch"), start, method.invariant_weight))
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

    return Objective(residual, loss, rows, slopes, regularizers)


def _network(
    dim: int, method: JointTraining, generator: torch.Generator, dtype: torch.dtype
) -> Network | ComponentNetworks:
    def network(outputs: int) -> Network:
        return Network(
            outputs,
            method.hidden,
            method.activation,
            frequency=method.frequency,
            generator=generator,
            dtype=dtype,
        )

    if method.shared_weights:
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
    if isinstance(trial, TrialSolution) and isinstance(initial.trial, TrialSolution):
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


def _judged(solution: Solution, training: Training, method: JointTraining) -> Solution:
    """Return the solution with its verdict."""
    done = f"{training.iterations:,} {method.unit}"
    if training.restarts:
        done += f" with {training.restarts} restart{'s' if training.restarts > 1 else ''}"
    if training.stopped == Stopped.DIVERGED:
        return solution.judged(
            False, f"the loss was not finite after {done}; reduce the learning rate"
        )
    if isinstance(solution.trial, ModuleTrial) and not _rates_agree(solution, solution.trial):
        return solution.judged(
            False,
            f"no error can be estimated after {done}: the derivative of the trained network in "
            "forward mode is not that of its values; give another trial",
        )
    rule = _ended_by(solution, training, method)
    state = f"{done}{rule}, loss {training.best_loss:.2e}, ell_max {solution.ell_max:.2e}"
    jump, doubt = None, ""
    if training.stopped == Stopped.INTERRUPTED:
        doubt = "interrupted"
    elif excess(solution) <= 1:
        # Estimated errors are not valid beyond a discontinuity of H, nor across a pulse.
        jump = first_jump(solution, solution.scan_times, unresolved(solution))
        doubt = "" if jump else hidden_residual(solution)
    return accepted(
        solution,
        state,
        jump=jump,
        doubt=doubt,
        cause="the network could not be made accurate enough",
    )


def _ended_by(solution: Solution, training: Training, method: JointTraining) -> str:
    """Return the rule that ended the training, in brackets; nothing if it is the last iteration."""
    rules = {
        Stopped.TARGET_LOSS: f"target loss {method.target_loss} reached",
        Stopped.TARGET_ELL_MAX: f"target ell_max {method.target_ell_max} reached",
        Stopped.ACCURACY: f"accuracy {method.accuracy} reached",
        Stopped.PATIENCE: f"no lower loss in the last {method.patience} {method.unit}",
        Stopped.TIME_LIMIT: f"time limit of {method.time_limit} s reached",
        Stopped.STALLED: "the optimizer stalled",
    }
    found = [rules[Stopped(training.stopped)]] if training.stopped in rules else []
    if method.accuracy is not None and solution.sigma_min == 0:
        found.append("accuracy is undefined: sigma_min = 0 on this trajectory")
    return f" ({'; '.join(found)})" if found else ""


def _rates_agree(solution: Solution, trial: ModuleTrial) -> bool:
    """Return whether dz^/dt, from which errors are estimated, is the derivative of z^."""
    allowed = 0.1 * solution.largest_error + 1e-8 * np.abs(solution(solution.scan_times)).max()
    return bool((rate_defect(trial, solution.span) <= allowed).all())


def _stages(method: JointTraining, trial: TrialSolution | ModuleTrial) -> Stages:
    # A module of the caller's is trained from its own weights, once.
    if isinstance(method, LevenbergMarquardt) and isinstance(trial, TrialSolution):
        return Stages(method.stages, restart_after=_STALLED_AFTER, restarts=method.restarts)
    return Stages(method.stages)
