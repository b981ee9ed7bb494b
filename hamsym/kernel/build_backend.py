"""The build backend: setuptools, and a library of the C sources of this folder in wheels.

One library for each level of instructions, ``kernel.v2.so`` and so on; ctypes loads them, so one
wheel serves every Python. Where there is no C compiler, the build requires ``ziglang``, which is
one. It runs before hamsym and numpy are installed. ``python hamsym/kernel/build_backend.py``
compiles in the checkout what is older than its sources.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from setuptools import Command, build_meta
from setuptools.build_meta import (
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build
from setuptools.errors import CompileError

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

FOLDER = Path(__file__).parent
X86 = platform.machine().lower() in ("x86_64", "amd64")
LEVELS = ("v2", "v3", "v4") if X86 else ("generic",)
ZIG = "ziglang>=0.17.1"
# No operation is contracted, reordered or left out, so that all levels compute the same bits.
FLAGS = (
    "-std=gnu99 -O3 -shared -fvisibility=hidden -ffp-contract=off -fno-fast-math -fno-math-errno"
)
WARNINGS = "-Wall -Wextra -Wno-psabi"  # vectors are passed inside of a library only


# -- the hooks of the build ------------------------------------------------------------------------


def get_requires_for_build_wheel(settings: dict | None = None) -> list[str]:
    """Return what building a wheel requires: a compiler too, where there is none."""
    return [*build_meta.get_requires_for_build_wheel(settings), *_required_compiler()]


def get_requires_for_build_editable(settings: dict | None = None) -> list[str]:
    """Return what an editable installation requires: a compiler too, where there is none."""
    return [*build_meta.get_requires_for_build_editable(settings), *_required_compiler()]


class BuildKernel(Command):
    """The step of a build that compiles: in the wheel, or in place for editable installations."""

    user_options = ()

    def initialize_options(self) -> None:
        self.build_lib = ""
        self.editable_mode = False

    def finalize_options(self) -> None:
        self.build_lib = self.get_finalized_command("build_py").build_lib

    def run(self) -> None:
        compile_libraries(FOLDER if self.editable_mode else Path(self.build_lib) / "hamsym/kernel")

    def get_source_files(self) -> list[str]:
        return [os.path.relpath(path) for path in sources(".[ch]")]

    def get_outputs(self) -> list[str]:
        return [f"{self.build_lib}/hamsym/kernel/{library_name(level)}" for level in LEVELS]

    def get_output_mapping(self) -> dict[str, str]:
        return {
            output: os.path.relpath(FOLDER / Path(output).name) for output in self.get_outputs()
        }


class Build(build):
    """A build that compiles the kernel too."""

    sub_commands = [*build.sub_commands, ("build_kernel", None)]


class PlatformWheel(bdist_wheel):
    """A wheel for one platform and every Python."""

    def finalize_options(self) -> None:
        # Otherwise the files of the wheel would be declared independent of the platform.
        self.distribution.has_ext_modules = lambda: True
        super().finalize_options()

    def get_tag(self) -> tuple[str, str, str]:
        # A Python for two architectures compiles for that one which runs it.
        return "py3", "none", super().get_tag()[2].replace("universal2", platform.machine())


# -- compiling -------------------------------------------------------------------------------------


def library_name(level: str) -> str:
    """Name the library of a level, on every system.

    ctypes loads it by its path, whatever its suffix. With a second dot in its name pkgutil does not
    take it for a module of Python.
    """
    return f"kernel.{level}.so"


def sources(suffix: str) -> list[Path]:
    """Return the files of the kernel with a suffix, which is a pattern."""
    return sorted(FOLDER.glob(f"*{suffix}"))


def compile_libraries(folder: Path) -> None:
    """Compile the libraries that a folder lacks or that are older than a source."""
    newest = max(path.stat().st_mtime for path in [*sources(".[ch]"), Path(__file__)])
    targets = {folder / library_name(level): level for level in LEVELS}
    old = [path for path in targets if not path.exists() or path.stat().st_mtime < newest]
    if not old:
        return
    compiler = _compiler()
    if compiler is None:
        raise CompileError(
            "the kernel of hamsym needs a C compiler, and neither cc, gcc nor clang works here; "
            f"install gcc 11 or clang 12 or later, name it in CC, or pip install '{ZIG}'"
        )
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor() as pool:
        list(pool.map(lambda path: _compile(compiler, targets[path], path), old))


def _required_compiler() -> list[str]:
    return [] if os.environ.get("CC") or _compiler_on_path() else [ZIG]


def _compiler() -> list[str] | None:
    """Find the command of a C compiler: CC, one on the path, or that of ziglang."""
    named = shlex.split(os.environ.get("CC", ""))
    if named:
        return named
    zig = [sys.executable, "-m", "ziglang", "cc"] if find_spec("ziglang") else None
    return _compiler_on_path() or zig


def _compiler_on_path() -> list[str] | None:
    """Find a compiler that compiles a line with a header for the highest level."""
    for name in ("gcc",) if sys.platform == "win32" else ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            command = [path, *_flags(LEVELS[-1]), "-x", "c", "-", "-o", f"{folder}/probe"]
            done = subprocess.run(command, input=b"#include <math.h>\n", capture_output=True)
        if done.returncode == 0:
            return [path]
    return None


def _flags(level: str, zig: bool = False) -> list[str]:
    """Return the flags of a level; without its own, zig compiles for the processor it runs on."""
    flags = f"{FLAGS} {WARNINGS}{'' if sys.platform == 'win32' else ' -fPIC'}".split()
    if zig:
        return [*flags, f"-mcpu=x86_64_{level}" if X86 else "-mcpu=baseline", "-s"]
    return [*flags, f"-march=x86-64-{level}"] if X86 else flags


def _compile(compiler: list[str], level: str, library: Path) -> None:
    """Compile all sources for a level; the library is replaced by a complete one or not at all."""
    flags = _flags(level, zig="ziglang" in compiler or Path(compiler[0]).stem == "zig")
    complete = library.with_suffix(".new.so")
    with tempfile.TemporaryDirectory() as folder:
        target = f"{folder}/{library.name}"
        command = [*compiler, *flags, *map(str, sources(".c")), "-o", target, "-lm"]
        caches = {"ZIG_GLOBAL_CACHE_DIR": folder, "ZIG_LOCAL_CACHE_DIR": folder}
        try:
            subprocess.run(command, env=os.environ | caches, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise CompileError(
                f"the kernel of hamsym was not compiled, because the C compiler "
                f"'{shlex.join(compiler)}' does not exist or failed with the messages above; name "
                "another one in CC"
            ) from error
        shutil.copy(target, complete)
    complete.replace(library)


if __name__ == "__main__":
    try:
        compile_libraries(FOLDER)
    except CompileError as error:
        sys.exit(f"error: {error}")
