"""Files of solutions: exact to the last bit, and refused with a reason if they are invalid."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import math
import os
import pickle
import random
import re
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
import torch

import hamsym
from hamsym import FileError, Hamiltonian, InputError
from hamsym.random_features.basis import rate_series
from hamsym.solution.digest import digest
from hamsym.solving.methods import made_method
from hamsym.support.method_object import Method
from hamsym.support.records import packed
from hamsym.support.tensor_files import kind_of, read_tensors, write_tensors
from hamsym.systems import Problem

METHODS = {
    "features": {},
    "adam": {"epochs": 30, "points": 10, "energy_weight": 0.5},
    "lbfgs": {"iterations": 20, "points": 10, "shared_weights": False},
    "ssbroyden": {"iterations": 20, "points": 10, "hidden": (8,)},
    "levenberg-marquardt": {"iterations": 10, "points": 20, "hidden": (8,), "activation": "tanh"},
    "float32": {"epochs": 20, "points": 10, "dtype": "float32"},
}


def asked(name: str) -> Method:
    """The method of a row of the table."""
    return made_method("adam" if name == "float32" else name, METHODS[name])


def same_everywhere(one: hamsym.Solution, other: hamsym.Solution) -> None:
    t = np.linspace(*one.span, 301)
    for name in ("__call__", "derivative", "residual", "energy", "error_estimate"):
        np.testing.assert_array_equal(getattr(one, name)(t), getattr(other, name)(t), name)
    for name in ("H", "span", "method", "success", "message", "energy_weight", "ell_max", "points"):
        assert getattr(one, name) == getattr(other, name), name
    np.testing.assert_array_equal(one.z0, other.z0)
    np.testing.assert_array_equal(one.largest_error, other.largest_error)
    for name, value in vars(one.history).items():
        np.testing.assert_array_equal(value, getattr(other.history, name), name)


@pytest.mark.slow_cases("levenberg-marquardt", "adam", "ssbroyden", "float32", "lbfgs")
@pytest.mark.parametrize("method", METHODS)
def test_exact_to_the_last_bit(method: str, tmp_path: Path) -> None:
    problem = hamsym.systems.nonlinear_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0.0, 2.0), method=asked(method))
    solution.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    same_everywhere(solution, again)
    assert again.plot() is not None
    again.save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.slow_cases("double_pendulum", "coupled_oscillators")
def test_every_catalogue_system_is_restored(problem: Problem, tmp_path: Path) -> None:
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-6)
    solution.save(tmp_path / "a")
    same_everywhere(solution, hamsym.load(tmp_path / "a"))


def test_own_symbols_and_binary_fractions_are_restored(tmp_path: Path) -> None:
    x, p, k = sympy.symbols("x p k", positive=True)
    expr = p**2 / 2 + 0.1 * x**2 + k * x**4 * sympy.Float("0.3", 30) + sympy.sqrt(x)
    H = Hamiltonian(expr, q=[x], p=[p], parameters={"k": 1 / 3})
    solution = hamsym.solve(H, [1.0, 0.5], (1.0, 0.5), breakpoints=[0.7])
    solution.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    assert again.H == H
    assert again.H.parameters["k"] == 1 / 3
    same_everywhere(solution, again)


def test_failed_solution_stays_failed(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2/2 - x**4/4"), [1.0, 1.0], (0, 5))
    solution.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    assert not again.success
    assert again.message == solution.message


def test_foreign_and_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with pytest.raises(FileError, match="cannot be read"):
        hamsym.load(path)
    hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1)).save(path)
    whole = path.read_bytes()
    for content in (whole[:200], b"", b"\x80\x04pickle", whole[:-8]):
        path.write_bytes(content)
        with pytest.raises(FileError, match="damaged"):
            hamsym.load(path)
    length = struct.unpack("<Q", whole[:8])[0]

    def changed(**values: object) -> None:
        header = json.loads(whole[8 : 8 + length])
        metadata = json.loads(header["__metadata__"]["hamsym"])
        head = {key: values.pop(key) for key in ("version", "kind", "sha256") if key in values}
        metadata["values"] |= values
        header["__metadata__"]["hamsym"] = json.dumps({**metadata, **head})
        text = json.dumps(header).encode()
        path.write_bytes(sealed(struct.pack("<Q", len(text)) + text + whole[8 + length :]))

    for values, message in (
        ({"version": 99}, "version 99; this hamsym reads version 3"),
        ({"version": 2}, "file version 2; this hamsym reads version 3"),
        ({"kind": "other"}, "of kind other, not solution"),
        ({"sha256": "0" * 63}, "damaged"),
        ({"sha256": 3}, "damaged"),
        ({"span": "long"}, "not a valid file of a solution"),
        ({"H": {"formula": "__import__('os')", "floats": {}}}, "not a valid file of a solution"),
        ({"trial": {"form": "network"}}, "not a valid file of a solution"),
        (
            {"H": {"formula": {"formula": "p**2 + x**2", "floats": [1]}}},
            "not a valid file of a solution",
        ),
    ):
        changed(**values)
        with pytest.raises(FileError, match=message):
            hamsym.load(path)


@pytest.mark.parametrize("path", [5, None, "a\0b"])
def test_invalid_paths_are_refused(path: object) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    with pytest.raises(FileError, match="cannot be written"):
        solution.save(path)
    with pytest.raises(FileError, match="cannot be read"):
        hamsym.load(path)


def test_inconsistent_windows_are_refused(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    trial = dataclasses.replace(solution.trial, states=solution.trial.states[:, :1])
    arrays, values = packed(solution)
    arrays["trial.states"] = trial.states
    write_tensors(tmp_path / "a", "solution", arrays, values)
    solution = dataclasses.replace(solution, trial=trial)
    with pytest.raises(FileError, match="states' has shape"):
        hamsym.load(tmp_path / "a")
    with pytest.raises(FileError, match="states' has shape"):
        solution.save(tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_failed_write_keeps_the_old_file(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    with pytest.raises(FileError, match="cannot be written"):
        solution.save(tmp_path / "no" / "folder")
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError, match="cannot be written"):
        solution.save(tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_links_and_permissions_are_kept(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    (tmp_path / "folder").mkdir()
    target = tmp_path / "folder" / "target"
    for link in ("a", "b"):
        (tmp_path / link).symlink_to(target if link == "a" else "a")
    solution.save(tmp_path / "b")  # to where nothing is yet
    target.chmod(0o640)
    solution.save(tmp_path / "b")
    assert (tmp_path / "a").is_symlink()
    assert (tmp_path / "b").is_symlink()
    assert not target.is_symlink()
    assert target.stat().st_mode & 0o777 == 0o640
    assert hamsym.load(tmp_path / "b").H == solution.H


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_pipes_and_devices_are_written_to(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    solution.save(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "null").symlink_to(os.devnull)
    solution.save(tmp_path / "null")
    assert (tmp_path / "null").is_char_device()
    found = []
    reader = threading.Thread(target=lambda: found.append((tmp_path / "pipe").read_bytes()))
    reader.start()
    solution.save(tmp_path / "pipe")
    reader.join()
    assert (tmp_path / "pipe").is_fifo()
    assert found == [(tmp_path / "file").read_bytes()]
    for path in ("pipe", "null", "."):
        with pytest.raises(FileError, match="not a regular file"):
            hamsym.load(tmp_path / path)


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="no such device here")
@pytest.mark.parametrize("to", ["file", "pipe"])
def test_standard_output_is_written_to(to: str, tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from hamsym.support.atomic import write_atomically;"
        "print('before', flush=True); write_atomically(Path('/dev/stdout'), b'content')"
    )
    with open(tmp_path / "out", "w+b") as file:
        stdout = file if to == "file" else subprocess.PIPE
        run = subprocess.run([sys.executable, "-c", code], stdout=stdout, check=True)
        file.seek(0)
        assert (file.read() if to == "file" else run.stdout) == b"before\ncontent"


# -- damage ---------------------------------------------------------------------------------------


def sealed(content: bytes) -> bytes:
    """Return the file with the checksum of its edited content, as an attacker would."""
    found = re.search(rb'sha256\\": \\"([0-9a-f]{64})', content)
    if found is None:
        return content
    start, end = found.span(1)
    whole = hashlib.sha256(content[:start] + b"0" * 64 + content[end:]).hexdigest().encode()
    return content[:start] + whole + content[end:]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One file of each kind of solution."""
    x, p = sympy.symbols("x p", real=True)
    fractions = Hamiltonian(p**2 / 2 + sympy.Float(0.3) * x**2, q=[x], p=[p])
    solutions = {
        "features": hamsym.solve("p**2/2 - cos(x) + sin(t)*x/10", [1, 0.3], (0, 2), tol=1e-8),
        "backwards": hamsym.solve(fractions, [1, 0.3], (2, -1), tol=1e-4),
        "network": hamsym.solve("p**2/2 - cos(x)", [1, 0.3], (0, 2), method=asked("float32")),
        "networks": hamsym.solve("p**2/2 - 3*cos(x)/2", [1, 0.3], (0, 2), method=asked("lbfgs")),
    }
    folder, found = tmp_path_factory.mktemp("saved"), {}
    for name, solution in solutions.items():
        found[name] = folder / name
        solution.save(found[name])
    return found


