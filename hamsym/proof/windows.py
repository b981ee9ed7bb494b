"""Enclosures of the true solution, window by window.

Each window has a polynomial y near the solution, which collocation in float64 finds and linear
corrections complete to twice float64, a polynomial matrix V near its derivatives, and the bounds of
``hamsym/kernel/enclosures.h``. The set of the states at the start of a window is

    z(t_a) in y(-1) + G r,   r: all vectors with |r_i| <= R_i.

The first columns of G are derivatives by the initial balls (Lohner 1992); each window appends the
identity with the radii of its own errors, and later windows multiply all columns by their
derivatives. So sets do not wrap. Only when there are too many columns are those of the errors
replaced by an orthogonal matrix. A window whose polynomials are not resolved is made shorter.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_straight_line
from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.kernel.enclosures import MIDDLE, UNDERFLOW, UNIT, enclosures
from hamsym.numerics.scales import coupled_sizes
from hamsym.proof.balls import number_of, working
from hamsym.proof.generated import GeneratedFunctions, evaluated
from hamsym.proof.limits import Deadline
from hamsym.proof.programs import BITS, ModelRows, Program, Recorder, tables
from hamsym.support.record_fields import floats
from hamsym.symbolic.exact import rational

TERMS = 32
_ITERATIONS = 80
_SHORTEST = Fraction(1, 2**40)  # window, relative to the span
_TRIES = 60  # of one window
_CORRECTIONS = 3  # of y
_REST = 1e4  # rest of a window in units of the accuracy
_GROWTH = 1e3  # of the defect to the rest that is always allowed
_MOST_COLUMNS = 2_048  # of a set
_WIDE = 1e-8  # relative width from which the shape of a set counts
_TUBES = 5  # attempts at a tube
_AT_REST = 1e-200  # of a component, up to which it is at rest
_BESIDE = 100.0  # size of a component beside the radius of a ball around zero
_LEAST = 1e-130  # size of a component; radii have the root of 1e-290 as a floor
# Root of the product q p of a pair at rest, relative to the others: errors of the derivatives of
# the others by the pair are larger by 1e6 than their own, and its own errors smaller.
_UNCOUPLED = 1e-6
_LOOSE = 32.0  # defect in units of the accuracy
_FINEST = 1e-28  # accuracy that twice float64 can reach
_ROUND_OFF = 2e-14  # of coefficients, relative to the component
_ABRUPT = 1e3  # drop of the coefficients to round-off, which is that of a polynomial


class Equation:
    """dz/dt = G(t, z, k), its derivatives and H as programs.

    - H: With a value for every parameter.
    - unknown: Names of parameters that are arguments k of the programs.
    - dim, columns: 2 dof, and dim plus the number of unknown parameters.
    - slopes: Derivatives of H with forces; without them ``rates``, which are those up to order and
      sign.
    - entries, signs: Rows (i, j, place): DG_ij is a sign times the result ``place`` of
      ``jacobian``.
    """

    def __init__(self, H: Hamiltonian, unknown: Sequence[str] = ()) -> None:
        H.require_parameters()
        self.dim, self.columns = H.dim, H.dim + len(unknown)
        self.conserved = H.conserves_energy
        self._H, self._unknown = H, list(unknown)
        self.rates, _ = self._recorded("vector_field")
        self.energy, _ = self._recorded("energy")
        self.slopes = self._recorded("gradient")[0] if H.forces else self.rates
        self.jacobian, indices = self._recorded("jacobian" if H.forces else "hessian")
        dof = H.dof
        rows: list[tuple[int, int, int, int]] = []
        for place, (i, j) in enumerate(indices):
            if j >= H.dim or H.forces:  # a rate by a parameter, or by the state itself
                rows.append((i, j, place, 1))
                continue
            for row, column in {(i, j), (j, i)}:
                target, sign = (row - dof, 1) if row >= dof else (row + dof, -1)
                rows.append((target, column, place, sign))
        self.entries = np.array([row[:3] for row in rows], dtype=np.int64).reshape(-1, 3)
        self.signs = np.array([float(row[3]) for row in rows])
        #: The same with registers in place of results.
        self.placed = self.entries.copy()
        self.placed[:, 2] = self.jacobian.results[self.entries[:, 2]]

    def resting(self, zero: Iterable[int]) -> set[int]:
        """Components that stay exactly zero, of those that are zero at the start."""
        own, found = self._H.real_equations, set(zero)
        while found:
            values = {own.z[i]: sympy.Integer(0) for i in found}
            moving = {i for i in found if own.vector_field[i].xreplace(values) != 0}
            if not moving:
                break
            found -= moving
        return found

    def _recorded(self, name: str) -> tuple[Program, list[tuple[int, ...]]]:
        """A generated function as a program, and the indices of its results."""
        recorder = Recorder(self.columns + 1, self.dim)
        functions = GeneratedFunctions(self._H, recorder.arithmetic, self._unknown)
        *state, time = recorder.variables
        varied = dict(zip(functions.keywords, state[self.dim :], strict=True))
        with working(BITS):
            found = functions(name, state[: self.dim], time, **varied)
            indices: list[tuple[int, ...]] = []
            if isinstance(found, dict):
                indices, results = list(found), list(found.values())
                for index, value in self._by_parameters(recorder).items():
                    indices.append(index)
                    results.append(value)
            else:
                results = found if isinstance(found, list) else [found]
            return Program(recorder, results), indices

    def _by_parameters(self, recorder: Recorder) -> dict[tuple[int, ...], Any]:
        """The derivatives of the rates by the unknown parameters."""
        own = self._H.real_equations
        values = {s: value for n, (s, value) in own.parameters.items() if n not in self._unknown}
        known = {s: value for s, value in values.items() if value is not None}
        rates = [own.exact.with_fractions(entry, known) for entry in own.exact.vector_field]
        found = {
            (i, self.dim + k): slope
            for k, name in enumerate(self._unknown)
            for i, rate in enumerate(rates)
            if (slope := sympy.diff(rate, own.parameters[name][0])) != 0
        }
        if not found:
            return {}
        exact = {s: rational(v) for s, v in known.items()}
        symbols = [
            *own.z,
            *(own.parameters[name][0] for name in self._unknown),
            own.time or sympy.Dummy("t"),
        ]
        function = compile_straight_line([e.xreplace(exact) for e in found.values()], symbols)
        results = evaluated(function, recorder.arithmetic, *recorder.variables)
        return dict(zip(found, results, strict=True))


def set_sizes(V: np.ndarray, G: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Bounds on the components of V(x) G r over a window for all |r_i| <= R_i, shape (dim,)."""
    products = np.einsum("ick,cd->idk", V, G)
    found = np.abs(products).sum(axis=2) @ R
    rounding = 2 * (len(G) + 8) * UNIT  # of sums of so many products
    found += rounding * (np.abs(V).sum(axis=2) @ (np.abs(G) @ R)) + UNDERFLOW * R.sum()
    return np.asarray(found * (1 + 1e-9))


