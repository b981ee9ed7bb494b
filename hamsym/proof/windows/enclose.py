"""Enclosures of true solutions: hamsym.enclose."""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Annotated, Any

import numpy as np

from hamsym.errors import CertificationError, InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.kernel.enclosures import enclosures
from hamsym.numerics.linear_systems import blas_on_one_core
from hamsym.problems.problem import InitialValueProblem
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import number_of
from hamsym.proof.arithmetic.directed import up
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.boxes.wide_sets import SetWindow, WideSet
from hamsym.proof.limits import Deadline, TimeLimitError
from hamsym.proof.windows.equation import equation_of
from hamsym.proof.windows.proven_windows import WindowStepper
from hamsym.proof.windows.public_windows import check_enclosure
from hamsym.proof.windows.window_sets import ErrorSet, Window
from hamsym.solution.times import times_in_span
from hamsym.support.record_fields import UNSAVED, OneOf, Size
from hamsym.support.shown import Drawn, Saved
from hamsym.support.suggestions import checked_keywords, did_you_mean, suggest_attributes
from hamsym.support.validation import require_whole

_WINDOWS = OneOf(window=Window, set=SetWindow)
# Accuracies of the polynomials, relative to the components, and their terms; the cheaper first.
_ACCURACIES = ((2.0**-70, 32), (2.0**-86, 48))


@checked_keywords
def enclose(
    H: HamiltonianLike,
    z0: Sequence[Any] | Mapping[Any, Any] | np.ndarray | Ball,
    span: tuple[float, float],
    *,
    parameters: Mapping[str, Any] | None = None,
    time_limit: float | None = None,
    max_parts: int = 16,
) -> Enclosure:
    """Enclose the exact solution of Hamilton's equations, rigorously.

    The result contains the true state at every time of the span, for every choice of the initial
    state and of the parameters in the balls that were given, and its derivatives by both. Every
    rounding is covered. The page "How the proofs work" of the documentation has the lemmas. Sets
    that become too wide for windows are carried as polynomials in the starts and parameters, in
    parts.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
        Smooth, with a value for every parameter.
    z0 : sequence or mapping
        Initial state, in the order of H.z or by name: numbers, taken as the exact binary fractions
        that they are, or balls: a :class:`hamsym.Ball`, a pair (low, high), or a text such as
        "0.3 +- 1e-6".
    span : (float, float)
        Start and end time, exact; the end may be the earlier one.
    parameters : mapping of name to ball, optional
        Parameters of H that are known up to a radius.
    time_limit : float, optional
        Seconds.
    max_parts : int
        Largest number of parts at once into which a wide set is cut where one polynomial does not
        follow it. Run time grows with the number that is needed.

    Returns
    -------
    Enclosure

    Raises
    ------
    InputError
        If an argument is not valid.
    CertificationError
        If the enclosure ends before the span (with the time), H is not smooth, or the time limit
        is reached.

    Examples
    --------
    >>> import hamsym
    >>> enclosure = hamsym.enclose("p**2/2 + x**2/2", [1, 0], (0, 10))
    >>> state = enclosure(10.0)
    >>> bool(abs(state.mid[0] - np.cos(10.0)) < 1e-15), bool(state.width < 1e-15)
    (True, True)
    >>> pendulum = "p**2/(2*l**2) - g*l*cos(x)"
    >>> H = hamsym.Hamiltonian(pendulum, parameters={"g": 9.81, "l": 1.0})
    >>> enclosure = hamsym.enclose(H, ["1 +- 1e-6", 0], (0, 2), parameters={"g": "9.81 +- 0.001"})
    >>> bool(enclosure(2.0).width < 1e-2)
    True
    """
    require_whole("max_parts", max_parts, 1)
    problem = _Problem.checked(H, z0, span, parameters, time_limit)
    with blas_on_one_core():  # the products of a window are too small for more
        try:
            found = problem.by_windows()
        except TimeLimitError:
            raise
        except CertificationError as failure:
            if not problem.radii.any():
                raise
            found = problem.in_parts(max_parts, failure)
        check_enclosure(found)
    return found


