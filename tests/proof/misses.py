"""Searches for arguments at which a compiled enclosure does not contain the true value.

Each function takes the functions ``L`` of a library (:mod:`hamsym.kernel.enclosures`), so that the
tests of mutations can run the same searches on a weakened one. The truth is computed in Arb with
some hundred bits or in fractions, never by the code under test. A miss is a tuple that shows the
arguments and the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from hamsym.kernel.enclosures import Models as Rows
from hamsym.numerics.collocation import chebyshev_tables
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.programs import Program, Recorder
from tests.proof import kernel_calls

BITS = 300
UNIT = 2.0**-53

Triple = tuple[float, float, float]


# -- balls -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawn:
    """A function of one ball: its values in Arb and an array of arguments in its domain."""

    truth: Callable[[arb], Any]
    draw: Callable[[np.random.Generator, int], np.ndarray]


def _powers(low: float, high: float, signed: bool = True) -> Callable[..., np.ndarray]:
    """Numbers whose decimal logarithms are uniform."""

    def draw(rng: np.random.Generator, count: int) -> np.ndarray:
        found = 10.0 ** rng.uniform(low, high, count)
        return found * rng.choice([-1.0, 1.0], count) if signed else found

    return draw


def _near_one(rng: np.random.Generator, count: int) -> np.ndarray:
    """Numbers in (-1, 1), of which some are near an end and some near 0."""
    distance = 10.0 ** rng.uniform(-12, 0, count)
    found = np.where(rng.random(count) < 0.5, 1 - distance, distance)
    return np.clip(found * rng.choice([-1.0, 1.0], count), -1 + 1e-12, 1 - 1e-12)


UNARY: dict[str, Drawn] = {
    "root": Drawn(lambda x: x.sqrt(), _powers(-150, 300, signed=False)),
    "exponential": Drawn(lambda x: x.exp(), _powers(-30, 2.8)),
    "sine": Drawn(lambda x: x.sin(), _powers(-30, 11)),
    "cosine": Drawn(lambda x: x.cos(), _powers(-30, 11)),
    "logarithm": Drawn(lambda x: x.log(), _powers(-280, 280, signed=False)),
    "arctangent": Drawn(lambda x: x.atan(), _powers(-30, 100)),
    "arcsine": Drawn(lambda x: x.asin(), _near_one),
    "arccosine": Drawn(lambda x: x.acos(), _near_one),
    "inverse_hyperbolic_sine": Drawn(lambda x: x.asinh(), _powers(-30, 100)),
    "inverse_hyperbolic_cosine": Drawn(
        lambda x: x.acosh(), lambda rng, n: 1 + _powers(-12, 100, signed=False)(rng, n)
    ),
    "inverse_hyperbolic_tangent": Drawn(lambda x: x.atanh(), _near_one),
    "error_function": Drawn(lambda x: x.erf(), _powers(-30, 1.5)),
}
BINARY: dict[str, Callable[[arb, arb], Any]] = {
    "add": lambda x, y: x + y,
    "multiply": lambda x, y: x * y,
    "divide": lambda x, y: x / y,
}


def all_applied(L: Any, name: str, *balls: np.ndarray) -> list[Triple]:
    """A function of balls (n, 3) by name; sine and cosine are two results of one function."""
    if name in ("sine", "cosine"):
        return triples(kernel_calls.balls(L, "sine_cosine", *balls)[:, 0 if name == "sine" else 1])
    return triples(kernel_calls.balls(L, name, *balls))


def applied(L: Any, name: str, *balls: Triple) -> Triple:
    return all_applied(L, name, *(np.array([ball]) for ball in balls))[0]


def drawn_balls(rng: np.random.Generator, middles: np.ndarray) -> np.ndarray:
    """Balls (n, 3) around mid-points: half of them exact, radii of 30 magnitudes."""
    count = len(middles)
    low = middles * rng.uniform(-1, 1, count) * 2 * UNIT
    radius = np.abs(middles) * 10.0 ** rng.uniform(-31, -1, count)
    radius[rng.random(count) < 0.5] = 0.0
    return np.stack([middles, low, radius], axis=1)


def triples(balls: np.ndarray) -> list[Triple]:
    return [(high, low, radius) for high, low, radius in balls.tolist()]


def point(ball: Triple, share: float) -> arb:
    """The number h + l + share r, |share| <= 1."""
    high, low, radius = ball
    return arb(high) + arb(low) + (arb(radius) * arb(share) if radius and share else 0)


def inside(ball: Triple, truth: Any) -> bool:
    """Whether a number is certainly in a ball; a ball of infinite radius has all numbers."""
    high, low, radius = ball
    if not radius < math.inf:
        return True
    if not (math.isfinite(high) and math.isfinite(low)):
        return False
    return bool(abs(truth - arb(high) - arb(low)) <= arb(radius))


def unary_misses(L: Any, name: str, count: int, seed: int) -> tuple[list[Any], list[Any]]:
    """Balls that do not contain the function at a point, and exact arguments without a result."""
    rng = np.random.default_rng(seed)
    drawn, missed, refused = UNARY[name], [], []
    with working(BITS):
        balls = drawn_balls(rng, drawn.draw(rng, count))
        shares = rng.choice([-1.0, 1.0, 0.0, *rng.uniform(-1, 1, 3)], count)
        results = all_applied(L, name, balls)
        for x, share, found in zip(triples(balls), shares.tolist(), results, strict=True):
            if not found[2] < math.inf:
                if x[2] == 0:
                    refused.append((name, x, found))
                continue
            truth = drawn.truth(point(x, share))
            # A ball of finite radius, although an argument in it is outside the domain.
            if not (isinstance(truth, arb) and truth.is_finite() and inside(found, truth)):
                missed.append((name, x, share, found))
    return missed, refused


def drawn_pairs(
    name: str, count: int, seed: int, size: float = 150.0
) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays of balls, for sums also of numbers that nearly cancel."""
    rng = np.random.default_rng(seed)
    first = _powers(-size, size)(rng, count)
    second = _powers(-size, size)(rng, count)
    near = rng.random(count) < 0.6  # of a size at which roundings matter in sums
    second = np.where(near, -first * 10.0 ** rng.uniform(-17, 17, count), second)
    close = rng.random(count) < 0.2
    second = np.where(close, -first * (1 + rng.normal(size=count) * 1e-15), second)
    if name != "add":
        second = _powers(-size, size)(rng, count)
    return drawn_balls(rng, first), drawn_balls(rng, second)


