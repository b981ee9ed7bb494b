"""Wide sets of starts and parameters, carried through time as Taylor models.

A set is cut into parts, on each of which the starts and the parameters that are known up to a
radius are middle + half s, |s_k| <= 1. On a step of the time the solution is

    z(t) in P(x, s) + balls of the radii ``bound``,   |x| <= 1,

with polynomials P near the solutions at points of the part (:mod:`hamsym.proof.boxes.nodes`). Each
step begins with the polynomials at which the last one ended. Parts whose polynomials leave out too
much are halved on the way. Errors are carried by :mod:`hamsym.proof.boxes.carried_errors`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

import numpy as np

from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.directed import UNIT, sum_up
from hamsym.proof.arithmetic.functions import SingularityError
from hamsym.proof.arithmetic.generated import ParameterSlopes
from hamsym.proof.arithmetic.taylor_models import (
    Model,
    Parts,
    space_of,
)
from hamsym.proof.boxes.carried_errors import CarriedErrors, ErrorStep
from hamsym.proof.boxes.map_models import Step
from hamsym.proof.boxes.nodes import Nodes
from hamsym.proof.boxes.tube import Flow, StepModels, Stepper, sizes, steepest_inputs
from hamsym.proof.limits import Deadline
from hamsym.support.record_fields import Count, floats

# Largest degrees in x and in the inputs, by the number of inputs.
_DEGREES = {1: (14, 12), 2: (14, 9), 3: (12, 6), 4: (10, 7)}
_MANY_INPUTS = (10, 3)
_MOST = 16  # of these degrees
# Most components of a system: the time of a step grows with their cube.
_MOST_COMPONENTS = 16
# Most inputs: of more, the relatively thinnest are balls around the polynomials.
_MOST_INPUTS = 6
# Radius, relative to the component and to the widest, from which a ball is an input.
_THIN = 1e-6
# Radii that a step may add over the whole span, relative to the extent of a part.
_SHARE = 3e-4
# The same where the radii of all later steps together are too large, so that parts are halved.
_MOST_ADDED = 0.2
# Terms in x that a step may leave out, relative to what it may add.
_TAIL = 3e-3
# First step, relative to the span; shortest step, and factors of the next one.
_FIRST, _SHORTEST = 1e-2, Fraction(1, 2**24)
_GROWTH, _FULL = 1.3, 0.3
# Excess of what is added, where parts are not halved, up to which steps grow again.
_NEAR = 10.0
# Share of its largest extent so far that a component always has; of others what may reach it.
_PAST, _COUPLED = 0.1, 1e-6
# Tail from which a step is not tried; relative round-off; factor of a step by its tail from which
# shorter ones do not help.
_LOOSE, _ROUND_OFF, _FINE = 30.0, 1e-15, 3.0
# Halvings of a step that are tried before a part is halved, and the least gain of each.
_HALVINGS, _GAIN = 2, 0.35
_SWEEPS = 80
# Halvings of a step on which nothing is proven until its parts are halved.
_TRIES = 4
_TINY = 1e-250


@dataclass(frozen=True, eq=False)
class SetWindow:
    """A step: z(t) in P(x, s) + balls for each part of the set, for all s with \\|s_k\\| <= 1."""

    #: start, half: Elapsed time; start + half (1 + x).
    start: Fraction
    half: Fraction
    #: Number of the inputs s, and largest degrees in x and in s.
    inputs: Count
    time_degree: Count
    degree: Count
    #: Coefficients of P, in the order of the terms of :class:`Space`.
    polynomials: Annotated[np.ndarray, floats("dim", "terms", "parts")]
    bound: Annotated[np.ndarray, floats("dim", "parts", least=0)]
    #: Coefficients of powers of x near the derivatives by starts and parameters, and bounds on
    #: their distance from those of all solutions of a part.
    V: Annotated[np.ndarray, floats("dim", "columns", "slopes", "parts")]
    V_error: Annotated[np.ndarray, floats("dim", "columns", "parts", finite=False, least=0)]

    @property
    def end(self) -> Fraction:
        return self.start + 2 * self.half

    @property
    def parts(self) -> int:
        return int(self.bound.shape[1])

    @property
    def columns(self) -> int:
        return int(self.V.shape[1])

    def check(self) -> None:
        """Raise ValueError unless its degrees are those of its polynomials."""
        if not (0 < self.inputs <= _MOST_INPUTS and 0 < self.degree <= self.time_degree <= _MOST):
            raise ValueError("it has other degrees than polynomials of sets")
        if self.polynomials.shape[1] != space_of(*self.degrees).count:
            raise ValueError("its polynomials have another number of terms")

    @property
    def degrees(self) -> tuple[int, int, int]:
        """Arguments of the :func:`space_of` its polynomials."""
        return self.inputs, self.time_degree, self.degree

    def state(self, x: Fraction) -> tuple[np.ndarray, np.ndarray]:
        """Middle and radius of balls around the states of all parts."""
        space = space_of(*self.degrees)
        balls = [
            space.at(Model(space, own, radius), x).range()
            for own, radius in zip(self.polynomials, self.bound, strict=True)
        ]
        middle, radius = np.moveaxis(np.array(balls), 1, 0)
        return _hull(middle, radius)

    def slopes(self, x: Fraction) -> tuple[np.ndarray, np.ndarray]:
        """The same of the derivatives."""
        count = self.V.shape[2]
        powers = np.array([float(x**a) for a in range(count)])
        terms = self.V * powers[:, None]
        rounding = 2 * (count + 6) * UNIT * np.abs(terms).sum(axis=2)
        return _hull(terms.sum(axis=2), sum_up(self.V_error + rounding, count))


def _hull(middle: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A ball around balls, over the last axis."""
    low, high = (middle - radius).min(axis=-1), (middle + radius).max(axis=-1)
    found = np.where(np.isfinite(high - low), (low + high) / 2, middle[..., 0])
    distance = np.abs(middle - found[..., None])
    return found, np.asarray(sum_up((distance + radius).max(axis=-1)))