def enclosed(
    H: HamiltonianLike,
    z0: Sequence[Any] | Mapping[Any, Any] | np.ndarray | Ball,
    span: tuple[float, float],
    parameters: Mapping[str, Any] | None,
    time_limit: float | None,
) -> Enclosure:
    """The enclosure of :func:`enclose` on windows, whose evaluation is not checked."""
    return _Problem.checked(H, z0, span, parameters, time_limit).by_windows()


@dataclass(frozen=True)
class _Problem:
    """Checked arguments of :func:`enclose`."""

    H: Hamiltonian
    start: list[Ball]
    balls: dict[str, Ball]
    span: tuple[float, float]
    deadline: Deadline
    began: float

    @classmethod
    def checked(
        cls,
        H: HamiltonianLike,
        z0: Any,
        span: tuple[float, float],
        parameters: Mapping[str, Any] | None,
        time_limit: float | None,
    ) -> _Problem:
        """Check the arguments; raise InputError."""
        H = Hamiltonian.of(H)
        balls = _parameter_balls(H, parameters)
        if balls:
            H = H.with_parameters(**{name: ball.mid for name, ball in balls.items()})
        start = initial_balls(H, z0)
        for ball in (*start, *balls.values()):
            if not math.isfinite(ball.radius):
                raise InputError("a ball has an infinite radius; give a finite one")
        # H must be finite at the start: its derivatives may be so where it is not real.
        problem = InitialValueProblem.checked(H, [ball.mid for ball in start], span)
        began, deadline = time.monotonic(), Deadline.after(time_limit)
        require_float64()
        return cls(H, start, balls, problem.span, deadline, began)

    @property
    def centre(self) -> np.ndarray:
        return np.array([ball.mid for ball in (*self.start, *self.balls.values())])

    @property
    def radii(self) -> np.ndarray:
        return np.array([ball.radius for ball in (*self.start, *self.balls.values())])

    @property
    def _course(self) -> tuple[Fraction, int, Fraction]:
        """Start, direction and length of the span."""
        begin, end = (Fraction(value) for value in self.span)
        return begin, 1 if end > begin else -1, abs(end - begin)

    def by_windows(self) -> Enclosure:
        """Enclose a set that derivatives carry."""
        equation = equation_of(self.H, tuple(self.balls))
        begin, direction, length = self._course
        windows: list[Window | SetWindow] = []
        failure = None
        for accuracy, terms in _ACCURACIES:
            stepper = WindowStepper(
                equation,
                begin,
                direction,
                length,
                self.centre,
                self.radii,
                accuracy,
                self.deadline,
                terms,
            )
            windows.clear()
            try:
                while stepper.elapsed < stepper.total:
                    windows.append(stepper.step(stepper.total))
                break
            except CertificationError as error:
                if self.deadline.exceeded:
                    raise
                failure = error
        else:
            assert failure is not None
            raise failure
        return self._enclosure(windows)

    def in_parts(self, most: int, failure: CertificationError | None = None) -> Enclosure:
        """Enclose a set that polynomials carry, in parts.

        Raise ``failure`` if there are no polynomials for this H.
        """
        names, course, deadline = list(self.balls), self._course, self.deadline
        try:
            stepper = WideSet(self.H, names, *course, self.centre, self.radii, deadline, most)
        except CertificationError as refusal:
            raise failure or refusal from None
        windows: list[Window | SetWindow] = []
        while stepper.elapsed < stepper.total:
            windows.append(stepper.step())
        return self._enclosure(windows)

    def _enclosure(self, windows: Sequence[Window | SetWindow]) -> Enclosure:
        middle, radius = np.split(np.stack([self.centre, self.radii]), [self.H.dim], axis=1)[0]
        seconds = time.monotonic() - self.began
        return Enclosure(
            self.H, Ball(middle, radius), self.span, self.balls, tuple(windows), seconds
        )


def _parameter_balls(H: Hamiltonian, parameters: Any) -> dict[str, Ball]:
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping):
        raise InputError('parameters must be a mapping of names to balls, e.g. {"g": (9.8, 9.82)}')
    for name in parameters:
        if name not in H.parameter_names:
            known = ", ".join(H.parameter_names) or "none"
            hint = did_you_mean(name, H.parameter_names)
            raise InputError(f"H has no parameter '{name}'{hint}; its parameters are: {known}")
    return {str(name): Ball.of(value) for name, value in parameters.items()}


