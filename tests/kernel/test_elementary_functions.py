"""Elementary functions of the kernel against mpmath, in units in the last place (ulp)."""

import ctypes
import importlib.util
import itertools
import math
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

import hamsym

SOURCE = Path(hamsym.__file__).parent / "kernel" / "functions.c"
FLAGS = ("-std=c99", "-w", "-fPIC", "-shared", "-ffp-contract=off")
Function = Callable[..., np.ndarray]

CIRCULAR = ("sin", "cos", "tan", "asin", "acos", "atan")
HYPERBOLIC = ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh")
ONE_ARGUMENT = (*CIRCULAR, *HYPERBOLIC, "exp", "expm1", "log", "log1p", "erf", "erfc")
TWO_ARGUMENTS = ("pow", "atan2")
INF, NAN = math.inf, math.nan
TINY = 5e-324

# Bounds of the error in ulp. The largest seen in ten million arguments is 0.8, or 1.0 for tan,
# 1.05 for expm1 and 1.15 for erfc.
BOUNDS = dict.fromkeys((*ONE_ARGUMENT, *TWO_ARGUMENTS), 1.5)
BOUNDS |= dict.fromkeys(("sin", "cos", "exp", "log", "pow"), 1.0)


def run_compiler(source: Path, target: Path, *command: str) -> Path:
    if shutil.which(command[0]) is None:
        pytest.skip(f"no C compiler: there is no program {command[0]} on the path")
    subprocess.run([*command, *FLAGS, str(source), "-o", str(target)], check=True)
    return target


def row_function(library: ctypes.CDLL, name: str, *, in_place: bool = False) -> Function:
    """The function of rows of any length: ones fill the last eight."""
    function = getattr(library, f"hamsym_{name}")
    function.restype = None

    def call(*arguments: np.ndarray) -> np.ndarray:
        n = len(arguments[0])
        rows = [np.concatenate([row, np.ones(-n % 8)]) for row in arguments]
        out = rows[-1] if in_place else np.empty_like(rows[0])
        function(
            *(ctypes.c_void_p(row.ctypes.data) for row in (*rows, out)), ctypes.c_long(len(out))
        )
        return out[:n]

    return call


@pytest.fixture(scope="module")
def unlinked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_compiler(
        SOURCE, tmp_path_factory.mktemp("kernel") / "functions.o", "cc", "-O3", "-c"
    )


@pytest.fixture(scope="module")
def library(unlinked: Path) -> ctypes.CDLL:
    return ctypes.CDLL(str(run_compiler(unlinked, unlinked.with_suffix(".so"), "cc")))


def exact_value(name: str, *arguments: float) -> mpmath.mpf:
    function = getattr(mpmath, "power" if name == "pow" else name)
    return function(*map(mpmath.mpf, arguments))


def error_in_ulp(value: float, exact: mpmath.mpf) -> mpmath.mpf:
    exponent = mpmath.frexp(exact)[1] if exact else -2000
    if exponent > 1024:
        return mpmath.mpf(0) if value == math.copysign(INF, exact) else mpmath.inf
    return abs(mpmath.mpf(value) - exact) * mpmath.mpf(2) ** -max(exponent - 53, -1074)


def spread(generator: np.random.Generator, low: float, high: float, n: int = 120) -> np.ndarray:
    """Numbers of both signs, of every size between low and high."""
    return np.exp2(generator.uniform(math.log2(low), math.log2(high), n)) * generator.choice(
        [-1.0, 1.0], n
    )


def neighbours(*centres: float) -> np.ndarray:
    steps = (x + k * np.spacing(x) for x, k in itertools.product(centres, range(-3, 4)))
    return np.array(list(steps))


def arguments_of(name: str) -> np.ndarray:
    generator = np.random.default_rng(20)
    unit, wide = generator.uniform(-1, 1, 200), spread(generator, 1e-310, 1e300)
    if name in ("sin", "cos", "tan"):
        multiples = np.concatenate([np.arange(1, 40), generator.integers(40, 2**40, 60)]) * (
            math.pi / 2
        )
        closest = math.ldexp(6381956970095103, 797)  # of all float64 to a multiple of pi/2
        hard = [1e22, 1e5, 99999.99999999999, closest, sys.float_info.max]
        return np.concatenate(
            [3 * unit, 1e5 * unit, wide, neighbours(*multiples, math.pi / 4), hard]
        )
    if name in ("exp", "expm1", "sinh", "cosh", "tanh"):
        edges = neighbours(
            math.log(2) / 2, 18.37, 19.06, 22.0, 40.0, 708.0, 709.78, 710.47, -37.4, -708.0, -745.1
        )
        return np.concatenate([unit, 40 * unit, 745 * unit, spread(generator, 1e-310, 1), edges])
    if name in ("asin", "acos", "atanh"):
        near = 1 - np.abs(spread(generator, 2e-16, 0.5))
        return np.concatenate([unit, near, -near, spread(generator, 1e-310, 1), neighbours(0.5)])
    if name == "log":
        return np.concatenate(
            [1 + spread(generator, 1e-16, 0.5), np.abs(wide), neighbours(1.0, 0.5**0.5, 2.0**0.5)]
        )
    if name == "log1p":
        return np.concatenate([unit, np.abs(wide), spread(generator, 1e-310, 0.99)])
    if name == "acosh":
        return 1 + np.abs(np.concatenate([spread(generator, 3e-16, 1), 10 * unit, wide]))
    if name in ("erf", "erfc"):
        return np.concatenate(
            [unit, 6 * unit, 27.2 * unit, spread(generator, 1e-310, 1), neighbours(0.5, 5.9)]
        )
    return np.concatenate(
        [unit, 10 * unit, wide, neighbours(1.0, 0.2360679, 0.7207592, 1.3874258, 4.2360679)]
    )