@dataclass
class _Candidate:
    """A step that is proven, and how good it is."""

    models: StepModels
    errors: ErrorStep
    #: Extent of the components, shape (dim, parts).
    extent: np.ndarray
    #: What the step added for each part, in units of what is allowed.
    ratio: np.ndarray


class WideSet:
    """Encloses one step after the other.

    - total: Length of the span.
    - centre, radii: Of the starts, and of the parameters ``names``; shape (columns,).
    - most: Parts at once.
    """

    def __init__(
        self,
        H: Hamiltonian,
        names: list[str],
        begin: Fraction,
        direction: int,
        length: Fraction,
        centre: np.ndarray,
        radii: np.ndarray,
        deadline: Deadline,
        most: int,
    ) -> None:
        if H.dim > _MOST_COMPONENTS:
            raise CertificationError(
                f"sets of {H.dim} components are not carried by polynomials; give at most "
                f"{_MOST_COMPONENTS}"
            )
        self._begin, self._direction, self.total = begin, direction, length
        self._deadline, self._most = deadline, most
        self._flow = Flow(H, names)
        self._field = _numeric_field(H, self._flow.keywords)
        chosen = _inputs(centre, radii)
        d = len(chosen)
        space = self._space = space_of(d, *_DEGREES.get(d, _MANY_INPUTS))
        self._nodes = Nodes(space, space.time_degree, space.degree)
        self._stepper = Stepper(self._flow, space, space.degree - 1)
        models = [space.constant(np.array([middle])) for middle in centre.tolist()]
        for k, column in enumerate(chosen):
            term = tuple(int(place == k) for place in range(d))
            models[column].coefficients[space.places[(0, *term)]] = radii[column]
        beside = np.where(np.isin(np.arange(len(radii)), chosen), 0.0, radii)
        dim = self._flow.dim
        self._states = models[:dim]
        self._parameters = [m.widened(r) for m, r in zip(models[dim:], beside[dim:], strict=True)]
        slopes = ParameterSlopes(H, names)
        self._errors = CarriedErrors.of_start(self._stepper, slopes, len(names), beside[:dim])
        self._extent = np.zeros((dim, 1))
        self.elapsed = Fraction(0)
        self._length = Fraction(_FIRST) * length

    @property
    def parts(self) -> int:
        return len(self._states[0].radius)

    # -- steps -------------------------------------------------------------------------------------

    def step(self) -> SetWindow:
        """The next step; raise CertificationError if there is none."""
        longest, before, halvings = self._length, np.inf, 0
        reason = "the set of solutions became too wide for"
        while True:
            t = float(self._begin + self._direction * self.elapsed)
            self._deadline.check(f"the solutions were enclosed, at t = {t:.6g}")
            length = min(self._length, self.total - self.elapsed)
            if not length > self.total * _SHORTEST and length < self.total - self.elapsed:
                raise self._refusal(t, reason)
            with np.errstate(all="ignore"):  # infinite and NaN are refused
                found, tail = self._candidate(length)
            # The factor of the length at which the terms in x that are left out would be allowed.
            reach = tail ** (-1 / self._space.time_degree) if tail > 0 else np.nan
            if found is None:
                halvings += not reach < 1
                if halvings > _TRIES and 2 * self.parts <= self._most:
                    # along the inputs one after the other, with the number of parts
                    axis = (self.parts.bit_length() - 1) % self._space.inputs
                    every, along = np.full(self.parts, True), np.full(self.parts, axis)
                    self._split(Parts.halving(every, along))
                    self._length, halvings = longest, 0
                    continue
                if not reach < 1:
                    reason = "H is not smooth, or not resolved, on"
                self._length = _short(length * Fraction(0.8 * reach if 0.3 < reach < 1 else 0.5))
                longest = self._length if reach < 1 else longest
                continue
            reason = "the set of solutions became too wide for"
            worst = float(found.ratio.max()) if np.isfinite(found.ratio).all() else np.inf
            if worst <= 1:
                return self._accept(length, found)
            # Where these terms are small already, a shorter step does not help; and the end of the
            # span, which is as short as it is, would be halved without end.
            resolved = reach > _FINE or length * 2**_HALVINGS < longest
            # Halves need twice the time, so that what matters is what would come up to the end.
            left = max(self.total - self.elapsed - length, self.total / 30)
            wide = ~(found.ratio <= _MOST_ADDED / _SHARE * float(self.total / left))
            if halvings < _HALVINGS and not resolved and not worst > _GAIN * before:
                before, halvings, self._length = worst, halvings + 1, length / 2
            elif wide.any() and self.parts + wide.sum() <= self._most:
                models = found.models
                axes = steepest_inputs([*models.defect, *models.states])
                self._split(Parts.halving(wide, axes))
                self._length, before, halvings = longest, np.inf, 0
            elif np.isfinite(found.errors.bound).all():
                if (found.errors.bound > found.extent).all(axis=0).any():
                    raise self._refusal(t, reason)
                window = self._accept(length, found)
                self._length = longest
                if resolved and worst < _NEAR:
                    self._length = _short(longest * Fraction(_GROWTH))
                return window
            else:
                self._length = longest = _short(length / 2)

    def _refusal(self, t: float, reason: str) -> CertificationError:
        return CertificationError(
            f"no enclosure beyond t = {t:.6g}: {reason} {self.parts:,} "
            f"part{'s' * (self.parts > 1)}; use narrower balls, an earlier end time or more parts "
            "(max_parts)"
        )

    def _candidate(self, length: Fraction) -> tuple[_Candidate | None, float]:
        """A step of a length, None where nothing is proven; and the tail of its terms in x.

        The tail is in units of what is allowed, and NaN where it is not known.
        """
        sign, space = self._direction, self._space
        step = Step(0, sign * self.elapsed, sign * (self.elapsed + length))
        values = self._solved(step)
        if values is None:
            return None, np.nan
        series = values @ self._nodes.series.T  # (dim, parts, nodes, times)
        extent = np.ptp(values, axis=2).max(axis=2)
        extent = np.maximum(extent, _PAST * self._extent)
        allowed = _SHARE * float(length / self.total) * extent
        last = np.abs(series[..., -3:]).max(axis=(2, 3))
        tail = float(
            (last / (_TAIL * allowed + _ROUND_OFF * np.abs(values).max(axis=(2, 3)) + _TINY)).max()
        )
        if not tail <= _LOOSE:
            return None, tail
        states = [
            space.moved(Model(space, self._nodes.polynomial(own), np.zeros(self.parts)), start)
            for own, start in zip(values, self._states, strict=True)
        ]
        rates = [space.rate(model) for model in states]
        clock = step.clock(space, self._begin, self.parts)
        try:
            models = self._stepper.models(
                step, states, rates, clock, self._parameters, self._errors.fundamental
            )
        except (SingularityError, np.linalg.LinAlgError):
            return None, np.nan
        pairs = zip(states, self._states, strict=True)
        jump = [space.at_end(model, -1) - start for model, start in pairs]
        errors = self._errors.step(models, jump)
        M, S = sizes(models.fundamental), sizes(models.adjoint)
        # What a component has no own extent for may be the share of another one.
        reach = np.einsum("ijc,jkc,kc->ic", M, S, allowed)
        added = np.einsum("ijc,jc->ic", M, errors.added)
        ratio = added / (allowed + _COUPLED * reach + _TINY)
        ratio = np.where(np.isfinite(errors.bound), ratio, np.inf).max(axis=0)
        ratio = np.where(np.isnan(ratio), np.inf, ratio)
        return _Candidate(models, errors, extent, ratio), tail

    def _solved(self, step: Step) -> np.ndarray | None:
        """Solutions from the nodes, by iteration, shape (dim, parts, nodes, times)."""
        nodes, half = self._nodes, float(step.half)
        start = np.stack([nodes.start_values(m.coefficients) for m in self._states], axis=-1)
        given = [nodes.start_values(m.coefficients) for m in self._parameters]
        t = float(self._begin + step.middle) + half * nodes.times[:, None, None]
        found = np.repeat(start[None], len(nodes.times), axis=0)  # (times, parts, nodes, dim)
        change = last = np.inf
        for _ in range(_SWEEPS):
            rates = self._field(found, t, given)
            fresh = start + half * np.tensordot(nodes.integral, rates, 1)
            change = np.abs(fresh - found).max(axis=(0, 1, 2))
            change = float((change / (np.abs(fresh).max(axis=(0, 1, 2)) + _TINY)).max())
            found = fresh
            if not np.isfinite(change):
                return None
            if change < 1e-15 or (change < 1e-12 and change >= last):
                break
            last = change
        return None if change > 1e-8 else np.moveaxis(found, (3, 0), (0, 3))

    def _split(self, parts: Parts) -> None:
        space = self._space
        self._states = [space.parts_of(model, parts) for model in self._states]
        self._parameters = [space.parts_of(model, parts) for model in self._parameters]
        self._extent = self._extent[:, parts.parents]
        self._errors = self._errors.split(parts)

    def _accept(self, length: Fraction, found: _Candidate) -> SetWindow:
        """The window, from whose end the next one goes on."""
        space, models = self._space, found.models
        errors, V, V_error = self._errors.after(models, found.errors)
        with np.errstate(all="ignore"):  # infinite and NaN are refused
            self._errors = errors.turned()
        distance = np.stack(V_error, axis=1)
        window = SetWindow(
            self.elapsed,
            length / 2,
            space.inputs,
            space.time_degree,
            space.degree,
            np.array([model.coefficients for model in models.states]),
            found.errors.bound,
            np.stack(V, axis=1),
            np.where(np.isfinite(distance), distance, np.inf),
        )
        self._states = [space.at_end(model, 1) for model in models.states]
        self._extent = np.maximum(self._extent, found.extent)
        self.elapsed = window.end
        if found.ratio.max() <= _FULL:
            length = length * Fraction(_GROWTH)
        self._length = _short(length)
        return window


def _inputs(centre: np.ndarray, radii: np.ndarray) -> list[int]:
    """The columns that become inputs, in their order."""
    relative = radii / (np.abs(centre) + radii + _TINY)
    order = np.argsort(-relative, kind="stable")[:_MOST_INPUTS]
    return sorted(k for k in order.tolist() if relative[k] > _THIN * relative.max())


def _short(length: Fraction) -> Fraction:
    """About a length, in few bits."""
    mantissa, exponent = math.frexp(float(length))
    return Fraction(math.ldexp(round(mantissa * 2**16), exponent - 16))


def _numeric_field(H: Hamiltonian, keywords: list[str]) -> Any:
    """(states, t, parameters) -> rates, with numpy."""
    system = H.compile("numpy")
    field = system.vector_field

    def rates(z: np.ndarray, t: np.ndarray, parameters: list[np.ndarray]) -> np.ndarray:
        given = dict(zip(keywords, parameters, strict=True))
        return np.asarray(field(z, *((t,) if system.time_dependent else ()), **given))

    return rates
