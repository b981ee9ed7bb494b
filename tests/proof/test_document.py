"""The page of the proofs names functions that exist, and every constant that a bound has."""

from __future__ import annotations

import importlib
import numbers
import pkgutil
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

import hamsym.proof
from hamsym.kernel import build_backend
from tests.proof.test_constants import SOURCES, definitions

PAGE = Path(__file__).parents[2] / "examples" / "guide" / "how_proofs_work.md"
TEXT = PAGE.read_text("utf-8")
NAMED = set(re.findall(r"`([^`\n]+)`", TEXT))
FOLDERS = ("dynamics", "orbits", "symbolic")
#: Names without a dot that are not those of the kernel.
OTHERS = {"hamsym", "checker", "abs", "sign", "min", "verify", "terms", "dim", "sum_up", "prove"}
PYTHON = sorted(
    name
    for name in NAMED
    if re.fullmatch(r"[a-z_0-9]+(\.\w+)+", name) and not name.startswith(("torch", "hamsym"))
)
COMPILED = sorted({name for name in NAMED if re.fullmatch(r"[a-z][a-z_]+", name)} - OTHERS)


def found(name: str) -> Any:
    """What a dotted name of the page means."""
    parts = f"hamsym.{name}" if name.startswith(FOLDERS) else f"hamsym.proof.{name}"
    path, rest = parts.split("."), []
    while path:
        try:
            result = importlib.import_module(".".join(path))
        except ModuleNotFoundError:
            rest.insert(0, path.pop())
        else:
            for part in rest:
                result = getattr(result, part)
            return result
    raise AssertionError(f"nothing is called {name}")


@pytest.mark.parametrize(
    "name", [name for name in PYTHON if not name.startswith(("torch", "hamsym"))]
)
def test_python_names_of_the_page_exist(name):
    assert found(name) is not None


@pytest.mark.parametrize("name", COMPILED)
def test_compiled_names_of_the_page_exist(name):
    texts = [(build_backend.FOLDER / source).read_text("utf-8") for source in SOURCES]
    assert any(re.search(rf"\b{name}\(", text) for text in texts)


def test_page_names_enough_to_be_a_proof():
    lemmas = [int(number) for number in re.findall(r"^\*\*Lemma (\d+)", TEXT, re.MULTILINE)]
    assert lemmas == list(range(1, len(lemmas) + 1))
    assert len(lemmas) > 30
    assert len(PYTHON) > 50
    assert len(COMPILED) > 40


def test_every_constant_of_the_kernel_is_named():
    text = "".join((build_backend.FOLDER / source).read_text("utf-8") for source in SOURCES)
    balls = re.findall(r"^(?:static )?const ball ([A-Z_0-9]+)", text, re.MULTILINE)
    constants = {*definitions(), *balls}
    assert len(constants) > 30
    assert constants - NAMED == set()


def _is_number(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_is_number, (*value, *value.values())))
    if isinstance(value, tuple):
        return bool(value) and all(map(_is_number, value))
    return isinstance(value, numbers.Number | Fraction) and not isinstance(value, bool)


def test_every_number_of_the_modules_of_proofs_is_named():
    modules = pkgutil.walk_packages(hamsym.proof.__path__, "hamsym.proof.")
    known = set()
    for each in modules:
        module = importlib.import_module(each.name)
        known |= {
            name
            for name, value in vars(module).items()
            if re.fullmatch(r"_?[A-Z][A-Z_0-9]+", name) and _is_number(value)
        }
    kernel = {name for name in known if hasattr(hamsym.kernel.enclosures, name)}
    bits = {"_SIGN", "_ONE", "_LEAST", "_UNIT"}  # of numbers whose sums are known
    assert known - kernel - bits - NAMED == set()
    private = {name for name in NAMED if re.fullmatch(r"_[A-Z][A-Z_0-9]+", name)}
    assert private - known == set()