def pairs_of(name: str) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(21)
    wide = spread(generator, 1e-310, 1e300, 300)
    if name == "atan2":
        return (
            np.concatenate([generator.uniform(-1, 1, 300), wide, wide]),
            np.concatenate(
                [
                    generator.uniform(-1, 1, 300),
                    generator.permutation(wide),
                    wide * spread(generator, 1e-7, 1e7, 300),
                ]
            ),
        )
    positive = np.abs(wide)
    near_one, powers = 1 + spread(generator, 1e-16, 0.1, 200), spread(generator, 1, 1e15, 200)
    signed, whole = generator.uniform(-10, 10, 200), generator.integers(-20, 20, 200).astype(float)
    return (
        np.concatenate([positive, near_one, signed]),
        np.concatenate([generator.uniform(-746, 710, 300) / np.log(positive), powers, whole]),
    )


@pytest.mark.parametrize("name", [*ONE_ARGUMENT, *TWO_ARGUMENTS])
def test_error_is_within_its_bound(library: ctypes.CDLL, name: str) -> None:
    rows = (arguments_of(name),) if name in ONE_ARGUMENT else pairs_of(name)
    values = row_function(library, name)(*rows)
    with mpmath.workprec(160):
        for value, *x in zip(values, *rows, strict=True):
            error = error_in_ulp(float(value), exact_value(name, *map(float, x)))
            assert error < BOUNDS[name], x


ZEROS = ((0.0, 0.0), (-0.0, -0.0))
ABOVE_ONE, RIGHT = 1.0 + 2**-52, math.pi / 2
SPECIAL = {
    "sin": [*ZEROS, (TINY, TINY), (INF, NAN), (-INF, NAN)],
    "cos": [(0.0, 1.0), (-0.0, 1.0), (INF, NAN), (-INF, NAN)],
    "tan": [*ZEROS, (-TINY, -TINY), (INF, NAN), (-INF, NAN)],
    "exp": [(0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, 0.0), (-746.0, 0.0), (710.0, INF)],
    "expm1": [*ZEROS, (INF, INF), (-INF, -1.0), (TINY, TINY), (1e300, INF), (-1e300, -1.0)],
    "log": [(0.0, -INF), (-0.0, -INF), (1.0, 0.0), (INF, INF), (-INF, NAN), (-TINY, NAN)],
    "log1p": [*ZEROS, (-1.0, -INF), (INF, INF), (-INF, NAN), (-1.5, NAN), (-TINY, -TINY)],
    "asin": [*ZEROS, (1.0, RIGHT), (-1.0, -RIGHT), (ABOVE_ONE, NAN), (INF, NAN)],
    "acos": [(1.0, 0.0), (-1.0, math.pi), (0.0, RIGHT), (-0.0, RIGHT), (-ABOVE_ONE, NAN)],
    "atan": [*ZEROS, (INF, RIGHT), (-INF, -RIGHT), (TINY, TINY)],
    "sinh": [*ZEROS, (INF, INF), (-INF, -INF), (TINY, TINY), (711.0, INF), (-1e300, -INF)],
    "cosh": [(0.0, 1.0), (-0.0, 1.0), (INF, INF), (-INF, INF), (711.0, INF), (-1e300, INF)],
    "tanh": [*ZEROS, (INF, 1.0), (-INF, -1.0), (TINY, TINY), (-1e300, -1.0)],
    "asinh": [*ZEROS, (INF, INF), (-INF, -INF), (-TINY, -TINY)],
    "acosh": [(1.0, 0.0), (INF, INF), (-INF, NAN), (0.9999999999999999, NAN), (-2.0, NAN)],
    "atanh": [*ZEROS, (1.0, INF), (-1.0, -INF), (ABOVE_ONE, NAN), (-INF, NAN), (TINY, TINY)],
    "erf": [*ZEROS, (INF, 1.0), (-INF, -1.0), (1e300, 1.0)],
    "erfc": [(0.0, 1.0), (-0.0, 1.0), (INF, 0.0), (-INF, 2.0), (28.0, 0.0), (-1e300, 2.0)],
}  # fmt: skip


def assert_same(values: np.ndarray, expected: list[float]) -> None:
    np.testing.assert_array_equal(values, expected)
    numbers = ~np.isnan(values)
    np.testing.assert_array_equal(np.signbit(values)[numbers], np.signbit(expected)[numbers])