def pairs(arrays: tuple[np.ndarray, np.ndarray]) -> list[tuple[Triple, Triple]]:
    return list(zip(triples(arrays[0]), triples(arrays[1]), strict=True))


def binary_misses(
    L: Any, name: str, operands: Sequence[tuple[Triple, Triple]], bits: int = BITS
) -> tuple[list[Any], list[Any]]:
    """As :func:`unary_misses`, at the ends of both balls."""
    missed, refused = [], []
    results = all_applied(L, name, *(np.array(part) for part in zip(*operands, strict=True)))
    with working(bits):
        for k, ((x, y), found) in enumerate(zip(operands, results, strict=True)):
            if not found[2] < math.inf:
                if x[2] == y[2] == 0:
                    refused.append((name, x, y, found))
                continue
            s, t = ((1, 1), (1, -1), (-1, 1), (-1, -1))[k % 4]
            truth = BINARY[name](point(x, s), point(y, t))
            if not (truth.is_finite() and inside(found, truth)):
                missed.append((name, x, y, found))
    return missed, refused


# -- many sums and products, by error-free transformations -----------------------------------------


def _two_sum(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def _two_product(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dekker's product, exact within 1e-120 .. 1e120."""

    def halves(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scaled = x * 134217729.0
        top = scaled - (scaled - x)
        return top, x - top

    p = a * b
    (a1, a2), (b1, b2) = halves(a), halves(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def exact_sum(parts: list[np.ndarray]) -> np.ndarray:
    """Sums with an error of u |sum| + (n u)^3 times the sum of magnitudes (Ogita 2005, SumK)."""
    parts = list(parts)
    for _ in range(3):
        for k in range(1, len(parts)):
            parts[k], parts[k - 1] = _two_sum(parts[k], parts[k - 1])
    return sum(parts[:-1]) + parts[-1]


def remainders(name: str, x: np.ndarray, y: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Distances of exact sums or products at ends of the balls from the mid-points of results."""
    columns = [x[:, 0], x[:, 1], x[:, 2]], [y[:, 0], y[:, 1], y[:, 2]]
    if name == "add":
        parts = [*columns[0], *columns[1]]
    else:
        parts = [part for a in columns[0] for b in columns[1] for part in _two_product(a, b)]
    return np.abs(exact_sum([*parts, -found[:, 0], -found[:, 1]]))


# -- models ----------------------------------------------------------------------------------------

TERMS = 32


@dataclass(frozen=True)
class Formula:
    """A function as a program, its truth, and where its arguments may be.

    Attributes
    ----------
    record : callable
        From the arithmetic of a recorder and its first registers to the result.
    truth : callable
        In Arb.
    middles, swing : (float, float), float
        Range of the constant terms, and the largest size of the other terms.
    variables : int
    """

    record: Callable[..., Any]
    truth: Callable[..., Any]
    middles: tuple[float, float]
    swing: float
    variables: int = 1


def _named(name: str) -> Callable[..., Any]:
    return lambda arithmetic, *values: getattr(arithmetic, name)(*values)


FORMULAS: dict[str, Formula] = {
    "sum": Formula(lambda _, x, y: x + y, lambda x, y: x + y, (-3, 3), 2, 2),
    "difference": Formula(lambda _, x, y: x - y, lambda x, y: x - y, (-3, 3), 2, 2),
    "product": Formula(lambda _, x, y: x * y, lambda x, y: x * y, (-3, 3), 2, 2),
    "multiple": Formula(lambda _, x: x * arb("0.1"), lambda x: x * arb("0.1"), (-3, 3), 2),
    "negative": Formula(lambda _, x: -x, lambda x: -x, (-3, 3), 2),
    "reciprocal": Formula(_named("reciprocal"), lambda x: 1 / x, (1, 5), 0.8),
    "reciprocal_root": Formula(_named("reciprocal_root"), lambda x: x.rsqrt(), (1, 5), 0.8),
    "root": Formula(_named("root"), lambda x: x.sqrt(), (1, 5), 0.8),
    "power": Formula(_named("general_power"), lambda x, y: x**y, (1, 3), 0.6, 2),
    "atan2": Formula(_named("atan2"), lambda y, x: arb.atan2(y, x), (0.5, 3), 0.3, 2),
    "exp": Formula(_named("exp"), lambda x: x.exp(), (-4, 4), 3),
    "sin": Formula(_named("sin"), lambda x: x.sin(), (-9, 9), 3),
    "cos": Formula(_named("cos"), lambda x: x.cos(), (-9, 9), 3),
    "log": Formula(_named("log"), lambda x: x.log(), (1, 5), 0.8),
    "tan": Formula(_named("tan"), lambda x: x.tan(), (-0.2, 0.2), 1),
    "atan": Formula(_named("atan"), lambda x: x.atan(), (-3, 3), 1),
    "asin": Formula(_named("asin"), lambda x: x.asin(), (-0.2, 0.2), 0.6),
    "acos": Formula(_named("acos"), lambda x: x.acos(), (-0.2, 0.2), 0.6),
    "sinh": Formula(_named("sinh"), lambda x: x.sinh(), (-3, 3), 2),
    "cosh": Formula(_named("cosh"), lambda x: x.cosh(), (-3, 3), 2),
    "tanh": Formula(_named("tanh"), lambda x: x.tanh(), (-2, 2), 0.8),
    "asinh": Formula(_named("asinh"), lambda x: x.asinh(), (-3, 3), 0.8),
    "acosh": Formula(_named("acosh"), lambda x: x.acosh(), (2.5, 5), 0.8),
    "atanh": Formula(_named("atanh"), lambda x: x.atanh(), (-0.2, 0.2), 0.6),
    "erf": Formula(_named("erf"), lambda x: x.erf(), (-2, 2), 1),
}


def program_of(formula: Formula) -> Program:
    recorder = Recorder(formula.variables)
    with working(240):
        result = formula.record(recorder.arithmetic, *recorder.variables)
    return Program(recorder, [result])


@dataclass
class Model:
    """A series in two floats, and its radius."""

    high: np.ndarray
    low: np.ndarray
    radius: float


def ran(L: Any, program: Program, models: Sequence[Model], double: bool) -> Model:
    """The model of the result of a program."""
    using, rows = chebyshev_tables(TERMS), program.registers
    high, low = np.zeros((rows, TERMS)), np.zeros((rows, TERMS))
    radius, length = np.zeros(rows), np.ones(rows, dtype=np.int64)
    high[program.constants, 0], radius[program.constants] = program.numbers[:, [0, 2]].T
    if double:
        low[program.constants, 0] = program.numbers[:, 1]
    else:
        radius[program.constants] += np.abs(program.numbers[:, 1]) * 1.000001
    for k, model in enumerate(models):
        count = len(model.high)
        high[k, :count], low[k, :count] = model.high, model.low
        radius[k], length[k] = model.radius, count
    rows_of = Rows(using.values, using.series, high, low, radius, length)
    L.run_models(program.steps, rows_of, double)
    place = program.results[0]
    n = length[place]
    return Model(high[place, :n].copy(), low[place, :n].copy(), float(radius[place]))


def drawn_model(rng: np.random.Generator, formula: Formula, double: bool, wide: bool) -> Model:
    """Coefficients that decay at a random rate; constant models now and then."""
    count = int(rng.choice([1, 2, 5, 20, TERMS]))
    high = rng.uniform(-1, 1, count) * rng.uniform(0.05, 0.6) ** np.arange(count)
    if count > 1:
        high[1:] *= formula.swing * rng.uniform(0.01, 1) / np.abs(high[1:]).sum()
    high[0] = rng.uniform(*formula.middles)
    low = high * rng.uniform(-1, 1, count) * UNIT if double else np.zeros(count)
    radius = formula.swing * 10.0 ** rng.uniform(-20, -1.5) if wide else 0.0
    return Model(high, low, radius)


def polynomials(x: float, count: int) -> list[arb]:
    """T_0(x) .. T_count-1(x) by the recurrence, in the working precision."""
    found = [arb(1), arb(x)]
    while len(found) < count:
        found.append(2 * arb(x) * found[-1] - found[-2])
    return found


def series_value(high: Sequence[float], low: Sequence[float], basis: Sequence[arb]) -> arb:
    total = arb(0)
    for h, m, t in zip(high, low, basis, strict=False):
        total += (arb(h) + arb(m)) * t
    return total


def places(rng: np.random.Generator, count: int) -> list[float]:
    return [-1.0, 1.0, 0.0, *rng.uniform(-1, 1, count).tolist()]


def model_misses(
    L: Any, name: str, double: bool, count: int, seed: int, *, narrow: bool = False
) -> tuple[list[Any], int]:
    """Models that do not contain their function at a point, and the number without a radius."""
    rng = np.random.default_rng(seed)
    formula, missed, refused = FORMULAS[name], [], 0
    program = program_of(formula)
    with working(400):
        for k in range(count):
            wide = k % 2 == 1 and not narrow
            models = [drawn_model(rng, formula, double, wide) for _ in range(formula.variables)]
            found = ran(L, program, models, double)
            if not found.radius < math.inf:
                refused += 1
                continue
            for x in places(rng, 5):
                basis = polynomials(x, TERMS)
                truth = formula.truth(*(_chosen(rng, model, basis) for model in models))
                value = series_value(found.high.tolist(), found.low.tolist(), basis)
                # The truth has an error of 1e-110, and a negative has the radius of its argument.
                apart = abs(truth - value) - arb(found.radius)
                if not apart <= arb(2) ** -340:
                    missed.append((name, double, models, found.radius, x))
                    break
    return missed, refused


def _chosen(rng: np.random.Generator, model: Model, basis: Sequence[arb]) -> arb:
    """A number in a model, often at its ends."""
    share = float(rng.choice([-1.0, 1.0, rng.uniform(-1, 1)]))
    middle = series_value(model.high.tolist(), model.low.tolist(), basis)
    return middle + arb(model.radius) * arb(share)


# -- operations on series, in fractions -----------------------------------------------------------


def fractions(high: Any, low: Any = None) -> list[Fraction]:
    """Exact coefficients of a series in two floats."""
    parts = [np.asarray(part).tolist() for part in (high, low) if part is not None]
    return [sum(map(Fraction, column), Fraction(0)) for column in zip(*parts, strict=True)]


def product_of(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    found = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] += x * y / 2
            found[abs(i - j)] += x * y / 2
    return found


def integral_of(c: list[Fraction]) -> list[Fraction]:
    """The integral from -1."""
    found = [Fraction(0)] * (len(c) + 1)
    for k, value in enumerate(c):
        if k == 0:
            found[1] += value
        elif k == 1:
            found[2] += value / 4
        else:
            found[k + 1] += value / (2 * (k + 1))
            found[k - 1] -= value / (2 * (k - 1))
    found[0] = -sum((value * (-1) ** k for k, value in enumerate(found) if k), Fraction(0))
    return found


def derivative_of(c: list[Fraction]) -> list[Fraction]:
    found = [Fraction(0)] * max(len(c) - 1, 1)
    for k, value in enumerate(c):
        for j in range(k - 1, -1, -2):
            found[j] += 2 * k * value / (2 if j == 0 else 1)
    return found


def distance(found: list[Fraction], exact: list[Fraction]) -> Fraction:
    """Sum of the differences of coefficients, a bound on the difference on [-1, 1]."""
    size = max(len(found), len(exact))
    padded = [[*c, *[Fraction(0)] * (size - len(c))] for c in (found, exact)]
    return sum((abs(a - b) for a, b in zip(*padded, strict=True)), Fraction(0))


def drawn_series(
    rng: np.random.Generator, count: int, double: bool
) -> tuple[np.ndarray, np.ndarray]:
    high = rng.normal(size=count) * rng.uniform(0.3, 1.0) ** np.arange(count)
    high *= 10.0 ** rng.uniform(-3, 3)
    return high, high * rng.uniform(-1, 1, count) * UNIT if double else np.zeros(count)


def series_misses(L: Any, name: str, double: bool, count: int, seed: int) -> list[Any]:
    """multiply_series, integrate_series, differentiate_series: bounds below the true errors."""
    rng, missed = np.random.default_rng(seed), []
    for _ in range(count):
        n, m = (int(rng.choice([1, 2, 3, 7, 20, TERMS])) for _ in range(2))
        (ah, al), (bh, bl) = drawn_series(rng, n, double), drawn_series(rng, m, double)
        oh, ol = rng.normal(size=(2, 2 * TERMS + 2))  # what was there before must not matter
        a, b = fractions(ah, al), fractions(bh, bl)
        if name == "multiply_series":
            bound = kernel_calls.multiply_series(L, (ah, al), (bh, bl), (oh, ol), double)
            exact = product_of(a, b)
        elif name == "integrate_series":
            bound = kernel_calls.integrate_series(L, (ah, al), (oh, ol), double)
            exact = integral_of(a)
        else:
            bound = L.differentiate_series((ah, al), (oh, ol), double)
            exact = derivative_of(a)
        size = len(exact)
        if not distance(fractions(oh[:size], ol[:size]), exact) <= Fraction(bound):
            missed.append((name, double, ah, bh, bound))
    return missed


def end_misses(L: Any, count: int, seed: int) -> list[Any]:
    """end_values: balls without the value at -1 or 1."""
    rng, missed = np.random.default_rng(seed), []
    for k in range(count):
        n = int(rng.choice([1, 2, 3, 7, 20, TERMS]))
        high, low = drawn_series(rng, n, double=True)
        if k % 2 and n > 1:  # a value that nearly vanishes
            high[0] = -high[1:].sum()
        for end in (-1, 1):
            found = L.end_values(high, low, end)
            exact = sum(c * end**j for j, c in enumerate(fractions(high, low)))
            if not abs(exact - Fraction(found[0]) - Fraction(found[1])) <= Fraction(found[2]):
                missed.append((high, end, found))
    return missed


# -- steps of windows ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Transport:
    """A linear equation dz/dx = (1 + b x) (A z + B k), and guesses for its enclosure.

    Attributes
    ----------
    A : numpy.ndarray
        Matrix (dim, columns); the last columns belong to parameters.
    start, D : numpy.ndarray
        Bounds on |xi| and on the defect.
    F : numpy.ndarray
        V(-1) - I, shape (dim, columns).
    flat : bool
        V is constant, in place of the flow.
    ripple : numpy.ndarray or None
        Coefficients of a term T_20 of V, which is small beside its derivative.
    slope : float
        The number b.
    loose : float
        Radius of the models of A, without a slope; the true matrix is at their end.
    units : tuple of float
    """

    A: np.ndarray
    start: np.ndarray
    D: np.ndarray
    F: np.ndarray
    flat: bool = False
    ripple: np.ndarray | None = None
    slope: float = 0.0
    loose: float = 0.0
    units: tuple[float, ...] = (1.0, 1.0)

    def elapsed(self, x: np.ndarray) -> np.ndarray:
        """The integral of 1 + b x from -1: the flow is that of A over this time."""
        return (x + 1) * (1 + self.slope * (x - 1) / 2)


def _flow(matrix: np.ndarray, times: np.ndarray) -> np.ndarray:
    """exp(matrix t) at times, by its power series and squares."""
    scaled = matrix[None] * times[:, None, None] / 1024
    found = np.eye(len(matrix)) + np.zeros_like(scaled)
    term = found.copy()
    for k in range(1, 12):
        term = term @ scaled / k
        found = found + term
    for _ in range(10):
        found = found @ found
    return found


def guess(case: Transport) -> np.ndarray:
    """Coefficients of V, shape (dim, columns, terms)."""
    dim, columns = case.A.shape
    using = chebyshev_tables(TERMS)
    square = np.zeros((columns, columns))
    square[:dim] = case.A
    times = np.zeros(TERMS) if case.flat else case.elapsed(using.points)
    begin = np.eye(columns)
    begin[:dim] += case.F
    values = (_flow(square, times) @ begin)[:, :dim]  # (points, dim, columns)
    V = np.ascontiguousarray(np.tensordot(values, using.series, (0, 0)))
    if case.ripple is not None:
        V[:, :, 20] += case.ripple
    return V


def transport_bounds(L: Any, case: Transport) -> Any:
    """The bounds of the step."""
    dim, columns = case.A.shape
    V = guess(case)
    places = [(i, j) for i in range(dim) for j in range(columns)]
    jacobian = np.zeros((len(places), TERMS))
    jacobian[:, 0] = [2 * case.A[i, j] for i, j in places]
    jacobian[:, 1] = case.slope * jacobian[:, 0]
    length = np.full(len(places), 2, dtype=np.int64)
    entries = np.array([(i, j, k) for k, (i, j) in enumerate(places)], dtype=np.int64)
    signed = entries, np.ones(len(places))
    half, sizes = 0.5, np.abs(V).sum(axis=2) * (1 + 1e-12)  # half the length: A = 0.5 G
    return L.transport(
        *(jacobian, np.full(len(places), 2 * case.loose), length, *signed),
        *(case.start, sizes @ case.start, sizes),
        *L.flow_defects(jacobian, length, *signed, V, sizes, half),
        *(case.D, half, np.array(case.units)),
    )


def transport_misses(L: Any, case: Transport) -> list[Any]:
    """Components in which d - K xi or V_d - K of the true equation is beyond the bounds.

    With the flow Phi, (d - K xi)(x) = (Phi(x) - V(x)) xi - int Phi(x) Phi(s)^-1 A(s) D(s) ds, for
    the worst xi and the worst D at each s; and V_d - K = Phi - V.
    """
    dim, columns = case.A.shape
    (tube, d, derivative, _), V = transport_bounds(L, case), guess(case)
    grid = np.linspace(-1, 1, 2001)
    basis = np.polynomial.chebyshev.chebvander(grid, TERMS - 1)
    V_grid = np.moveaxis(V @ basis.T, 2, 0)
    elapsed, missed = case.elapsed(grid), []
    for sign in (1.0, -1.0):
        true = case.A + sign * case.loose
        square = np.zeros((columns, columns))
        square[:dim] = true
        flow = _flow(square, elapsed)[:, :dim]
        weights = np.full(len(grid), 1e-3)
        weights[[0, -1]] /= 2
        for last in (500, 1000, 2000):
            to_end = _flow(square, elapsed[last] - elapsed[: last + 1])[:, :dim, :dim]
            forcing = to_end @ true[:, :dim] * (1 + case.slope * grid[: last + 1])[:, None, None]
            w = weights[: last + 1].copy()
            w[-1] = 5e-4
            by_defect = np.einsum("t,tij->ij", w, np.abs(forcing)) @ case.D
            apart = np.abs(flow[last] - V_grid[last])
            largest = apart @ case.start + by_defect
            reach = np.abs(V_grid[last]) @ case.start + case.D + largest
            checks = (("d", largest, d), ("tube", reach, tube), ("V_d", apart, derivative))
            for name, value, bound in checks:
                if not (value <= bound * (1 + 1e-5) + 1e-13).all():
                    missed.append((name, sign, last, value, bound))
    return missed


def _inverse_times(matrix: np.ndarray, vector: list[Fraction]) -> list[Fraction]:
    """Solve a linear system exactly."""
    n = len(matrix)
    rows = [
        [*map(Fraction, row), value] for row, value in zip(matrix.tolist(), vector, strict=True)
    ]
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for i in range(n):
            if i != k:
                factor = rows[i][k] / rows[k][k]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return [rows[k][n] / rows[k][k] for k in range(n)]


def _times(matrix: Any, vector: list[Fraction]) -> list[Fraction]:
    return [
        sum((Fraction(float(a)) * b for a, b in zip(row, vector, strict=True)), Fraction(0))
        for row in matrix
    ]


def set_misses(L: Any, name: str, count: int, seed: int) -> list[Any]:
    """moved_set, boxed_set, set_radius: sets that do not contain a corner of the exact one."""
    rng, missed = np.random.default_rng(seed), []
    for k in range(count):
        n = int(rng.integers(2, 5))
        m = n * int(rng.integers(1, 4))  # columns of several windows
        J, E = rng.normal(size=(n, n)), np.zeros((n, n))
        G = rng.normal(size=(n, m)) * 10.0 ** rng.uniform(-6, 6, m)
        R = 10.0 ** rng.uniform(-12, 0, (m, 2))
        if k % 3:
            E = np.abs(rng.normal(size=(n, n))) * 10.0 ** rng.uniform(-18, -3)
        if k % 3 == 2:  # shears, whose sets are long and thin
            J = np.eye(n) + 1e8 * np.triu(J, 1)
            G = J @ G
        if k % 7 == 6:  # columns that are nearly parallel, or zero
            G[:, 1:] = G[:, :1] * (1 + 1e-9 * rng.normal(size=(n, m - 1)))
            G[:, -1] = 0.0
        units = np.ones(n)
        if k % 2 and name == "boxed_set":  # components of different dimensions
            units = 2.0 ** rng.integers(-90, 90, n)
            G = G * units[:, None]
        for kind in range(2):
            r = [Fraction(v) * int(rng.choice([-1, 1])) for v in R[:, kind].tolist()]
            inner = _times(G, r)
            if name == "boxed_set":
                found, radii = L.boxed_set(G, R, units)
                fine = all(
                    b == math.inf or abs(a) <= Fraction(b)
                    for a, b in zip(
                        _inverse_times(found, inner), radii[:, kind].tolist(), strict=True
                    )
                )
            else:
                signs = rng.choice([-1.0, 1.0], (n, n))
                true = [
                    [Fraction(a) + Fraction(b) for a, b in zip(*rows, strict=True)]
                    for rows in zip(J, E * signs, strict=True)
                ]
                moved = _exact_times(true, inner)
                if name == "moved_set":
                    found, rest = L.moved_set(J, E, G, R)
                    moved = [a - b for a, b in zip(moved, _times(found, r), strict=True)]
                else:
                    rest = L.set_radius(J, E, G, R)
                bounds = rest[:, kind].tolist()
                fine = all(abs(a) <= Fraction(b) for a, b in zip(moved, bounds, strict=True))
            if not fine:
                missed.append((name, J, E, G, R))
    return missed


def _exact_times(matrix: list[list[Fraction]], vector: list[Fraction]) -> list[Fraction]:
    return [sum((a * b for a, b in zip(row, vector, strict=True)), Fraction(0)) for row in matrix]


def exact_polynomials(x: Fraction, count: int) -> list[Fraction]:
    found = [Fraction(1), x]
    while len(found) < count:
        found.append(2 * x * found[-1] - found[-2])
    return found[:count]


def value_misses(L: Any, name: str, count: int, seed: int) -> list[Any]:
    """chebyshev_balls, vector_value, matrix_value: values of series at a point."""
    rng, missed = np.random.default_rng(seed), []
    for k in range(count):
        x = float(rng.choice([-1.0, 1.0, rng.uniform(-1, 1)]))
        place = (x, 0.0, 0.0) if k % 2 else (x, x * 2.0**-55, 1e-33)
        exact = exact_polynomials(Fraction(place[0]) + Fraction(place[1]), TERMS)
        basis = L.chebyshev_balls(place, TERMS)
        high, low = drawn_series(rng, TERMS, double=True)
        if name == "chebyshev_balls":
            results = [
                (Fraction(b[0]) + Fraction(b[1]), Fraction(b[2]), e)
                for b, e in zip(basis.tolist(), exact, strict=True)
            ]
        elif name == "vector_value":
            h, m, r = L.vector_value(high[None], low[None], basis)[0].tolist()
            truth = _exact_times([fractions(high, low)], exact)[0]
            results = [(Fraction(h) + Fraction(m), Fraction(r), truth)]
        else:
            value, error = L.matrix_value(high[None, None], basis)
            truth = _exact_times([fractions(high)], exact)[0]
            results = [(Fraction(value[0, 0]), Fraction(error[0, 0]), truth)]
        if not all(abs(found - truth) <= radius for found, radius, truth in results):
            missed.append((name, place, high))
    return missed


def dense_misses(L: Any, count: int, seed: int) -> list[Any]:
    """Dense layers of models whose sums do not contain the exact ones."""
    rng, missed = np.random.default_rng(seed), []
    for k in range(count):
        inputs, outputs = int(rng.choice([1, 3, 20])), 2
        weights, bias = rng.normal(size=(outputs, inputs)), rng.normal(size=outputs)
        high, low = np.zeros((2, inputs, 8))
        length = rng.integers(1, 9, inputs)
        for j, n in enumerate(length):
            high[j, :n], low[j, :n] = drawn_series(rng, int(n), double=True)
        if k % 2:  # without constant terms, whose roundings would cover the others
            bias[:], high[:, 0], low[:, 0] = 0.0, 0.0, 0.0
        radius = 10.0 ** rng.uniform(-40, -2, inputs) * (rng.random(inputs) < 0.3)
        oh, ol, error, lengths = L.dense(weights, bias, high, low, radius, length)
        for i in range(outputs):
            exact = [Fraction(0)] * 8
            exact[0] += Fraction(bias[i])
            beside = Fraction(0)
            for j, n in enumerate(length):
                beside += abs(Fraction(weights[i, j])) * Fraction(radius[j])
                for m, value in enumerate(fractions(high[j, :n], low[j, :n])):
                    exact[m] += Fraction(weights[i, j]) * value
            n = lengths[i]
            apart = distance(fractions(oh[i, :n], ol[i, :n]), exact) + beside
            if not apart <= Fraction(error[i]):
                missed.append((weights[i], bias[i], error[i]))
    return missed


def clenshaw_misses(L: Any, count: int, seed: int) -> list[Any]:
    """Series of series: models of sum c_k T_k(a + b x) that miss a value."""
    rng, missed = np.random.default_rng(seed), []
    for k in range(count):
        n, columns, terms = int(rng.choice([1, 2, 8, 20])), 2, 24
        ch = rng.normal(size=(n, columns)) * rng.uniform(0.4, 1, (n, 1)) ** np.arange(n)[:, None]
        cl = ch * rng.uniform(-1, 1, ch.shape) * UNIT
        b = rng.uniform(-0.5, 0.5)
        a = rng.uniform(-1, 1) * (1 - abs(b))
        wide = 1e-12 if k % 2 else 0.0
        oh, ol, error, lengths = L.clenshaw(
            ch, cl, (a, a * UNIT / 4, wide), (b, b * UNIT / 4, wide), terms
        )
        for x in places(rng, 3):
            share = Fraction(wide) * int(rng.choice([-1, 1]))
            line = (
                Fraction(a)
                + Fraction(a * UNIT / 4)
                + share
                + (Fraction(b) + Fraction(b * UNIT / 4) + share) * Fraction(x)
            )
            outer = exact_polynomials(line, n)
            inner = exact_polynomials(Fraction(x), terms)
            for i in range(columns):
                truth = _exact_times([fractions(ch[:, i], cl[:, i])], outer)[0]
                m = lengths[i]
                value = _exact_times([fractions(oh[i, :m], ol[i, :m])], inner[:m])[0]
                if not abs(truth - value) <= Fraction(error[i]):
                    missed.append((a, b, x, ch[:, i], error[i]))
    return missed


def enclosure_misses(
    L: Any, enclosure: Any, times: Sequence[float], states: Sequence[Sequence[arb]]
) -> list[Any]:
    """Times at which the enclosure does not contain a state.

    The ball of float64 has a mid-point rounded to 2**-53; the two floats of the value and the
    radius without this rounding are compared too.
    """
    missed = []
    with working(BITS):
        for t, state in zip(times, states, strict=True):
            shown = enclosure(t)
            k, basis = enclosure._place(t)
            window = enclosure.windows[k]
            value = L.vector_value(window.high, window.low, basis)
            matrix, error = L.matrix_value(window.V, basis)
            spread = L.set_radius(matrix, error, window.G, window.R[:, None])[:, 0]
            for i, truth in enumerate(state):
                public = (float(shown.mid[i]), 0.0, float(shown.radius[i]))
                radius = spread[i] + window.beside[i] + value[i, 2]
                sharp = (value[i, 0], value[i, 1], float(radius) * (1 + 1e-9))
                if not (inside(public, truth) and inside(sharp, truth)):
                    missed.append((t, i, public, sharp, truth.str(40)))
    return missed