def initial_balls(H: Hamiltonian, z0: Any) -> list[Ball]:
    """The balls of an initial state, as :func:`enclose` takes it."""
    if isinstance(z0, Ball):
        if np.shape(z0.mid) != (H.dim,):
            raise InputError(f"z0 must be a Ball of shape ({H.dim},), not {np.shape(z0.mid)}")
        return [Ball(float(m), float(r)) for m, r in zip(z0.mid, z0.radius, strict=True)]
    if isinstance(z0, Mapping):
        balls = {name: Ball.of(value) for name, value in z0.items()}
        middle = H.state_from({name: ball.mid for name, ball in balls.items()})
        radius = H.state_from({name: ball.radius for name, ball in balls.items()})
        return [Ball(float(m), float(r)) for m, r in zip(middle, radius, strict=True)]
    if isinstance(z0, (str, bytes)):
        raise InputError("z0 must be a sequence of numbers or balls, or a mapping")
    try:
        values = list(z0)
    except TypeError:
        raise InputError(
            "z0 must be a sequence of numbers or balls, or a mapping by name"
        ) from None
    found = [Ball.of(value) for value in values]
    H.state_from([ball.mid for ball in found])
    return found


@suggest_attributes
@dataclass(frozen=True, eq=False, repr=False)
class Enclosure(Drawn, Saved):
    """Balls around the true state at every time of a span, from :func:`hamsym.enclose`.

    ``plot()`` draws the enclosures of up to six components as bands over time, and the widths of
    all; ``plot("x")`` the band of one component, ``plot("width")`` the widths.

    Attributes
    ----------
    H : Hamiltonian
    z0 : Ball
        Of the initial state, shape (dim,).
    span : (float, float)
    parameters : dict of str to Ball
        The parameters that are balls.
    windows : tuple of Window or SetWindow
        The steps of the time; of wide sets, with all parts.
    seconds : float
        Run time.
    """

    H: Hamiltonian
    z0: Ball
    span: tuple[float, float]
    parameters: dict[str, Ball]
    windows: tuple[Annotated[Window | SetWindow, _WINDOWS], ...]
    seconds: Size
    _derivatives: list[tuple[np.ndarray, ErrorSet]] = field(default_factory=list, metadata=UNSAVED)

    def check(self) -> None:
        """Raise ValueError unless its windows follow each other over the span."""
        if np.shape(self.z0.mid) != (self.H.dim,):
            raise ValueError("z0 has another number of components")
        if not {*self.parameters} <= {*self.H.parameter_names}:
            raise ValueError("a parameter is a ball that H does not have")
        columns, place = self.H.dim + len(self.parameters), Fraction(0)
        for window in self.windows:
            if window.start != place or not window.half > 0 or window.columns != columns:
                raise ValueError("its windows do not follow each other")
            if isinstance(window, SetWindow):
                window.check()
            place = window.end
        if place != abs(Fraction(self.span[1]) - Fraction(self.span[0])) or not place:
            raise ValueError("its windows do not end with its span")

    def __repr__(self) -> str:
        start, end = self.span
        return (
            f"Enclosure({self.H.formulas!r}, t from {start:.6g} to {end:.6g}, width at the end "
            f"{self(end).width:.2g})"
        )

    def __call__(self, t: Any) -> Ball:
        """Enclose the true state at times t.

        Parameters
        ----------
        t : float or array

        Returns
        -------
        Ball
            Shape (dim,) for a scalar, else (n, dim).

        Raises
        ------
        InputError
            If a time is outside the span.
        """
        return self._at(t, self._state, (self.H.dim,))

    def derivative(self, t: Any) -> Ball:
        """Enclose dz(t)/dz0 for all initial states and parameters in the balls.

        Returns
        -------
        Ball
            Shape (dim, dim) for a scalar, else (n, dim, dim).
        """
        dim = self.H.dim
        return self._at(
            t, lambda *place: [part[:, :dim] for part in self._slopes(*place)], (dim, dim)
        )

    def parameter_derivative(self, t: Any) -> Ball:
        """Enclose dz(t)/dk for the parameters that are balls, in their order.

        Returns
        -------
        Ball
            Shape (dim, parameters) for a scalar, else (n, dim, parameters).

        Raises
        ------
        InputError
            If no parameter is a ball, or a time is outside the span.
        """
        dim, count = self.H.dim, len(self.parameters)
        if not count:
            raise InputError(
                "no parameter of this enclosure is a ball; give parameters= to enclose"
            )
        return self._at(
            t, lambda *place: [part[:, dim:] for part in self._slopes(*place)], (dim, count)
        )

    def end_states(self) -> tuple[Ball, np.ndarray]:
        """Enclose the state at the end more narrowly than one float64 number a component can.

        Returns
        -------
        (Ball, numpy.ndarray)
            A ball and numbers below the round-off of its mid-points: the state is in their sum.
            Shapes (dim,).
        """
        require_float64()
        high, low, radius = self._sums(*self._place(self.span[1]))
        return Ball(high, radius), low

    def _at(self, t: Any, value: Any, shape: tuple[int, ...]) -> Ball:
        require_float64()
        times = times_in_span(t, self.span, extrapolate=True)
        low, high = min(self.span), max(self.span)
        if not ((times >= low) & (times <= high)).all():
            raise InputError(
                f"t is outside the span from {low!r} to {high!r}, in which the enclosure is proven"
            )
        found = [value(*self._place(time)) for time in np.ravel(times).tolist()]
        middle = np.array([entry[0] for entry in found]).reshape(*np.shape(times), *shape)
        radius = np.array([entry[1] for entry in found]).reshape(*np.shape(times), *shape)
        return Ball(middle, radius)

    def _place(self, t: float) -> tuple[int, Any]:
        """The window of a time, and balls of the Chebyshev polynomials there.

        For wide sets the place from -1 to 1.
        """
        direction = 1 if self.span[1] > self.span[0] else -1
        elapsed = (Fraction(t) - Fraction(self.span[0])) * direction
        k = bisect_right(self.windows, elapsed, key=lambda window: window.start) - 1
        window = self.windows[k]
        x = (elapsed - window.start) / window.half - 1
        if isinstance(window, SetWindow):
            return k, x
        return k, enclosures().chebyshev_balls(number_of(x), window.high.shape[1])

    def _state(self, k: int, basis: Any) -> Sequence[np.ndarray]:
        high, low, radius = self._sums(k, basis)
        return [high, up(radius + np.abs(low))]

    def _sums(self, k: int, basis: Any) -> Sequence[np.ndarray]:
        """Middles as sums of two numbers, and radii."""
        window, dim = self.windows[k], self.H.dim
        if isinstance(window, SetWindow):
            middle, radius = window.state(basis)
            return [middle, np.zeros(dim), radius]
        value = enclosures().vector_value(window.high, window.low, basis)
        matrix, error = enclosures().matrix_value(window.V, basis)
        radius = enclosures().set_radius(matrix, error, window.G, window.R[:, None])[:dim, 0]
        return [value[:, 0], value[:, 1], up(radius + window.beside + value[:, 2])]

    def _slopes(self, k: int, basis: Any) -> Sequence[np.ndarray]:
        """dz/d(z0, k): the derivative of the window times that of the windows before."""
        window = self.windows[k]
        if isinstance(window, SetWindow):
            return window.slopes(basis)
        middle, rest = self._derivative_before(k)
        matrix, error = enclosures().matrix_value(window.V, basis)
        error = error + window.derivative
        columns = len(middle)
        found, rounding = enclosures().moved_set(matrix, error, middle, np.eye(columns))
        beside = enclosures().set_radius(matrix, error, rest.G, rest.R)
        return [found, up(rounding + beside)]

    def _derivative_before(self, k: int) -> tuple[np.ndarray, ErrorSet]:
        """dz/d(z0, k) at the start of window k: a matrix and the set of its errors."""
        known = list(self._derivatives)  # another thread may compute them too
        if not known:
            columns = self.windows[0].columns
            known.append((np.eye(columns), ErrorSet.of_radii(np.zeros((columns, columns)))))
        while len(known) <= k:
            window = self.windows[len(known) - 1]
            assert isinstance(window, Window)
            middle, rest = known[-1]
            error = window.J_error.copy()
            error[: self.H.dim] += window.derivative
            error = up(error)
            fresh, rounding = enclosures().moved_set(window.J, error, middle, np.eye(len(middle)))
            known.append((fresh, rest.moved(window.J, error, rounding, window.units)))
        self._derivatives[:] = known
        return known[k]
