"""Facts of results: one description, which every rendering has word for word."""

from __future__ import annotations

import dataclasses
import functools
import html
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym.cli.commands import main
from hamsym.facts.describe import describe
from hamsym.facts.facts import Column, Fact, Facts, Table, strict
from hamsym.facts.solutions import proof_sentence
from hamsym.facts.wording import against

OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
FALLING = "p**2/2 - x**4/4"


@functools.cache
def solution() -> hamsym.Solution:
    return hamsym.solve(OSCILLATOR, [1.3, 1], (0, 2), tol=1e-7)


def plain(text: str) -> str:
    return " ".join(text.split())


# -- one description -------------------------------------------------------------------------------


def test_every_rendering_has_the_headline(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = solution()
    headline = found.facts.headline
    assert headline.startswith("largest estimated error ")
    assert headline in plain(found.summary())
    assert headline in html.unescape(found._repr_html_())
    found.export("orbit.py")
    assert headline in plain(Path("orbit.py").read_text())
    found.export("orbit.json")
    assert json.loads(Path("orbit.json").read_text())["about"]["headline"] == headline
    start = ["--z0", "x=1.3,p=1", "--t-end", "2", "--tol", "1e-7", "--json"]
    assert main(["solve", OSCILLATOR, *start]) == 0
    assert json.loads(capsys.readouterr().out)["headline"] == headline


@pytest.mark.slow
def test_report_has_the_headline_and_every_fact(tmp_path: Path) -> None:
    found = solution()
    hamsym.report(found, tmp_path / "a.html", compare=False)
    text = html.unescape((tmp_path / "a.html").read_text()).replace('<span class="one">', "")
    text = text.replace("</span>", "")
    assert found.facts.headline in text
    for fact in (*found.facts.given, *found.facts.found):
        if isinstance(fact, Fact):
            assert fact.text in text, fact


@pytest.mark.slow
def test_failure_is_one_sentence_everywhere(tmp_path: Path) -> None:
    failed = hamsym.solve(FALLING, [1, 1], (0, 5))
    warning = f"Failed: {failed.message}"
    assert failed.facts.warning == warning
    assert failed.facts.opening[0] == failed.message
    assert failed.facts.values()["message"] == failed.message
    assert plain(failed.message) in plain("\n".join(failed.facts.header()))
    assert plain(warning) in plain(" ".join(failed.plot("x")._warning))


@functools.cache
def made() -> dict[str, Any]:
    H, x0 = hamsym.Hamiltonian(OSCILLATOR), [1.0, 0.0]
    found = solution()
    many = hamsym.solve_many(H, [[1.0, 0.0], [2.0, 0.0]], (0, 2))
    return {
        "Hamiltonian": H,
        "Solution": found,
        "Solutions": many,
        "Trajectory": hamsym.integrate(H, x0, (0, 2), tol=1e-6),
        "ensemble": hamsym.integrate(H, [x0, x0], (0, 2), tol=1e-6),
        "Certificate": found.certify(),
        "Proofs": many.certify(bound=1e-6),
        "Comparison": hamsym.compare(found, "gauss4", points=20, max_steps=1_000),
        "Sweep": hamsym.Sweep((0,), (0.0, 2.0), {"a": (found,)}),
        "LyapunovExponents": hamsym.lyapunov(H, x0, (0, 20), count=2),
        "LyapunovMap": hamsym.lyapunov(H, [x0, x0], (0, 20)),
        "ChaosIndicators": hamsym.chaos_indicators(H, x0, (0, 20)),
        "Section": hamsym.section(H, [0, 1], (0, 20), "x = 0, p > 0"),
        "Equilibria": H.equilibria(),
        "PeriodicOrbit": hamsym.periodic_orbit(H, x0),
    }


@pytest.mark.slow
def test_values_are_strict_and_texts_are_narrow() -> None:
    for name, result in made().items():
        facts = result.facts
        assert json.dumps(facts.values(), allow_nan=False), name
        assert max(map(len, result.summary().splitlines())) <= 80, name
        for sentence in facts.opening:
            assert plain(sentence) in plain(result.summary()), name
        assert facts.header(), name


#: What results have, by their types; each array of an ensemble has the axes of its members.
COMMON = ("H", "z0", "span", "success", "message", "seconds")
WITHOUT = {
    "Hamiltonian": COMMON,
    "Certificate": ("H", "z0", "success", "message"),
    "Proofs": ("H", "z0", "span", "success", "seconds"),
    "Equilibria": ("z0", "span", "success"),
}


@pytest.mark.slow
def test_results_have_the_same_names() -> None:
    for name, result in made().items():
        for attribute in COMMON:
            assert hasattr(result, attribute) == (attribute not in WITHOUT.get(name, ())), (
                name,
                attribute,
            )
        if hasattr(result, "z0"):
            assert np.shape(result.z0)[-1] == result.H.dim, name
        if hasattr(result, "span"):
            assert all(isinstance(float(end), float) for end in result.span), name


def test_largest_errors_are_those_of_each_component() -> None:
    found = hamsym.integrate(OSCILLATOR, [[1, 0], [2, 0], [3, 0]], (0, 2), tol=1e-6)
    assert found.errors is not None
    np.testing.assert_array_equal(found.largest_error, found.errors.max(axis=1))
    assert found.z0.shape == (3, 2)
    assert found.span == (0.0, 2.0)
    assert found.verdicts is not None
    shares = found.verdicts.largest
    assert shares.min() < shares.max()
    assert f" of trajectory {np.argmax(shares)}, " in found.facts.headline
    assert hamsym.integrate(OSCILLATOR, [1, 0], (0, 2), "gauss4", steps=9).largest_error is None
    np.testing.assert_array_equal(
        solution().largest_error,
        hamsym.solve_many(OSCILLATOR, [[1.3, 1.0]], (0, 2), tol=1e-7).largest_error[0],
    )


def test_states_after_an_end_have_no_drift() -> None:
    found = hamsym.integrate(FALLING, [[0.1, 0.0], [1.0, 1.0]], (0, 5), tol=1e-8, saves=50)
    assert np.isnan(found.z[1, -1]).all()
    drifts = [each["energy_error"] for each in found.facts["trajectories"].value]
    assert np.isfinite(drifts).all()


def test_largest_error_is_related_to_what_was_asked() -> None:
    H = hamsym.Hamiltonian(OSCILLATOR)
    text = against(H, [1e-9, 2e-10], [1e-8, 1e-9])
    assert text == "largest estimated error 2.0e-10 in p, 20 % of the 1.0e-09 asked"


def test_proof_of_one_component_is_not_one_of_all() -> None:
    found, proven = solution(), solution().certify()
    assert proof_sentence(found, proven).startswith("Proven: every error is within what was asked")
    wide = dataclasses.replace(proven, component_bounds=(1.0, proven.component_bounds[1]))
    assert proof_sentence(found, wide).startswith("Proven, but not that every error is within")


def test_objects_without_facts_are_refused() -> None:
    with pytest.raises(hamsym.InputError, match="int has no facts"):
        describe(3)


# -- renderings ------------------------------------------------------------------------------------


def facts(*entries: Fact | Table | Callable[[], list[Fact]], **options: Any) -> Facts:
    return Facts("Example", "first", "outcome", True, entries=entries, **options)


def table(count: int, **options: Any) -> Table:
    values = np.arange(count) / 4
    columns = (Column("size", values, ".2f", "size"), Column("none", [""] * count))
    return Table("things", [f"q{k}" for k in range(count)], columns, **options)


def test_computed_facts_are_computed_when_they_are_read() -> None:
    calls = []

    def later() -> list[Fact]:
        calls.append(1)
        return [Fact("energy", "energy error", 0.5, "5.0e-01")]

    found = facts(Fact("a", "a", 1, "one"), later)
    assert found.values(computed=False) == {
        "success": True, "message": "outcome", "headline": "first", "a": 1,
    }  # fmt: skip
    assert "Energy" not in "\n".join(found.header())
    assert not calls
    assert found.values()["energy"] == 0.5
    assert found.text() == "first\noutcome\na one\nenergy error 5.0e-01"
    assert len(calls) == 1


def test_tables_name_what_they_leave_out() -> None:
    lines = table(20).lines(12)
    assert lines[0] == "     size"
    assert lines[-1] == "... and 8 things; all with --full, summary(rows=None)"
    assert len(table(20).lines(None)) == 21
    assert table(13).lines(12)[-1].startswith("... and 1 things")
    assert len(table(20, whole=True).lines(3)) == 21
    chosen = table(20, choose=lambda rows: [19, 0][:rows]).lines(2)
    assert [line.split()[0] for line in chosen[1:3]] == ["q19", "q0"]


def test_wide_tables_become_paragraphs() -> None:
    columns = tuple(Column(f"column {k}", ["1.23456789"] * 2) for k in range(9))
    lines = Table("things", ["a", "b"], columns, notes=["note", ""]).lines(None)
    assert max(map(len, "\n".join(lines).splitlines())) <= 80
    assert "column 8 1.23456789" in " ".join("\n".join(lines).split())
    assert lines[1].strip() == "note"


def test_verdict_precedes_the_headline_unless_it_failed() -> None:
    assert facts(verdict="converged").text() == "converged: first\noutcome"
    failed = Facts("Example", "first", "reason", False, "failed")
    assert failed.text() == "reason\nfirst"
    assert failed.warning == "Failed: reason"
    assert Facts("Example", "", "2 of 3 failed", False, members=3).warning == "2 of 3 failed"


def test_headers_have_no_control_characters() -> None:
    lines = facts(Fact("a", "name", 1, "one\x07 two\n three")).header()
    assert "Name: one\\x07 two three" in lines


def test_values_become_strict() -> None:
    values = {"a": np.array([1.0, np.nan]), 2: (np.int64(3), -np.inf), "c": np.complex128(1j)}
    assert strict(values) == {"a": [1.0, None], "2": [3, "-inf"], "c": [0.0, 1.0]}
    assert strict(np.bool_(True)) is True