def _bit(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(content))
    return (
        content[:place] + bytes([content[place] ^ 1 << chance.randrange(8)]) + content[place + 1 :]
    )


def _shortened(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def _without_a_byte(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(content))
    return content[:place] + content[place + 1 :]


def _blanked(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(content) - 64)
    return content[:place] + bytes(64) + content[place + 64 :]


def _swapped(content: bytes, chance: random.Random) -> bytes:
    size = (len(content) - 8) // 2
    first, second = sorted(chance.randrange(8, size, 8) for _ in range(2))
    second += size
    return (
        content[:first]
        + content[second : second + 8]
        + content[first + 8 : second]
        + content[first : first + 8]
        + content[second + 8 :]
    )


def _digit(content: bytes, chance: random.Random) -> bytes:
    """Another digit in the header."""
    length = 8 + struct.unpack("<Q", content[:8])[0]
    place = chance.choice([m.start() for m in re.finditer(rb"[0-9]", content[8:length])]) + 8
    other = chance.choice([d for d in b"0123456789" if d != content[place]])
    return content[:place] + bytes([other]) + content[place + 1 :]


def _type(content: bytes, chance: random.Random) -> bytes:
    """Another type of the same size for a tensor."""
    names = [m.span() for m in re.finditer(rb'"(F64|I64|F32)"', content)]
    start, end = chance.choice(names)
    same = (
        [b'"I64"', b'"U64"', b'"C64"'] if content[start:end] != b'"F32"' else [b'"I32"', b'"U32"']
    )
    return (
        content[:start]
        + chance.choice([t for t in same if t != content[start:end]])
        + content[end:]
    )


_DAMAGES = (_bit, _bit, _shortened, _without_a_byte, _blanked, _swapped, _digit, _type)


def _refused(path: Path) -> None:
    """Loading refuses a file in one sentence, with work in proportion to its size."""
    resource = pytest.importorskip("resource")
    memory, spent = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(FileError) as refusal:
        hamsym.load(path)
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 600 + len(str(path))
    assert time.process_time() - spent < 5  # thousandths of a second where nothing is wrong
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 500_000  # kB


def _damage(saved: dict[str, Path], path: Path, seeds: range) -> None:
    for seed in seeds:
        chance = random.Random(seed)
        content = chance.choice(sorted(saved.items()))[1].read_bytes()
        damaged = _DAMAGES[seed % len(_DAMAGES)](content, chance)
        if damaged != content:
            path.write_bytes(damaged)
            _refused(path)


@pytest.mark.slow
def test_damaged_files_are_refused(saved: dict[str, Path], tmp_path: Path) -> None:
    _damage(saved, tmp_path / "a", range(40))


def test_kind_of_files_of_another_length_is_unknown(saved: dict[str, Path], tmp_path: Path) -> None:
    content, path = saved["features"].read_bytes(), tmp_path / "a"
    for changed, kind in ((content, "solution"), (content[:-1], None), (content + b"0", None)):
        path.write_bytes(changed)
        assert kind_of(path) == kind


@pytest.mark.slow
def test_many_damaged_files_are_refused(saved: dict[str, Path], tmp_path: Path) -> None:
    _damage(saved, tmp_path / "a", range(40, 340))


# -- edits with a new checksum --------------------------------------------------------------------


def _set(*keys: Any, to: Any) -> Callable[[dict, dict], None]:
    """Return a function that replaces or removes one of the values."""

    def change(tensors: dict[str, Any], values: dict[str, Any]) -> None:
        *way, last = keys
        for key in way:
            values = values[key]
        if to is None:
            del values[last]
        else:
            values[last] = to

    return change


def _made(name: str, function: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict, dict], None]:
    def change(tensors: dict[str, Any], values: dict[str, Any]) -> None:
        tensors[name] = function(tensors[name].copy())

    return change