@dataclass(frozen=True, eq=False)
class ErrorSet:
    """Sets {G r} with \\|r\\| <= R, one for each column of R."""

    #: G, R: Shapes (columns, m) and (m, kinds).
    G: np.ndarray
    R: np.ndarray
    #: Number of the first columns of G, which are kept.
    initial: int

    @classmethod
    def of_radii(cls, R: np.ndarray) -> ErrorSet:
        """The sets of all vectors within radii, shape (columns, kinds)."""
        initial = len(R) if R.any() else 0
        return cls(np.eye(len(R))[:, :initial], R[:initial], initial)

    def sizes(self) -> np.ndarray:
        """Bounds on the components, shape (columns, kinds)."""
        return np.asarray((np.abs(self.G) @ self.R) * (1 + 1e-9))

    def initial_sizes(self) -> np.ndarray:
        """About the sizes of the components from the initial set alone, shape (columns, kinds)."""
        return np.asarray(np.abs(self.G[:, : self.initial]) @ self.R[: self.initial])

    def moved(
        self, J: np.ndarray, J_error: np.ndarray, extra: np.ndarray, units: np.ndarray
    ) -> ErrorSet:
        """The sets {(J +- J_error) G r + e} with \\|e\\| <= extra, shape (columns, kinds).

        ``units`` are those of the components, powers of two.
        """
        columns, first, R = len(self.G), self.initial, self.R
        G, rest = enclosures().moved_set(J, J_error, self.G, R)
        if G.shape[1] - first > columns * min(max(_MOST_COLUMNS // columns, 6), 64):
            later = np.ascontiguousarray(G[:, first:]), np.ascontiguousarray(R[first:])
            Q, radii = enclosures().boxed_set(*later, units)
            G, R = np.hstack([G[:, :first], Q]), np.vstack([R[:first], radii])
        fresh = (rest + extra) * (1 + 1e-9)
        return ErrorSet(np.hstack([G, np.eye(columns)]), np.vstack([R, fresh]), first)


@dataclass(frozen=True, eq=False)
class Window:
    """One window: z(t) in y(x) + V(x) G r + balls of the radii ``beside``, \\|r\\| <= R."""

    #: start, half: Elapsed time; start + half (1 + x).
    start: Fraction
    half: Fraction
    #: high, low: Coefficients of y.
    high: Annotated[np.ndarray, floats("dim", "terms")]
    low: Annotated[np.ndarray, floats("dim", "terms")]
    V: Annotated[np.ndarray, floats("dim", "columns", "slopes")]
    #: G, R: The set at the start.
    G: Annotated[np.ndarray, floats("columns", "kinds")]
    R: Annotated[np.ndarray, floats("kinds", least=0)]
    #: Bounds on everything else.
    beside: Annotated[np.ndarray, floats("dim", least=0)]
    #: Bounds on V_d.
    derivative: Annotated[np.ndarray, floats("dim", "columns", least=0)]
    #: J, J_error: V(1) with rows of the identity for the constants, and bounds on its rounding.
    J: Annotated[np.ndarray, floats("columns", "columns")]
    J_error: Annotated[np.ndarray, floats("columns", "columns", least=0)]
    #: Bounds on |z - y|.
    tube: Annotated[np.ndarray, floats("dim", least=0)]
    #: Of the components and constants, powers of two, in which DG is nearly balanced.
    units: Annotated[np.ndarray, floats("columns", least=0)]

    @property
    def end(self) -> Fraction:
        return self.start + 2 * self.half


@dataclass(frozen=True)
class _Place:
    """A window that is tried: half its length, exact and rounded, and balls of time."""

    half: Fraction
    w: float
    #: middle, slope: The time is middle + slope x.
    middle: tuple[float, float, float]
    slope: tuple[float, float, float]


class WindowStepper:
    """Encloses one window after the other.

    - total: Length of the span.
    - centre: Middle of the initial set, shape (columns,); the constants are the last.
    - radii: Of the initial set.
    - accuracy: Of the polynomials, relative to the components.
    """

    def __init__(
        self,
        equation: Equation,
        start_time: Fraction,
        direction: int,
        total: Fraction,
        centre: np.ndarray,
        radii: np.ndarray,
        accuracy: float,
        deadline: Deadline,
        terms: int = TERMS,
    ) -> None:
        self.equation, self._deadline = equation, deadline
        self._time, self._direction, self.total = start_time, direction, total
        self._accuracy, self._tables = accuracy, tables(terms)
        dim = equation.dim
        self._terms = terms
        self._centre = centre[:dim].astype(float)
        self._centre_low = np.zeros(dim)
        self._constants = centre[dim:].astype(float)
        self._unknown = radii[dim:].astype(float)
        self._set = ErrorSet.of_radii(radii.astype(float)[:, None])
        self._rates = ModelRows(equation.rates, terms)
        self._jacobian = ModelRows(equation.jacobian, terms)
        self._energy = ModelRows(equation.energy, terms)
        self._signs = equation.signs * direction
        self._rows = [
            np.repeat(models.high[:, :1], terms, axis=1) for models in (self._rates, self._jacobian)
        ]
        self.elapsed = Fraction(0)
        self._sizes = np.abs(self._centre)
        self.length: float | None = None  # suggestion for the next window
        self._defect = np.full(dim, math.inf)  # per time, of the try before
        self._round_off = np.zeros(dim)  # defects per time that no window reduced
        self.reason = ""

    # -- one window ---------------------------------------------------------------------------

    def step(self, limit: Fraction) -> Window:
        """The next window, which ends at ``limit`` or before.

        Raise CertificationError if there is none.
        """
        time = float(self._time + self._direction * self.elapsed)
        room = limit - self.elapsed
        length = float(room) if self.length is None else self.length
        self._defect = np.full(self.equation.dim, math.inf)
        for _ in range(_TRIES):
            self._deadline.check(f"the solution was enclosed, at t = {time:.6g}")
            if not length > float(self.total * _SHORTEST):
                break
            if length >= float(room) * (1 - 1e-9):
                chosen = room
            else:
                if length * 2 > float(room):
                    length = float(room) / 2
                chosen = self._rounded(length, room)
            with np.errstate(all="ignore"):  # infinite and NaN are refused
                window, factor = self._try(chosen)
            if window is not None:
                self.length = float(chosen) * min(max(factor, 0.5), 2.0)
                return window
            length = float(chosen) * factor
        raise CertificationError(
            f"no enclosure beyond t = {time:.6g}: {self.reason or 'the windows became too short'}; "
            "use an earlier end time"
        )

    def _rounded(self, length: float, room: Fraction) -> Fraction:
        """About this length, so that the window ends at a float64 time if possible."""
        wanted = self.elapsed + Fraction(length)
        end = Fraction(float(self._time + self._direction * wanted))
        chosen = self._direction * (end - self._time) - self.elapsed
        return chosen if 0 < chosen < room else Fraction(length)

    def _try(self, length: Fraction) -> tuple[Window | None, float]:
        """A window of this length, or None; and the factor of the length to try next."""
        half = length / 2
        place = _Place(
            half,
            float(half),
            number_of(self._time + self._direction * (self.elapsed + half)),
            number_of(half * self._direction),
        )
        sizes, y = self._guess(place)
        if y is None:
            self.reason = "the solution leaves every scale there, as at a collision or a jump"
            return None, 0.5
        # What the others drive a component to; its round-off has that scale if it is nearly zero.
        couplings = self._couplings()
        driven = place.w * (couplings @ sizes)
        tail, factor = self._decay(y, np.maximum(sizes, 0.02 * driven))
        if not tail <= 30 * self._accuracy:
            return None, min(max(0.9 * factor, 0.25), 0.8)
        sizes = np.maximum(self._sizes, np.maximum(sizes, 1e-8 * driven))
        units = self._units(place.w, couplings, sizes)
        models, D = self._completed(place, y, units)
        if not np.isfinite(D).all():
            self.reason = "a function was not resolved"
            return None, 0.5
        self._sizes = sizes
        resolved, factor = self._resolved(D / place.w, D, factor)
        if not resolved:
            self.reason = "the solution was not resolved"
            return None, factor
        # Roundings of a component at rest may have a size, as those of sin(x) at 0: the 2-norm has
        # to compare them with those of the others.
        least = D / (_LOOSE * max(self._accuracy, _FINEST))
        units = self._units(place.w, couplings, sizes, least)
        return self._enclosed(place, models, D, units, factor)

    def _guess(self, place: _Place) -> tuple[np.ndarray, np.ndarray | None]:
        """Sizes of the components and coefficients of y in float64; and DG along y in rows.

        What does not depend on the state is put into the models, and rounded into the rows: a time
        of many periods has too few digits in float64.
        """
        equation, tabs = self.equation, self._tables
        dim, columns = equation.dim, equation.columns
        rows, more = self._rows
        signed = place.w * self._direction
        rows[:dim] = self._centre[:, None]
        rows[dim:columns] = self._constants[:, None]
        rows[columns] = place.middle[0] + signed * tabs.points
        for values, models in ((rows, self._rates), (more, self._jacobian)):
            models.high[dim:columns, 0] = self._constants
            models.radius[dim : columns + 1] = 0.0
            models.set_line(columns, place.middle, place.slope)
            models.run_still()
            values[models.program.still_places] = models.still_values()
        count = enclosures().collocate(
            equation.rates.steps,
            equation.rates.results,
            rows,
            tabs.integral,
            self._centre,
            signed,
            _ITERATIONS,
        )
        sizes = np.abs(rows[:dim]).max(axis=1)
        more[: columns + 1] = rows[: columns + 1]
        enclosures().run_values(equation.jacobian.steps, more)
        return sizes, rows[:dim] @ tabs.series if count else None

    def _completed(
        self, place: _Place, y: np.ndarray, units: np.ndarray
    ) -> tuple[ModelRows, np.ndarray]:
        """y in twice float64, by linear corrections of its defect, and bounds on the defect."""
        equation, tabs, models = self.equation, self._tables, self._rates
        dim = equation.dim
        models.high[:dim], models.low[:dim] = y, 0.0
        models.length[:dim] = self._terms
        models.radius[:dim] = 0.0
        self._start(models)
        arguments = (
            equation.rates.steps,
            equation.rates.results,
            models.models,
            dim,
            place.slope,
        )
        series, D = enclosures().defects(*arguments)
        for _ in range(_CORRECTIONS):
            before = D
            found = enclosures().correct(
                self._rows[1],
                equation.placed,
                self._signs,
                dim,
                tabs.integral,
                place.w,
                -(series[:, : self._terms] @ tabs.values),
                units,
                _ITERATIONS,
            )
            self._corrected(models, found @ tabs.series)
            series, D = enclosures().defects(*arguments)
            if not (0.1 * before > D).any():
                break
        return models, D

    def _resolved(self, rates: np.ndarray, D: np.ndarray, factor: float) -> tuple[bool, float]:
        """Whether the defect is small enough, and the factor of the length to try next."""
        shares = D / np.maximum(self._sizes, _LEAST)
        loose = shares > _LOOSE * max(self._accuracy, _FINEST)
        share = max(float(shares.max()), 1e-3 * self._accuracy)
        reach = (self._accuracy / share) ** (2 / self._terms)
        before, self._defect = self._defect, rates
        if not loose.any():
            return True, min(factor, reach)
        # A defect that a shorter window did not reduce is round-off, as near an equilibrium.
        reducible = rates > 4 * self._round_off
        if (reducible & (rates < 0.5 * before))[loose].any():
            return False, max(0.9 * reach, 0.4)
        self._round_off = np.maximum(self._round_off, np.where(loose, rates, 0.0))
        return True, factor

    def _decay(self, y: np.ndarray, sizes: np.ndarray) -> tuple[float, float]:
        """The size of the terms that y leaves out, and the factor of the window that is allowed.

        Extrapolated from the terms above round-off, because those below say nothing.
        """
        shares = (np.abs(y) / np.maximum(sizes, 1e-300)[:, None]).max(axis=0)
        if not np.isfinite(shares).all():
            return math.inf, 0.5
        places = np.flatnonzero(shares > _ROUND_OFF)
        last = max(int(places[-1]), 2) if len(places) else 2
        share = max(float(shares[last]), _ROUND_OFF)
        rate = math.log(share) / last if last < self._terms - 2 else -0.1
        if last < self._terms - 2 and share > _ABRUPT * _ROUND_OFF:  # a polynomial of this degree
            rate = math.log(_ROUND_OFF) / (last + 1)
        tail = math.exp(rate * self._terms)
        factor = (self._accuracy / max(tail, 1e-100)) ** (1 / self._terms)
        y[:, last + 1 :] = 0.0  # round-off, which the corrections replace
        return tail, factor

    def _start(self, models: ModelRows) -> None:
        """Shift y so that y(-1) is the centre."""
        high, low = (part[: self.equation.dim] for part in (models.high, models.low))
        value, rest, _ = enclosures().end_values(high, low, -1)
        gap = (self._centre - value) + (self._centre_low - rest)
        total, error = _two_sum(high[:, 0], gap)
        high[:, 0], low[:, 0] = _two_sum(total, low[:, 0] + error)

    def _corrected(self, models: ModelRows, series: np.ndarray) -> None:
        dim = self.equation.dim
        pair = _two_sum(models.high[:dim], models.low[:dim] + series)
        models.high[:dim], models.low[:dim] = pair
        self._start(models)

    def _enclosed(
        self, place: _Place, models: ModelRows, D: np.ndarray, units: np.ndarray, factor: float
    ) -> tuple[Window | None, float]:
        """The window with the bounds of the lemma, or None; and the factor of the next length."""
        equation, w, tabs = self.equation, place.w, self._tables
        dim = equation.dim
        values = enclosures().tangents(
            self._rows[1],
            equation.placed,
            self._signs,
            dim,
            equation.columns,
            tabs.integral,
            w,
            units,
            _ITERATIONS,
        )
        V = np.ascontiguousarray(values @ tabs.series)
        offset = self._offset(models)
        start = self._set.sizes()[:, 0]
        start[:dim] += offset
        start *= 1 + 1e-9
        safe = np.where(self._sizes > _AT_REST, self._sizes, units)
        width = float((start[:dim] / safe).max())
        hull = self._hull(V, start, offset, width)
        tube = 1.5 * (hull + 2 * D) + 4 * UNIT * UNIT * self._sizes + 1e-280
        accepted = None
        for _ in range(_TUBES):
            jacobian = self._over_tube(place, models, tube)
            found, d, derivative, _ = enclosures().transport(
                *jacobian,
                equation.entries,
                self._signs,
                start,
                hull,
                V,
                D,
                w * (1 + 4 * UNIT),
                units,
                dim,
            )
            if (found < tube).all():
                accepted = found, d, derivative
                if width < _WIDE or (tube < 1.1 * found).all():
                    break
                tube = 1.02 * found  # a second proof in a narrower tube
            elif accepted is not None or not np.isfinite(found).all():
                break
            else:
                tube = np.maximum(tube, 2 * found)
        if accepted is None:
            self.reason = "the set of solutions became too wide"
            return None, 0.6
        found, d, derivative = accepted
        # Derivatives of H may be smooth where H is not, as those of acot(x) at 0.
        self._run_over_tube(self._energy, place, models, found)
        if not np.isfinite(self._energy.radius[equation.energy.results]).all():
            self.reason = "H is not smooth there, or was not resolved"
            return None, 0.5
        # A shorter window has a smaller rest d beside the derivative.
        room = _REST * self._accuracy + 0.03 * width
        share = float((d / safe).max())
        grown = float((d / units).max()) > _GROWTH * float((D / units).max())
        if share > room and grown and w > 1e-6 * float(self.total):
            return None, 0.6
        if share > 0.1 * room:
            factor = min(factor, 1.0)
        return self._accepted(place.half, models, V, D, d, derivative, offset, found, units), factor

    def _offset(self, models: ModelRows) -> np.ndarray:
        """Bounds on the distance of y(-1) from the centre."""
        dim = self.equation.dim
        high, low, radius = enclosures().end_values(models.high[:dim], models.low[:dim], -1)
        gap = (high - self._centre) + (low - self._centre_low)
        rounding = MIDDLE * (np.abs(high) + np.abs(self._centre))
        return np.asarray((np.abs(gap) + rounding + radius) * (1 + 1e-9) + 1e-290)

    def _hull(
        self, V: np.ndarray, start: np.ndarray, offset: np.ndarray, width: float
    ) -> np.ndarray:
        """Bounds on |V xi| over a window; of thin sets without regard to their shape."""
        sizes = np.abs(V).sum(axis=2)
        if width < _WIDE:
            return np.asarray((sizes @ start) * (1 + 1e-9))
        return (set_sizes(V, self._set.G, self._set.R[:, 0]) + sizes[:, : len(offset)] @ offset) * (
            1 + 1e-9
        )

    def _over_tube(
        self, place: _Place, models: ModelRows, tube: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Models of DG over a tube around y: coefficients, radii and lengths."""
        own = self._jacobian
        self._run_over_tube(own, place, models, tube)
        places = self.equation.placed[:, 2]
        # The half length may not be exact.
        radius = own.radius[places] + 8 * UNIT * np.abs(own.high[places]).sum(axis=1)
        return own.high[places], radius * (1 + 1e-9), own.length[places]

    def _run_over_tube(
        self, own: ModelRows, place: _Place, models: ModelRows, tube: np.ndarray
    ) -> None:
        dim, columns = self.equation.dim, self.equation.columns
        own.high[:dim] = models.high[:dim]
        own.low[:dim] = models.low[:dim]
        own.length[:dim] = self._terms
        own.radius[:dim] = tube
        own.high[dim:columns, 0] = self._constants
        own.radius[dim:columns] = self._unknown
        own.set_line(columns, place.middle, place.slope)
        own.run(double=False)

    def _couplings(self) -> np.ndarray:
        """Sizes of the entries of DG at the points, shape (dim, dim)."""
        dim = self.equation.dim
        i, j, place = self.equation.placed.T
        found = np.zeros((dim, self.equation.columns))
        np.add.at(found, (i, j), np.abs(self._rows[1][place]).max(axis=1))
        return found[:, :dim]

    def _units(
        self, w: float, couplings: np.ndarray, sizes: np.ndarray, least: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Units in which DG is nearly balanced (Osborne 1960), not rounded.

        ``sizes`` are those of the components on the windows so far, and ``least`` the smallest to
        be balanced.
        """
        dim, matrix = self.equation.dim, couplings.copy()
        np.fill_diagonal(matrix, 0.0)
        # A ball around zero gives a component its size: more than the radius, because roundings of
        # its shares in the unit are errors of the others, too. Errors of windows give none: they
        # are small in units of the component, which would be theirs.
        radii = self._set.initial_sizes()[:dim, 0]
        sizes = np.where(sizes < radii, _BESIDE * radii, sizes)
        safe = np.maximum(_sizes_of_all(sizes, matrix, w), least)
        safe = coupled_sizes(safe, matrix, w)
        matrix += 1e-3 / w * safe[:, None] / safe[None, :] * (1 - np.eye(dim))
        units = safe.copy()
        for _ in range(6):
            for i in range(dim):
                row = float(matrix[i] @ units) / units[i]
                column = float((matrix[:, i] / units).sum()) * units[i]
                units[i] *= math.sqrt(row / column)
        return units

    def _constant_units(self, half: Fraction, units: np.ndarray) -> np.ndarray:
        """Changes of the constants that move a component by its unit within half a window."""
        dim = self.equation.dim
        shares = np.zeros(self.equation.columns - dim)
        for i, j, place in self.equation.placed:
            if j >= dim:
                share = float(half) * np.abs(self._rows[1][place]).max() / units[i]
                shares[j - dim] = max(shares[j - dim], share)
        found = 1 / shares
        return np.where((found > 0) & (found < math.inf), found, 1.0)

    def _accepted(
        self,
        half: Fraction,
        models: ModelRows,
        V: np.ndarray,
        D: np.ndarray,
        d: np.ndarray,
        derivative: np.ndarray,
        offset: np.ndarray,
        tube: np.ndarray,
        units: np.ndarray,
    ) -> Window:
        dim, columns = self.equation.dim, self.equation.columns
        large = np.abs(V).sum(axis=2)
        beside = (large[:, :dim] @ offset + d + D) * (1 + 1e-9)
        J, J_error = np.eye(columns), np.zeros((columns, columns))
        J[:dim], rest, radius = enclosures().end_values(V, None, 1)
        J_error[:dim] = (np.abs(rest) + radius) * (1 + 1e-9)
        extra = np.zeros(columns)
        self._centre, self._centre_low, radius = enclosures().end_values(
            models.high[:dim], models.low[:dim], 1
        )
        extra[:dim] = (beside + radius) * (1 + 1e-9)
        window = Window(
            self.elapsed,
            half,
            models.high[:dim].copy(),
            models.low[:dim].copy(),
            V,
            self._set.G,
            self._set.R[:, 0],
            beside,
            derivative,
            J,
            J_error,
            tube,
            _powers_of_two(np.concatenate([units, self._constant_units(half, units)])),
        )
        self._set = self._set.moved(J, J_error, extra[:, None], window.units)
        if not np.isfinite(self._set.R).all():
            raise CertificationError("the enclosure became infinite; use an earlier end time")
        self.elapsed = window.end
        return window


def _powers_of_two(units: np.ndarray) -> np.ndarray:
    """Powers of two near numbers > 0, exact in any library: division by them is."""
    return np.ldexp(1.0, np.round(np.log2(units)).clip(-1022, 1023).astype(int))


def _two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """a + b rounded, and its error: a low part within half an ulp, as bounds of products need."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)


def _sizes_of_all(sizes: np.ndarray, couplings: np.ndarray, w: float) -> np.ndarray:
    """Sizes of all components, positive also for those that are at rest.

    Such a component has the size that the others drive it to, or else that which would move
    another one by its own size within w. Without such couplings, the product of a coordinate and
    its momentum is compared with those of the others: all have the dimension of H times time.
    Components are never compared otherwise, because they may have different dimensions.
    """
    found = coupled_sizes(np.where(sizes > _AT_REST, sizes, 0.0), couplings, w)
    half = len(found) // 2
    action = float((np.sqrt(found[:half]) * np.sqrt(found[half:])).max())  # its root
    while (at_rest := found == 0).any():
        moved = np.where((couplings > 0) & ~at_rest[:, None], found[:, None], math.inf)
        moving = (moved / couplings).min(axis=0) / w
        chosen = np.flatnonzero(at_rest & (moving < math.inf))
        if len(chosen):
            found[chosen] = np.maximum(moving[chosen], math.ulp(0.0))  # it may underflow
        else:  # nothing moves it, and it moves nothing
            i = int(np.flatnonzero(at_rest)[0])
            found[i] = _size_beside(i, couplings, w, _UNCOUPLED * action or _LEAST)
        found = coupled_sizes(found, couplings, w)
    return found


def _size_beside(i: int, couplings: np.ndarray, w: float, action: float) -> float:
    """The size of a component whose product with its partner is the square of ``action``."""
    dim = len(couplings)
    partner = (i + dim // 2) % dim
    alone = np.zeros(dim)
    alone[i] = 1.0
    ratio = float(coupled_sizes(alone, couplings, w)[partner])
    if ratio == 0:
        ratio = float(1 / (w * couplings[i, partner]))
    found = action / math.sqrt(ratio) if ratio > 0 else math.inf
    return found if 0 < found < math.inf else _LEAST


@functools.lru_cache(maxsize=64)
def equation_of(H: Hamiltonian, unknown: tuple[str, ...] = ()) -> Equation:
    """The equation of a Hamiltonian, kept for other solutions of it."""
    return Equation(H, unknown)
