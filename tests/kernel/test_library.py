"""The library of the kernel is compiled, found and checked."""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import threading
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from setuptools.errors import CompileError

import hamsym
from hamsym.bounds import models
from hamsym.errors import FileError, HamsymError, InputError
from hamsym.kernel import build_backend, library
from hamsym.proof.arithmetic import directed
from hamsym.random_features import window_checks
from hamsym.random_features.error_estimate import _PERTURBATIONS

ROOT = Path(hamsym.__file__).parents[1]
# Numbers of fesetround: upward, downward, towards zero.
_ROUNDING = {"x86_64": (0x800, 0x400, 0xC00), "aarch64": (0x400000, 0x800000, 0xC00000)}
_LOAD = """
from hamsym.kernel import library
print(library.__file__)
for level in library.supported_levels():
    library.require_arithmetic(library.open_library(level))
library.kernel_library()
"""


def in_thread(function):
    """The result of a function in a thread of its own, whose arithmetic it may change."""
    results = []
    thread = threading.Thread(target=lambda: results.append(function()))
    thread.start()
    thread.join()
    return results[0]


def message_of_arithmetic():
    try:
        library.require_arithmetic(library.kernel_library())
    except HamsymError as error:
        return str(error)
    return ""


# -- loading ---------------------------------------------------------------------------------------