def _as(dtype: type) -> Callable[[np.ndarray], np.ndarray]:
    return lambda array: array.astype(dtype)


def _last(value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(tensor: np.ndarray) -> np.ndarray:
        tensor.reshape(-1)[-1] = value
        return tensor

    return change


def _next(tensor: np.ndarray) -> np.ndarray:
    return np.nextafter(tensor, tensor + 1)


def _swapped_edges(edges: np.ndarray) -> np.ndarray:
    return edges[[0, 2, 1, *range(3, len(edges))]]


_GIANT = 10**400
_TOWER = "p**2/2 + x**2 + exp(exp(exp(exp(number0))))"
_EDITS: dict[str, tuple[str, Callable[[dict, dict], None], str]] = {
    "complex states": ("features", _made("trial.states", _as(np.complex64)), "C64"),
    "half readouts": ("features", _made("trial.readouts", _as(np.float16)), "F16"),
    "float32 readouts": (
        "features",
        _made("trial.readouts", _as(np.float32)),
        "float64",
    ),
    "integer z0": (
        "features",
        _made("z0", _as(np.int64)),
        "'z0' is not of type float64",
    ),
    "float32 z0": (
        "network",
        _made("z0", _as(np.float32)),
        "'z0' is not of type float64",
    ),
    "float64 weights": (
        "network",
        _made("trial.weights", _as(np.float64)),
        "size and type",
    ),
    "another z0": ("features", _made("z0", _next), "does not start at its z0"),
    "another z0 backwards": ("backwards", _made("z0", _next), "does not start at its z0"),
    "another z0 of networks": ("networks", _made("z0", _next), "does not start at its z0"),
    "another z0 of float32": ("network", _made("trial.z0", _next), "does not start at its z0"),
    "another first state": (
        "features",
        _made("trial.states", lambda a: a[::-1]),
        "does not start",
    ),
    "permuted edges": ("features", _made("trial.edges", _swapped_edges), "not in order"),
    "equal edges": ("features", _made("trial.edges", lambda a: a * 0), "not in order"),
    "no edges": ("features", _made("trial.edges", lambda a: a[:0]), "edges' has shape"),
    "NaN": ("features", _made("trial.readouts", _last(math.nan)), "not finite"),
    "infinity": ("features", _made("trial.states", _last(math.inf)), "not finite"),
    "NaN weight": ("network", _made("trial.weights", _last(math.nan)), "not finite"),
    "NaN z0": ("features", _made("z0", _last(math.nan)), "not finite"),
    "NaN error": ("features", _made("error.series", _last(math.nan)), "not finite"),
    "infinite floor": ("features", _made("error.floors", _last(math.inf)), "not finite"),
    "negative error": ("features", _made("error.largest", _last(-1.0)), "negative size"),
    "error of other windows": (
        "features",
        _made("error.edges", lambda a: 2 * a),
        "windows of its error differ",
    ),
    "error of one component": (
        "features",
        _made("error.floors", lambda a: a[:, :1]),
        "has shape",
    ),
    "integer error": ("features", _made("error.largest", _as(np.int64)), "float64"),
    "long series": ("features", _made("trial.series", lambda a: np.tile(a, (999, 1))), "has shape"),
    "flat series": ("features", _made("trial.series", np.ravel), "has shape"),
    "series of rates": (
        "features",
        lambda tensors, values: tensors.update({"trial.rate_series": tensors["trial.series"]}),
        "rate_series",
    ),
    "further tensor": (
        "features",
        lambda tensors, values: tensors.update(more=tensors["z0"]),
        "'more'",
    ),
    "missing tensor": (
        "features",
        lambda tensors, values: tensors.pop("error.floors"),
        "floors' of its arrays is missing",
    ),
    "further value": ("features", _set("more", to=1), "'more'"),
    "missing value": ("features", _set("record", "seed", to=None), "'seed'"),
    "longer span": (
        "features",
        _set("span", to=[0.0, 3.0]),
        "span differs from that of its windows",
    ),
    "shorter span": (
        "features",
        _set("span", to=[0.0, 1.0]),
        "span differs from that of its windows",
    ),
    "turned span": (
        "backwards",
        _set("span", to=[-1.0, 2.0]),
        "span differs from that of its windows",
    ),
    "earlier span": ("network", _set("span", to=[-1.0, 2.0]), "span is not that of its network"),
    "three times": ("features", _set("span", to=[0.0, 1.0, 2.0]), "span"),
    "giant span": ("features", _set("span", to=[0.0, _GIANT]), "'span.1' is not of type float"),
    "endless span": ("network", _set("span", to=[0.0, math.inf]), "'span.1' is not finite"),
    "NaN span": ("network", _set("span", to=[0.0, math.nan]), "'span.1' is not finite"),
    "NaN tau": ("network", _set("trial", "tau", to=math.nan), "tau' is not finite"),
    "giant tau": ("network", _set("trial", "tau", to=_GIANT), "tau' is not of type float"),
    "tau of zero": ("network", _set("trial", "tau", to=0.0), "span is not that of its network"),
    "negative tau": ("network", _set("trial", "tau", to=-1.0), "span is not that of its network"),
    "huge sizes": (
        "network",
        _set("trial", "sizes", to=[1, 20_000, 20_000, 2]),
        "layers need",
    ),
    "huge sizes apart": (
        "networks",
        _set("trial", "sizes", to=[1, 10**9, 1]),
        "layers need",
    ),
    "negative sizes": ("network", _set("trial", "sizes", to=[1, 50, -50, 2]), "layer sizes"),
    "NaN frequency": ("network", _set("trial", "frequency", to=math.nan), "frequency"),
    "another form": ("network", _set("trial", "form", to="features"), "is missing|unknown"),
    "another method": ("features", _set("method", to="adam"), "does not return such"),
    "number of success": ("features", _set("success", to=1), "'success' is not of type bool"),
    "NaN weight of energy": ("network", _set("energy_weight", to=math.nan), "not finite"),
    "giant weight of energy": ("network", _set("energy_weight", to=_GIANT), "not of type float"),
    "another time reached": ("features", _set("record", "reached", to=1.0), "does not end at"),
    "fewer iterations": ("network", _set("record", "iterations", to=3), "number of iterations"),
    "giant seed": ("features", _set("record", "seed", to=10**300), "seed' is out of range"),
    "truth as seed": ("features", _set("record", "seed", to=True), "seed' is not of type int"),
    "infinite parameter": (
        "networks",
        _set(
            "H",
            to={
                "formula": {"formula": "p**2/2 - k*cos(x)", "floats": {}},
                "q": ["x"],
                "p": ["p"],
                "parameters": {"k": math.inf},
                "units": {},
                "forces": {},
            },
        ),
        "k' is not finite",
    ),
    "unbound parameter": (
        "networks",
        _set("H", "formula", "formula", to="p**2/2 - k*cos(x)"),
        "k has no value",
    ),
    "more components": ("networks", _set("H", "q", to=["x", "y"]), "not a valid file"),
    "endless names": ("networks", _set("H", "q", to=["x"] * 20_000), "10,000 entries"),
    "no H": ("networks", _set("H", to=3), "'H' is not a mapping"),
    "long formula": (
        "networks",
        _set("H", "formula", "formula", to="x + " * 20_000 + "p"),
        "formula",
    ),
    "exponent": (
        "backwards",
        _set("H", "formula", "floats", "number0", to=[0, "1", 2**30, 53]),
        "range",
    ),
    "giant exponent": (
        "backwards",
        _set("H", "formula", "floats", "number0", to=[0, "1", _GIANT, 53]),
        "range",
    ),
    "tiny exponent": (
        "backwards",
        _set("H", "formula", "floats", "number0", to=[0, "1", -(2**30), 53]),
        "range",
    ),
    "precision": (
        "backwards",
        _set("H", "formula", "floats", "number0", to=[0, "1", 0, 2**30]),
        "range",
    ),
    "long mantissa": (
        "backwards",
        _set("H", "formula", "floats", "number0", to=[0, "9" * 99_999, 0, 53]),
        "invalid",
    ),
    "short number": (
        "backwards",
        _set("H", "formula", "floats", "number0", to=[0, "1"]),
        "2 entries, not 4",
    ),
    "tower": (
        "backwards",
        lambda tensors, values: values["H"]["formula"].update(
            formula=_TOWER, floats={"number0": [0, "21", 0, 53]}
        ),
        "not finite",
    ),
}


@pytest.mark.parametrize("name", _EDITS)
def test_edited_files_are_refused(name: str, saved: dict[str, Path], tmp_path: Path) -> None:
    kind, change, message = _EDITS[name]
    tensors, values = read_tensors(saved[kind], "solution")
    change(tensors, values)
    write_tensors(tmp_path / "a", "solution", tensors, values)
    _refused(tmp_path / "a")
    with pytest.raises(FileError, match=message):
        hamsym.load(tmp_path / "a")


def test_sizes_are_compared_before_allocation(
    saved: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tensors, values = read_tensors(saved["network"], "solution")
    values["trial"]["sizes"] = [1, 20_000, 20_000, 2]
    write_tensors(tmp_path / "a", "solution", tensors, values)
    monkeypatch.setattr("hamsym.networks.trial.Network", None)
    with pytest.raises(FileError, match="layers need"):
        hamsym.load(tmp_path / "a")


def test_header_is_checked_before_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "a"
    for length in (0, 100, 2**32, 2**63):
        with open(path, "wb") as file:
            file.write(struct.pack("<Q", length))
            file.truncate(2**33)  # of which the disk holds next to nothing
        _refused(path)
    with open(path, "wb") as file:
        file.truncate(2**40)
    with pytest.raises(FileError, match="larger than any file that hamsym writes"):
        hamsym.load(path)
    for text in (
        b"[" * 1_000_000,
        b'{"a":' * 100_000,
        b"1" * 5_000,
        b'{"__metadata__": {"hamsym": 3}}',
    ):
        path.write_bytes(struct.pack("<Q", len(text)) + text)
        _refused(path)


@pytest.mark.slow
def test_edited_file_loads_only_if_rewritten_equal(saved: dict[str, Path], tmp_path: Path) -> None:
    """Random edits under a new checksum: refused, or every value of the file is used."""
    path, loaded = tmp_path / "a", 0
    for seed in range(300):
        chance = random.Random(seed)
        content = chance.choice(sorted(saved.items()))[1].read_bytes()
        path.write_bytes(sealed(_DAMAGES[seed % len(_DAMAGES)](content, chance)))
        try:
            solution = hamsym.load(path)
        except FileError:
            continue
        loaded += 1
        tensors, values = read_tensors(path, "solution")
        again_tensors, again_values = packed(solution)
        assert tensors.keys() == again_tensors.keys()
        for name, tensor in tensors.items():
            assert tensor.tobytes() == again_tensors[name].tobytes(), name
        values.pop("H")  # which may be written in another way
        again_values.pop("H")
        assert values == json.loads(json.dumps(again_values))
        assert len(digest(solution)) == 64
    assert 30 < loaded < 270


# -- digests --------------------------------------------------------------------------------------


def test_digest_depends_on_every_bit(saved: dict[str, Path], tmp_path: Path) -> None:
    solution = hamsym.load(saved["features"])
    original = digest(solution)
    assert digest(hamsym.load(saved["features"])) == original
    assert digest(pickle.loads(pickle.dumps(solution))) == original
    assert digest(solution.judged(False, "forgotten")) == original
    for name in ("states", "readouts", "series"):
        changed = copy.deepcopy(solution)
        getattr(changed.trial, name)[-1, -1] = _next(getattr(changed.trial, name)[-1, -1])
        assert digest(changed) != original


@pytest.mark.parametrize("name", ["states", "readouts"])
def test_digest_refuses_other_types(name: str, saved: dict[str, Path]) -> None:
    solution = hamsym.load(saved["features"])
    original = getattr(solution.trial, name)
    for dtype in (np.complex64, np.complex128, np.int64, np.float32):
        trial = dataclasses.replace(solution.trial, **{name: original.astype(dtype)})
        changed = dataclasses.replace(solution, trial=trial)
        with pytest.raises(InputError, match=f"{name}' is not of type float64"):
            digest(changed)
        with pytest.raises(FileError, match=f"{name}' is not of type float64"):
            changed.save("never written")


def test_success_needs_finite_numbers(saved: dict[str, Path], tmp_path: Path) -> None:
    solution = hamsym.load(saved["features"])
    solution.error.largest[0] = math.nan
    with pytest.raises(FileError, match="'largest' of its error is not finite"):
        solution.save(tmp_path / "a")
    # A failure may have an error that cannot be estimated.
    solution.judged(False, "failed").save(tmp_path / "a")
    assert math.isnan(hamsym.load(tmp_path / "a").error.largest[0])


def test_rates_are_those_of_the_series(saved: dict[str, Path]) -> None:
    """The derivative against divided differences of the function in extended precision."""
    trial = hamsym.load(saved["features"]).trial
    x = np.linspace(-0.999, 0.999, 41)
    series, h = trial.series.astype(np.longdouble), np.longdouble(1e-5)
    value = np.polynomial.chebyshev.chebval
    slopes = [(value(x + k * h, series) - value(x - k * h, series)) / (k * h) for k in (1, 2)]
    exact = ((4 * slopes[0] - slopes[1]) / 3).astype(float)  # of s = (x + 1) / 2
    found = value(x, rate_series(trial.series))
    np.testing.assert_allclose(found, exact, atol=1e-8 * np.abs(exact).max())


# -- how nearby solutions move --------------------------------------------------------------------


@pytest.mark.slow_cases("henon_heiles", "kepler", "double_pendulum")
@pytest.mark.parametrize("name", ["henon_heiles", "kepler", "charged_particle", "double_pendulum"])
def test_sensitivity_against_finite_differences(name: str) -> None:
    problem = hamsym.systems.CATALOGUE[name]()
    span = (0.0, 5.0)
    solution = hamsym.solve(problem.H, problem.z0, span, tol=1e-11)
    t = np.array([0.0, 0.3, 2.0, 5.0])
    found = solution.sensitivity(t)
    np.testing.assert_allclose(found[0], np.eye(problem.H.dim), atol=1e-14)
    for i, unit in enumerate(np.eye(problem.H.dim)):
        h = 1e-4
        ends = [
            hamsym.solve(problem.H, solution.z0 + side * h * unit, span, tol=1e-12)(t)
            for side in (-2, -1, 1, 2)
        ]
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        np.testing.assert_allclose(found[:, :, i], slope, atol=2e-6 * np.abs(found).max())
    J = np.array(problem.H.poisson_matrix, dtype=float)
    np.testing.assert_allclose(
        found[-1].T @ J @ found[-1], J, atol=1e-7 * np.abs(found[-1]).max() ** 2
    )


@pytest.mark.slow
def test_sensitivity_of_a_trained_network() -> None:
    H = Hamiltonian("p**2/2 + x**2/2")
    solution = hamsym.solve(
        H,
        [1, 0],
        (0, 6),
        method=hamsym.LevenbergMarquardt(iterations=60, points=50, hidden=(20, 20)),
    )
    t = np.linspace(0, 6, 7)
    exact = np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]).transpose(2, 0, 1)
    np.testing.assert_allclose(solution.sensitivity(t), exact, atol=1e-8)


