"""Scripts of the gallery run, and each draws a figure that is not empty."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest
from matplotlib.figure import Figure

SCRIPTS = sorted((Path(__file__).parents[2] / "examples" / "gallery").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_run_and_draw(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(script))
    figures = [value for value in names.values() if isinstance(value, Figure)]
    assert figures
    for figure in figures:
        assert all(
            axis.has_data() or axis.texts or axis.tables or axis.get_legend()
            for axis in figure.axes
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_have_a_title_and_a_text(script: Path) -> None:
    assert script.stem.startswith("plot_")
    title, rule, blank, text = (
        (ast.get_docstring(ast.parse(script.read_text(encoding="utf-8"))) or "") + "\n\n\n"
    ).split("\n", 3)
    assert title
    assert set(rule) == {"="}
    assert len(rule) >= len(title)
    assert not blank
    assert text.strip()
