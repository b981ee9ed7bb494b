"""Compiled code: equal results, and a cache that only the user can write."""

from __future__ import annotations

import importlib.util
import os
import py_compile
import stat
import time
from pathlib import Path

import numpy as np
import pytest

from hamsym import Hamiltonian
from hamsym.codegen import numba_cache
from hamsym.codegen.generate import Source
from hamsym.codegen.system import System
from hamsym.symbolic import derivatives

# -- the cache -------------------------------------------------------------------------------------


@pytest.fixture
def fresh_cache(monkeypatch: pytest.MonkeyPatch):
    numba_cache.cache_directory.cache_clear()
    yield monkeypatch
    monkeypatch.undo()
    numba_cache.cache_directory.cache_clear()


def test_cache_directory_is_private(fresh_cache, tmp_path: Path) -> None:
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path / "a" / "cache"))
    path = numba_cache.cache_directory()
    assert path == (tmp_path / "a" / "cache").resolve()
    assert stat.S_IMODE(path.stat().st_mode) == 0o700
    module = numba_cache.load_module("VALUE = 3\n", "numba")
    assert module.VALUE == 3
    assert Path(module.__file__).parent == path
    Path(module.__file__).write_text("VALUE = 4\n")
    assert numba_cache.load_module("VALUE = 3\n", "numba").VALUE == 3
    assert not [entry for entry in path.iterdir() if entry.name.startswith(".")]


def test_planted_bytecode_does_not_run(fresh_cache, tmp_path: Path) -> None:
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    path = Path(numba_cache.load_module("VALUE = 3\n", "numba").__file__)
    other = tmp_path / "other.py"
    other.write_text("VALUE = 4\n")
    planted = Path(importlib.util.cache_from_source(str(path)))
    planted.parent.mkdir(exist_ok=True)
    unchecked = py_compile.PycInvalidationMode.UNCHECKED_HASH  # which Python loads without a check
    py_compile.compile(str(other), str(planted), invalidation_mode=unchecked)
    assert numba_cache.load_module("VALUE = 3\n", "numba").VALUE == 3


def test_cached_texts_are_validated(fresh_cache, tmp_path: Path) -> None:
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    fresh_cache.setattr(numba_cache, "_SLOW", -1.0)
    assert numba_cache.cached_text("key", lambda: "one") == "one"
    assert numba_cache.cached_text("key", lambda: "two") == "one"
    assert numba_cache.cached_text("other", lambda: "two") == "two"
    (file,) = [path for path in tmp_path.glob("text_*.txt") if "one" in path.read_text()]
    for damaged in (file.read_bytes().replace(b"one", b"own"), b"one", b"", b"\xff\n"):
        file.write_bytes(damaged)
        assert numba_cache.cached_text("key", lambda: "three") == "three"
        file.write_bytes(damaged)
    (key, text) = ("key", "one")
    file.write_text(f"{numba_cache._digest('other key', text)}\n{text}")
    assert numba_cache.cached_text(key, lambda: "four") == "four"


def test_derived_text_serves_the_next_process(fresh_cache, tmp_path: Path) -> None:
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    fresh_cache.setattr(numba_cache, "_SLOW", -1.0)
    H = Hamiltonian(" + ".join(f"p{i}**2/2 + cos(x{i} - x{i + 1})" for i in range(8)) + " + p8**2")
    written = Source(H.real_equations, "numba").module("splitting")
    fresh_cache.setattr(derivatives, "gradient", lambda *_: pytest.fail("derived again"))
    again = Hamiltonian(H.expr, q=H.q, p=H.p).real_equations
    again.__dict__["is_separable"] = True
    assert Source(again, "numba").module("splitting") == written


@pytest.mark.parametrize("damage", [b"", b"damaged", None])
def test_damaged_code_is_compiled_again(fresh_cache, tmp_path: Path, damage: bytes | None) -> None:
    """Of a generated function: cut, replaced, or with one bit changed."""
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    form = Hamiltonian("p**2/2 + x**2/2").real_equations

    def hits() -> int:
        energy = System(Source(form, "numba")).function("energy")
        assert energy(np.array([1.0, 2.0])) == 2.5
        return sum(energy.__globals__["_energy"].stats.cache_hits.values())

    assert (hits(), hits()) == (0, 1)
    for file in (tmp_path / "__pycache__").iterdir():
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content if damage is None else damage)
    assert (hits(), hits()) == (0, 1)


def _entry(cache: Path, source: str, days: float, size: int) -> list[Path]:
    """Add a source and its compiled file to the cache, last used ``days`` days ago."""
    path = Path(numba_cache.load_module(source, "numba").__file__)
    data = cache / "__pycache__" / f"{path.stem}.function-1.py311.1.nbc"
    data.write_bytes(bytes(size))
    then = time.time() - 86_400 * days
    for file in (path, data):
        os.utime(file, (then, then))
    return [path, data]


def test_old_cache_entries_are_removed(fresh_cache, tmp_path: Path) -> None:
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    fresh_cache.setattr(numba_cache, "_LARGEST", 3_000)
    ages = {"new": 0.0, "recent": 1.5, "older": 30.0, "oldest": 60.0, "forgotten": 91.0}
    entries = {name: _entry(tmp_path, f"NAME = '{name}'\n", age, 900) for name, age in ages.items()}

    def left() -> set[str]:
        both = {name: [file.exists() for file in files] for name, files in entries.items()}
        assert all(one == other for one, other in both.values())
        return {name for name, (there, _) in both.items() if there}

    assert numba_cache.load_module("NAME = 'oldest'\n", "numba").NAME == "oldest"  # used again
    numba_cache.load_module("VALUE = 1\n", "numba")
    assert left() == {*ages}  # pruned today already
    os.utime(tmp_path / "pruned", (0, 0))
    numba_cache.load_module("VALUE = 2\n", "numba")
    assert left() == {"new", "recent", "oldest"}
    fresh_cache.setattr(numba_cache, "_LARGEST", 0)
    os.utime(tmp_path / "pruned", (0, 0))
    numba_cache.load_module("VALUE = 3\n", "numba")
    assert left() == {"new", "oldest"}  # used within a day: another process may load them


def test_reading_the_cache_keeps_modification_time(fresh_cache, tmp_path: Path) -> None:
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(tmp_path))
    path, _ = _entry(tmp_path, "VALUE = 3\n", 50.0, 1)
    before = path.stat()
    numba_cache.load_module("VALUE = 3\n", "numba")
    after = path.stat()
    assert (after.st_mtime_ns, after.st_size) == (before.st_mtime_ns, before.st_size)
    assert time.time() - after.st_atime < 3_600


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no permission bits here")
@pytest.mark.parametrize("unsafe", ["writable by others", "a link", "a file"])
def test_unsafe_cache_directory_is_not_used(fresh_cache, tmp_path: Path, unsafe: str) -> None:
    path = tmp_path / "cache"
    if unsafe == "a file":
        path.write_text("")
    elif unsafe == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        path.symlink_to(tmp_path / "elsewhere")
    else:
        path.mkdir()
        path.chmod(0o777)
    fresh_cache.setenv("HAMSYM_CACHE_DIR", str(path))
    used = numba_cache.cache_directory()
    assert tmp_path.resolve() not in used.resolve().parents
    assert stat.S_IMODE(used.stat().st_mode) == 0o700
