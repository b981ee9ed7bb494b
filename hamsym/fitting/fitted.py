"""Fit: quantities estimated from observations, with their uncertainty and a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import sympy

import hamsym
from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.fitting.motions import MappedMotions
from hamsym.fitting.unknowns import Unknowns
from hamsym.hamiltonian import Hamiltonian
from hamsym.problems.description import attributes_of
from hamsym.solution.solution import Solution
from hamsym.solution.times import times_in_span
from hamsym.support.record_fields import (
    AnyFloat,
    As,
    Count,
    Limit,
    OneOf,
    Size,
    counts,
    flags,
    floats,
)
from hamsym.support.shown import Saved
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.tables import data_frame
from hamsym.support.validation import outside_span

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Minimum:
    """A minimum of chi-square."""

    #: The free quantities.
    parameters: dict[str, float]
    chi_square: AnyFloat
    #: Number of starts that reached it.
    starts: Count


_PER_SET = AnyFloat | Annotated[np.ndarray, floats("*sets", finite=False)]
_WHOLE_PER_SET = Annotated[Any, As(int | Annotated[np.ndarray, counts("*sets")])]
_TEXTS = Annotated[tuple[str, ...], Limit(most=1_000_000)]
_Number = Annotated[Any, As(_PER_SET)]
_Series = Annotated[np.ndarray, floats("*sets", "times", finite=False)]
_MOTIONS = OneOf(solution=Solution, solutions=Solutions, map="hamsym.flow_maps.flow_map:FlowMap")


def _texts(message: Any) -> Any:
    return message if isinstance(message, str) else tuple(message.tolist())


def _messages(texts: Any) -> Any:
    return texts if isinstance(texts, str) else np.array(texts, dtype=object)


@suggest_attributes
@dataclass(frozen=True, eq=False, repr=False)
class Fit(Saved):
    """Free quantities estimated from observations, from :func:`hamsym.fit`.

    Of several sets of data, every array has a leading axis (sets,), written "..." below; of one
    set, numbers are floats.

    Attributes
    ----------
    H : Hamiltonian
        With the fitted parameters (of the first set).
    names : tuple of str
        The free quantities.
    parameters : dict of str to float or numpy.ndarray
        Their estimates, shape (...).
    covariance : numpy.ndarray
        Shape (..., k, k), in the order of ``names``; nan where the data do not determine them.
    confidence : float
    confidence_intervals : dict of str to (low, high)
        Each of shape (...): estimates -+ a multiple of their standard errors, from the normal
        distribution, or Student's t distribution if sigma was estimated; where chi-square at these
        ends shows that the model is curved, ends of the profile likelihood, and the message says
        so. Infinite where the data give no end.
    z0 : numpy.ndarray
        Starts with the estimates, shape (..., dim).
    span : (float, float)
    t : numpy.ndarray
        Times of the data, shape (n,).
    data, sigma, residuals : dict of str to numpy.ndarray
        Of each observable, shape (..., n). Residuals are data minus model; nan where data are
        missing. An estimated sigma is the same for all data of a set.
    chi_square : float or numpy.ndarray
        Sum of (residual/sigma)^2, with sigma = 1 if it was not given.
    degrees_of_freedom : int or numpy.ndarray
        Number of data minus number of free quantities.
    p_value : float or numpy.ndarray
        Probability of a larger chi-square if the model and sigma are right; nan without sigma.
    success : bool or numpy.ndarray
        Whether the estimates are a minimum inside the bounds that the data determine, without
        another one known that fits as well, by symmetry, aliasing or from another start, the
        motion is accurate to a tenth of sigma, and the model fits (p >= 1e-6).
    message : str or numpy.ndarray
    seconds : float
        Run time.
    minima : tuple of Minimum
        The minima that several starts reached, the best one first; empty for several sets.
    starts_reached : int or numpy.ndarray
        Number of refined starts that reached the best minimum.
    solution : Solution, Solutions or None
        Motions with the estimates; None if a flow map was used.
    flow : FlowMap or None
        The map that was used in their place.
    unknowns : Unknowns
        What was free, with bounds and first guesses.
    expressions : dict of str to sympy.Expr
        Observables by the labels that were given.
    """

    H: Hamiltonian
    names: tuple[str, ...]
    parameters: dict[str, _Number]
    covariance: Annotated[np.ndarray, floats("*sets", "free", "free", finite=False)]
    confidence: Annotated[float, Limit(0, 1)]
    confidence_intervals: dict[str, tuple[_Number, _Number]]
    z0: Annotated[np.ndarray, floats("*sets", "dim")]
    span: tuple[float, float]
    t: Annotated[np.ndarray, floats("times")]
    data: dict[str, _Series]
    sigma: dict[str, _Series]
    residuals: dict[str, _Series]
    chi_square: _Number
    degrees_of_freedom: _WHOLE_PER_SET
    p_value: _Number
    success: Annotated[Any, As(bool | Annotated[np.ndarray, flags("*sets")])]
    message: Annotated[Any, As(str | _TEXTS, _texts, _messages)]
    seconds: Size
    minima: tuple[Minimum, ...]
    starts_reached: _WHOLE_PER_SET
    solution: Annotated[Solution | Solutions, _MOTIONS] | None
    unknowns: Unknowns = field(repr=False)
    expressions: Mapping[str, sympy.Expr] = field(repr=False)
    flow: Annotated[Any, _MOTIONS] | None = field(repr=False)

    def check(self) -> None:
        """Raise ValueError unless its parts are those of one fit."""
        numbers = [
            *self.parameters.values(),
            *(end for ends in self.confidence_intervals.values() for end in ends),
            *(self.chi_square, self.degrees_of_freedom, self.p_value, self.starts_reached),
        ]
        if {np.shape(value) for value in numbers} != {np.shape(self.success)}:
            raise ValueError("its numbers are not those of its sets")
        if np.shape(_messages(self.message)) != np.shape(self.success):
            raise ValueError("its messages are not those of its sets")
        for names in (
            self.unknowns.names,
            tuple(self.parameters),
            tuple(self.confidence_intervals),
        ):
            if names != self.names:
                raise ValueError("its free quantities differ")
        for labels in (self.data, self.sigma, self.residuals):
            if [*labels] != [*self.expressions]:
                raise ValueError("its observables differ")
        if outside_span(self.t, self.span, 1e-15).any():
            raise ValueError("its times are not within its span")
        if self.unknowns.H.names != self.H.names:
            raise ValueError("its unknowns are those of another system")
        self._check_success()

    def _check_success(self) -> None:
        good = np.asarray(self.success)
        estimates = [np.asarray(value)[good] for value in self.parameters.values()]
        if not all(np.isfinite(part).all() for part in (self.covariance[good], *estimates)):
            raise ValueError("its success is true, but its estimates are not finite")
        for label, data in self.data.items():
            missing = np.isnan(data[good])
            residuals, sigma = self.residuals[label][good], self.sigma[label][good]
            if not np.array_equal(np.isnan(residuals), missing) or not (sigma[~missing] > 0).all():
                raise ValueError("its success is true, but its residuals are not those of its data")
        if good.all() and self.solution is not None and self.solution.span != self.span:
            raise ValueError("its solution has another span")

    def __repr__(self) -> str:
        if np.ndim(self.success):
            good, sets = int(self.success.sum()), len(self.success)
            listed = ", ".join(self.names)
            return f"Fit({listed} from {sets:,} sets: {good:,} succeeded, {sets - good:,} failed)"
        errors = self.standard_errors
        listed = ", ".join(f"{n} = {v:.6g} +- {errors[n]:.2g}" for n, v in self.parameters.items())
        return f"Fit({listed}, success={self.success})"

    @property
    def standard_errors(self) -> dict[str, Any]:
        """Square roots of the variances, by name, shape (...)."""
        with np.errstate(invalid="ignore"):
            errors = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return {name: errors[..., j][()] for j, name in enumerate(self.names)}

    @property
    def correlation(self) -> np.ndarray:
        """The covariance in units of the standard errors, shape (..., k, k)."""
        errors = np.stack([np.asarray(error) for error in self.standard_errors.values()], axis=-1)
        with np.errstate(all="ignore"):
            return np.asarray(self.covariance / (errors[..., :, None] * errors[..., None, :]))

    @property
    def weighted_residuals(self) -> dict[str, np.ndarray]:
        """Residuals divided by sigma, by observable, shape (..., n)."""
        return {label: r / self.sigma[label] for label, r in self.residuals.items()}

    def __call__(self, t: Any) -> dict[str, np.ndarray]:
        """Return the fitted observables at times t, each of shape (..., m), or (...).

        Raises
        ------
        InputError
            If a time is outside the span.
        """
        times = times_in_span(t, self.span)
        flat = np.atleast_1d(times)
        values = np.stack([np.atleast_1d(value) for value in self.parameters.values()], axis=-1)
        if self.solution is not None:
            states = np.asarray(self.solution(flat)).reshape(len(values), len(flat), -1)
        elif self.flow is not None:
            states = MappedMotions(self.flow, self.unknowns, flat).states(values)
        else:
            raise InputError("this fit has no motion; see its message")
        rows = self.unknowns.parameter_rows(values)[:, None]
        shape = (*np.shape(self.success), *times.shape)
        found = {}
        for label, function in self._functions.items():
            with np.errstate(all="ignore"):
                found[label] = np.broadcast_to(
                    function(states, flat, rows), (len(values), len(flat))
                ).reshape(shape)
        return found

    @cached_property
    def _functions(self) -> dict[str, Any]:
        return {label: self.H.observable(expr) for label, expr in self.expressions.items()}

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the estimates as a table of pandas, a row for each free quantity.

        Columns are ``estimate``, ``standard_error``, ``low`` and ``high``, the ends of the
        confidence interval. The index is ``name``, or ``set`` and ``name`` of several sets of data.
        H, other parameters and units are in ``attrs``.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> t = np.linspace(0, 5, 40)
        >>> H = hamsym.Hamiltonian("p**2/2 + k*x**2/2")
        >>> x = np.cos(2 * t) + 0.01 * np.sin(99 * t)
        >>> start = {"x": 1, "p": 0}
        >>> found = hamsym.fit(H, t, {"x": x}, free={"k": 3.8}, z0=start, span=(0, 5), sigma=0.01)
        >>> found.to_dataframe()["estimate"].round(1).to_dict()
        {'k': 4.0}
        """
        ends = self.confidence_intervals.values()
        values = {
            "estimate": list(self.parameters.values()),
            "standard_error": list(self.standard_errors.values()),
            "low": [low for low, _ in ends],
            "high": [high for _, high in ends],
        }
        columns = {name: np.array(own, dtype=float).T.ravel() for name, own in values.items()}
        names = np.array(self.names, dtype=object)
        index: dict[str, np.ndarray] = {"name": names}
        if np.ndim(self.success):
            sets = len(self.success)
            index = {"set": np.repeat(np.arange(sets), len(names)), "name": np.tile(names, sets)}
        attributes = {**attributes_of(self.H, self.names), "confidence": self.confidence}
        return data_frame(columns, index, attributes)

    def plot(self, *names: Any, number: int = 0, ax: Any = None) -> Figure:
        """Draw data with the fitted motion above residuals, of each observable.

        Parameters
        ----------
        *names : str
            Observables; by default all, up to six.
        number : int
            Of the set, if there are several.
        ax : matplotlib.axes.Axes, optional
            Axes to draw the data of one observable into, in your own style.

        Raises
        ------
        InputError
            If a name or a number is unknown, or ``ax`` is given for several observables.
        """
        return hamsym.plot(self, *names, number=number, ax=ax)
