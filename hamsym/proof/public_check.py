"""Comparison of what users evaluate with the function whose error was proven.

A proof reads the numbers that define a function, not the code that evaluates it. Before a
certificate is made, the public object is evaluated at about 50 times, in windows that are spread
over the span, at their joints, at both ends and at random, and compared with models of the function
that was proven. Both may differ by the roundings of the evaluation, which are bounded a priori:
u = 2^-53 times the sizes of all terms that are added, times the number of operations, or n^2 for
Chebyshev polynomials of degree n, plus the rate of change times the rounding of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hamsym.errors import CertificationError

# Roundings of two evaluations are allowed, with products of roundings.
ROOM = 2.0


def require_same(
    what: str,
    names: Sequence[str],
    public: np.ndarray,
    proven: np.ndarray,
    allowed: np.ndarray,
    places: Callable[[int], str],
) -> None:
    """Require that values of a public object are those of the function that was proven.

    - what: The public object.
    - names: Of the components.
    - public: Shape (n, dim).
    - proven, allowed: Values and bounds on the difference, shape (m, n, dim): at a joint that of
      either window.
    - places: The number of a value -> where it is.

    Raises
    ------
    CertificationError
        Naming the first place at which they differ.
    """
    public = np.asarray(public)
    if public.shape != proven.shape[1:] or public.dtype != np.float64:
        raise CertificationError(f"the {what} is not evaluated to states; load it again")
    with np.errstate(all="ignore"):
        differences = np.abs(public - proven)
        same = (differences <= allowed).all(axis=2).any(axis=0)
    if not same.all():
        n = int(np.argmin(same))
        i = int(np.argmax(~(differences[0, n] <= allowed[0, n])))
        raise CertificationError(
            f"the {what} at {places(n)} has {names[i]} = {float(public[n, i])!r}, but what was "
            f"proven is about {float(proven[0, n, i])!r}, more apart than the rounding of its "
            f"evaluation, {allowed[0, n, i]:.2g}; save it and load it again"
        )
