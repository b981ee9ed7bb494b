"""Trial solutions in ball arithmetic: z^(t) as the real function that its float64 numbers define.

The enclosed function is that of a real t given by the formulas below, with every stored number
(float64 or float32) as an exact binary fraction, not its rounded evaluation:

* a deep network (:class:`~hamsym.networks.trial.TrialSolution`), z^(t) = z0 + f(s) N(s) with
  s = (t - t0)/tau, f(s) = 1 - exp(-s) or s, and N the layers W h + b with sin, tanh or
  1/(1 + exp(-a)) between them; the numbers are z0, t0, tau and all W and b;
* a chain of networks (:class:`~hamsym.networks.chain.Chain`): on each closed window [t_a, t_b] the
  deep network of its piece, with the edges t_a, t_b as further numbers;
* features (:class:`~hamsym.random_features.trial.FeatureTrial`), on each closed window [t_a, t_b]

      z^(t) = z_a + (1 - exp(-s)) sum_l T_l(2 s - 1) sum_m S_lm C_m,   s = (t - t_a)/(t_b - t_a),

  with T_l the Chebyshev polynomials; the numbers are the edges t_a, t_b, the states z_a, the series
  S and the readouts C. The length t_b - t_a is the exact difference of two floats. At a joint the
  values of two windows differ by round-off; both are enclosed.

Everything is in elapsed time, t = t_start + sigma s with sigma = +-1, as in
:mod:`hamsym.proof.taylor`.
"""

from __future__ import annotations

import sys
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.errors import CertificationError
from hamsym.proof.feature_trial import feature_segments, features_fit
from hamsym.proof.segments import Segment
from hamsym.random_features.trial import FeatureTrial

__all__ = ["require_exact", "segments"]


def require_exact(trial: Any, dim: int) -> None:
    """Require that all numbers of a trial solution are real and finite, in arrays that fit.

    Raises
    ------
    CertificationError
        Naming the first array or number that is not valid.
    """
    if not isinstance(trial, FeatureTrial) and not _is_network(trial):
        raise CertificationError(
            f"the trial solution is a {type(trial).__name__}, which has no enclosure; solve by "
            "'features', or with a network of hamsym"
        )
    for name, array in trial.arrays().items():
        if array.dtype not in (np.float64, np.float32):
            raise CertificationError(
                f"'{name}' of the solution has type {array.dtype}, not float64 or float32; "
                "solve again"
            )
        if not np.isfinite(array).all():
            raise CertificationError(f"'{name}' of the solution is not finite; solve again")
    fits = features_fit if isinstance(trial, FeatureTrial) else _of_networks().networks_fit
    if not fits(trial, dim):
        raise CertificationError("the arrays of the solution do not fit together; solve again")


def segments(trial: Any, span: tuple[float, float]) -> list[Segment]:
    """The smooth parts of a trial solution over a span, in its direction.

    Raises
    ------
    CertificationError
        If an activation has no enclosure, or the windows do not cover the span.
    """
    start, end = (Fraction(float(time)) for time in span)
    direction = 1 if end > start else -1
    pieces = (
        feature_segments if isinstance(trial, FeatureTrial) else _of_networks().networks_segments
    )
    return pieces(trial, start, abs(end - start), direction)


def _is_network(trial: Any) -> bool:
    # Only where torch is imported already can there be one.
    modules = (("hamsym.networks.trial", "TrialSolution"), ("hamsym.networks.chain", "Chain"))
    kinds = [getattr(sys.modules[name], kind) for name, kind in modules if name in sys.modules]
    return isinstance(trial, tuple(kinds))


def _of_networks() -> Any:
    from hamsym.proof import network_trial  # needs torch

    return network_trial
