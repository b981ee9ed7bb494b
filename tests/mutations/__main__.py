"""Make each mistake of the table in a copy of the package, and run the tests that must catch it.

In the end the tests that failed are run once more without a mistake. Compiled code is cached by its
source, so that it is compiled again for a mistake and kept for the others.
"""

from __future__ import annotations

import argparse
import compileall
import importlib
import multiprocessing
import os
import py_compile
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

import pytest

from .table import MUTATIONS, Mutation

_ROOT = Path(__file__).parents[2]
_OPTIONS = ["-m", "not slow and not browser", "-x", "-vv", "-n", "0", "-p", "no:cacheprovider"]
# The tests import the copy, in whose folder they run, instead of the checkout.
_OPTIONS += ["-o", "pythonpath=", "--rootdir", str(_ROOT)]
_SECONDS = 120  # of processor time, after which tests that do not end have caught a mistake
_SLOW_IMPORTS = ("torch", "sympy", "numba", "scipy.integrate", "scipy.optimize")
_PASSED, _FAILED, _NO_TESTS = 0, 1, 5  # exit statuses of pytest
_ENDLESS = -signal.SIGXCPU


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutations", description=__doc__)
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=", ".join(MUTATIONS))
    rooms = parser.parse_args().rooms or list(MUTATIONS)
    if unknown := {*rooms} - MUTATIONS.keys():
        parser.error(f"no rooms: {', '.join(sorted(unknown))}; choose from {', '.join(MUTATIONS)}")
    chosen = [(room, mutation) for room in rooms for mutation in MUTATIONS[room]]
    survived, failed = [], set()
    with tempfile.TemporaryDirectory(prefix="hamsym-mutations-") as name:
        folder = _package(Path(name))
        os.environ.setdefault("HAMSYM_CACHE_DIR", str(folder / "cache"))
        for package in _SLOW_IMPORTS:
            importlib.import_module(package)
        for room, mutation in chosen:
            before = _spent()
            code, names = _caught(folder, mutation)
            failed |= {*names}
            if code == _PASSED:
                survived.append(f"{room}: {mutation.name}")
            verdict = "SURVIVED" if code == _PASSED else "endless" if code == _ENDLESS else "caught"
            spent = _spent() - before
            print(f"{verdict:8} {spent:4.0f} s  {room}: {mutation.name}", *names, flush=True)
        code, names = _tested(folder, sorted(failed)) if failed else (_PASSED, [])
    print(f"caught {len(chosen) - len(survived)} of {len(chosen)} in {_spent():.0f} CPU s")
    print("".join(f"survived {line}\n" for line in survived), end="")
    if code != _PASSED:
        print("without a mistake these must pass:", *names)
    return 1 if survived or code != _PASSED else 0


def _spent() -> float:
    """Seconds of processor time of the tests so far."""
    times = os.times()
    return times.children_user + times.children_system


def _package(folder: Path) -> Path:
    """Copy the package with its templates, in the arrangement of an installed one."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(_ROOT / "hamsym", folder / "hamsym", ignore=ignored)
    shutil.copytree(_ROOT / "templates", folder / "hamsym" / "templates", ignore=ignored)
    by_digest = py_compile.PycInvalidationMode.CHECKED_HASH
    compileall.compile_dir(folder, quiet=2, invalidation_mode=by_digest)
    return folder


def _caught(folder: Path, mutation: Mutation) -> tuple[int, list[str]]:
    """Run the tests of a mistake while it is in the copy; see :func:`_tested`."""
    path = folder / "hamsym" / mutation.file
    original = path.read_text(encoding="utf-8")
    path.write_text(mutation.applied(original), encoding="utf-8")
    try:
        _compile(path)
        return _tested(folder, [f"tests/{test}" for test in mutation.tests])
    finally:
        path.write_text(original, encoding="utf-8")
        _compile(path)


def _compile(source: Path) -> None:
    """Compile the kernel again if a source of it has changed."""
    if source.suffix in (".c", ".h"):
        subprocess.run([sys.executable, "-P", source.parent / "build_backend.py"], check=True)


def _tested(folder: Path, tests: Iterable[str]) -> tuple[int, list[str]]:
    """Run tests with the package in a folder up to the first that fails.

    Returns
    -------
    int
        Exit status.
    list of str
        The test that failed, if one did.
    """
    log = folder / "log"
    # A fork has the packages already that take seconds to import.
    process = multiprocessing.get_context("fork").Process(target=_test, args=(folder, log, tests))
    process.start()
    process.join()
    code, text = process.exitcode or 0, log.read_text(encoding="utf-8")
    names = re.findall(r"^\S*/(tests/\S+::.*?) (?:FAILED|ERROR)\b", text, re.MULTILINE)
    code = _PASSED if code == _NO_TESTS else code  # all of them are slow
    if code not in (_PASSED, _FAILED, _ENDLESS) or (code == _FAILED and not names):
        raise SystemExit(f"{text[-3000:]}\nexit status {code}")
    return code, names


def _test(folder: Path, log: Path, tests: Iterable[str]) -> None:
    """Run tests in this process, whose output goes to a file."""
    with open(log, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS + 5))
    os.chdir(folder)
    paths = [str(folder), str(_ROOT)]
    sys.path[:0] = paths
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)  # of processes that tests start
    os.environ["HAMSYM_NO_TIME_LIMIT"] = "1"
    # No bytecode is written for files with mistakes, and that of the others is used by its digest.
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.exit(pytest.main([*_OPTIONS, *(str(_ROOT / test) for test in tests)]))


if __name__ == "__main__":
    sys.exit(main())