def test_all_levels_load_and_agree():
    numbers = {library.open_library(level).hamsym_level() for level in build_backend.LEVELS}
    assert len(numbers) == 1
    levels = library.supported_levels()
    assert levels == build_backend.LEVELS[: len(levels)]
    for level in levels:
        assert library.open_library(level).hamsym_arithmetic() == 0


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="no list of the features")
@pytest.mark.skipif(not build_backend.X86, reason="one level on this architecture")
def test_level_agrees_with_the_system():
    flags = set(Path("/proc/cpuinfo").read_text().partition("flags")[2].partition("\n")[0].split())
    v3 = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"} <= flags
    v4 = v3 and {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= flags
    assert library.supported_levels() == ("v2", "v3", "v4")[: 1 + v3 + v4]


def test_environment_chooses_the_level(monkeypatch):
    monkeypatch.delenv(library.LEVEL_VARIABLE, raising=False)
    assert library.chosen_level() == library.supported_levels()[-1]
    for level in library.supported_levels():
        monkeypatch.setenv(library.LEVEL_VARIABLE, level)
        assert library.chosen_level() == level


def test_unknown_level_is_refused(monkeypatch):
    monkeypatch.setenv(library.LEVEL_VARIABLE, "v9")
    with pytest.raises(InputError, match=r"HAMSYM_KERNEL_LEVEL must be one of .* not 'v9'"):
        library.chosen_level()


@pytest.mark.skipif(not build_backend.X86, reason="one level on this architecture")
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_levels_above_the_processor_are_refused(number, monkeypatch):
    older = SimpleNamespace(hamsym_level=lambda: number)
    monkeypatch.setattr(library, "open_library", lambda level: older)
    if number == 1:
        with pytest.raises(HamsymError, match="needs an x86-64 processor with"):
            library.chosen_level()
        return
    assert library.supported_levels() == ("v2", "v3", "v4")[: number - 1]
    monkeypatch.setenv(library.LEVEL_VARIABLE, f"v{number + 1}")
    with pytest.raises(InputError, match="on this processor"):
        library.chosen_level()


def test_missing_library_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(library, "_FOLDER", tmp_path)
    with pytest.raises(FileError, match=r"was not compiled .*'pip install -e \.' in a checkout"):
        library.open_library("v2")
    (tmp_path / "kernel.v2.so").write_text("no library")
    with pytest.raises(FileError, match="cannot be loaded"):
        library.open_library("v2")


def test_import_loads_no_library():
    code = "import sys, hamsym; print([name for name in sys.modules if 'kernel' in name])"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert "hamsym" not in done.stdout


@pytest.mark.skipif(
    platform.machine() not in _ROUNDING or sys.platform == "win32", reason="numbers unknown"
)
@pytest.mark.parametrize("place", [0, 1, 2])
def test_other_rounding_is_refused(place):
    mode = _ROUNDING[platform.machine()][place]

    def change():
        assert ctypes.CDLL(ctypes.util.find_library("m")).fesetround(mode) == 0
        return message_of_arithmetic()

    assert "lacks rounding to nearest in this thread" in in_thread(change)
    assert message_of_arithmetic() == ""


def test_flushed_subnormals_are_refused():
    import torch

    def change():
        assert torch.set_flush_denormal(True)
        return message_of_arithmetic()

    assert "lacks subnormal numbers in this thread" in in_thread(change)


# -- building --------------------------------------------------------------------------------------


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """The smallest source as the only one, with an empty folder for libraries."""
    if build_backend._compiler() is None:
        pytest.skip("there is no C compiler")
    sources = tmp_path / "sources"
    sources.mkdir()
    shutil.copy(build_backend.FOLDER / "level.c", sources)
    monkeypatch.setattr(build_backend, "FOLDER", sources)
    return tmp_path


def test_only_older_libraries_are_compiled(copied, monkeypatch):
    build_backend.compile_libraries(copied / "built")
    names = {path.name for path in (copied / "built").iterdir()}
    assert names == {f"kernel.{level}.so" for level in build_backend.LEVELS}
    monkeypatch.setenv("CC", "no-such-compiler")
    build_backend.compile_libraries(copied / "built")
    (copied / "sources/new.h").touch()
    later = 60 + (copied / "sources/new.h").stat().st_mtime
    os.utime(copied / "sources/new.h", (later, later))
    with pytest.raises(CompileError, match="'no-such-compiler' does not exist or failed"):
        build_backend.compile_libraries(copied / "built")
    assert {path.name for path in (copied / "built").iterdir()} == names


def test_flags_for_fast_mathematics_are_found(copied, monkeypatch):
    """Contraction, which -O3 alone allows where the level has a fused operation."""
    if "v3" not in library.supported_levels():
        pytest.skip("the lowest level has no fused operation to contract to")
    flags = build_backend.FLAGS.replace("-ffp-contract=off", "-ffp-contract=fast")
    monkeypatch.setattr(build_backend, "FLAGS", flags)
    build_backend.compile_libraries(copied / "built")
    monkeypatch.setattr(library, "_FOLDER", copied / "built")
    with pytest.raises(HamsymError, match="lacks operations rounded one by one"):
        library.require_arithmetic(library.open_library("v3"))


def test_a_compiler_is_required_where_there_is_none(copied, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(copied))
    monkeypatch.setattr(build_backend, "find_spec", lambda name: None)
    assert build_backend._required_compiler() == [build_backend.ZIG]
    with pytest.raises(CompileError, match="needs a C compiler, and neither cc, gcc nor clang"):
        build_backend.compile_libraries(copied / "built")
    monkeypatch.setenv("CC", "some compiler")
    assert build_backend._required_compiler() == []


@pytest.mark.skipif(sys.platform == "win32", reason="the compilers of the test are scripts")
def test_a_compiler_that_fails_is_passed_over(copied, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    (copied / "cc").write_text("#!/bin/sh\nexit 1\n")
    (copied / "gcc").write_text("#!/bin/sh\nexit 0\n")
    for name in ("cc", "gcc"):
        (copied / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(copied))
    assert build_backend._compiler() == [str(copied / "gcc")]


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["found", "ziglang"])
def test_wheel_of_the_source_archive_loads(compiler, tmp_path):
    source, dist, installed = tmp_path / "source", tmp_path / "dist", tmp_path / "installed"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("hamsym", "templates", "examples"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    environment = {name: value for name, value in os.environ.items() if name != "CC"}
    if compiler == "ziglang":
        environment["PATH"] = str(Path(sys.executable).parent)
    done = subprocess.run(
        [sys.executable, "-m", "build", "--outdir", str(dist), str(source)],
        capture_output=True,
        text=True,
        env=environment,
    )
    if "No matching distribution found for ziglang" in done.stdout + done.stderr:
        pytest.skip("ziglang cannot be downloaded")
    assert done.returncode == 0, done.stdout + done.stderr

    with tarfile.open(next(dist.glob("*.tar.gz"))) as archive:
        names = {Path(name).name for name in archive.getnames()}
    needed = [*build_backend.sources(".[ch]"), *(ROOT / "templates").glob("*.jinja")]
    assert {path.name for path in needed} <= names
    libraries = {build_backend.library_name(level) for level in build_backend.LEVELS}
    assert not libraries & names
    (wheel,) = dist.glob("*.whl")
    assert "-py3-none-" in wheel.name
    assert not wheel.name.endswith("-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert {f"hamsym/kernel/{name}" for name in libraries} <= set(archive.namelist())
        archive.extractall(installed)
    done = subprocess.run(
        [sys.executable, "-c", _LOAD],
        check=True,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment | {"PYTHONPATH": str(installed)},
    )
    assert done.stdout.startswith(str(installed))


def _constants() -> dict[str, dict[str, float]]:
    """The numbers and products of numbers that each source defines."""
    folder, found = Path(library.__file__).parent, {}
    for path in (folder / "rows.h", *sorted(folder.glob("*.[ch]"))):
        own = found[path.name] = dict(found["rows.h"] if found else {})
        for line in path.read_text().splitlines():
            if not (match := re.match(r"#define (\w+) ([^/]+)", line)):
                continue
            factors = [part.strip(" ()") for part in match[2].split("*")]
            if all(re.fullmatch(r"0x1p-\d+|[\d.e-]+", part) or part in own for part in factors):
                own[match[1]] = math.prod(
                    own.get(part) or (float.fromhex if "p" in part else float)(part)
                    for part in factors
                )
    return found


def test_constants_stand_in_sources_and_package_alike() -> None:
    of = _constants()
    balls, march, errors, own = (of[f"{name}.h"] for name in "balls march errors models".split())
    assert (balls["UNIT"], balls["MIDDLE"]) == (directed.UNIT, directed.MIDDLE)
    assert (balls["SMALL"], balls["UNDERFLOW_ERROR"]) == (directed.TINY, directed.UNDERFLOW)
    assert (errors["SLACK"], march["ROUND_OFF"]) == (window_checks.SLACK, window_checks.ROUND_OFF)
    assert (own["DEGREE"], own["PLACES"]) == (models.DEGREE, models.PLACES)
    counts = {errors[name] - 2 for name in ("EACH_MOST", "EACH_FEWER")}
    assert counts == {perturbations for perturbations, _ in _PERTURBATIONS.values()}
    for name in ("NOISE", "LEAST_INSIDE", "INSIDE", "SMALL_INSIDE"):
        assert of["march.c"][name] == getattr(window_checks, f"_{name}")
