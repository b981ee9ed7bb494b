"""Each bound of the compiled enclosures is needed: without it a search finds a miss.

The text of the library is weakened in one place, compiled as another one, and searched for
arguments at which it does not contain the truth. The same search finds nothing in the text as it
is. Three bounds are below the roundings of the operation that follows them, so that no argument
shows them: the remainders of the Taylor series of exp (below 1e-45), of sin and cos (5e-36), and of
the error function (1e-34).
"""

from __future__ import annotations

import atexit
import ctypes
import functools
import math
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym.proof.arithmetic.programs
import hamsym.proof.windows.enclose
import hamsym.proof.windows.guessed_windows
import hamsym.proof.windows.window_lemma
import hamsym.proof.windows.window_sets
from hamsym.hamiltonian import Hamiltonian
from hamsym.kernel import build_backend
from hamsym.kernel.enclosures import Enclosures, enclosures
from hamsym.kernel.library import chosen_level
from hamsym.proof.arithmetic.programs import ModelRows
from hamsym.proof.windows.equation import Equation
from tests.proof.built_cases import SOURCES
from tests.proof.misses import (
    FORMULAS,
    Model,
    Transport,
    binary_misses,
    clenshaw_misses,
    drawn_pairs,
    enclosure_misses,
    fractions,
    integral_of,
    model_misses,
    pairs,
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


_COMPILER = build_backend._compiler()

if _COMPILER is None:
    pytest.skip("needs a C compiler", allow_module_level=True)


@functools.cache
def _folder() -> Path:
    """A folder for all libraries, with the compiled elementary functions."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    _compile(build_backend.FOLDER / "functions.c", "-c", "-o", f"{folder.name}/functions.o")
    return Path(folder.name)


def _compile(*arguments: str | Path) -> None:
    flags = [flag for flag in build_backend._flags(chosen_level()) if flag != "-shared"]
    subprocess.run([*_COMPILER, *flags, "-O1", *arguments], check=True)  # the same bits, sooner


@functools.cache
def changed(changes: Changes) -> Any:
    """The functions of a library with passages of its text replaced."""
    if not changes:
        return enclosures()
    texts = {part: (build_backend.FOLDER / part).read_text("utf-8") for part in SOURCES}
    for old, new in changes:
        (place,) = [part for part, text in texts.items() if old in text]
        assert texts[place].count(old) == 1, old
        texts[place] = texts[place].replace(old, new)
    folder = Path(tempfile.mkdtemp(dir=_folder()))
    for part, text in texts.items():
        (folder / part).write_text(text, "utf-8")
    sources = [folder / part for part in SOURCES if part.endswith(".c")]
    include = f"-I{build_backend.FOLDER}"
    _compile(
        "-w",
        "-shared",
        include,
        *sources,
        _folder() / "functions.o",
        "-o",
        folder / "one.so",
        "-lm",
    )
    return Enclosures(ctypes.CDLL(str(folder / "one.so")))


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


def poor_defects(L: Any) -> list[Any]:
    """Defects at the end, of polynomials that solve nothing, above their bounds."""
    rates = Equation(Hamiltonian("p**2/2 + x**2/2")).rates
    rows = ModelRows(rates, 8)
    rows.high[:2] = np.random.default_rng(1).normal(size=(2, 8))
    rows.length[:2] = 8
    bounds = L.defects(rates.steps, rates.results, rows.models, 2, (0.125, 0.0, 0.0))[1]
    x, p = (fractions(row) for row in rows.high[:2])
    found = []
    for own, rate, sign, bound in ((x, p, 1, bounds[0]), (p, x, -1, bounds[1])):
        moved = 2 * sum(own[1::2], Fraction(0))  # from one end to the other
        exact = abs(moved - sign * sum(integral_of(rate)) / 8)
        if not exact <= Fraction(float(bound)):
            found.append((exact, bound))
    return found


def overflows(L: Any) -> list[Any]:
    """Products of models beyond the range that have a radius."""
    one = Model(np.full(2, 1e155), np.zeros(2), 0.0)
    models = [
        ran(L, program_of(FORMULAS["product"]), [one, one], double) for double in (False, True)
    ]
    return [model for model in models if model.radius < np.inf]


def _less(old: str, part: str, new: str) -> tuple[str, str]:
    assert part in old
    return old, old.replace(part, new)


_ADD = "outward(x.radius + y.radius + MIDDLE * (fabs(x.high) + fabs(y.high)))"
_MULTIPLY = "outward(a * y.radius + x.radius * (b + y.radius) + MIDDLE * (a * b))"
_LIBRARY = "0.0001"  # relative error of a library that a proof must survive
_LOG, _ATAN, _ASIN = (f"value_at(hamsym_{name}, x.high)" for name in ("log", "atan", "asin"))
_POOR_LOG = ((_LOG, f"({_LOG} * (1 + {_LIBRARY}))"),)
_POOR_ATAN = ((_ATAN, f"{_ATAN} * (1 + {_LIBRARY})"),)
_POOR_ASIN = ((_ASIN, f"{_ASIN} * (1 - {_LIBRARY})"),)
#: A library whose angles are wrong by a whole turn.
_TURNED_ATAN = ((_ATAN, f"{_ATAN} + {2 * math.pi}"),)
_TURNED_ASIN = ((_ASIN, f"{_ASIN} - {2 * math.pi}"),)
_RIPPLE = np.array([[1e-3, -2e-3], [5e-4, 1e-3]])
_RIPPLED = transport(np.eye(2) * 1e-3, start=np.ones(2), F=-_RIPPLE, ripple=_RIPPLE)
_POOR_TURN = (("found[i * n + c] /= length;", "found[i * n + c] /= length * 1.001;"),)
_IN = "dim, 1, s->units"
_SETS = "(fabs(product[i * count + c]) + error[i * count + c]) * R[c * kinds + kind]"
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
    "sum, first radius": Mutation(*_less(_ADD, "x.radius + ", ""), binary("add")),
    "sum, second radius": Mutation(*_less(_ADD, "y.radius + ", ""), binary("add")),
    "product, first radius": Mutation(
        *_less(_MULTIPLY, "x.radius * (b + y.radius)", "x.radius * y.radius"), binary("multiply")
    ),
    "product, second radius": Mutation(
        *_less(_MULTIPLY, "a * y.radius + ", ""), binary("multiply")
    ),
    "product, both radii": Mutation(*_less(_MULTIPLY, "(b + y.radius)", "b"), binary("multiply")),
    "quotient": Mutation(
        "absolute(product) * error / (1 - error)", "absolute(product) * error", binary("divide")
    ),
    "root": Mutation(
        *_less("absolute(rest) / (q.high - fabs(q.low))", "absolute(rest)", "0.3 * absolute(rest)"),
        unary("root"),
    ),
    "ball beyond the range": Mutation(
        "return fabs(value) < INFINITY ? radius : INFINITY;",
        "return radius;",
        lambda L: binary_misses(L, "multiply", BEYOND, bits=4500)[0],
        ((_MULTIPLY, _MULTIPLY.replace("(a * b)", "a * b")),),
    ),
    "product, rounding of tiny and huge numbers": Mutation(
        *_less(_MULTIPLY, "MIDDLE * (a * b)", "MIDDLE * a * b"),
        lambda L: binary_misses(L, "multiply", list(special_pairs()), bits=4500)[0],
    ),
    "exponential, radius": Mutation(
        "absolute(total) * 2 * x.radius", "absolute(total) * 0.99 * x.radius", unary("exponential")
    ),
    "sine, radius": Mutation(
        "widened(add(y, multiply(y, s)), REST_SINE + x.radius)",
        "widened(add(y, multiply(y, s)), REST_SINE + 0.5 * x.radius)",
        unary("sine"),
    ),
    "cosine, radius": Mutation(
        "widened(add(ball_of(1.0), c), REST_SINE + x.radius)",
        "widened(add(ball_of(1.0), c), REST_SINE + 0.5 * x.radius)",
        unary("cosine"),
    ),
    "logarithm, series": Mutation("power(size, 4)", "0.0", unary("logarithm"), _POOR_LOG),
    "logarithm, radius": Mutation(
        "x.radius / low * (", "x.radius / x.high * (", unary("logarithm")
    ),
    "arctangent, series": Mutation(
        "power(size, 3) + x.radius",
        "0.01 * power(size, 3) + x.radius",
        unary("arctangent"),
        _POOR_ATAN,
    ),
    "arctangent, radius": Mutation(
        "power(size, 3) + x.radius", "power(size, 3)", unary("arctangent")
    ),
    "arcsine, series": Mutation(
        "found = widened(add(y, z), power(size, 3))",
        "found = widened(add(y, z), 0.01 * power(size, 3))",
        unary("arcsine"),
        _POOR_ASIN,
    ),
    "arctangent, whole turns": Mutation(
        "fabs(value) <= 2 ? value : NAN", "value", unary("arctangent", 50), _TURNED_ATAN
    ),
    "arcsine, whole turns": Mutation(
        "fabs(value) <= 2 ? value : NAN", "value", unary("arcsine", 50), _TURNED_ASIN
    ),
    "arcsine, radius": Mutation("x.radius / sqrt(room)", "x.radius", unary("arcsine")),
    "error function, radius": Mutation(
        "TWO_BY_ROOT_PI), 2 * x.radius)", "TWO_BY_ROOT_PI), x.radius)", unary("error_function")
    ),
    "error function, far away": Mutation(
        "ldexp(1.0, -(int)lesser(45 + floor(fabs(x.high)), 960.0))",
        "1e-300",
        unary("error_function"),
    ),
    # series
    "product of series beyond the range": Mutation(
        "return total < INFINITY ? up(error) : INFINITY;", "return up(error);", overflows
    ),
    # windows
    "defect of y": Mutation("sizes[i] = up(error + total)", "sizes[i] = up(error)", poor_defects),
    "defect of V": Mutation(
        "error[c] < INFINITY ? up(error[c])",
        "error[c] < INFINITY ? up(2 * errors[c])",
        step(CASES["defect of V"]),
    ),
    "defect of V beside its derivative": Mutation(
        "s->units[i] * most + s->defect[i * columns + c]", "s->units[i] * most", step(_RIPPLED)
    ),
    "defect of V beside d": Mutation(
        "d[i] = up(d[i] + hidden[i])", "d[i] = up(d[i])", step(_RIPPLED)
    ),
    "defect of V in its derivative": Mutation(
        " + large[e] * s->defect[j * columns + c]", "", step(CASES["defect of V"])
    ),
    "defect of V in the rest": Mutation(
        "large[e] * (s->D[j] + hidden[j])", "large[e] * s->D[j]", step(CASES["defect of V"])
    ),
    "radius of A in the derivative": Mutation(
        "loosely[e] * s->sizes[j * columns + c] + ",
        "",
        step(CASES["matrix in a tube"]),
    ),
    "radius of A in the rest": Mutation(
        " + loosely[e] * (s->hull[j] + UNDERFLOW_ERROR)", "", step(CASES["matrix in a tube"])
    ),
    "radius of A by a parameter in the derivative": Mutation(
        "own[j] += loosely[e];", ";", step(_UNKNOWN)
    ),
    "radius of A by a parameter in the rest": Mutation(
        "reach[i] += loosely[e] * s->start[j]", "(void)0", step(_UNKNOWN)
    ),
    "terms of A by a parameter": Mutation(
        "*own += p;",
        ";",
        step(CASES["parameter without its column"]),
    ),
    "growth": Mutation(
        "growth = absolute(exponential(ball_of(up(2 * s->half * *norm))))",
        "growth = 1.0",
        step(CASES["growth"]),
    ),
    "growth over half the window": Mutation(
        "up(2 * s->half * *norm)", "up(s->half * *norm)", step(CASES["growth"])
    ),
    "circles": Mutation("circle += 0.5 * total", "circle += 0.2 * total", step(CASES["growth"])),
    "circles of a matrix that changes": Mutation(
        "total += fabs(one[k] + other[k]);",
        "total += k == 0 ? fabs(one[k] + other[k]) : 0.0;",
        step(_STEEP),
    ),
    "radius of A in the growth": Mutation(
        "s->jacobian_radius[e] * (ratio + UNDERFLOW_ERROR)", "0.0", step(_IN_A_TUBE)
    ),
    "start of V": Mutation(
        "start_error[c] = up(", "start_error[c] = 0.0 * up(", step(CASES["start error"])
    ),
    "lengths of start and rest": Mutation(
        f"double bound = up(growth * (length_in(begun, {_IN}) + 2 * length_in(reach, {_IN})));",
        "for (long i = 0; i < dim; i++) begun[i] += 2 * reach[i];"
        f"double bound = up(growth * length_in(begun, {_IN}));",
        step(CASES["start error turned onto the defect"]),
    ),
    "length of the window": Mutation(
        f"2 * length_in(reach, {_IN})",
        f"length_in(reach, {_IN})",
        step(CASES["defect of a rotation"]),
    ),
    "units": Mutation("d[i] = s->units[i] * bound", "d[i] = bound", step(_IN_UNITS)),
    "defect in the rest": Mutation(
        "large[e] * (s->D[j] + hidden[j])",
        "large[e] * hidden[j]",
        step(CASES["defect of a rotation"]),
    ),
    "defect in the tube": Mutation(
        "up(s->hull[i] + s->D[i] + d[i])", "up(s->hull[i] + d[i])", step(_STILL)
    ),
    "hull in the tube": Mutation(
        "up(s->hull[i] + s->D[i] + d[i])", "up(s->D[i] + d[i])", step(CASES["start error"])
    ),
    "error of the map": Mutation(
        "+ J_error[i * k + h]) * extent[h * kinds + kind]",
        ") * extent[h * kinds + kind]",
        sets("moved_set"),
    ),
    "error of the map in a radius": Mutation(
        "+ J_error[i * k + h]) * extent[h * kinds + kind]",
        ") * extent[h * kinds + kind]",
        sets("set_radius"),
    ),
    "extent of a radius": Mutation(
        "total += fabs(product[i * columns + c]) * R[c * kinds + kind]",
        "total += 0.5 * fabs(product[i * columns + c]) * R[c * kinds + kind]",
        sets("set_radius"),
    ),
    "frame that is not orthogonal": Mutation(
        "up(found[i * kinds + kind] + f / (1 - f) * largest)",
        "found[i * kinds + kind]",
        sets("boxed_set"),
        _POOR_TURN,
    ),
    "units of a box": Mutation(
        "own[i * count + c] = G[i * count + c] / units[i]",
        "own[i * count + c] = G[i * count + c]",
        sets("boxed_set"),
    ),
    "extent of a box": Mutation(_SETS, f"0.5 * {_SETS}", sets("boxed_set")),
    "value of a matrix, rounding": Mutation(
        "UNIT * (fabs(p) + fabs(value)) + fabs(series[k]) * gap",
        "fabs(series[k]) * gap",
        values("matrix_value"),
    ),
    "value of a matrix, place": Mutation(
        "UNIT * (fabs(p) + fabs(value)) + fabs(series[k]) * gap",
        "0.01 * UNIT * (fabs(p) + fabs(value))",
        values("matrix_value"),
    ),
    "series of lines": Mutation(
        "total += (k + 1) * made", "(void)made", lambda L: clenshaw_misses(L, 20, seed=1)
    ),
}

#: Bounds in branches of run_models that do not use each other, weakened in one text.
BRANCHES: dict[str, Mutation] = {
    "sum of models": Mutation(
        "total += (fabs(x) + fabs(y)) * MIDDLE", "total += 0.0", model("sum", True, narrow=True)
    ),
    "sum of models in float64": Mutation("total += fabs(sum.low);", ";", model("sum", False, True)),
    "product of models, radii": Mutation(
        "first * (other + second) + size * second",
        "first * other",
        model("product", True),
    ),
    "product of models, terms beyond": Mutation(
        "error += cut(wide, rest, count, terms)", "(void)0", model("product", True, narrow=True)
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
        "error = up(defect + grown * (absolute(apart) + 2 * rate.size * defect))",
        "error = up(0.01 * defect)",
        model("exp", False, narrow=True),
    ),
    "sine and cosine": Mutation(
        "error = up(defect + distance + 2 * rate.size * defect + radius)",
        "error = up(radius)",
        model("sin", True, narrow=True),
    ),
    "functions by their slope": Mutation(
        "error += total.radius + cut(other, other_low, product + 1, terms) + *f.radius * size",
        "error += total.radius + *f.radius * size",
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


def enclosed_misses(L: Any, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    windows = hamsym.proof.windows
    own = windows.guessed_windows, windows.window_lemma, windows.window_sets, windows.enclose
    for module in (*own, hamsym.proof.arithmetic.programs):
        monkeypatch.setattr(module, "enclosures", lambda: L)
    found = []
    for name in ("pendulum", "morse", "henon_heiles"):
        case = PROBLEMS[name]
        enclosure = hamsym.proof.windows.enclose.enclose(case.formula, case.z0, case.span)
        times = sampled(case.span)
        found += enclosure_misses(L, enclosure, times, reference(case, times))
    return found


def test_enclosures_as_they_are_miss_nothing(monkeypatch):
    assert enclosed_misses(changed(()), monkeypatch) == []
