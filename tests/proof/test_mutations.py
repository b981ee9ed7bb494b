"""Each bound of the compiled enclosures is needed: without it a search finds a miss.

The text of the compiled functions is weakened in one place, loaded as another module, and searched
for arguments at which it does not contain the truth. The same search finds nothing in the text as
it is. Three bounds are below the roundings of the operation that follows them, so that no argument
shows them: the remainders of the Taylor series of exp (below 1e-45), of sin and cos (5e-36), and of
the error function (1e-34).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import hamsym.proof.enclose
import hamsym.proof.programs
import hamsym.proof.windows
from hamsym.proof import compiled
from hamsym.proof.balls import working
from tests.proof.misses import (
    FORMULAS,
    Model,
    Transport,
    binary_misses,
    clenshaw_misses,
    dense_misses,
    drawn_pairs,
    enclosure_misses,
    end_misses,
    inside,
    model_misses,
    pairs,
    point,
    product_misses,
    program_of,
    ran,
    series_misses,
    set_misses,
    transport_misses,
    unary_misses,
    value_misses,
)
from tests.proof.test_ball_arithmetic import special_pairs
from tests.proof.test_enclose import CASES as PROBLEMS
from tests.proof.test_enclose import reference, sampled
from tests.proof.test_window_steps import CASES, transport

pytestmark = pytest.mark.slow

Changes = tuple[tuple[str, str], ...]


@functools.cache
def changed(changes: Changes) -> Any:
    """The compiled functions with passages of their text replaced."""
    if not changes:
        return compiled.loops()
    text = compiled._text()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return compiled.module_of(text, "weakened")


@dataclass(frozen=True)
class Mutation:
    """A weakened bound.

    Attributes
    ----------
    old, new : str
    search : callable
        From the module to a list of misses.
    before : tuple of pairs
        Changes that enclosures must survive, because nothing is assumed about what they change.
    """

    old: str
    new: str
    search: Callable[[Any], list[Any]]
    before: Changes = ()


def binary(name: str, seed: int = 1, count: int = 20_000) -> Callable[[Any], list[Any]]:
    return lambda L: binary_misses(L, name, pairs(drawn_pairs(name, count, seed)))[0]


def unary(name: str, count: int = 5_000) -> Callable[[Any], list[Any]]:
    return lambda L: unary_misses(L, name, count, seed=1)[0]


def series(name: str, double: bool) -> Callable[[Any], list[Any]]:
    return lambda L: series_misses(L, name, double, 300, seed=1)


def model(name: str, double: bool, narrow: bool = False) -> Callable[[Any], list[Any]]:
    return lambda L: model_misses(L, name, double, 200, seed=1, narrow=narrow)[0]


def step(case: Transport) -> Callable[[Any], list[Any]]:
    return lambda L: transport_misses(L, case)


def sets(name: str) -> Callable[[Any], list[Any]]:
    return lambda L: set_misses(L, name, 200, seed=1)


def values(name: str) -> Callable[[Any], list[Any]]:
    return lambda L: value_misses(L, name, 100, seed=1)


def halves(L: Any) -> list[Any]:
    """Products of subnormal and huge numbers that miss the exact one."""
    found, zero = [], np.zeros(1)
    for a in (5e-324, 1.5e-323):
        oh, ol = np.zeros((2, 4))
        bound = L.multiply_series(np.array([a]), zero, 1, np.array([1e300]), zero, 1, oh, ol, False)
        if not abs(Fraction(a) * Fraction(1e300) - Fraction(oh[0])) <= Fraction(bound):
            found.append(a)
    return found


def overflows(L: Any) -> list[Any]:
    """Products of models beyond the range that have a radius."""
    one = Model(np.full(2, 1e155), np.zeros(2), 0.0)
    models = [
        ran(L, program_of(FORMULAS["product"]), [one, one], double) for double in (False, True)
    ]
    return [model for model in models if model.radius < np.inf]


def smallest_exponentials(L: Any) -> list[Any]:
    """Exponentials of numbers below -665 that miss the value."""
    places = [(x, 0.0, 0.0) for x in np.arange(-668.0, -664.0, 0.1).tolist()]
    with working(300):
        return [x for x in places if not inside(L.exponential(x), point(x, 0.0).exp())]


def _less(old: str, part: str, new: str) -> tuple[str, str]:
    assert part in old
    return old, old.replace(part, new)


_ADD = "_up(x[2] + y[2] + MIDDLE * (abs(x[0]) + abs(y[0])))"
_MULTIPLY = "_up(a * y[2] + x[2] * (b + y[2]) + MIDDLE * (a * b))"
_LIBRARY = "0.0001"  # relative error of a library that a proof must survive
_POOR_LOG = (("math.log(x[0])", f"(math.log(x[0]) * (1 + {_LIBRARY}))"),)
_POOR_ATAN = (("math.atan(x[0])", f"math.atan(x[0]) * (1 + {_LIBRARY})"),)
_POOR_ASIN = (("math.asin(x[0])", f"math.asin(x[0]) * (1 - {_LIBRARY})"),)
#: A library whose angles are wrong by a whole turn.
_TURNED_ATAN = (("math.atan(x[0])", "math.atan(x[0]) + 2 * math.pi"),)
_TURNED_ASIN = (("math.asin(x[0])", "math.asin(x[0]) - 2 * math.pi"),)
_RIPPLE = np.array([[1e-3, -2e-3], [5e-4, 1e-3]])
_RIPPLED = transport(np.eye(2) * 1e-3, start=np.ones(2), F=-_RIPPLE, ripple=_RIPPLE)
_POOR_TURN = (("found[i, c] /= length\n", "found[i, c] /= length * 1.001\n"),)
_SETS = "(abs(product[i, c]) + error[i, c]) * R[c, kind]"
_IN_A_TUBE = transport(np.zeros((2, 2)), start=np.ones(2), flat=True, loose=1.0)
_UNKNOWN = transport(np.zeros((2, 3)), start=np.array([0.0, 0.0, 1.0]), flat=True, loose=0.3)
_STEEP = transport(
    np.array([[0.0, 1.5], [1.5, 0.0]]), start=np.ones(2), F=np.full((2, 2), 1e-3), slope=-3.0
)
_IN_UNITS = transport(np.array([[0.0, 4.0], [0.0, 0.0]]), D=np.array([0.0, 1e-3]), units=(8.0, 1.0))
_STILL = transport(np.eye(2) * 1e-3, D=np.array([1e-3, 1e-3]))

#: Products of 1e306 .. 1e338.
BEYOND = [((1e200, 0.0, 0.0), (10.0**k, 0.0, 0.0)) for k in range(106, 139, 4)]

MUTATIONS: dict[str, Mutation] = {
    # operations on balls
    "sum, rounding": Mutation(*_less(_ADD, "MIDDLE", "0.01 * MIDDLE"), binary("add")),
    "sum, first radius": Mutation(*_less(_ADD, "x[2] + ", ""), binary("add")),
    "sum, second radius": Mutation(*_less(_ADD, "y[2] + ", ""), binary("add")),
    "product, rounding": Mutation(*_less(_MULTIPLY, "MIDDLE", "0.01 * MIDDLE"), binary("multiply")),
    "product, first radius": Mutation(
        *_less(_MULTIPLY, "x[2] * (b + y[2])", "x[2] * y[2]"), binary("multiply")
    ),
    "product, second radius": Mutation(*_less(_MULTIPLY, "a * y[2] + ", ""), binary("multiply")),
    "product, both radii": Mutation(*_less(_MULTIPLY, "(b + y[2])", "b"), binary("multiply")),
    "quotient": Mutation(
        "absolute(product) * error / (1 - error)", "absolute(product) * error", binary("divide")
    ),
    "root": Mutation(
        *_less("absolute(rest) / (high - abs(low))", "absolute(rest)", "0.3 * absolute(rest)"),
        unary("root"),
    ),
    "ball beyond the range": Mutation(
        "return radius if abs(value) < math.inf else math.inf",
        "return radius",
        lambda L: binary_misses(L, "multiply", BEYOND, bits=4500)[0],
        ((_MULTIPLY, _MULTIPLY.replace("(a * b)", "a * b")),),
    ),
    "product, rounding of tiny and huge numbers": Mutation(
        *_less(_MULTIPLY, "MIDDLE * (a * b)", "MIDDLE * a * b"),
        lambda L: binary_misses(L, "multiply", list(special_pairs()), bits=4500)[0],
    ),
    "exponential of very negative numbers": Mutation(
        "return 0.0, 0.0, 1e-287", "return 0.0, 0.0, 1e-290", smallest_exponentials
    ),
    "exponential, radius": Mutation(
        "absolute(total) * 2 * x[2]", "absolute(total) * 0.99 * x[2]", unary("exponential")
    ),
    "sine, radius": Mutation(
        "widened(add(y, multiply(y, sine)), 1e-35 + x[2])",
        "widened(add(y, multiply(y, sine)), 1e-35 + 0.5 * x[2])",
        unary("sine"),
    ),
    "cosine, radius": Mutation(
        "widened(add(ball_of(1.0), cosine), 1e-35 + x[2])",
        "widened(add(ball_of(1.0), cosine), 1e-35 + 0.5 * x[2])",
        unary("cosine"),
    ),
    "logarithm, series": Mutation("size**4", "0.0", unary("logarithm"), _POOR_LOG),
    "logarithm, radius": Mutation("x[2] / low * (", "x[2] / x[0] * (", unary("logarithm")),
    "arctangent, series": Mutation(
        "size**3 + x[2]", "0.01 * size**3 + x[2]", unary("arctangent"), _POOR_ATAN
    ),
    "arctangent, radius": Mutation("size**3 + x[2]", "size**3", unary("arctangent")),
    "arcsine, series": Mutation(
        "found = widened(add(y, z), size**3)",
        "found = widened(add(y, z), 0.01 * size**3)",
        unary("arcsine"),
        _POOR_ASIN,
    ),
    "arctangent, whole turns": Mutation(
        "value if abs(value) <= 2 else math.nan", "value", unary("arctangent", 50), _TURNED_ATAN
    ),
    "arcsine, whole turns": Mutation(
        "value if abs(value) <= 2 else math.nan", "value", unary("arcsine", 50), _TURNED_ASIN
    ),
    "arcsine, radius": Mutation("x[2] / math.sqrt(room)", "x[2]", unary("arcsine")),
    "error function, radius": Mutation(
        "_TWO_BY_ROOT_PI), 2 * x[2])", "_TWO_BY_ROOT_PI), x[2])", unary("error_function")
    ),
    "error function, far away": Mutation(
        "2.0 ** -min(45 + math.floor(abs(x[0])), 960.0)", "1e-300", unary("error_function")
    ),
    # series
    "product of series in float64": Mutation(
        "count, UNIT * size * other",
        "count, 0.01 * UNIT * size * other",
        series("multiply_series", False),
    ),
    "product of series in two floats": Mutation(
        "count, 80 * UNIT * UNIT * size * other",
        "count, 0.8 * UNIT * UNIT * size * other",
        series("multiply_series", True),
    ),
    "halves of subnormal numbers": Mutation(
        "count, UNIT * size * other + HALVING * other", "count, UNIT * size * other", halves
    ),
    "product of series beyond the range": Mutation(
        "return up(error) if total < math.inf else math.inf", "return up(error)", overflows
    ),
    "integral in float64": Mutation(
        "128 * UNIT * UNIT if double else 10 * UNIT",
        "128 * UNIT * UNIT if double else 0.1 * UNIT",
        series("integrate_series", False),
    ),
    "integral in two floats": Mutation(
        "128 * UNIT * UNIT if double else 10 * UNIT",
        "0.0 if double else 10 * UNIT",
        series("integrate_series", True),
    ),
    "derivative in float64": Mutation(
        "64 * UNIT * UNIT if double else 4 * UNIT",
        "64 * UNIT * UNIT if double else 0.04 * UNIT",
        series("differentiate_series", False),
    ),
    "derivative in two floats": Mutation(
        "64 * UNIT * UNIT if double else 4 * UNIT",
        "0.0 if double else 4 * UNIT",
        series("differentiate_series", True),
    ),
    "value at an end": Mutation(
        "up((count + 2) * UNIT * (UNIT * weight + small))",
        "up(0.0 * (UNIT * weight + small))",
        lambda L: end_misses(L, 1_000, seed=1),
    ),
    # windows
    "defect of V": Mutation(
        "error += abs(value)\n            defect[i, c]",
        "pass\n            defect[i, c]",
        step(CASES["defect of V"]),
    ),
    "defect of V beside its derivative": Mutation(
        "up(units[i] * bound + defect[i, c])", "up(units[i] * bound)", step(_RIPPLED)
    ),
    "defect of V beside d": Mutation(
        "d[i] = up(d[i] + hidden[i])", "d[i] = up(d[i])", step(_RIPPLED)
    ),
    "defect of V in its derivative": Mutation(
        "residuals[i, c] += large[e] * defect[j, c]", "pass", step(CASES["defect of V"])
    ),
    "defect of V in the rest": Mutation(
        "large[e] * (D[j] + hidden[j])", "large[e] * D[j]", step(CASES["defect of V"])
    ),
    "radius of A in the derivative": Mutation(
        "loose[i, c] += loosely[e] * sizes[j, c]",
        "pass",
        step(CASES["matrix in a tube"]),
    ),
    "radius of A in the rest": Mutation(
        " + loosely[e] * (hull[j] + UNDERFLOW)", "", step(CASES["matrix in a tube"])
    ),
    "radius of A by a parameter in the derivative": Mutation(
        "loose[i, c] += loosely[e]\n", "pass\n", step(_UNKNOWN)
    ),
    "radius of A by a parameter in the rest": Mutation(
        "reach[i] += loosely[e] * start[j]", "pass", step(_UNKNOWN)
    ),
    "terms of A by a parameter": Mutation(
        "sums[i, c, k] += p\n                        errors",
        "errors",
        step(CASES["parameter without its column"]),
    ),
    "growth": Mutation(
        "growth = absolute(exponential(ball_of(up(2 * half * norm))))",
        "growth = 1.0",
        step(CASES["growth"]),
    ),
    "growth over half the window": Mutation(
        "up(2 * half * norm)", "up(half * norm)", step(CASES["growth"])
    ),
    "circles": Mutation("circle += 0.5 * total", "circle += 0.2 * total", step(CASES["growth"])),
    "circles of a matrix that changes": Mutation(
        "total += abs(scaled[i, j, k] + scaled[j, i, k])",
        "total += abs(scaled[i, j, k] + scaled[j, i, k]) if k == 0 else 0.0",
        step(_STEEP),
    ),
    "radius of A in the growth": Mutation(
        "jacobian_radius[e] * (ratio + UNDERFLOW) + ", "", step(_IN_A_TUBE)
    ),
    "start of V": Mutation(
        "start_error[i, c] = up(", "start_error[i, c] = 0.0 * up(", step(CASES["start error"])
    ),
    "lengths of start and rest": Mutation(
        "up(growth * (length_in(begun, units) + 2 * length_in(reach, units)))",
        "up(growth * length_in(begun + 2 * reach, units))",
        step(CASES["start error turned onto the defect"]),
    ),
    "length of the window": Mutation(
        "2 * length_in(reach, units)",
        "length_in(reach, units)",
        step(CASES["defect of a rotation"]),
    ),
    "units": Mutation("d = units * bound", "d = 0.0 * units + bound", step(_IN_UNITS)),
    "defect in the rest": Mutation(
        "large[e] * (D[j] + hidden[j])", "large[e] * hidden[j]", step(CASES["defect of a rotation"])
    ),
    "defect in the tube": Mutation("up(hull[i] + D[i] + d[i])", "up(hull[i] + d[i])", step(_STILL)),
    "hull in the tube": Mutation(
        "up(hull[i] + D[i] + d[i])", "up(D[i] + d[i])", step(CASES["start error"])
    ),
    "product of matrices": Mutation(
        "error[i, j] = up((k + 2) * UNIT * error[i, j])", "error[i, j] = 0.0", sets("moved_set")
    ),
    "error of the map": Mutation(
        "total += J_error[i, k] * abs(C[k, c])", "pass", sets("moved_set")
    ),
    "error of the map in a radius": Mutation(
        "total += J_error[i, k] * abs(C[k, c])", "pass", sets("set_radius")
    ),
    "extent of a radius": Mutation(
        "total += abs(product[i, c]) * R[c, kind]",
        "total += 0.5 * abs(product[i, c]) * R[c, kind]",
        sets("set_radius"),
    ),
    "frame that is not orthogonal": Mutation(
        "up(found[i, kind] + f / (1 - f) * largest)",
        "found[i, kind]",
        sets("boxed_set"),
        _POOR_TURN,
    ),
    "units of a box": Mutation(
        "own[i, c] = G[i, c] / units[i]", "own[i, c] = G[i, c]", sets("boxed_set")
    ),
    "extent of a box": Mutation(_SETS, f"0.5 * {_SETS}", sets("boxed_set")),
    "value of a matrix, rounding": Mutation(
        "UNIT * (abs(p) + abs(found[i, j])) + abs(series[i, j, k]) * gap",
        "abs(series[i, j, k]) * gap",
        values("matrix_value"),
    ),
    "value of a matrix, place": Mutation(
        "UNIT * (abs(p) + abs(found[i, j])) + abs(series[i, j, k]) * gap",
        "0.01 * UNIT * (abs(p) + abs(found[i, j]))",
        values("matrix_value"),
    ),
    "dense layer, rounding": Mutation(
        "(inputs + 8) * (inputs + 8) * 8 * UNIT * UNIT * size",
        "0.0",
        lambda L: dense_misses(L, 100, seed=1),
    ),
    "series of lines": Mutation(
        "total += (k + 1) * made", "pass", lambda L: clenshaw_misses(L, 20, seed=1)
    ),
    "products of a readout": Mutation(
        "error[i] += (inner + 8) * (inner + 8) * 2 * UNIT * UNIT * size",
        "pass",
        lambda L: product_misses(L, 100, seed=1),
    ),
}

#: Bounds in branches of run_models that do not use each other, weakened in one text.
BRANCHES: dict[str, Mutation] = {
    "sum of models": Mutation(
        "total += (abs(a) + abs(b)) * MIDDLE", "total += 0.0", model("sum", True, narrow=True)
    ),
    "sum of models in float64": Mutation("total += abs(e)\n", "pass\n", model("sum", False, True)),
    "product of models, radii": Mutation(
        "radius[i] * (more_size + radius[j]) + size * radius[j]",
        "radius[i] * more_size",
        model("product", True),
    ),
    "product of models, terms beyond": Mutation(
        "error += cut(wide, rest, n + m - 1, terms)", "pass", model("product", True, narrow=True)
    ),
    "reciprocal": Mutation(
        "up(size * error / (1 - error))", "up(0.01 * size * error)", model("reciprocal", False)
    ),
    "reciprocal root": Mutation(
        "up(size * error / (2 * (1 - error)))",
        "up(0.01 * size * error)",
        model("reciprocal_root", False),
    ),
    "exponential": Mutation(
        "error = up(defect + grown * (absolute(apart) + 2 * steep * defect))",
        "error = up(0.01 * defect)",
        model("exp", False, narrow=True),
    ),
    "sine and cosine": Mutation(
        "error = up(defect + distance + 2 * steep * defect + radius[i])",
        "error = up(radius[i])",
        model("sin", True, narrow=True),
    ),
    "functions by their slope": Mutation(
        "error += total[2] + cut(other, other_low, product + 1, terms) + radius[i] * size",
        "error += total[2] + radius[i] * size",
        model("atan", True, narrow=True),
    ),
}
_ALL_BRANCHES: Changes = tuple((one.old, one.new) for one in BRANCHES.values())


@pytest.mark.parametrize("name", MUTATIONS)
def test_search_finds_a_miss_of_a_weakened_bound(name):
    mutation = MUTATIONS[name]
    assert mutation.search(changed((*mutation.before, (mutation.old, mutation.new))))


@pytest.mark.parametrize("name", MUTATIONS)
def test_search_finds_no_miss_of_the_bound_as_it_is(name):
    mutation = MUTATIONS[name]
    assert mutation.search(changed(mutation.before)) == []


@pytest.mark.parametrize("name", BRANCHES)
def test_search_finds_a_miss_of_a_weakened_model(name):
    assert BRANCHES[name].search(changed(_ALL_BRANCHES))


@pytest.mark.parametrize("name", BRANCHES)
def test_search_finds_no_miss_of_a_model_as_it_is(name):
    assert BRANCHES[name].search(changed(())) == []


#: The bound on the defect of y without its polynomial, seen in whole enclosures.
_NO_POLYNOMIAL = ("sizes[i] = up(error + total)", "sizes[i] = up(error)")


def enclosed_misses(L: Any, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    for module in (hamsym.proof.windows, hamsym.proof.enclose, hamsym.proof.programs):
        monkeypatch.setattr(module, "loops", lambda: L)
    found = []
    for name in ("pendulum", "morse", "henon_heiles"):
        case = PROBLEMS[name]
        enclosure = hamsym.proof.enclose.enclose(case.formula, case.z0, case.span)
        times = sampled(case.span)
        found += enclosure_misses(L, enclosure, times, reference(case, times))
    return found


def test_enclosures_without_a_bound_on_the_defect_miss_the_solution(monkeypatch):
    assert enclosed_misses(changed((_NO_POLYNOMIAL,)), monkeypatch)


def test_enclosures_as_they_are_miss_nothing(monkeypatch):
    assert enclosed_misses(changed(()), monkeypatch) == []
