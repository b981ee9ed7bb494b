"""Compiled code: equal results, and a cache that only the user can write."""

from __future__ import annotations

import importlib.util
import os
import py_compile
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.codegen import numba_cache
from hamsym.codegen.generate import Source
from hamsym.random_features import compiled_loop, error_loop, row_products, window_loop
from hamsym.symbolic import derivatives
from hamsym.systems import CATALOGUE


@pytest.mark.slow_cases("double_pendulum", "kepler")
@pytest.mark.parametrize("name", ["driven_oscillator", "kepler", "double_pendulum"])
def test_compiled_and_plain_march_agree(name: str) -> None:
    problem = CATALOGUE[name]()
    plain = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9, compiled=False)
    fast = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9, compiled=True)
    assert (plain.history.compiled, fast.history.compiled) == (False, True)
    assert fast.success
    t = np.linspace(*problem.span, 501)
    assert (np.abs(fast(t) - plain(t)) <= 2e-9 * plain.scale).all()
    assert abs(len(fast.history.edges) - len(plain.history.edges)) <= 1


@pytest.mark.slow
def test_short_march_does_not_compile() -> None:
    code = (
        "import sys, hamsym; hamsym.solve(hamsym.Hamiltonian('p**2 + x**2'), [1, 0], (0, 9));"
        "sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_compiles_when_it_saves_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_loop, "cost", lambda: 0.0)
    H = Hamiltonian("p**2/2 + x**2/2 + x**6/6")
    solution = hamsym.solve(H, [1.0, 0.0], (0, 200), tol=1e-9)
    assert solution.success
    assert solution.history.compiled
    monkeypatch.setattr(compiled_loop, "cost", lambda: 100.0)
    other = Hamiltonian("p**2/2 + x**2/2 + x**6/12 + x**6/12")
    assert not hamsym.solve(
        other, [1.0, 0.0], (0, 1)
    ).history.compiled  # equal to H, which was compiled


@pytest.mark.parametrize("value", ["always", None, 2, 1])
def test_compiled_is_true_false_or_auto(value: object) -> None:
    with pytest.raises(InputError, match="compiled="):
        hamsym.solve("p**2/2 + x**2/2", [1.0, 0.0], (0, 1), compiled=value)


def test_parameters_and_time_reach_compiled_code() -> None:
    H = Hamiltonian("p**2/(2*m) + k*x**2/2 - x*cos(2*t)", parameters={"m": 2.0, "k": 3.0})
    plain = hamsym.solve(H, [0.3, 0.1], (1.0, 9.0), tol=1e-10, compiled=False)
    fast = hamsym.solve(H, [0.3, 0.1], (1.0, 9.0), tol=1e-10, compiled=True)
    assert fast.history.compiled
    t = np.linspace(1, 9, 101)
    np.testing.assert_allclose(fast(t), plain(t), atol=1e-9)


def test_row_functions_agree_with_numpy() -> None:
    """The functions that compiled loops call compute what the plain ones do, NaN included."""
    random = np.random.default_rng(0)
    for dim, nodes in ((1, 8), (2, 16), (3, 24), (7, 40)):
        table, rows = random.normal(size=(nodes, 24)), random.normal(size=(dim, nodes))
        base, before = random.normal(size=(2, dim, 24))
        found, wanted = np.empty((2, dim, 24))
        row_products.products(table, rows, found)
        window_loop.products(table, rows, wanted)
        np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)
        states, others = before.copy(), before.copy()
        changes, sizes = np.empty((2, dim, 8))
        row_products.advance(table, rows, base, 0.3, states, changes)
        window_loop.advance(table, rows, base, 0.3, others, sizes)
        np.testing.assert_allclose(states, others, rtol=1e-13, atol=1e-13)
        scale = random.uniform(1, 2, size=dim)
        assert row_products.ratio(changes, scale) == pytest.approx(window_loop.ratio(sizes, scale))
        found, wanted = np.empty((2, dim))
        row_products.row_sizes(rows, found)
        window_loop.row_sizes(rows, wanted)
        np.testing.assert_array_equal(found, wanted)
        found[:] = wanted[:] = scale
        row_products.widen(found, rows)
        window_loop.widen(wanted, rows)
        np.testing.assert_array_equal(found, wanted)
        rows[dim - 1, nodes - 2] = np.nan
        row_products.advance(table, rows, base, 0.3, states, changes)
        assert np.isnan(row_products.ratio(changes, scale))
        row_products.row_sizes(rows, found)
        assert np.isnan(found[dim - 1])
        row_products.widen(wanted, rows)
        assert np.isnan(wanted[dim - 1])


def test_error_functions_agree_with_numpy() -> None:
    random = np.random.default_rng(1)
    each = error_loop.PERTURBATIONS + 2
    actions = error_loop.Actions(
        rows=np.array([0, 2]),
        starts=np.array([0, 2]),
        sources=np.array([1, 4, 0, 5, 2]),
        entries=np.array([0, 1, 2, 0, 1]),
        factors=random.normal(size=5),
    )
    second, vectors = random.normal(size=(3, 16)), random.normal(size=(6 * each, 16))
    found, wanted = np.empty((2, 3 * each, 16))
    row_products.apply(actions, second, vectors, found)
    error_loop.apply(actions, second, vectors, wanted)
    np.testing.assert_allclose(found, wanted, atol=1e-13)
    drift, scale = random.normal(size=(6, 16)), random.uniform(1, 2, size=6)
    for name, shape, arguments in (
        ("deviations", (2, 6), (vectors,)),
        ("typical_noise", (6 * each,), (vectors, vectors[::-1].copy())),
        ("component_sizes", (6 * each,), (vectors, 0.1)),
        ("join_error", (6, 16), (vectors, drift, 0.3, scale)),
    ):
        found, wanted = np.empty((2, *shape))
        getattr(row_products, name)(*arguments, found)
        getattr(error_loop, name)(*arguments, wanted)
        np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)
    found, wanted = vectors.copy(), vectors.copy()
    row_products.force_error(found, drift, 0.3, scale)
    error_loop.force_error(wanted, drift, 0.3, scale)
    np.testing.assert_allclose(found, wanted, rtol=1e-13)


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


def _all_but_the_loop(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if not name.startswith(("window_loop_", "__pycache__"))]


@pytest.mark.slow
def test_damaged_cache_is_replaced(tmp_path: Path) -> None:
    code = (
        "import hamsym; H = hamsym.Hamiltonian('p**2/2 + x**4');"
        "print(hamsym.solve(H, [1, 0], (0, 1), compiled=True).history.compiled)"
    )
    environment = {**os.environ, "HAMSYM_CACHE_DIR": str(tmp_path)}
    run = [sys.executable, "-c", code]
    # The loop of the march is the same for every H and slow to compile: it is copied.
    hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1), compiled=True)
    shutil.copytree(
        numba_cache.cache_directory(), tmp_path, ignore=_all_but_the_loop, dirs_exist_ok=True
    )
    subprocess.run(run, env=environment, check=True)
    for file in (tmp_path / "__pycache__").glob("numba_*.nb?"):
        file.write_bytes(b"damaged")
    again = subprocess.run(run, env=environment, check=True, capture_output=True, text=True)
    assert again.stdout == "True\n"
