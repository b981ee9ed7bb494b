"""Each constant of the kernel is needed: shrunk, a case that is built for it has a miss.

The sources are compiled once with all constants as variables, which the tests shrink one by one.
"""

from __future__ import annotations

import ctypes
import functools
import re
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hamsym.kernel import build_backend
from hamsym.kernel.enclosures import Enclosures, enclosures
from hamsym.proof.arithmetic import directed
from tests.proof.built_cases import CASES, PROVEN, SOURCES

DEFINITION = re.compile(r"^#define ([A-Z_]+) (.+?)(?: +/\*.*)?$", re.MULTILINE)
VARIED = {name.partition(",")[0] for name in CASES}


def definitions() -> dict[str, str]:
    """All constants of the sources, and their values as text."""
    found: dict[str, str] = {}
    for source in SOURCES:
        found.update(DEFINITION.findall((build_backend.FOLDER / source).read_text("utf-8")))
    return {name: text for name, text in found.items() if not name.endswith("_H")}


def test_every_constant_has_a_case_or_a_reason():
    assert not VARIED & PROVEN.keys()
    assert definitions().keys() == VARIED | PROVEN.keys()


@pytest.mark.parametrize("name", CASES)
def test_bound_holds_for_the_case_that_is_built_for_it(name):
    assert CASES[name].search(enclosures()) == []


@functools.cache
def varied() -> ctypes.CDLL:
    """The library, with the constants that have cases as variables."""
    from tests.proof.test_mutations import _compile, _folder

    folder, made = Path(tempfile.mkdtemp(dir=_folder())), ["#define UNIT 0x1p-53"]

    def variable(found: re.Match[str]) -> str:
        name, value = found[1], found[2]
        if name not in VARIED:
            return found[0]
        made.append(f'__attribute__((visibility("default"))) double varied_{name} = {value};')
        return f"extern double varied_{name};\n#define {name} varied_{name}"

    for source in SOURCES:
        text = (build_backend.FOLDER / source).read_text("utf-8")
        (folder / source).write_text(DEFINITION.sub(variable, text), "utf-8")
    (folder / "constants.c").write_text("\n".join(made) + "\n", "utf-8")
    parts = [*folder.glob("*.c"), _folder() / "functions.o"]
    include = f"-I{build_backend.FOLDER}"
    _compile("-w", "-shared", include, *parts, "-o", folder / "varied.so", "-lm")
    return ctypes.CDLL(str(folder / "varied.so"))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_case_has_a_miss_if_its_constant_is_shrunk(name):
    case, library = CASES[name], varied()
    constant = ctypes.c_double.in_dll(library, f"varied_{name.partition(',')[0]}")
    assert constant.value == case.value
    assert case.search(Enclosures(library)) == []
    constant.value = case.shrunk
    try:
        assert case.search(Enclosures(library))
    finally:
        constant.value = case.value


# -- directed operations ---------------------------------------------------------------------------


def _misses_up(operation: Any) -> bool:
    """Whether a bound is below 1 + 2^-54, which is rounded to 1."""
    return not Fraction(float(operation(1.0 + 2.0**-54))) >= 1 + Fraction(2) ** -54


def _misses_down(operation: Any) -> bool:
    """Whether a bound is above 1 - 2^-55, which is rounded to 1."""
    return not Fraction(float(operation(1.0 - 2.0**-55))) <= 1 - Fraction(2) ** -55


#: The operation, a constant, its value if it is shrunk, and a search for a miss.
DIRECTED = [
    ("up", "_ROOM", 0.0, _misses_up),
    ("down", "_ROOM", 0.0, _misses_down),
    ("sum_up", "_BESIDE", -1, _misses_up),
    ("sum_down", "_BESIDE", -1, _misses_down),
    ("nearest_up", "UNIT", 2.0**-56, _misses_up),
]


@pytest.mark.parametrize(("operation", "constant", "shrunk", "misses"), DIRECTED)
def test_directed_operation_needs_its_constant(monkeypatch, operation, constant, shrunk, misses):
    assert not misses(getattr(directed, operation))
    monkeypatch.setattr(directed, constant, shrunk)
    assert misses(getattr(directed, operation))


def test_sums_of_numbers_that_underflow_need_an_absolute_bound(monkeypatch):
    tiny = np.full(2, 1e-162)
    exact = sum(Fraction(a) ** 2 for a in tiny.tolist())
    assert Fraction(float(directed.sum_up((tiny * tiny).sum()))) >= exact
    assert directed.sum_down((tiny * tiny).sum()) == 0
    monkeypatch.setattr(directed, "TINY", 0.0)
    assert not Fraction(float(directed.sum_up((tiny * tiny).sum()))) >= exact


def test_numbers_of_the_kernel_and_of_python_are_the_same():
    unit, second = 2.0**-53, 2.0**-106
    known = definitions()
    assert (known["UNIT"], known["MIDDLE"]) == ("0x1p-53", "(32 * UNIT * UNIT)")
    assert (unit, 32 * second) == (directed.UNIT, directed.MIDDLE)
    assert (float(known["SMALL"]), directed.TINY) == (1e-290, 1e-290)
    assert (float.fromhex(known["UNDERFLOW_ERROR"]), directed.UNDERFLOW) == (2.0**-1060,) * 2
