"""Chaos indicators of one trajectory: MEGNO, SALI and GALI.

Input:  a Hamiltonian, an initial state, a time span.
Output: the indicators over time, with an interpretation.

With g = log(|v(t)|/|v(0)|) of a tangent vector v and the time t since the start,

    Y(t) = 2/t * integral of s g'(s) ds = 2 (g(t) - G(t)/t),  G = integral of g.

After this integration by parts the quadrature error of an oscillation of g does not accumulate.
GALI_k is the volume of the parallelepiped of k unit vectors, the product of the singular values of
the matrix of these. In the columns of an orthogonal Q, by repeated QR decompositions, the vectors
are an upper triangular matrix C, whose columns have length 1 as well: GALI_k is the product of the
first k diagonal entries of C. Their logarithms are summed, since the vectors themselves agree to
round-off where GALI_2 falls below 1e-16. With the angle a of two vectors GALI_2 = sin a and
SALI = 2 sin(a/2), where a is at most a right angle.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hamsym.dynamics.monodromy import reject_doubled, tangent_stepper
from hamsym.dynamics.tangent_steps import (
    APART,
    KEPT,
    LOST,
    PARALLEL,
    STEPS_PER_RADIAN,
    TangentSteps,
    first_vectors,
    growth_limit,
    orthonormal,
)
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.table import usual_method
from hamsym.problems.problem import checked_span
from hamsym.support.progress import advance_in_blocks
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import require_whole

_SAMPLE = 2 / STEPS_PER_RADIAN  # radians of the fastest linear motion between two samples
# Bounds of the interpretation. MEGNO tends to 2 on a torus and grows without limit in chaos; 1e-8
# is the usual threshold of SALI.
_FROZEN, _NEAR_TWO, _ALIGNED = 0.5, (1.5, 2.5), 1e-8


@suggest_attributes
@dataclass(frozen=True)
class ChaosIndicators(Drawn, Shown):
    """MEGNO, SALI and GALI over time, and the settings of their computation.

    ``plot()`` draws MEGNO with its mean, and SALI, over time, and with more than two tangent
    vectors GALI of all orders; ``plot("megno")``, ``plot("sali")`` and ``plot("gali")`` draw one of
    these panels.

    Attributes
    ----------
    t : numpy.ndarray
        Times of the history, shape (n,).
    megno : numpy.ndarray
        Y(t), twice the average of s d log|v|/ds over the time since the start, shape (n,). No unit.
    mean_megno : numpy.ndarray
        Average of Y over the time since the start, shape (n,): tends to 2 on quasi-periodic
        motion, to 0 on a stable isochronous one (harmonic oscillator), and grows like lambda t/2
        on chaotic motion with the largest exponent lambda.
    gali : numpy.ndarray
        Generalized alignment indices of the orders 2, 3, ..., the columns: the volume of the
        parallelepiped of the first k tangent vectors of length 1, from 0 to 1, shape
        (n, vectors - 1). In chaos GALI_k falls like exp(-(k lambda_1 - lambda_1 - ... - lambda_k)
        t), also below round-off; 0 means less than 1e-307. On a torus of dimension s it keeps its
        size for k up to s, and with d degrees of freedom falls like t^(s - k) up to k = 2 d - s and
        like t^(2 (d - k)) above.
    H : Hamiltonian
    z0 : numpy.ndarray
        Initial state, shape (dim,).
    span : (float, float)
        The times that were asked for; the history ends early where the run failed.
    energy_error : float
        Largest change of H, nan if H depends on time or forces act.
    method : str
    dt : float
    seconds : float
    success : bool
        Whether the trajectory reached the end and kept H as for
        :class:`hamsym.LyapunovExponents`; independent of the verdict on chaos.
    message : str
    """

    t: np.ndarray = field(repr=False)
    megno: np.ndarray = field(repr=False)
    mean_megno: np.ndarray = field(repr=False)
    gali: np.ndarray = field(repr=False)
    H: Hamiltonian = field(repr=False, compare=False)
    z0: np.ndarray = field(repr=False)
    span: tuple[float, float]
    energy_error: float
    method: str
    dt: float
    seconds: float
    success: bool
    message: str

    def __repr__(self) -> str:
        return (
            f"ChaosIndicators({self.H.formulas!r}: mean MEGNO {self.mean_megno[-1]:.4g}, SALI "
            f"{self.sali[-1]:.2g} after t = {self.t[-1]:.6g}, success={self.success})"
        )

    @property
    def sali(self) -> np.ndarray:
        """Smaller alignment index min(|v + w|, |v - w|) of the first two tangent vectors.

        From 0 to 1.414, shape (n,). It follows from GALI_2 and falls like it: in chaos
        exponentially; on a torus of two or more dimensions it keeps its size; with one degree of
        freedom it falls like a power of t.
        """
        return np.asarray(2 * np.sin(np.arcsin(np.minimum(self.gali[:, 0], 1.0)) / 2))

    @property
    def is_integrable(self) -> bool:
        """Whether H has one degree of freedom and no explicit time, which excludes chaos."""
        return self.H.dof == 1 and self.H.time is None

    @cached_property
    def slope(self) -> float:
        """Twice the slope of the mean MEGNO over the last four fifths of time, per unit of time.

        An estimate of the largest Lyapunov exponent (Cincotta & Simo 2000), about 0 on regular
        motion; nan with less than ten points.
        """
        elapsed = np.abs(self.t - self.span[0])
        late = elapsed >= 0.2 * elapsed[-1]
        if late.sum() < 10:
            return float("nan")
        # Points are dense at early times: equal weight for equal time.
        weights = np.sqrt(np.gradient(elapsed[late]))
        return 2 * float(np.polyfit(elapsed[late], self.mean_megno[late], 1, w=weights)[0])

    @property
    def statement(self) -> str:
        """Interpretation of the indicators, with the limits of a finite time."""
        end, mean, sali = abs(self.t[-1] - self.span[0]), self.mean_megno[-1], self.sali[-1]
        begin = f"After a time of {end:.6g} the mean MEGNO is {mean:.3g} and SALI is {sali:.2g}"
        # A mean that grows in proportion to t is the exponent times t/2.
        grows = mean > 2 * _NEAR_TWO[1] and 0.5 <= self.slope * end / (2 * mean) <= 2
        if _NEAR_TWO[0] <= mean <= _NEAR_TWO[1]:
            verdict = (
                "MEGNO tends to 2 on a quasi-periodic trajectory. Up to this time the trajectory "
                "is indistinguishable from a regular one; chaos weaker than about "
                f"{2 * _NEAR_TWO[1] / end:.1g}, or setting in later, is possible."
            )
        elif abs(mean) < _FROZEN:
            verdict = (
                "MEGNO tends to 0 on a stable trajectory whose neighbours have its frequencies, as "
                "in a harmonic oscillator; it is also near 0 at first, so a longer span may differ."
            )
        elif grows and self.is_integrable:
            verdict = (
                f"MEGNO grows in proportion to time, by an exponent of {self.slope:.3g}. With one "
                "degree of freedom and no explicit time this is not chaos."
            )
        elif grows and sali < _ALIGNED:
            verdict = (
                f"MEGNO grows in proportion to time, by an exponent of {self.slope:.3g}, and the "
                "tangent vectors are parallel. Both indicate chaos over this time, if the motion "
                "is bounded and recurs; the trajectory may still stick to a regular region later, "
                "and nothing is proved."
            )
        else:
            verdict = "This is inconclusive; use a longer span."
        if not self.success:
            verdict = f"{verdict} However, the run failed: {self.message}."
        return f"{begin}. {verdict}"


@checked_keywords
def chaos_indicators(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    *,
    method: str | None = None,
    steps: int | None = None,
    dt: float | None = None,
    vectors: int = 2,
    seed: int = 0,
    progress: bool | None = None,
) -> ChaosIndicators:
    """Compute MEGNO, SALI and GALI of one trajectory over time.

    MEGNO is the mean exponential growth of nearby orbits (Cincotta & Simo 2000, Astron. Astrophys.
    Suppl. 147, 205), SALI the smaller alignment index (Skokos 2001, J. Phys. A 34, 10029), GALI the
    generalized ones (Skokos, Bountis & Antonopoulos 2007, Physica D 231, 30). They separate regular
    from chaotic motion earlier than a Lyapunov exponent does. Tangent vectors, orthonormal at the
    start, are moved by the derivative of the steps; MEGNO is that of the first, SALI that of two.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : sequence or mapping
        One initial state.
    span : (float, float)
    method : str, optional
        A fixed-step method, not ``tao2`` or ``tao4``; by default ``blanes_moan6`` for a separable
        H, otherwise ``gauss6``.
    steps : int, optional
        Number of steps.
    dt : float, optional
        Largest step, in place of ``steps``. By default a fifth of a radian of the fastest linear
        motion at the beginning of the trajectory.
    vectors : int
        Number of tangent vectors, from 2 to the number of components: the highest order of GALI.
    seed : int
        Seed of the first tangent vectors.
    progress : bool, optional
        Show progress; by default on a terminal, after a second.

    Returns
    -------
    ChaosIndicators
        With an interpretation as ``statement``. After a failure or Ctrl-C, the part before it,
        with ``success=False``.

    Raises
    ------
    InputError
        If an option cannot be used, or the first steps fail.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 - x**2/2")  # its exponents are 1 and -1, so Y is about t
    >>> found = chaos_indicators(H, [1e-9, 0.0], (0, 20))
    >>> round(float(found.megno[-1])), round(float(found.mean_megno[-1]))
    (20, 10)
    >>> bool(found.sali[-1] < 1e-16)  # exp(-2 t)
    True
    >>> H = "(p_x**2 + x**2)/2 + p_y**2/2 - y**2/2"  # a centre and a saddle
    >>> found = chaos_indicators(H, [1, 0, 0, 0], (0, 10), vectors=4)
    >>> found.gali.shape[1], bool((np.diff(np.log(found.gali[-1])) < -9).all())  # exp(-t) and less
    (3, True)
    """
    H = Hamiltonian.of(H)
    span = checked_span(span)
    method = usual_method(H) if method is None else method
    require_whole("seed", seed, 0)
    require_whole("vectors", vectors, 2)
    if vectors > H.dim:
        raise InputError(f"vectors={vectors} cannot be used; z has {H.dim} components")
    reject_doubled(H, method)
    state = H.states_from(z0)
    if state.ndim > 1:
        raise InputError(
            f"z0 has the shape {state.shape}; give one start, or compute the exponents of all "
            "with hamsym.lyapunov"
        )
    plan = TangentSteps.choose(H, method, state, span, steps, dt)
    began = time.perf_counter()
    run = _Indicators(plan, state, first_vectors(H.dim, vectors, seed))
    if advance_in_blocks(plan.number, run.block, progress, run.advance):
        run.problem = "interrupted"
    if not run.times:
        raise InputError(f"integration failed at the first steps: {run.problem}")
    times, history = np.concatenate(run.times), np.concatenate(run.history)
    return ChaosIndicators(
        t=times,
        megno=history[:, 0],
        mean_megno=history[:, 1],
        gali=history[:, 2:],
        **plan.outcome(times, np.concatenate(run.path), run.problem, began),
    )


class _Indicators:
    """Sums of the indicators at samples, a block of them at a time.

    At the beginning of a block the tangent vectors are the columns of an orthogonal Q, and the
    deviation vectors have the directions of the columns of Q C.
    """

    def __init__(self, plan: TangentSteps, state: np.ndarray, vectors: np.ndarray) -> None:
        self._plan, self._system = plan, plan.H.compile("numpy")
        self._scales = plan.scales
        self._stepper = tangent_stepper(
            plan.H, plan.method, state, plan.span[0], plan.size, self._scales * vectors
        )
        angle = max(plan.rate * abs(plan.size), 1e-3)
        self._every = max(1, min(int(_SAMPLE / angle * (1 + 1e-9)), plan.number // KEPT))
        samples = -(-plan.number // self._every)
        #: Steps of a block.
        self.block = self._every * max(1, int(growth_limit(2) / (angle * self._every)))
        # Numbers of the samples that are kept.
        self._rows = np.unique(np.geomspace(1, samples, KEPT).astype(int))
        self._directions = np.eye(vectors.shape[1])  # C, with columns of length 1
        self._heights = np.zeros(vectors.shape[1])  # logarithms of its diagonal entries
        self._elapsed = 0.0
        # g and G with their derivatives, Y and its integral with theirs, at the last sample.
        slope = self._slopes(state[None], vectors[None, :, 0], plan.span[0])[0]
        self._growth, self._slope = 0.0, slope
        self._integral, self._total = 0.0, 0.0
        self._megno, self._megno_slope = 0.0, slope
        self.times: list[np.ndarray] = []
        self.history: list[np.ndarray] = []  # columns Y, its mean, GALI_2, ...
        self.path = [state[None]]  # states at the start, and at each of the times
        self.problem = ""

    def advance(self, done: int, count: int) -> bool:
        """Take a block of steps; return False, with ``problem`` set, where that fails."""
        ends = np.append(np.arange(done, done + count, self._every)[1:], done + count)
        dim, number = self._plan.H.dim, len(self._heights)
        states, tangents = np.empty((len(ends), dim)), np.empty((len(ends), dim, number))
        before = done
        for sample, end in enumerate(ends.tolist()):
            states[sample] = self._stepper.step(end - before)[0]
            tangents[sample] = self._stepper.tangents[0] / self._scales
            before = end
        with np.errstate(all="ignore"):  # what is not finite is refused below
            vectors, grown = orthonormal(tangents)
        times = self._plan.span[0] + self._plan.size * ends
        slopes = self._slopes(states, vectors[..., 0], times)
        tests = {
            LOST: np.isfinite(states).all(axis=1),
            APART: np.isfinite(grown).all(axis=1) & (np.ptp(grown, axis=1) <= PARALLEL),
            "the Hessian of H is not finite": np.isfinite(slopes),
        }
        passed = np.array(list(tests.values()))
        good = int(np.argmin(np.append(passed.all(axis=0), False)))
        if good < len(ends):
            self.problem = list(tests)[int(np.argmin(passed[:, good]))]
        if good:
            gali = self._alignment(tangents[:good], vectors[:good], grown[:good])
            growth = self._growth + grown[:good, 0]
            elapsed = abs(self._plan.size) * ends[:good]
            megno, mean = self._averages(elapsed, growth, slopes[:good])
            self._keep(ends[:good], states[:good], np.column_stack((megno, mean, gali)))
        self._stepper.tangents[0] = self._scales * vectors[-1]
        return good == len(ends)

    def _slopes(
        self, states: np.ndarray, vectors: np.ndarray, times: np.ndarray | float
    ) -> np.ndarray:
        """Return the rates of growth of vectors of length 1, per unit of elapsed time."""
        with np.errstate(all="ignore"):
            matrices = self._system.at("jacobian", states, times)
            own = matrices * (self._scales.T / self._scales)
            rates = np.einsum("ni,nij,nj->n", vectors, own, vectors)
        return rates if self._plan.size > 0 else -rates

    def _alignment(
        self, tangents: np.ndarray, vectors: np.ndarray, grown: np.ndarray
    ) -> np.ndarray:
        """Return GALI of all orders at the samples, and keep the directions of the vectors."""
        upper = np.triu(np.einsum("nik,nil->nkl", vectors, tangents), 1)
        places = np.arange(len(self._heights))
        upper[:, places, places] = np.exp(grown)
        moved = upper @ self._directions
        lengths = np.linalg.norm(moved, axis=1)
        heights = self._heights + grown - np.log(lengths)
        self._directions, self._heights = moved[-1] / lengths[-1], heights[-1]
        return np.asarray(np.exp(np.cumsum(heights, axis=1)[:, 1:]))

    def _averages(
        self, elapsed: np.ndarray, growth: np.ndarray, slopes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Y and its mean at the samples, from g and its derivative there."""
        widths = np.diff(elapsed, prepend=self._elapsed)
        pieces = _hermite(widths, self._growth, growth, self._slope, slopes)
        integral = self._integral + np.cumsum(pieces)
        megno = 2 * (growth - integral / elapsed)
        megno_slopes = 2 * (slopes - growth / elapsed + integral / elapsed**2)
        pieces = _hermite(widths, self._megno, megno, self._megno_slope, megno_slopes)
        total = self._total + np.cumsum(pieces)
        self._elapsed, self._growth, self._slope = elapsed[-1], growth[-1], slopes[-1]
        self._integral, self._total = integral[-1], total[-1]
        self._megno, self._megno_slope = megno[-1], megno_slopes[-1]
        return megno, total / elapsed

    def _keep(self, ends: np.ndarray, states: np.ndarray, values: np.ndarray) -> None:
        """Add the samples of a block that belong to the history."""
        last = -(-int(ends[-1]) // self._every)
        first = last - len(ends) + 1
        low, high = np.searchsorted(self._rows, (first, last + 1))
        kept = self._rows[low:high] - first
        if len(kept):
            self.times.append(self._plan.span[0] + self._plan.size * ends[kept])
            self.history.append(values[kept])
            self.path.append(states[kept])


def _hermite(
    widths: np.ndarray, value: float, values: np.ndarray, slope: float, slopes: np.ndarray
) -> np.ndarray:
    """Return the integrals of cubic Hermite interpolants over successive intervals.

    - widths, values, slopes: Width of each interval, and what the function and its derivative are
      at its end.
    - value, slope: At the beginning of the first.
    """
    before, steeper = np.append(value, values[:-1]), np.append(slope, slopes[:-1])
    return widths / 2 * (before + values) + widths**2 / 12 * (steeper - slopes)
