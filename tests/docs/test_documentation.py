"""What the documentation shows works: docstrings, README, examples."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hamsym
from hamsym.integrators.table import INTEGRATORS
from hamsym.systems import CATALOGUE

ROOT = Path(__file__).parents[2]
MODULES = ["hamsym"] + [
    module.name
    for module in pkgutil.walk_packages(hamsym.__path__, "hamsym.")
    if module.name not in ("hamsym.__main__", "hamsym.templates")
]


@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples(name: str) -> None:
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
    module = importlib.import_module(name)
    assert module.__doc__
    result = doctest.testmod(module, optionflags=flags)
    assert result.failed == 0


@pytest.mark.parametrize("name", hamsym.__all__)
def test_public_names_are_documented(name: str) -> None:
    thing = getattr(hamsym, name)
    assert thing.__doc__
    assert name in dir(hamsym)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'sove'"):
        hamsym.sove  # noqa: B018


_MINIATURE = {
    "chaos": ["--time", "1000"],
    "henon_heiles": ["--epochs", "30"],
    "oscillator": ["--epochs", "30"],
    "scheme": [],
}
# The other scripts in examples/paper have tests of their own.
_EXAMPLES = [*sorted((ROOT / "examples").glob("*.py")), ROOT / "examples" / "paper" / "scheme.py"]


@pytest.mark.parametrize("example", _EXAMPLES, ids=lambda p: p.stem)
def test_examples_run_in_miniature(example: Path, tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, str(example), *_MINIATURE[example.stem], "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "wrote " in result.stdout
    assert list((tmp_path / "out").glob("*.png"))


def _blocks(language: str) -> list[str]:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def test_readme_session_prints_what_it_says() -> None:
    session = "\n".join(_blocks("pycon"))
    assert session
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    examples = doctest.DocTestParser().get_doctest(session, {}, "README", None, None)
    runner = doctest.DocTestRunner(optionflags=flags)
    runner.run(examples)
    assert runner.summarize().failed == 0


@pytest.mark.parametrize("block", _blocks("console"), ids=lambda b: b.splitlines()[0][:40])
def test_readme_commands_print_what_they_say(
    block: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Commands that print the same each time; those with timings are marked `text` there."""
    import shlex

    from hamsym.cli.commands import main

    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        command, _, expected = part.partition("\n")
        program, *arguments = shlex.split(command)
        assert program == "hamsym"
        main(arguments)
        captured = capsys.readouterr()
        assert (captured.out + captured.err).rstrip() == expected.rstrip()


def test_readme_lists_every_integrator() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name, row in INTEGRATORS.items():
        stages = "" if row.stages is None else row.stages
        assert f"| `{name}` | {row.order} | {stages} | {row.summary} | {row.source} |" in text


def test_readme_names_every_system() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in CATALOGUE:
        assert f"`{name}`" in text