@pytest.mark.parametrize("name", ONE_ARGUMENT)
def test_special_arguments_follow_annex_f(library: ctypes.CDLL, name: str) -> None:
    cases = [*SPECIAL[name], (NAN, NAN), (-NAN, NAN)]
    assert_same(
        row_function(library, name)(np.array([x for x, _ in cases])), [value for _, value in cases]
    )


def special_pairs() -> list[tuple[float, float]]:
    values = [0.0, TINY, 0.5, 1.0, 2.0, 3.0, 2.5, 1e300, 2.0**53 + 2, 2.0**53 - 1, INF]
    signed = [*values, *(-v for v in values), NAN]
    return list(itertools.product(signed, signed))


@pytest.mark.parametrize("name", TWO_ARGUMENTS)
def test_special_pairs_follow_annex_f(library: ctypes.CDLL, name: str) -> None:
    # numpy calls the functions of the C library, which follow it.
    x, y = np.array(special_pairs()).T
    with np.errstate(all="ignore"):
        expected = np.arctan2(x, y) if name == "atan2" else np.power(x, y)
    values = row_function(library, name)(x, y)
    np.testing.assert_array_equal(np.isnan(values), np.isnan(expected))
    np.testing.assert_allclose(values, expected, rtol=4e-16, atol=TINY)
    numbers = ~np.isnan(values)
    np.testing.assert_array_equal(np.signbit(values)[numbers], np.signbit(expected)[numbers])


def test_powers_of_whole_numbers_are_exact(library: ctypes.CDLL) -> None:
    cases = [(b, e) for b in range(-9, 10) for e in range(1, 17) if abs(b) ** e < 2**53]
    values = row_function(library, "pow")(*np.array(cases, dtype=float).T)
    assert values.tolist() == [float(b**e) for b, e in cases]


@pytest.mark.parametrize("name", [*ONE_ARGUMENT, *TWO_ARGUMENTS])
def test_results_may_replace_arguments(library: ctypes.CDLL, name: str) -> None:
    rows = (arguments_of(name),) if name in ONE_ARGUMENT else pairs_of(name)
    apart, in_place = (
        row_function(library, name)(*rows),
        row_function(library, name, in_place=True)(*rows),
    )
    assert apart.tobytes() == in_place.tobytes()


@pytest.mark.parametrize("name", [*ONE_ARGUMENT, *TWO_ARGUMENTS])
def test_neighbours_do_not_change_results(library: ctypes.CDLL, name: str) -> None:
    rows = (arguments_of(name),) if name in ONE_ARGUMENT else pairs_of(name)
    function, order = (
        row_function(library, name),
        np.random.default_rng(22).permutation(len(rows[0])),
    )
    assert function(*rows)[order].tobytes() == function(*(row[order] for row in rows)).tobytes()


def test_sine_and_cosine_together_are_those_alone(library: ctypes.CDLL) -> None:
    special = [0.0, -0.0, TINY, INF, -INF, NAN, 1e300, -1e5, 1e22]
    x = np.concatenate([arguments_of("sin"), special])
    x = np.concatenate([x, np.ones(-len(x) % 8)])
    both = np.empty((2, len(x)))
    places = (ctypes.c_void_p(row.ctypes.data) for row in (x, *both))
    library.hamsym_sin_cos(*places, ctypes.c_long(len(x)))
    for name, values in zip(("sin", "cos"), both, strict=True):
        assert values.tobytes() == row_function(library, name)(x).tobytes()


@pytest.mark.skipif(sys.platform != "linux", reason="options of the linker of Linux")
def test_functions_call_no_library(unlinked: Path, tmp_path: Path) -> None:
    run_compiler(unlinked, tmp_path / "alone.so", "cc", "-nostdlib", "-Wl,-z,defs")


def variants() -> Iterator[Any]:
    """Commands of the compilers here, for the processors that this one can stand for."""
    yield pytest.param(("cc", "-O0"), id="O0")
    features = set(np.__config__.show(mode="dicts")["SIMD Extensions"].get("found", []))
    levels = {
        "v2": True,
        "v3": bool(features & {"AVX2", "X86_V3"}),
        "v4": bool(features & {"AVX512_SKX", "X86_V4"}),
    }
    if platform.machine() in ("x86_64", "AMD64"):
        for level, runs in levels.items():
            if runs:
                yield pytest.param(("cc", "-O3", f"-march=x86-64-{level}"), id=level)
    if importlib.util.find_spec("ziglang"):
        yield pytest.param((sys.executable, "-m", "ziglang", "cc", "-O3"), id="clang")


@pytest.mark.slow_cases("v3")
@pytest.mark.parametrize("command", list(variants()))
def test_every_build_gives_the_same_bits(
    library: ctypes.CDLL, tmp_path: Path, command: tuple[str, ...]
) -> None:
    other = ctypes.CDLL(str(run_compiler(SOURCE, tmp_path / "other.so", *command)))
    for function in (*ONE_ARGUMENT, *TWO_ARGUMENTS):
        rows = (arguments_of(function),) if function in ONE_ARGUMENT else pairs_of(function)
        values = [row_function(build, function)(*rows) for build in (library, other)]
        assert values[0].tobytes() == values[1].tobytes(), function
