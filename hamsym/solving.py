"""Solution of initial-value problems by one of several methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.conservation import InvariantLike, KnownInvariants
from hamsym.errors import CertificationError, InputError, KeywordError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.table import ALIASES, INTEGRATORS
from hamsym.methods import METHOD, METHODS, SEED
from hamsym.networks.options import CONVERGED
from hamsym.problem import InitialValueProblem
from hamsym.solution.invariant_check import judged_by_invariants
from hamsym.solution.settings import settings_of
from hamsym.solution.solution import Solution
from hamsym.solution.window_error import allowed_errors
from hamsym.suggestions import advice, checked_keywords, did_you_mean, require_known

if TYPE_CHECKING:
    from hamsym.networks.record import TrainingState


@checked_keywords
def solve(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    *,
    method: str = METHOD,
    seed: int = SEED,
    progress: bool | Callable[[TrainingState], None] | None = None,
    prove: bool = False,
    invariants: InvariantLike | Sequence[InvariantLike] = (),
    **options: Any,
) -> Solution:
    """Compute a neural trajectory z^(t) that satisfies Hamilton's equations over a time span.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
        With a value for every parameter.
    z0 : sequence or mapping
        Initial state, in the order of H.z or by name.
    span : (float, float)
        Start and end time; the end may be the earlier one.
    method : {"features", "levenberg-marquardt", "ssbroyden", "lbfgs", "adam"}
        Random sine features marched to a tolerance, or a deep network trained by the optimizer of
        this name ("adam" as in the paper; "ssbroyden" is the self-scaled Broyden method of Urban,
        Stefanou & Pons 2025, whose time per iteration grows with the square of the weights).
    seed : int
        Seed of all random numbers: same seed, same machine, same result.
    progress : bool or callable, optional
        Draw progress on standard error; by default if that is a terminal. Methods that train call
        a callable with a :class:`~hamsym.networks.record.TrainingState` instead.
    prove : bool
        Prove that the error of each component is within the tolerance
        (:meth:`hamsym.Solution.certify` with ``bound``), for methods with a tolerance. ``success``
        then means that it is proven, and ``solution.certificate`` is the proof.
    invariants : sequence of str, sympy.Expr or Invariant
        Functions that H conserves, e.g. from :meth:`hamsym.Hamiltonian.invariants`; that is checked
        first. ``success`` then needs that each of them changes by no more than the allowed errors
        of the components explain, to second order: the tolerance, or for methods without one the
        larger of the estimated errors and ``target_error``, or 1 % of the motion. The changes are
        in ``solution.invariant_drift``.
    **options
        For ``"features"``:

        tol : float, default 1e-9
            Tolerance: |z^_i(t) - z_i(t)| <= atol_i + tol s_i for every component and all t, with
            s_i the largest |z^_i|. For a component that is zero, or below 1e-8 of the size given
            by the terms of its own equation, s_i is that size (:mod:`hamsym.numerics.scales`),
            since smaller values are round-off of these terms. Units of components do not matter.
        atol : float or sequence, default 0
            Absolute tolerance, in the units of the components.
        breakpoints : sequence of float, default ()
            Times at which a window must end, e.g. jumps of a force.
        max_window : float, optional
            Longest window, by default an eighth of the span. Pulses and steps of H are detected
            from the formula, at random times and by the change of H
            (:mod:`hamsym.random_features.window_checks`); reduce it to resolve shorter features.

        For all methods that train a deep network:

        hidden : sequence of int, default (50, 50)
            Neurons of each hidden layer.
        activation : {"sin", "sigmoid", "tanh"}
        envelope : {"exponential", "linear"}
            f(s) = 1 - exp(-s) or f(s) = s, with s = |t - t_start| / tau.
        tau : float
            Unit of time of the network's input, in the units of H; by default the span over
            4 pi, and 1 for ``"adam"``, as in the paper.
        frequency : float, optional
            Weights of the first layer start uniform within +- this, 3 by default; None, the
            default of ``"adam"``, is torch's usual start.
        shared_weights : bool, default True
            One network with dim outputs; otherwise one network for each component.
        points : int or sequence of float, default 200
            Collocation points K; or an increasing list of times in the span, at exactly which the
            loss is trained (``"adam"``: without noise, unless ``noise`` is given). Weights are
            always judged at other points.
        stages : int, default 12, and 1 for ``"adam"``
            Sequential training: number of spans, each longer by an equal part, with the weights
            carried over.
        energy_weight : float, default 0
            Weight lambda of the mean of (H - E0)^2 in the loss (the paper's eq. regLoss).
        invariant_weight : float, default 0
            Weight of the mean squared change of each of the ``invariants`` in the loss.
        regularizers : sequence of Regularizer
            Additional terms of the loss; not for ``"levenberg-marquardt"``.
        target_loss, target_ell_max : float, optional
            Stop, with success, when the loss or the largest residual at fixed points, which are
            not trained on, is at most this.
        target_error : float, optional
            Stop, with success, when the estimated error relative to the motion
            (:attr:`Solution.relative_error`) is at most this.
        accuracy : float, optional
            Stop, with success, when ell_max <= sigma_min * accuracy, as in the paper, with
            sigma_min along the trajectory; never if that is 0, which the message reports.
        patience : int, optional
            Stop after this number of iterations without a lower loss; 200 for
            ``"levenberg-marquardt"``.
        time_limit : float, optional
            Stop after this number of seconds.
        checkpoint : path, optional
            A file that is written every ``checkpoint_every`` (10) seconds and at the end. If it
            exists, the training is resumed from it, to the same bits as without an interruption.
        initial : Solution, optional
            A trained solution with the initial weights: on another span, of another H, or with
            other settings, as in the paper's sequential training. The network and ``tau``, whose
            default depends on the span, should be the same.
        dtype : {"float64", "float32"}
            Precision of the training and of the weights. The solution is evaluated in float64: it
            is the function that the weights define.
        device : str or torch.device, default "cpu"
            Device of the training, e.g. ``"cuda"`` or ``"mps"`` (float32 only). The result is on
            the CPU. Random numbers are drawn there, so that a seed starts alike on every device.
        trial : torch.nn.Module, optional
            A network N of your own in place of hidden, activation, frequency and shared_weights:
            it takes s = |t - t_start| / tau of shape (K, 1), from 0 to span / tau, and returns
            shape (K, dim); z^ = z0 + f(s) N(s) starts exactly at z0. A copy is trained, from the
            module's own weights, with dN/ds in forward mode; the copy is
            ``solution.trial.network``. Restarts call ``reset_parameters`` of its layers; without
            any there are no restarts. Such a solution cannot be saved or certified.

        For ``"levenberg-marquardt"``, which trains a chain of networks to a tolerance, each on a
        window and exact at its start, joined end to start
        (:mod:`hamsym.networks.window_training`):

        tol, atol, breakpoints, max_window
            As for ``"features"``; ``max_window`` is a quarter of the span by default.
        windows : int, optional
            This number of equal windows instead of as many as the motion needs; 1 is one network
            over the whole span. A chain gives the first guess. If ``hidden`` is not given, the last
            layer is as wide as the motion in a window needs.
        train_hidden : bool, default True
            Train the hidden layers where readouts do not suffice; otherwise readouts only.
        hidden, activation, envelope, frequency, time_limit, device
            As above; in float64.
        iterations, restarts
            1,000 and 10, of the joint training of all weights of one network, without elimination
            of readouts and as far as its targets say. Any other option of the methods that train a
            network, e.g. ``target_error``, ``points`` or ``trial``, selects this training.

        For ``"ssbroyden"``, in float64 on the CPU only: ``iterations`` (3,000), and at most 20,000
        weights. For ``"lbfgs"``: ``iterations`` (5,000).

        For ``"adam"``:

        epochs, learning_rate, betas, schedule, noise
            50,000, 8e-3, (0.9, 0.999), "cosine" and three spacings of the points; see
            :class:`~hamsym.networks.optimizers.Adam`.

    Returns
    -------
    Solution
        ``success`` is true if the estimated error, round-off included, is within the tolerance
        (``"features"``, and chains of ``"levenberg-marquardt"``), or if a target was reached or,
        without targets, the estimated error is below 1 % of the motion (other methods that train).
        It is false if the trajectory crosses a discontinuity of H or of its gradient. A march or a
        chain that had to stop spans the time up to there.

    Raises
    ------
    InputError
        If an option, a name, the state or the span is invalid.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> solution = solve(H, [1.0, 0.0], (0, 100), tol=1e-9)
    >>> solution.success, bool(abs(solution(100.0)[0] - np.cos(100.0)) < 1e-9)
    (True, True)
    >>> chain = solve(H, [1.0, 0.0], (0, 20), method="levenberg-marquardt")
    >>> chain.success, bool(abs(chain(20.0)[0] - np.cos(20.0)) < 1e-11)
    (True, True)
    >>> trained = solve(H, [1.0, 0.0], (0, 1), method="adam", epochs=400, points=20)
    >>> trained(0.0)
    array([1., 0.])
    """
    problem = InitialValueProblem.checked(H, z0, span, seed, progress)
    chosen = checked_options(problem.H, method, options)
    known = KnownInvariants(problem.H, invariants)
    if getattr(chosen, "invariant_weight", 0):
        chosen = replace(chosen, invariants=known)
    if not isinstance(prove, bool):
        raise InputError(f"prove={prove!r} is not a choice; give True or False")
    if prove and getattr(chosen, "tol", None) is None:
        raise InputError(
            f"prove=True needs a method with a tolerance, which '{method}' has not; use "
            "'features', or certify the solution"
        )
    solution = METHODS[method].run(problem, chosen)  # which checks the values of options
    settings = settings_of(
        problem.span,
        problem.seed,
        chosen,
        options,
        prove=prove,
        invariants=known.formulas,
        version=hamsym.__version__,
    )
    solution = replace(solution, settings=settings)
    if known:
        solution = judged_by_invariants(solution, known, _explaining_errors(solution, chosen))
    return proven(solution, chosen.tol, chosen.atol) if prove else solution


def _explaining_errors(solution: Solution, options: Any) -> np.ndarray:
    """Return the errors of components that may explain the drift of an invariant, (dim,)."""
    if solution.error is not None:
        return allowed_errors(options.tol, options.atol, solution.error.scale)
    share = getattr(options, "target_error", None) or CONVERGED
    return np.maximum(solution.largest_error, share * solution.scale)


def proven(solution: Solution, tol: float, atol: float | Sequence[float]) -> Solution:
    """Return the solution with a proof that its errors are within the tolerance.

    Without a proof ``success`` is false and the message gives the reason. A solution that did not
    succeed is returned as it is.
    """
    if not solution.success:
        return solution
    if solution.error is None:
        reason = "one network that was trained jointly has no tolerance; certify it"
        return solution.judged(False, f"{solution.message}; not proven: {reason}")
    allowed = allowed_errors(tol, atol, solution.error.scale)
    try:
        certificate = hamsym.certify(solution, progress=False, bound=allowed.tolist())
    except CertificationError as error:
        return solution.judged(False, f"{solution.message}; not proven: {error}")
    message = f"{solution.message}; proven: the error is at most {certificate.bound:.2g} (2-norm)"
    return replace(solution, message=message, certificate=certificate)


def checked_options(H: Hamiltonian, method: str, options: Mapping[str, Any]) -> Any:
    """Return the options of a method as its dataclass.

    Raise InputError if the method or one of its options does not exist.
    """
    if isinstance(method, str) and {method} & {*INTEGRATORS, *ALIASES}:
        raise InputError(
            f"'{method}' is a method of integrate; call hamsym.integrate, or choose one of "
            f"{', '.join(METHODS)}"
        )
    require_known(method, METHODS, "a method")
    names = [field.name for field in fields(METHODS[method].options)]
    for name in options:
        if name not in names:
            if name in H.parameter_names:
                raise InputError(f"'{name}' is a parameter; use H.with_parameters({name}=...)")
            instead = advice(name)
            if instead is not None:
                raise KeywordError(f"'{name}' is not an argument of solve; {instead}")
            others = [
                f"'{other}'"
                for other, entry in METHODS.items()
                if name in [field.name for field in fields(entry.options)]
            ]
            hint = f", but of {', '.join(others)}" if others else did_you_mean(name, names)
            raise KeywordError(
                f"'{name}' is not an option of method {method!r}{hint}; it has {', '.join(names)}"
            )
    return METHODS[method].options(**options)