@pytest.mark.slow_cases(
    "<lambda>-levenberg-marquardt", "deepcopy-levenberg-marquardt", "deepcopy-adam", "<lambda>-adam"
)
@pytest.mark.parametrize("method", ["features", "levenberg-marquardt", "adam"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_solutions_are_copied_and_pickled(method: str, copied: Callable[[Any], Any]) -> None:
    few = {"levenberg-marquardt": {"iterations": 3}, "adam": {"epochs": 3}}.get(method, {})
    made = made_method(method, few)
    solution = hamsym.solve("p**2/2 - cos(x)", [1, 0], (0, 5), method=made)
    again = copied(solution)
    t = np.linspace(0, 5, 101)
    np.testing.assert_array_equal(again(t), solution(t))
    np.testing.assert_array_equal(again.error_estimate(t), solution.error_estimate(t))
    assert (again.success, again.message) == (solution.success, solution.message)
    assert (again.H, again.span, again.method) == (solution.H, solution.span, method)
    assert again.evaluations == solution.evaluations


@pytest.mark.parametrize("backend", ["numpy", "torch", "numba"])
def test_generated_functions_are_pickled(backend: str) -> None:
    system = hamsym.Hamiltonian("p**2/2 - cos(x)*t").compile(backend)
    again = pickle.loads(pickle.dumps(system))
    assert again.source == system.source
    z = torch.tensor([0.3, 0.2], dtype=torch.float64)
    z = z if backend == "torch" else z.numpy()
    assert (again.vector_field(z, 2.0) == system.vector_field(z, 2.0)).all()


def test_success_with_a_larger_error_than_allowed_is_refused(tmp_path: Path) -> None:
    solution = hamsym.solve("p**2/2 + x**4/4", [1, 0], (0, 10), tol=1e-6)
    settings = dataclasses.replace(solution.settings, tol=1e-15)
    with pytest.raises(FileError, match="larger than allowed"):
        dataclasses.replace(solution, settings=settings).save(tmp_path / "forged.hamsym")
