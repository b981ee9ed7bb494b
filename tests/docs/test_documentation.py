"""Docstrings, README, the pages of the guide and the examples themselves run as shown."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

import hamsym
from hamsym.cli.commands import main
from hamsym.integrators.table import INTEGRATORS
from hamsym.systems import CATALOGUE

pytestmark = pytest.mark.page

ROOT = Path(__file__).parents[2]
MODULES = ["hamsym"] + [
    module.name
    for module in pkgutil.walk_packages(hamsym.__path__, "hamsym.")
    if module.name not in ("hamsym.__main__", "hamsym.templates")
]

# Modules that only the extra hamsym[explore] can import.
_OF_PAGES = {f"hamsym.workbench.explore.{name}" for name in ("page", "tab_panels")}


class _Finder(doctest.DocTestFinder):
    """Finds examples of decorated functions too."""

    def _from_module(self, module: object, thing: object) -> bool:
        return super()._from_module(module, inspect.unwrap(thing) if callable(thing) else thing)


@pytest.mark.slow_cases(
    "hamsym.dynamics.sections",
    "hamsym.flow_maps.flow_map",
    "hamsym.workbench.animations.animate",
)
@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples(name: str) -> None:
    if name in _OF_PAGES:
        pytest.importorskip("nicegui")
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
    module = importlib.import_module(name)
    assert module.__doc__
    runner = doctest.DocTestRunner(optionflags=flags)
    for examples in _Finder().find(module, name):
        if examples.examples:  # a run without any looks at all files of source that were read
            runner.run(examples)
    assert runner.summarize(verbose=False).failed == 0


def test_examples_of_decorated_functions_are_found() -> None:
    module = importlib.import_module("hamsym.integrators.integrate")
    found = {test.name for test in _Finder().find(module, "m") if test.examples}
    assert "m.integrate" in found


@pytest.mark.parametrize("name", hamsym.__all__)
def test_public_names_are_documented(name: str) -> None:
    thing = getattr(hamsym, name)
    assert thing.__doc__
    assert name in dir(hamsym)


def test_unknown_names_are_rejected() -> None:
    with pytest.raises(AttributeError, match=r"attribute \W*sove"):
        hamsym.sove  # noqa: B018


# -- examples --------------------------------------------------------------------------------------

_MINIATURE = {
    "chaos": ["--time", "300"],
    "chaos_map": ["--grid", "8", "--time", "50"],
    "figures": ["--time", "100"],
    "double_pendulum": ["--frames", "5"],
    "henon_heiles": ["--epochs", "30"],
    "lagrange_points": ["--count", "9"],
    "jax_gradients": ["--count", "3"],
    "oscillator": [],
    "pendulum_period": ["--count", "12"],
    "periodic_orbits": [],
    "scheme": [],
}
_LONG = {"figures", "henon_heiles", "jax_gradients", "oscillator", "periodic_orbits"}
_NEEDS = {"jax_gradients": "diffrax"}  # packages that the extra dev lacks
# The other scripts in examples/paper have tests of their own.
_EXAMPLES = [
    *sorted((ROOT / "examples").glob("*.py")),
    ROOT / "examples" / "paper" / "scheme.py",
]


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(path, id=path.stem, marks=pytest.mark.slow if path.stem in _LONG else ())
        for path in _EXAMPLES
    ],
)
def test_examples_run_in_miniature(
    example: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if example.stem in _NEEDS:
        pytest.importorskip(_NEEDS[example.stem])
    monkeypatch.chdir(tmp_path)
    arguments = [*_MINIATURE[example.stem], "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", [str(example), *arguments])
    runpy.run_path(str(example), run_name="__main__")
    assert "wrote " in capsys.readouterr().out
    assert any(path.suffix in (".png", ".gif") for path in (tmp_path / "out").iterdir())


# -- README and the pages of the guide -------------------------------------------------------------

_PAGES = [ROOT / "README.md", *sorted((ROOT / "examples" / "guide").glob("*.md"))]
# A page with this comment takes more than two seconds.
_SLOW = "<!-- tests: slow -->"


def _blocks(page: Path, language: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def _pages_with(language: str) -> pytest.MarkDecorator:
    """One case for each page that has such blocks."""
    cases = [
        pytest.param(
            page,
            id=page.name,
            marks=pytest.mark.slow if _SLOW in page.read_text(encoding="utf-8") else (),
        )
        for page in _PAGES
        if _blocks(page, language)
    ]
    return pytest.mark.parametrize("page", cases)


@_pages_with("pycon")
def test_sessions_print_what_pages_show(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All blocks of a page are one session, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    session = "\n".join(_blocks(page, "pycon"))
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    examples = doctest.DocTestParser().get_doctest(session, {}, page.name, None, None)
    assert examples.examples
    failures: list[str] = []
    runner = doctest.DocTestRunner(optionflags=flags)
    runner.run(examples, out=failures.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(failures)


@_pages_with("console")
def test_commands_print_what_pages_show(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Commands that print the same each time; blocks with timings are marked ``text``."""
    monkeypatch.chdir(tmp_path)
    for block in _blocks(page, "console"):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, _, expected = part.partition("\n")
            program, *arguments = shlex.split(command)
            assert program == "hamsym"
            main(arguments)
            captured = capsys.readouterr()
            assert (captured.out + captured.err).rstrip() == expected.rstrip(), command


@_pages_with("python")
def test_python_blocks_are_python(page: Path) -> None:
    for block in _blocks(page, "python"):
        compile(block, page.name, "exec")


def test_pages_list_every_integrator_and_system() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in _PAGES)
    assert f"{len(INTEGRATORS)} integrators" in (ROOT / "README.md").read_text(encoding="utf-8")
    for name, row in INTEGRATORS.items():
        stages = "" if row.stages is None else row.stages
        assert f"| `{name}` | {row.order} | {stages} | {row.summary} | {row.source} |" in text
    for name in CATALOGUE:
        assert f"`{name}`" in text
