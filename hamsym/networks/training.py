"""A trainer for trial solutions of any first-order equation; it knows no Hamiltonian.

Input:  a trial solution t -> (z, dz/dt), an :class:`Objective` made of a residual function, a
        loss and regularisers, a time span, an optimiser (:mod:`hamsym.networks.optimizers`,
        :mod:`hamsym.networks.levenberg_marquardt`) and rules for stopping.
Output: the weights with the lowest loss at fixed points (left in the trial solution), and a
        :class:`Training` that tells how it went.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import FileError
from hamsym.networks.checkpoint import Checkpoint
from hamsym.networks.network import Network
from hamsym.networks.objective import Objective
from hamsym.support.checked_data import require_array, require_counts
from hamsym.support.tensor_files import one_line
from hamsym.support.validation import require_positive, require_whole

__all__ = [
    "Criterion",
    "History",
    "Optimizer",
    "Stages",
    "Stopping",
    "Training",
    "TrainingState",
    "train",
]

#: Methods of solution that train a network.
TRAINING_METHODS = ("adam", "lbfgs", "levenberg-marquardt")
# Products of points and weights below this are no faster on two threads, which cost twice the CPU
# time.
_ONE_THREAD = 4_000_000


@dataclass(frozen=True)
class TrainingState:
    """What a callback is told after each evaluation at the fixed points."""

    iteration: int
    iterations: int
    loss: float
    best_loss: float
    ell_max: float
    seconds: float


@dataclass(frozen=True)
class History:
    """The course of a training.

    Attributes
    ----------
    loss : numpy.ndarray
        Loss at the optimiser's own points, one value per iteration.
    iteration, fixed_loss, ell_max, seconds : numpy.ndarray
        Evaluations at the fixed points: after which iteration, the loss, the largest 2-norm of
        the residual, and the time since the start.
    """

    loss: np.ndarray = field(repr=False)
    iteration: np.ndarray = field(repr=False)
    fixed_loss: np.ndarray = field(repr=False)
    ell_max: np.ndarray = field(repr=False)
    seconds: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class Training:
    """How a training ended; the best weights are in the trial solution.

    Attributes
    ----------
    history : History
    points : int
        Collocation points K.
    iterations : int
        Of the optimiser: epochs of Adam, steps of the others.
    restarts : int
        How often the training began again with new weights.
    best_loss, best_ell_max : float
        At the fixed points, of the weights that were kept.
    stopped : str
        The rule that ended it: "iterations", "target loss", "target ell_max", the name of a
        :class:`Criterion`, "patience", "time limit", "stalled", "diverged" or "interrupted".
    seconds, cpu_seconds : float
        Including those before a resumption.
    """

    history: History
    points: int
    iterations: int
    restarts: int
    best_loss: float
    best_ell_max: float
    stopped: str
    seconds: float
    cpu_seconds: float

    # A network is one smooth function over the whole span.
    edges: ClassVar[None] = None
    origin: ClassVar[float] = 0.0

    @property
    def point_evaluations(self) -> int:
        """Evaluations of the vector field, each at one point."""
        return self.iterations * self.points

    def times(self, span: tuple[float, float], count: int) -> np.ndarray:
        """So many equally spaced times over a span."""
        return np.linspace(*span, count)

    def check(self, trial: Any, method: str) -> None:
        """Raise ValueError if this is not the record of a training by a method."""
        if method not in TRAINING_METHODS:
            raise ValueError(f"method '{method}' does not train")
        history = self.history
        checks = len(history.iteration)
        # A loss that was not finite is part of the record, also of a training that began again.
        for name, dtype, count in (
            ("loss", np.float64, self.iterations),
            ("iteration", np.int64, checks),
            ("fixed_loss", np.float64, checks),
            ("ell_max", np.float64, checks),
            ("seconds", np.float64, checks),
        ):
            require_array(name, getattr(history, name), (count,), dtype, finite=False)
        require_counts(self)


@dataclass(frozen=True)
class Criterion:
    """A rule for stopping that looks at the trial solution; asked when the loss has quartered."""

    name: str
    value: float
    holds: Callable[[torch.nn.Module], bool]


@dataclass(frozen=True)
class Stopping:
    """When a training ends: at the first of these.

    Attributes
    ----------
    iterations : int
    target_loss : float, optional
        The loss at the fixed points is at most this.
    target_ell_max : float, optional
        The largest residual at the fixed points is at most this.
    patience : int, optional
        So many iterations have not improved the loss at the fixed points.
    time_limit : float, optional
        So many seconds have passed.
    criteria : tuple of Criterion
    """

    iterations: int
    target_loss: float | None = None
    target_ell_max: float | None = None
    patience: int | None = None
    time_limit: float | None = None
    criteria: tuple[Criterion, ...] = ()

    def __post_init__(self) -> None:
        require_whole("iterations", self.iterations, 1)
        if self.patience is not None:
            require_whole("patience", self.patience, 1)
        for name in ("target_loss", "target_ell_max", "time_limit"):
            if getattr(self, name) is not None:
                require_positive(name, getattr(self, name))


@dataclass(frozen=True)
class Stages:
    """Sequential training: first a short span, then longer ones, the weights carried over.

    Attributes
    ----------
    count : int
        The span of stage k is the k-th part of count.
    residual : float
        A stage ends when the root mean square of the residual is below this part of that of
        dz/dt, or when its share of the iterations is used up.
    restart_after : int, optional
        Instead, after so many iterations in a stage without that (or, in the last one, with a
        residual above 1e-4), new weights are drawn and the first stage begins again.
    restarts : int
        Largest number of such restarts.
    """

    count: int = 1
    residual: float = 0.03
    restart_after: int | None = None
    restarts: int = 10

    def __post_init__(self) -> None:
        require_whole("stages", self.count, 1)
        require_whole("restarts", self.restarts, 0)


class Optimizer(Protocol):
    """What changes the weights, one iteration at a time."""

    points: int
    check_every: int  # iterations between evaluations at the fixed points

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        """Set to work on these; to be called once, before anything else."""

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Points at which weights are judged, and which are never trained on."""

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        """One iteration on a span that is this share of the whole, done the part of all iterations.

        Returns the loss at its points before the step, and the mean square of dz/dt there.
        """

    @property
    def stalled(self) -> bool:
        """Whether further iterations are of no use."""

    def reset(self) -> None:
        """Forget what was learned about weights that are no more."""

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """All that the next iterations depend on, as tensors and as values for JSON."""

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Take over such a state."""


def train(
    trial: torch.nn.Module,
    objective: Objective,
    span: tuple[float, float],
    optimizer: Optimizer,
    stopping: Stopping,
    *,
    generator: torch.Generator,
    stages: Stages | None = None,
    callbacks: Sequence[Callable[[TrainingState], None]] = (),
    checkpoint: Checkpoint | None = None,
) -> Training:
    """Minimise an objective over a time span.

    The weights that are kept are the best at fixed points, which are never trained on.

    Parameters
    ----------
    trial : torch.nn.Module
        t of shape (K,) -> (z, dz/dt), each (K, dim).
    objective : Objective
    span : (float, float)
        Start and end time; the end may be the smaller.
    optimizer : Optimizer
        A new one.
    stopping : Stopping
    generator : torch.Generator
        Source of all that is random.
    stages : Stages, optional
        By default the whole span from the beginning.
    callbacks : sequence of callable
        Each is given a :class:`TrainingState` now and then.
    checkpoint : Checkpoint, optional

    Returns
    -------
    Training

    Raises
    ------
    FileError
        If the checkpoint cannot be read or written, or is of another training.
    """
    optimizer.bind(trial, objective, generator)
    run = _Run(trial, objective, span, optimizer, stopping, stages or Stages(), generator)
    if checkpoint is not None:
        saved = checkpoint.read()
        if saved is None:
            run.write(checkpoint)  # better to learn now than after hours that it cannot be written
        else:
            try:
                run.restore(*saved)
            except (
                *(ArithmeticError, AttributeError, LookupError, RuntimeError),
                *(TypeError, ValueError),
            ) as error:
                raise FileError(
                    f"'{checkpoint.path}' holds a training that makes no sense: {one_line(error)}"
                ) from None
    return run.through(callbacks, checkpoint)


class _Run:
    """The state of a training, which a checkpoint holds completely."""

    def __init__(
        self,
        trial: torch.nn.Module,
        objective: Objective,
        span: tuple[float, float],
        optimizer: Optimizer,
        stopping: Stopping,
        stages: Stages,
        generator: torch.Generator,
    ) -> None:
        self.trial, self.objective, self.span = trial, objective, span
        self.optimizer, self.stopping, self.stages = optimizer, stopping, stages
        self.generator = generator
        self.parameters = list(trial.parameters())
        self.fixed = optimizer.fixed_points(span)
        self.best = self._weights()
        self.stopped: str | None = None
        self.losses: list[float] = []
        self.checks: list[tuple[int, float, float, float]] = []
        # Numbers that change on the way; all of them go into a checkpoint.
        self.counts = {"iteration": 0, "stage": 1, "in_stage": 0, "restarts": 0, "improved": 0}
        self.levels = {
            "best_loss": math.inf,
            "best_ell_max": math.inf,
            "lowest": math.inf,  # at the optimiser's points
            "judged": math.inf,  # best loss when the criteria were last asked
            "seconds": 0.0,
            "cpu_seconds": 0.0,
        }

    def through(
        self, callbacks: Sequence[Callable[[TrainingState], None]], checkpoint: Checkpoint | None
    ) -> Training:
        threads = torch.get_num_threads()
        size = len(self.fixed) * sum(parameter.numel() for parameter in self.parameters)
        self.began = time.perf_counter() - self.levels["seconds"]
        self.cpu_began = time.process_time() - self.levels["cpu_seconds"]
        written = time.perf_counter()
        # A run that had ended does not take one step more, unless its rules are others now.
        stopped = self.stopped if self.stopped not in (None, "iterations", "time limit") else None
        try:
            if size < _ONE_THREAD:
                torch.set_num_threads(1)
            while stopped is None:
                if self.counts["iteration"] >= self.stopping.iterations:
                    stopped = "iterations"
                    break
                stopped = self._iterate(callbacks)
                if checkpoint is not None and time.perf_counter() - written >= checkpoint.every:
                    self._clock()
                    self.write(checkpoint)
                    written = time.perf_counter()
        except KeyboardInterrupt:
            # The iteration was left halfway: what was written before it is what can be resumed.
            stopped = "interrupted"
        finally:
            torch.set_num_threads(threads)
        self._clock()
        if checkpoint is not None and stopped != "interrupted":
            self.stopped = stopped
            self.write(checkpoint)
        self._put(self.best)
        columns = np.array(self.checks, dtype=float).reshape(-1, 4).T
        return Training(
            history=History(np.array(self.losses), columns[0].astype(int), *columns[1:]),
            points=self.optimizer.points,
            iterations=len(self.losses),
            restarts=self.counts["restarts"],
            best_loss=self.levels["best_loss"],
            best_ell_max=self.levels["best_ell_max"],
            stopped=stopped or "interrupted",
            seconds=self.levels["seconds"],
            cpu_seconds=self.levels["cpu_seconds"],
        )

    def _iterate(self, callbacks: Sequence[Callable[[TrainingState], None]]) -> str | None:
        """One iteration and what follows from it; the rule that ends the training, if one does."""
        counts, levels, total = self.counts, self.levels, self.stopping.iterations
        start, end = self.span
        share = counts["stage"] / self.stages.count
        # Stages share what is left of the iterations.
        left = (total - counts["iteration"] + counts["in_stage"]) / (
            self.stages.count - counts["stage"] + 1
        )
        reached = end if share == 1 else start + share * (end - start)
        loss, motion = self.optimizer.iterate((start, reached), share, counts["iteration"] / total)
        self.losses.append(loss)
        counts["iteration"] += 1
        counts["in_stage"] += 1
        if not math.isfinite(loss):
            return self._restart("diverged")
        record = loss < 0.9 * levels["lowest"]
        levels["lowest"] = min(levels["lowest"], loss)
        if share < 1:
            passed = loss <= self.stages.residual**2 * motion
            patience = self.stages.restart_after
            if passed or (patience is None and counts["in_stage"] >= left):
                counts["stage"] += 1
                counts["in_stage"] = 0
                levels["lowest"] = math.inf
            elif self.optimizer.stalled or (patience and counts["in_stage"] >= patience):
                return self._restart("stalled")
        last = counts["iteration"] == total
        stopped = None
        if (share == 1 and record) or counts["iteration"] % self.optimizer.check_every == 0 or last:
            self._check(callbacks)
            stopped = self._verdict()
            poor = share == 1 and levels["best_loss"] > 1e-8 * motion
            if (
                stopped is None
                and poor
                and counts["in_stage"] >= (self.stages.restart_after or math.inf)
            ):
                return self._restart("stalled")
        if stopped is None and share == 1 and self.optimizer.stalled:
            poor = levels["best_loss"] > 1e-8 * motion
            return self._restart("stalled") if poor else "stalled"
        return stopped

    def _check(self, callbacks: Sequence[Callable[[TrainingState], None]]) -> None:
        counts, levels = self.counts, self.levels
        with torch.no_grad():
            z, dz = self.trial(self.fixed)
            loss = float(self.objective(self.fixed, z, dz))
            residual = self.objective.residual(self.fixed, z, dz)
            ell_max = float(residual.square().sum(-1).max().sqrt())
        if loss < levels["best_loss"]:
            levels["best_loss"], levels["best_ell_max"] = loss, ell_max
            counts["improved"] = counts["iteration"]
            self.best = self._weights()
        self._clock()
        self.checks.append((counts["iteration"], loss, ell_max, levels["seconds"]))
        state = TrainingState(
            counts["iteration"],
            self.stopping.iterations,
            loss,
            levels["best_loss"],
            ell_max,
            levels["seconds"],
        )
        for callback in callbacks:
            callback(state)

    def _verdict(self) -> str | None:
        """The first rule that holds for the best weights, if one does."""
        rules, counts, levels = self.stopping, self.counts, self.levels
        if rules.target_loss is not None and levels["best_loss"] <= rules.target_loss:
            return "target loss"
        if rules.target_ell_max is not None and levels["best_ell_max"] <= rules.target_ell_max:
            return "target ell_max"
        if rules.criteria and levels["best_loss"] <= levels["judged"] / 4:
            levels["judged"] = levels["best_loss"]
            present = self._weights()
            self._put(self.best)
            held = [rule.name for rule in rules.criteria if rule.holds(self.trial)]
            self._put(present)
            if held:
                return held[0]
        if rules.time_limit is not None and levels["seconds"] >= rules.time_limit:
            return "time limit"
        waited = min(counts["iteration"] - counts["improved"], counts["in_stage"])
        last_stage = counts["stage"] == self.stages.count
        if rules.patience is not None and last_stage and waited >= rules.patience:
            return "patience"
        return None

    def _restart(self, reason: str) -> str | None:
        """Begin again with new weights, or end for this reason where that is not wanted."""
        if self.stages.restart_after is None or self.counts["restarts"] >= self.stages.restarts:
            return reason
        for module in self.trial.modules():
            if isinstance(module, Network):
                module.draw(self.generator)
        self.optimizer.reset()
        self.counts["restarts"] += 1
        self.counts["stage"], self.counts["in_stage"] = 1, 0
        self.levels["lowest"] = math.inf
        return None

    def _rules(self) -> list[Any]:
        rules = self.stopping
        criteria = [[rule.name, rule.value] for rule in rules.criteria]
        return [rules.target_loss, rules.target_ell_max, rules.patience, criteria]

    def _weights(self) -> list[Tensor]:
        return [parameter.detach().clone() for parameter in self.parameters]

    @torch.no_grad()
    def _put(self, weights: list[Tensor]) -> None:
        for parameter, value in zip(self.parameters, weights, strict=True):
            parameter.copy_(value)

    def _clock(self) -> None:
        self.levels["seconds"] = time.perf_counter() - self.began
        self.levels["cpu_seconds"] = time.process_time() - self.cpu_began

    def write(self, checkpoint: Checkpoint) -> None:
        """Put the whole state into a file."""
        tensors = {
            "losses": torch.tensor(self.losses, dtype=torch.float64),
            "checks": torch.tensor(self.checks, dtype=torch.float64).reshape(-1, 4),
            "generator": self.generator.get_state(),
        }
        for position, (now, best) in enumerate(zip(self._weights(), self.best, strict=True)):
            tensors[f"weights.{position}"], tensors[f"best.{position}"] = now, best
        own, values = self.optimizer.state()
        tensors |= {f"optimizer.{name}": tensor.clone() for name, tensor in own.items()}
        checkpoint.write(
            tensors,
            {
                "counts": self.counts,
                "levels": self.levels,
                "optimizer": values,
                "stopped": self.stopped,
                "rules": self._rules(),
            },
        )

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Go on from what a checkpoint holds."""
        self._require_own(tensors, values)
        count = len(self.parameters)
        self._put([tensors[f"weights.{position}"] for position in range(count)])
        self.best = [tensors[f"best.{position}"] for position in range(count)]
        self.losses = tensors["losses"].tolist()
        self.checks = [(int(row[0]), *row[1:]) for row in tensors["checks"].tolist()]
        self.generator.set_state(tensors["generator"])
        self.counts, self.levels = values["counts"], values["levels"]
        self.stopped = values["stopped"]
        if values["rules"] != self._rules():
            # The best weights so far may do for rules that have changed.
            self.levels["judged"] = math.inf
            self.stopped = self._verdict()
        prefix = "optimizer."
        own = {
            name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)
        }
        self.optimizer.restore(own, values["optimizer"])

    def _require_own(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Refuse what :meth:`write` does not write for this training."""
        if {*values} != {"settings", "counts", "levels", "optimizer", "stopped", "rules"}:
            raise ValueError("its values are not those of a training")
        for name, kind in (("counts", int), ("levels", float)):
            own, theirs = getattr(self, name), values[name]
            if theirs.keys() != own.keys() or not all(
                type(value) is kind and value >= 0 for value in theirs.values()
            ):
                raise ValueError(f"its {name} are not those of a training")
        if not isinstance(values["stopped"], (str, type(None))):
            raise ValueError("its end has no name")
        if not isinstance(values["optimizer"], dict):
            raise ValueError("its optimizer is none")
        counts, losses, checks = values["counts"], tensors["losses"], tensors["checks"]
        if not 1 <= counts["stage"] <= self.stages.count or counts["iteration"] != len(losses):
            raise ValueError("its iterations do not fit together")
        wanted = {
            "losses": torch.empty(len(losses), dtype=torch.float64),
            "checks": torch.empty(len(checks), 4, dtype=torch.float64),
            "generator": self.generator.get_state(),
        }
        for position, parameter in enumerate(self.parameters):
            wanted[f"weights.{position}"] = wanted[f"best.{position}"] = parameter
        found = {name: t for name, t in tensors.items() if not name.startswith("optimizer.")}
        if found.keys() != wanted.keys():
            raise ValueError("it has other weights")
        for name, like in wanted.items():
            if found[name].shape != like.shape or found[name].dtype != like.dtype:
                raise ValueError(f"its {name} have another shape or type")
            if name.startswith("best.") and not bool(torch.isfinite(found[name]).all()):
                raise ValueError(f"its {name} are not finite")
