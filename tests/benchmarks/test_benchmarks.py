"""Every benchmark runs, and the tables of the documentation are those of the results."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from . import __main__ as command
from .markdown import number, table
from .measuring import exponent, largest_error
from .opponents import optional
from .registry import BENCHMARKS
from .results import read, replace_section
from .tables import PAGE, filled


def _numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [x for part in value.values() for x in _numbers(part)]
    if isinstance(value, list):
        return [x for part in value for x in _numbers(part)]
    return [value] if isinstance(value, float) else []


@pytest.mark.slow
@pytest.mark.parametrize("name", BENCHMARKS)
def test_quick_run_fills_its_section(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "results.json"
    command.main(["--quick", "--results", str(file), name])
    section = read(file)[name]
    assert section["quick"]
    assert section["environment"]["versions"]["numpy"]
    lists = [part for part in section.values() if isinstance(part, list)]
    rows = [row for part in lists for row in part if isinstance(row, dict)]
    assert rows or section["skipped"]
    assert all(map(math.isfinite, _numbers(rows)))
    assert all(row.get("seconds", 1.0) > 0 for row in rows)
    text = BENCHMARKS[name].table(section)
    assert text in capsys.readouterr().out
    tables = re.findall(r"(?:^\|.*$\n?)+", text, re.MULTILINE)
    assert tables
    for lines in map(str.splitlines, tables):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1


def test_page_shows_the_stored_results() -> None:
    sections, page = read(), PAGE.read_text("utf-8")
    assert list(sections) == sorted(BENCHMARKS)
    assert not any(section["quick"] for section in sections.values())
    assert re.findall(r"<!-- benchmark (\S+) -->", page) == list(BENCHMARKS)
    assert filled(page, sections) == page


def test_section_replaces_only_itself(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    for name, value in (("b", 1), ("a", 2), ("b", 3)):
        replace_section(name, {"rows": [value]}, False, file)
    assert {name: section["rows"] for name, section in read(file).items()} == {"a": [2], "b": [3]}
    assert list(json.loads(file.read_text("utf-8"))) == ["a", "b"]


def test_missing_opponent_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    missing: list[str] = []
    assert optional("no_such_integrator", missing) is None
    assert missing == ["no_such_integrator"]
    assert "no_such_integrator is not installed: skipped" in capsys.readouterr().out


def test_unknown_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command.main(["no-such-benchmark"])
    assert "'no-such-benchmark' is not a benchmark; choose from" in capsys.readouterr().err


def test_largest_error_of_states() -> None:
    truth = np.zeros((9, 2))
    states = np.zeros((5, 2))  # every other time
    states[3] = 3.0, 4.0
    assert largest_error(states, truth) == 5.0
    states[0, 0] = np.nan
    assert largest_error(states, truth) == math.inf
    assert largest_error(np.zeros((4, 2)), truth) == math.inf


def test_power_law_and_numbers() -> None:
    assert exponent([1, 2, 4], [3, 12, 48]) == pytest.approx(2)
    assert [number(x) for x in (0.0456, 1234.0, 2e-9, math.nan, None, math.inf, 0.0)] == [
        *("0.0456", "1,234", "2.00e-09", "-", "-", "inf", "0")
    ]
    assert table(["a", "b"], [["x", "1.5"]]).splitlines() == [
        *("| a   |   b |", "| --- | --: |", "| x   | 1.5 |")
    ]
