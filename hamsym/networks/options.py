"""Options of the methods that train a network; they are checked before torch is imported."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

from hamsym.errors import InputError
from hamsym.support.option_fields import option
from hamsym.support.validation import is_positive, require_positive, require_whole

if TYPE_CHECKING:
    import numpy as np
    import torch

    from hamsym.conservation import KnownInvariants
    from hamsym.hamiltonian import Hamiltonian
    from hamsym.networks.objective import Regularizer
    from hamsym.solution.solution import Solution

_OF_CHAINS = ("tol", "atol", "breakpoints", "max_window", "windows", "train_hidden")
_OF_BOTH = ("hidden", "activation", "envelope", "frequency", "time_limit", "device")
#: Estimated error, relative to the motion, below which a network without targets has succeeded.
CONVERGED = 0.01
_FREQUENCY = 3.0  # of the first layer at the start, for methods of second order


@dataclass(frozen=True, kw_only=True)
class DeepOptions:
    """Options of all methods that train a network; see :func:`hamsym.solve`."""

    hidden: Sequence[int] = option((50, 50), "Neurons of each hidden layer.", unit="WIDTHS")
    activation: str = option("sin", "Activation function.", choices=("sin", "sigmoid", "tanh"))
    envelope: str = option(
        "exponential", "Envelope that fixes the initial state.", choices=("exponential", "linear")
    )
    tau: float | None = option(
        None, "Unit of time of the network's input.", default_text="span/(4 pi)", unit="TIME"
    )
    frequency: float | None = option(
        _FREQUENCY,
        "Largest initial weight of the first layer.",
        default_text="torch's initialisation",
    )
    shared_weights: bool = option(True, "One network for all components, or one for each.")
    points: int | Sequence[float] | np.ndarray = option(200, "Collocation points K.")
    stages: int = option(12, "Spans of sequential training.")
    energy_weight: float = option(0.0, "Weight of the energy penalty.")
    invariants: KnownInvariants | None = None
    invariant_weight: float = option(0.0, "Weight of the penalty on changes of invariants.")
    regularizers: Sequence[Regularizer] = ()
    target_loss: float | None = option(None, "Stop at this loss.")
    target_ell_max: float | None = option(None, "Stop at this largest residual.")
    target_error: float | None = option(None, "Stop at this estimated error of the motion.")
    accuracy: float | None = option(None, "Stop at this ell_max / sigma_min.")
    patience: int | None = option(None, "Stop after this many iterations without a lower loss.")
    time_limit: float | None = option(None, "Stop after this time.", unit="SECONDS")
    checkpoint: str | os.PathLike[str] | None = option(
        None, "File from which the training is resumed."
    )
    checkpoint_every: float = option(10.0, "Time between two checkpoints.", unit="SECONDS")
    dtype: str | torch.dtype = option(
        "float64", "Precision of the weights.", choices=("float64", "float32")
    )
    initial: Solution | None = option(None, "Saved solution with the initial weights.")
    trial: torch.nn.Module | None = None
    device: str | torch.device = option(
        "cpu", "Device of the training: cpu, cuda, cuda:1, mps.", unit="DEVICE"
    )

    method: ClassVar[str]
    unit: ClassVar[str] = "iterations"

    @property
    def total(self) -> int:
        """Largest number of iterations."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class AdamOptions(DeepOptions):
    """Options of the method "adam"; all defaults but the schedule are those of the paper."""

    epochs: int = option(50_000, "Epochs of training.")
    learning_rate: float = option(8e-3, "Learning rate.")
    betas: tuple[float, float] = option((0.9, 0.999), "Decay rates of the moment estimates.")
    schedule: str = option(
        "cosine", "Schedule of the learning rate.", choices=("cosine", "constant")
    )
    noise: float | None = option(
        None,
        "Standard deviation of the noise of the points.",
        default_text="3 spacings",
        unit="TIME",
    )
    # Other defaults of options that all methods have.
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

    iterations: int = option(5_000, "Largest number of iterations.")

    method = "lbfgs"

    @property
    def total(self) -> int:
        return self.iterations


@dataclass(frozen=True, kw_only=True)
class SelfScaledBroydenOptions(DeepOptions):
    """Options of the method "ssbroyden"."""

    iterations: int = option(3_000, "Largest number of iterations.")

    method = "ssbroyden"

    @property
    def total(self) -> int:
        return self.iterations


