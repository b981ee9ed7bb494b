"""A notebook executed by a kernel: figures, representations and progress, without warnings."""

from __future__ import annotations

import functools
import json
from typing import Any

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")
pytestmark = pytest.mark.slow

CELLS = {
    "formula": "import hamsym\nH = hamsym.Hamiltonian('p**2/2 - cos(theta)')\nH",
    "equations": "H.equations",
    "solution": "solution = hamsym.solve(H, [2, 0], (0, 20))\nsolution",
    "figure": "solution.plot()",
    "trajectory": "trajectory = hamsym.integrate(H, [2, 0], (0, 20), tol=1e-9)\ntrajectory",
    "by name": "(trajectory['theta'] - solution(trajectory.t)[:, 0]).round(6).any()",
    "table": "trajectory.to_dataframe().head(2)",
    "failed": "hamsym.solve('p**2/2 - x**4/4', [1, 0], (0, 9))",
    "progress": """
import time
from hamsym.support.progress import stepping_progress
with stepping_progress(30, text="proving") as advance:
    for _ in range(30):
        time.sleep(0.05)
        advance(1)
""",
    "training": """
adam = hamsym.Adam(epochs=4_000, points=20)
trained = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1), method=adam)
""",
    "quiet": """
with stepping_progress(30, show=False) as advance:
    time.sleep(1.2)
    advance(30)
""",
}


@functools.cache
def outputs() -> dict[str, list[dict[str, Any]]]:
    """The outputs of each cell, from a fresh kernel."""
    cells = [nbformat.v4.new_code_cell(text.strip()) for text in CELLS.values()]
    notebook = nbformat.v4.new_notebook(cells=cells)
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    nbformat.validate(notebook)
    return {name: cell["outputs"] for name, cell in zip(CELLS, notebook.cells, strict=True)}


def data(name: str) -> dict[str, str]:
    *_, output = outputs()[name]  # a progress line may come before
    found: dict[str, str] = output["data"]
    return found


def test_nothing_is_written_to_standard_error() -> None:
    streams = [each for cell in outputs().values() for each in cell if "data" not in each]
    assert not streams, json.dumps(streams)[:500]


def test_formulas_are_typeset() -> None:
    assert "<math" in data("formula")["text/html"]
    assert data("formula")["text/latex"].startswith("$")
    assert r"\frac{d \theta}{d t} &= p" in data("equations")["text/latex"]


def test_figures_appear_without_any_magic() -> None:
    found = data("figure")
    assert {"image/png", "image/svg+xml", "text/html"} & found.keys()


@pytest.mark.parametrize("name", ["solution", "trajectory", "failed"])
def test_results_have_their_card_and_figure(name: str) -> None:
    found = data(name)
    assert 'class="hamsym-card"' in found["text/html"]
    assert "data:image/png;base64," in found["text/html"]
    assert "\n" not in found["text/plain"]


def test_results_agree_by_name() -> None:
    assert data("by name")["text/plain"] in ("False", "np.False_")
    assert "theta" in data("table")["text/html"]


@pytest.mark.parametrize(("name", "start"), [("progress", "proving: "), ("training", "training: ")])
def test_progress_leaves_one_readable_line(name: str, start: str) -> None:
    line = data(name)["text/plain"]
    assert line.startswith(start)
    assert line.partition(",")[0].endswith(" s")
    assert "<progress" not in data(name)["text/html"]


def test_quiet_work_leaves_nothing() -> None:
    assert outputs()["quiet"] == []
