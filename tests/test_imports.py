"""Slow packages are imported by those who need them only."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

_HEAVY = ("matplotlib", "numba", "scipy", "scipy.special", "sympy", "torch")

# What a user does, in an order in which each step needs more than those before it, and the packages
# that must not be there after it.
_STEPS = {
    "import": ("import hamsym", _HEAVY),
    "help": ("run('--help')", _HEAVY),
    "options": ("run('solve', '--help')", _HEAVY),
    "complete an option": (
        "os.environ |= {'_HAMSYM_COMPLETE': 'bash_complete', 'COMP_CWORD': '2'};"
        "os.environ['COMP_WORDS'] = 'hamsym solve --to'; assert '--tol' in printed();"
        "del os.environ['_HAMSYM_COMPLETE']",
        _HEAVY,
    ),
    "derive": (
        "H = hamsym.Hamiltonian('p**2/2 + x**2/2 + x**4/4'); H.source('torch')",
        ("matplotlib", "numba", "scipy", "torch"),
    ),
    "bad tolerance": (
        "assert run('solve', 'p**2/2 + x**2/2', '--z0', '1,0', '--t-end', '1', '--tol', '0') == 2",
        ("matplotlib", "numba", "scipy.special", "torch"),
    ),
    "solve": (
        "solution = hamsym.solve(H, [1.3, 1.0], (0, 3), tol=1e-6); assert solution.success;"
        "solution(1.0); solution.error_estimate(1.0); solution.energy(1.0)",
        ("matplotlib", "numba", "scipy.special", "torch"),
    ),
    "save and load": (
        "solution.save('a.hamsym'); solution = hamsym.load('a.hamsym')",
        ("matplotlib", "numba", "scipy.special", "torch"),
    ),
    "certify": (
        "hamsym.verify(hamsym.certify(solution), solution)",
        ("matplotlib", "torch"),
    ),
    "integrate": ("hamsym.integrate(H, [1.3, 1.0], (0, 1), steps=9)", ("matplotlib", "torch")),
    "section": (
        "hamsym.section(H, [1.3, 1.0], (0, 9), 'x = 0', dt=0.1)",
        ("matplotlib", "torch"),
    ),
    "chaos_indicators": (
        "hamsym.chaos_indicators(H, [1.3, 1.0], (0, 1), dt=0.1)",
        ("matplotlib", "torch"),
    ),
    "lyapunov": ("hamsym.lyapunov(H, [1.3, 1.0], (0, 1), dt=0.1)", ("matplotlib", "torch")),
}

_SCRIPT = """
import contextlib, io, json, os, sys, traceback

def printed(*arguments):
    from hamsym.cli.commands import main
    text = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # completions are bytes
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        main(list(arguments))
    text.flush()
    return text.buffer.getvalue().decode()

def run(*arguments):
    from hamsym.cli.commands import main
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return main(list(arguments))

heavy, steps = json.loads(sys.argv[1])
found = {}
for name, code in steps.items():
    try:
        exec(code)
    except BaseException:
        found[name] = traceback.format_exc()
    else:
        found[name] = [module for module in heavy if module in sys.modules]
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str] | str]:
    """The slow packages that are there after each step of one process, or its traceback."""
    steps = {name: code for name, (code, _) in _STEPS.items()}
    result = subprocess.run(
        [sys.executable, "-c", _SCRIPT, json.dumps([_HEAVY, steps])],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path_factory.mktemp("imports"),
    )
    return json.loads(result.stdout)


@pytest.mark.slow_cases("import")
@pytest.mark.parametrize("step", _STEPS)
def test_slow_packages_not_imported(step: str, loaded: dict[str, list[str] | str]) -> None:
    assert isinstance(loaded[step], list), loaded[step]
    assert not set(loaded[step]) & set(_STEPS[step][1])


def test_program_starts_without_sympy() -> None:
    result = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "hamsym", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.startswith("Usage: hamsym")
    imported = {line.rpartition("|")[2].strip() for line in result.stderr.splitlines()}
    assert "hamsym.cli.commands" in imported
    assert imported.isdisjoint(_HEAVY)