@dataclass(frozen=True, kw_only=True)
class LevenbergMarquardtOptions(DeepOptions):
    """Options of the method "levenberg-marquardt".

    Without an option of joint training, a chain of networks is trained to a tolerance.
    """

    tol: float = option(1e-9, "Tolerance, relative to the largest value of each component.")
    atol: float | Sequence[float] = option(
        0.0, "Absolute tolerance, one or one for each component.", unit="NUMBERS"
    )
    breakpoints: Sequence[float] = option((), "Times at which a window ends.", unit="TIMES")
    max_window: float | None = option(None, "Longest window.", default_text="span/4", unit="TIME")
    windows: int | None = option(
        None, "Number of equal windows.", default_text="as the motion needs"
    )
    train_hidden: bool = option(True, "Train the hidden layers, or the readouts only.")
    iterations: int = option(1_000, "Largest number of iterations.")
    restarts: int = option(10, "Largest number of restarts with new weights.")
    patience: int | None = 200

    method = "levenberg-marquardt"

    @property
    def total(self) -> int:
        return self.iterations

    @property
    def joint(self) -> tuple[str, ...]:
        """Options given that belong to the joint training of all weights of one network."""
        return self._given({field.name for field in fields(self)} - {*_OF_BOTH, *_OF_CHAINS})

    @property
    def of_chain(self) -> tuple[str, ...]:
        """Options given that belong to the training of a chain."""
        return self._given({*_OF_CHAINS})

    def _given(self, names: set[str]) -> tuple[str, ...]:
        return tuple(
            field.name
            for field in fields(self)
            if field.name in names and not _same(getattr(self, field.name), field.default)
        )


def _same(value: Any, default: Any) -> bool:
    if isinstance(default, str):  # a type or a device of torch may stand for its name
        return str(value).removeprefix("torch.") == default
    return type(value) is type(default) and bool(value == default)


def check_options(H: Hamiltonian, options: DeepOptions) -> None:
    """Raise InputError if an option is invalid; checks that need a network are left to it."""
    energy_weight = options.energy_weight
    if options.frequency is not None:
        require_positive("frequency", options.frequency)
    if isinstance(options, LevenbergMarquardtOptions) and not isinstance(
        options.train_hidden, bool
    ):
        raise InputError(
            f"train_hidden={options.train_hidden!r} cannot be used; give True or False"
        )
    if isinstance(options, LevenbergMarquardtOptions) and options.joint and options.of_chain:
        raise InputError(
            f"{options.of_chain[0]} belongs to a chain of networks and {options.joint[0]} to the "
            "joint training of one network; leave one of them out"
        )
    if energy_weight != 0 and not is_positive(energy_weight):
        raise InputError(f"energy_weight={energy_weight!r} cannot be used; give 0 or more")
    if energy_weight and not H.conserves_energy:
        cause = "of the forces" if H.forces else "H depends on t"
        raise InputError(
            f"energy_weight={energy_weight!r} penalises changes of an energy that is not "
            f"conserved, because {cause}; leave it at 0"
        )
    if H.forces and getattr(options, "accuracy", None) is not None:
        raise InputError(
            f"accuracy={options.accuracy!r} rests on the paper's bound ell_max/sigma_min, which "
            "needs equations without forces; give target_error"
        )
    if options.invariant_weight != 0 and not is_positive(options.invariant_weight):
        raise InputError(
            f"invariant_weight={options.invariant_weight!r} cannot be used; give 0 or more"
        )
    if options.invariant_weight and not options.invariants:
        raise InputError(
            f"invariant_weight={options.invariant_weight!r} needs invariants; give for example "
            'invariants=["x*p_y - y*p_x"]'
        )
    if options.trial is not None:
        _check_own_network(options)
    if options.tau is not None and not is_positive(options.tau):
        raise InputError(f"tau={options.tau!r} cannot be used; give a time above 0")
    precision = precision_name(options.dtype)
    if options.method == "ssbroyden" and (precision, str(options.device)) != ("float64", "cpu"):
        raise InputError(
            f"dtype={options.dtype!r} and device={options.device!r} cannot be used with "
            "'ssbroyden'; it trains in float64 on the CPU"
        )


def _check_own_network(options: DeepOptions) -> None:
    """Raise InputError if an option has no meaning for a network of the user's own."""
    defaults = {field.name: field.default for field in fields(options)}
    for name in ("hidden", "activation", "frequency", "shared_weights"):
        if getattr(options, name) != defaults[name]:
            raise InputError(
                f"{name} describes a network of hamsym, and trial is one of your own; "
                "leave out one of them"
            )
    if options.checkpoint is not None:
        raise InputError(
            "a checkpoint holds networks of hamsym only, and trial is one of your own; train "
            "without checkpoint, and save solution.trial.network.state_dict() with torch.save"
        )


def precision_name(dtype: str | torch.dtype) -> str:
    """Return the name of a precision, "float32" or "float64".

    Raise InputError if it is neither of them.
    """
    name = str(dtype).removeprefix("torch.")
    if name not in ("float32", "float64"):
        raise InputError(f"dtype={dtype!r} cannot be used; choose float64 or float32")
    return name
