"""Options of the methods that train a network; they are checked before torch is imported."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.solution.solution import Solution
from hamsym.support.validation import is_positive, require_positive, require_whole

if TYPE_CHECKING:
    import torch

    from hamsym.networks.objective import Regularizer

__all__ = [
    "AdamOptions",
    "DeepOptions",
    "LBFGSOptions",
    "LevenbergMarquardtOptions",
    "check_options",
    "precision_name",
]

_FREQUENCY = 3.0  # of the first layer at the start, for methods of second order


@dataclass(frozen=True, kw_only=True)
class DeepOptions:
    """What all methods that train a deep network share; see :func:`hamsym.solve`."""

    hidden: Sequence[int] = (50, 50)
    activation: str = "sin"
    envelope: str = "exponential"
    tau: float | None = None
    frequency: float | None = _FREQUENCY
    shared_weights: bool = True
    points: int = 200
    stages: int = 12
    energy_weight: float = 0.0
    regularizers: Sequence[Regularizer] = ()
    target_loss: float | None = None
    target_ell_max: float | None = None
    target_error: float | None = None
    accuracy: float | None = None
    patience: int | None = None
    time_limit: float | None = None
    checkpoint: str | os.PathLike[str] | None = None
    checkpoint_every: float = 10.0
    dtype: str | torch.dtype = "float64"
    initial: Solution | None = None

    method: ClassVar[str]
    unit: ClassVar[str] = "iterations"

    @property
    def total(self) -> int:
        """Largest number of iterations."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class AdamOptions(DeepOptions):
    """Options of the method "adam"; but for the schedule the defaults are those of the paper."""

    epochs: int = 50_000
    learning_rate: float = 8e-3
    betas: tuple[float, float] = (0.9, 0.999)
    schedule: str = "cosine"
    noise: float | None = None
    tau: float | None = 1.0
    frequency: float | None = None
    stages: int = 1

    method = "adam"
    unit = "epochs"

    @property
    def total(self) -> int:
        require_whole("epochs", self.epochs, 1)
        return self.epochs


@dataclass(frozen=True, kw_only=True)
class LBFGSOptions(DeepOptions):
    """Options of the method "lbfgs"."""

    iterations: int = 5_000

    method = "lbfgs"

    @property
    def total(self) -> int:
        return self.iterations


@dataclass(frozen=True, kw_only=True)
class LevenbergMarquardtOptions(DeepOptions):
    """Options of the method "levenberg-marquardt"."""

    iterations: int = 1_000
    patience: int | None = 200
    restarts: int = 10

    method = "levenberg-marquardt"

    @property
    def total(self) -> int:
        return self.iterations


def check_options(H: Hamiltonian, options: DeepOptions) -> None:
    """Raise InputError if an option cannot be used, as far as that needs no network."""
    energy_weight = options.energy_weight
    if options.frequency is not None:
        require_positive("frequency", options.frequency)
    if energy_weight != 0 and not is_positive(energy_weight):
        raise InputError(f"energy_weight={energy_weight!r} cannot be used; give 0 or more")
    if energy_weight and H.time is not None:
        raise InputError(
            f"energy_weight={energy_weight!r} penalises changes of an energy that is not "
            "conserved, because H depends on t; leave it at 0"
        )
    if options.tau is not None and not is_positive(options.tau):
        raise InputError(f"tau={options.tau!r} cannot be used; give a time above 0")
    if precision_name(options.dtype) != "float64" and options.method != "adam":
        raise InputError(f"dtype={options.dtype!r} is too coarse for {options.method}; use float64")


def precision_name(dtype: str | torch.dtype) -> str:
    """Name of a precision, "float32" or "float64".

    Raises
    ------
    InputError
        If it is neither.
    """
    name = str(dtype).removeprefix("torch.")
    if name not in ("float32", "float64"):
        raise InputError(f"dtype={dtype!r} cannot be used; choose float64 or float32")
    return name
