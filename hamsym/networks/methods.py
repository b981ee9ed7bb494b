"""The methods that train networks, with their options; torch is imported when they solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hamsym.errors import InputError
from hamsym.support.method_object import Method, documented, option
from hamsym.support.validation import (
    is_positive,
    require,
    require_positive,
    require_whole,
    require_widths,
)

if TYPE_CHECKING:
    import torch

    from hamsym.networks.objective import Regularizer
    from hamsym.problems.problem import InitialValueProblem
    from hamsym.solution.solution import Solution

_FREQUENCY = 3.0  # of the first layer at the start, for methods of second order
_ENVELOPE = (
    "Envelope that fixes the initial state.",
    'f(s) = 1 - exp(-s) ("exponential") or f(s) = s ("linear"), with s = |t - t_start| / tau.',
)
_TAU = (
    "Unit of time of the network's input.",
    "In the units of H; input s = |t - t_start| / tau.",
)
_FREQUENCIES = (
    "Largest initial weight of the first layer.",
    "Its weights start uniform within +- this; None is torch's usual start.",
)
_STAGES = (
    "Spans of sequential training.",
    "Each is longer by an equal part, with the weights carried over.",
)
_PATIENCE = ("Stop after this many iterations without a lower loss.",)
_ITERATIONS = ("Largest number of iterations.",)
_ACTIVATIONS = ("sin", "sigmoid", "tanh")
_ENVELOPES = ("exponential", "linear")


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class NetworkChain(Method):
    """A chain of networks, each on a window and exact at its start, trained to a tolerance.

    Readouts are solved for by Newton's method, and hidden layers are trained where those do not
    suffice (:mod:`hamsym.networks.window_training`), in float64.

    Examples
    --------
    >>> import hamsym
    >>> chain = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 20), method=hamsym.NetworkChain())
    >>> chain.success, bool(chain.largest_error.max() < 1e-9)
    (True, True)
    """

    name = "network-chain"
    usual_tol = 1e-9

    hidden: Sequence[int] = option((50, 50), "Neurons of each hidden layer.", unit="WIDTHS")
    activation: str = option("sin", "Activation function.", choices=_ACTIVATIONS)
    envelope: str = option("exponential", *_ENVELOPE, choices=_ENVELOPES)
    frequency: float | None = option(_FREQUENCY, *_FREQUENCIES)
    windows: int | None = option(
        None,
        "Number of equal windows.",
        "1 is one network over the whole span; if ``hidden`` is not given, the last layer is as "
        "wide as the motion in a window needs. By default windows are those of a march by "
        ":class:`~hamsym.Features`, divided where a network does not reach the tolerance.",
        default_text="as the motion needs",
    )
    train_hidden: bool = option(True, "Train the hidden layers, or the readouts only.")
    time_limit: float | None = option(None, "Stop after this time.", unit="SECONDS")

    def check(self) -> None:
        """Raise InputError if an option is invalid."""
        _check_shared(self)
        if self.windows is not None:
            require_whole("windows", self.windows, 1, 50_000)

    def solve(self, problem: InitialValueProblem) -> Solution:
        """Solve by training a chain of networks to the tolerance of the problem."""
        from hamsym.networks.chain_method import solve_by_chain

        return solve_by_chain(problem, self)


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class JointTraining(Method):
    """A deep network over the whole span, all weights of which are trained together."""

    usual_tol = 1e-2
    joint = True

    hidden: Sequence[int] = option((50, 50), "Neurons of each hidden layer.", unit="WIDTHS")
    activation: str = option("sin", "Activation function.", choices=_ACTIVATIONS)
    envelope: str = option("exponential", *_ENVELOPE, choices=_ENVELOPES)
    tau: float | None = option(None, *_TAU, default_text="span/(4 pi)", unit="TIME")
    frequency: float | None = option(_FREQUENCY, *_FREQUENCIES)
    shared_weights: bool = option(True, "One network for all components, or one for each.")
    points: int = option(200, "Collocation points K.", "Weights are judged at other points.")
    stages: int = option(12, *_STAGES)
    energy_weight: float = option(
        0.0,
        "Weight of the energy penalty.",
        "The weight lambda of the mean of (H - E0)^2 in the loss (the paper's eq. regLoss).",
    )
    invariant_weight: float = option(
        0.0,
        "Weight of the penalty on changes of invariants.",
        "Of the mean squared change of each of the ``invariants`` of :func:`hamsym.solve`.",
    )
    regularizers: Sequence[Regularizer] = option(
        (), "", "Additional terms of the loss, each a :class:`hamsym.Regularizer`."
    )
    target_loss: float | None = option(None, "Stop at this loss.", "At points not trained on.")
    target_ell_max: float | None = option(
        None, "Stop at this largest residual.", "At points not trained on."
    )
    accuracy: float | None = option(
        None,
        "Stop at this ell_max / sigma_min.",
        "The paper's rule, with sigma_min along the trajectory; never if that is 0, which the "
        "message reports.",
    )
    patience: int | None = option(None, *_PATIENCE)
    time_limit: float | None = option(None, "Stop after this time.", unit="SECONDS")
    dtype: str | torch.dtype = option(
        "float64",
        "Precision of the weights.",
        "The solution is evaluated in float64: it is the function that the weights define.",
        choices=("float64", "float32"),
    )
    initial: Solution | None = option(
        None,
        "Saved solution with the initial weights.",
        "On another span, of another H, or with other settings, as in the paper's sequential "
        "training. The network and ``tau``, whose default depends on the span, should be the same.",
    )
    trial: torch.nn.Module | None = option(
        None,
        "",
        "A network N of your own in place of hidden, activation, frequency and shared_weights: it "
        "takes s = |t - t_start| / tau of shape (K, 1), from 0 to span / tau, and returns shape "
        "(K, dim); z^ = z0 + f(s) N(s) starts exactly at z0. A copy is trained, from the module's "
        "own weights, with dN/ds in forward mode and without restarts; the copy is "
        "``solution.trial.network``. Such a solution cannot be saved or certified.",
    )
    device: str | torch.device = option(
        "cpu",
        "Device of the training: cpu, cuda, cuda:1, mps.",
        "mps needs float32. Results are on the CPU, where random numbers are drawn, so that a seed "
        "starts alike.",
        unit="DEVICE",
    )

    @property
    def total(self) -> int:
        """Largest number of iterations."""
        found: int = getattr(self, self.unit)
        return found

    @property
    def unit(self) -> str:
        """What an iteration is called."""
        return "iterations"

    def __post_init__(self) -> None:
        for name in ("dtype", "device"):
            value = getattr(self, name)
            if type(value).__module__ == "torch":
                object.__setattr__(self, name, str(value).removeprefix("torch."))
        super().__post_init__()

    def check(self) -> None:
        """Raise InputError if an option is invalid; checks that need a network are left to it."""
        _check_shared(self)
        for name in ("energy_weight", "invariant_weight"):
            weight = getattr(self, name)
            require(weight == 0 or is_positive(weight), name, weight, "0 or more")
        for name in ("tau", "target_loss", "target_ell_max", "accuracy"):
            if getattr(self, name) is not None:
                require_positive(name, getattr(self, name))
        require_whole(self.unit, self.total, 1)
        require_whole("points", self.points, 2)
        require_whole("stages", self.stages, 1)
        if self.patience is not None:
            require_whole("patience", self.patience, 1)
        if self.trial is not None:
            self._check_own_network()

    def _check_own_network(self) -> None:
        """Raise InputError if an option has no meaning for a network of the user's own."""
        given = [*self.given]
        for name in ("hidden", "activation", "frequency", "shared_weights"):
            if name in given:
                raise InputError(
                    f"{name} describes a network of hamsym, and trial is one of your own; "
                    "leave out one of them"
                )

    def check_problem(self, problem: InitialValueProblem) -> None:
        """Raise InputError if an option has no meaning for this problem."""
        H = problem.H
        if problem.breakpoints:
            raise InputError(
                f"breakpoints end windows, and '{self.name}' trains one network over the whole "
                "span; use 'features' or 'network-chain'"
            )
        if self.energy_weight and not H.conserves_energy:
            cause = "of the forces" if H.forces else "H depends on t"
            raise InputError(
                f"energy_weight={self.energy_weight!r} penalises changes of an energy that is not "
                f"conserved, because {cause}; leave it at 0"
            )
        if H.forces and self.accuracy is not None:
            raise InputError(
                f"accuracy={self.accuracy!r} rests on the paper's bound ell_max/sigma_min, which "
                "needs equations without forces; give solve a tolerance, tol=..."
            )
        if self.invariant_weight and not problem.invariants:
            raise InputError(
                f"invariant_weight={self.invariant_weight!r} needs invariants; give for example "
                'invariants=["x*p_y - y*p_x"]'
            )

    def solve(self, problem: InitialValueProblem) -> Solution:
        """Solve by training one network, judged by the tolerance of the problem."""
        self.check_problem(problem)
        # torch takes seconds to import, and the method "features" does not need it.
        from hamsym.networks.method import solve_by_training

        return solve_by_training(problem, self)


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class Adam(JointTraining):
    """One network trained by Adam, as in the paper; only the schedule has another default.

    Examples
    --------
    >>> import hamsym
    >>> adam = hamsym.Adam(epochs=400, points=20)
    >>> adam
    Adam(points=20, epochs=400)
    >>> trained = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1), method=adam)
    >>> trained(0.0), trained.evaluations
    (array([1., 0.]), 8000)
    """

    name = "adam"

    tau: float | None = option(1.0, *_TAU, unit="TIME")
    frequency: float | None = option(None, *_FREQUENCIES, default_text="torch's initialisation")
    stages: int = option(1, *_STAGES)
    epochs: int = option(50_000, "Epochs of training.")
    learning_rate: float = option(8e-3, "Learning rate.")
    betas: tuple[float, float] = option((0.9, 0.999), "Decay rates of the moment estimates.")
    schedule: str = option(
        "cosine", "Schedule of the learning rate.", choices=("cosine", "constant")
    )
    noise: float | None = option(
        None,
        "Standard deviation of the noise of the points.",
        "In the units of time; points are moved anew in each epoch and reflected at the ends.",
        default_text="3 spacings",
        unit="TIME",
    )

    @property
    def unit(self) -> str:
        """What an iteration is called."""
        return "epochs"

    def check(self) -> None:
        """Raise InputError if an option is invalid."""
        super().check()
        require_positive("learning_rate", self.learning_rate)
        require(
            self.noise is None or self.noise == 0 or is_positive(self.noise),
            "noise",
            self.noise,
            "0 or more",
        )
        require(
            isinstance(self.betas, tuple)
            and len(self.betas) == 2
            and all(isinstance(beta, (int, float)) and 0 <= beta < 1 for beta in self.betas),
            "betas",
            self.betas,
            "two numbers from 0 to below 1",
        )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LBFGS(JointTraining):
    """One network trained by L-BFGS, with collocation points of its own in each stage."""

    name = "lbfgs"

    iterations: int = option(5_000, *_ITERATIONS)


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class SSBroyden(JointTraining):
    """One network trained by the self-scaled Broyden method of Urban, Stefanou & Pons (2025).

    In float64 on the CPU, with at most 20,000 weights: the time of an iteration grows with the
    square of their number.
    """

    name = "ssbroyden"

    iterations: int = option(3_000, *_ITERATIONS)

    def check(self) -> None:
        """Raise InputError if an option is invalid."""
        super().check()
        if (self.dtype, self.device) != ("float64", "cpu"):
            raise InputError(
                f"dtype={self.dtype!r} and device={self.device!r} cannot be used with "
                "'ssbroyden'; it trains in float64 on the CPU"
            )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class LevenbergMarquardt(JointTraining):
    """One network, all weights of which are trained by the method of Levenberg and Marquardt.

    It restarts with new weights where a stage does not end; there are no ``regularizers``.
    """

    name = "levenberg-marquardt"

    iterations: int = option(1_000, *_ITERATIONS)
    restarts: int = option(10, "Largest number of restarts with new weights.")
    patience: int | None = option(200, *_PATIENCE)

    def check(self) -> None:
        """Raise InputError if an option is invalid."""
        super().check()
        require_whole("restarts", self.restarts, 0)


def _check_shared(method: NetworkChain | JointTraining) -> None:
    require_widths(method.hidden)
    if method.frequency is not None:
        require_positive("frequency", method.frequency)
    if method.time_limit is not None:
        require_positive("time_limit", method.time_limit)
