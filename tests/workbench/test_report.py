"""Reports: one well-formed file that says what a solution is, and nothing that is not so."""

from __future__ import annotations

import os
import re
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import CertificationError, FileError, InputError
from hamsym.cli.commands import main
from hamsym.workbench.mathml import mathml
from hamsym.workbench.reports.contents import compared_within
from hamsym.workbench.reports.inline_svg import inline_svg

DUFFING = "p**2/2 + x**2/2 + x**4/4"
#: Elements of HTML that have no end.
VOID = {"meta", "link", "br", "img", "hr"}


class _Page(HTMLParser):
    """Elements of a page; fails where one is not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.rows: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "svg"} & {*self.open}:
            self.words.append(data)
        if self.open and self.open[-1] == "th":
            self.rows.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def having(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def page_of(solution: Any, folder: Path, **options: Any) -> _Page:
    hamsym.report(solution, folder / "a.html", **{"compare": False, **options})
    return _Page((folder / "a.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def solution() -> hamsym.Solution:
    return hamsym.solve(DUFFING, [1.3, 1], (0, 4), tol=1e-7)


@pytest.fixture
def saved(solution: hamsym.Solution, tmp_path: Path) -> Path:
    solution.save(tmp_path / "orbit.hamsym")
    return tmp_path / "orbit.hamsym"


@pytest.fixture(scope="module")
def page(solution: hamsym.Solution, tmp_path_factory: pytest.TempPathFactory) -> _Page:
    """The report of the saved solution."""
    folder = tmp_path_factory.mktemp("report")
    solution.save(folder / "orbit.hamsym")
    return page_of(folder / "orbit.hamsym", folder)


# -- contents --------------------------------------------------------------------------------------


def test_page_is_well_formed_and_fetches_nothing(page: _Page) -> None:
    assert page.tags[0][0] == "html"
    assert not {"script", "iframe", "img", "object", "form"} & {tag for tag, _ in page.tags}
    policy = next(m for m in page.having("meta") if m.get("http-equiv"))
    assert policy["content"] == "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    for tag, attributes in page.tags:
        for name in ("href", "src", "xlink:href"):
            value = attributes.get(name) or "#"
            assert value.startswith(("#", "data:")), (tag, value)
        assert not any(name.startswith("on") for name in attributes)
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len({*ids})
    for attributes in page.having("a") + page.having("use"):
        assert (attributes["href"] or "").removeprefix("#") in ids


def test_headings_are_in_order(page: _Page) -> None:
    levels = [int(tag[1]) for tag, _ in page.tags if re.match("h[1-6]$", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_summary_says_error_against_what_was_asked(solution: hamsym.Solution, page: _Page) -> None:
    text = page.text
    allowed = solution.settings.allowed(solution.error.scale)
    ratios = solution.largest_error / allowed
    worst = int(np.argmax(ratios))
    assert text.index("Succeeded") < text.index("Summary")
    assert "error of at most 1e-07 of the largest value of each component" in text
    assert solution.facts.headline in text
    assert f"in {solution.H.names[worst]}, {100 * ratios[worst]:.2g} % of the " in text
    assert "Not proven: there is no certificate" in text


def test_equations_code_and_lines_are_present(page: _Page) -> None:
    assert len(page.having("math")) >= 5
    assert len(page.having("svg")) == 1
    assert page.having("svg")[0]["role"] == "img"
    assert "def vector_field ( z )" in page.text
    assert "solution=hamsym.solve(H,{" in "".join(page.text.split())
    assert "hamsym.report(solution," in "".join(page.text.split())
    for name in ("seed", "tolerance", "sympy", "numpy", "SHA-256"):
        assert name in page.text
    assert re.search(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", page.text)


@pytest.mark.slow
def test_failed_solution_is_said_first(tmp_path: Path) -> None:
    failed = hamsym.solve("p**2/2 - x**4/4", [1.3, 1], (0, 5))
    page = page_of(failed, tmp_path)
    body = page.text[page.text.index("FAILED") :]
    assert body.startswith("FAILED: Solution")
    assert body.index("Failed: this solution is not what was asked for") < body.index("Summary")
    assert any(p.get("class") == "outcome bad" for p in page.having("p"))
    assert "Succeeded" not in page.text
    assert "largest estimated error" in page.text
    assert failed.message in page.text
    assert "What was asked t from 0.0 to 5.0, an error of" in " ".join(page.text.split())


@pytest.mark.slow
def test_invariants_of_a_file_are_measured_again(tmp_path: Path) -> None:
    hamsym.solve(DUFFING, [1, 0], (0, 1), invariants=[DUFFING]).save(tmp_path / "a")
    assert f"largest change of {DUFFING}" in page_of(tmp_path / "a", tmp_path).text


@pytest.mark.slow
def test_trained_network_is_reported(tmp_path: Path) -> None:
    solution = hamsym.solve(
        "p**2/2 + x**2/2", [1, 0], (0, 1), method=hamsym.Adam(epochs=5, points=8)
    )
    text = page_of(solution, tmp_path).text
    assert "an error of at most 0.01 of the largest value of each component" in text
    assert "Failed" in text
    assert "% of the " in text


@pytest.mark.slow
def test_target_of_a_training_is_what_was_asked(tmp_path: Path) -> None:
    problem = ("p**2/2 + x**2/2", [1, 0], (0, 1))
    solution = hamsym.solve(*problem, method=hamsym.Adam(epochs=5, points=8, target_loss=1e-3))
    assert "target_loss = 0.001" in page_of(solution, tmp_path).text


@pytest.mark.slow
def test_units_and_forces_are_shown(tmp_path: Path) -> None:
    H = hamsym.Hamiltonian(
        "p**2/(2*m) + k*x**2/2",
        parameters={"m": 9.1e-31, "k": 1e-10, "c": 1e-22},
        units={"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m", "c": "1/s"},
        forces={"p": "-c*p"},
    )
    text = page_of(hamsym.solve(H, [1e-9, 1e-24], (0, 1e-10)), tmp_path).text
    assert "kg*m/s" in text
    assert "energy not conserved: forces act" in text
    assert "|H - E0 - work|" in text


@pytest.mark.slow
def test_many_components_are_shortened_with_a_sentence(tmp_path: Path) -> None:
    springs = "+".join(f"p{i}**2/2 + (x{i} - x{(i + 1) % 30})**2/2" for i in range(30))
    solution = hamsym.solve(springs, np.linspace(0, 1, 60), (0, 0.5), tol=1e-5)
    page = page_of(solution, tmp_path)
    assert "30 degrees of freedom, separable" in page.text
    assert "further entries are in the generated code" in page.text
    assert page.rows.count("p29") == 1


# -- hostile texts ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_hostile_texts_are_escaped(solution: hamsym.Solution, tmp_path: Path) -> None:
    attack = "</style><script>alert(1)</script>--><img src=x onerror=alert(2)>'\""
    name = tmp_path / "<b onclick=x>&.hamsym"
    solution.judged(False, attack).save(name)
    page = page_of(name, tmp_path, title=attack)
    assert not {"script", "img"} & {tag for tag, _ in page.tags}
    assert page.text.count("<script>alert(1)</script>") >= 3
    assert "<b onclick=x>&.hamsym" in page.text
    assert not page.having("b")


def test_names_in_formulas_are_escaped() -> None:
    text = mathml(sympy.Symbol("<b>") + sympy.Symbol("a&b"))
    assert "<b>" not in text
    assert "&amp;" in text


@pytest.mark.slow
def test_svg_has_its_own_names_and_no_style_sheet(solution: hamsym.Solution) -> None:
    one, other = (inline_svg(solution.plot(), prefix, "a < b") for prefix in ("a", "b"))
    names = [{*re.findall(r'\bid="([^"]+)"', text)} for text in (one, other)]
    assert not names[0] & names[1]
    assert "<style" not in one
    assert 'aria-label="a &lt; b"' in one
    assert inline_svg(solution.plot(), "a", "a < b") == one


# -- certificates ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_certificate_beside_the_file_is_verified(saved: Path, tmp_path: Path) -> None:
    certificate = hamsym.load(saved).certify()
    beside = tmp_path / "orbit.hamsym.certificate"
    beside.write_text(certificate.to_json(), encoding="utf-8")
    page = page_of(saved, tmp_path)
    assert "Proven: every error is within what was asked" in page.text
    assert "read from orbit.hamsym.certificate; its proof was repeated" in page.text
    assert certificate.digest in page.text
    moved = tmp_path / "elsewhere"
    beside.rename(moved)
    assert "Not proven" in page_of(saved, tmp_path).text
    assert "Proven: every error" in page_of(saved, tmp_path, certificate=moved).text
    assert "Proven: every error" in page_of(saved, tmp_path, certificate=certificate).text


def test_certificate_of_another_solution_is_refused(saved: Path, tmp_path: Path) -> None:
    other = hamsym.solve(DUFFING, [1.3, 1.1], (0, 4), tol=1e-7).certify()
    (tmp_path / "orbit.hamsym.certificate").write_text(other.to_json(), encoding="utf-8")
    with pytest.raises(CertificationError, match="does not belong to this solution"):
        hamsym.report(saved, tmp_path / "a.html", compare=False)
    assert not (tmp_path / "a.html").exists()
    with pytest.raises(CertificationError, match="does not belong"):
        hamsym.report(saved, tmp_path / "a.html", compare=False, certificate=other)


def test_forged_certificate_is_refused(saved: Path, tmp_path: Path) -> None:
    genuine = hamsym.load(saved).certify()
    small = dict.fromkeys(("bound", "lower"), 1e-30)
    forged = hamsym.Certificate(**{**vars(genuine), **small})
    with pytest.raises(CertificationError):
        hamsym.report(saved, tmp_path / "a.html", compare=False, certificate=forged)
    (tmp_path / "orbit.hamsym.certificate").write_text("{}", encoding="utf-8")
    with pytest.raises(FileError, match="not a certificate"):
        hamsym.report(saved, tmp_path / "a.html", compare=False)
    (tmp_path / "orbit.hamsym.certificate").write_bytes(b"\xff\xfe")
    with pytest.raises(FileError, match="not a certificate"):
        hamsym.report(saved, tmp_path / "a.html", compare=False)
    assert not (tmp_path / "a.html").exists()


@pytest.mark.slow
def test_new_proof_is_shown_or_its_refusal(solution: hamsym.Solution, tmp_path: Path) -> None:
    proof = hamsym.report(solution, tmp_path / "a.html", certify=True, compare=False)
    assert proof.certificate.bound < 1e-7
    jump = hamsym.solve("p**2/2 + abs(x)", [1, 0], (0, 5))
    page = page_of(jump, tmp_path, certify=True, time_limit=5)
    assert "Not proven: " in page.text
    assert "Proven: " not in page.text


@pytest.mark.slow
def test_proof_that_is_wider_than_asked_is_said(tmp_path: Path) -> None:
    failed = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 200), tol=1e-12, atol=0)
    asked = failed.settings
    object.__setattr__(asked, "tol", 1e-17)
    page = page_of(failed, tmp_path, certify=True)
    assert "Proven, but not that every error is within what was asked" in page.text


# -- comparisons -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_comparison_is_shown(solution: hamsym.Solution, tmp_path: Path) -> None:
    page = page_of(solution, tmp_path, compare=True)
    for name in ("network", "stormer_verlet", "blanes_moan6", "dop853"):
        assert name in page.text
    assert len(page.having("svg")) == 2
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len({*ids})


def test_comparison_ends_with_its_time(solution: hamsym.Solution) -> None:
    assert "stopped after 0.01 s" in compared_within(solution, 0.01).reason


def test_comparison_names_its_failure(
    solution: hamsym.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hamsym.parallel.processes._START", "raise SystemExit(3)")
    assert "the process of the computation ended" in compared_within(solution, 60).reason


# -- files and arguments ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"backend": "fortran"}, "is not a backend"),
        ({"time_limit": -1}, "time_limit"),
        ({"certificate": "a", "certify": True}, "exclude each other"),
        ({"certificate": 3}, "certificate must be a path"),
    ],
)
def test_unusable_arguments_are_refused(
    options: dict[str, Any], match: str, solution: hamsym.Solution, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=match):
        hamsym.report(solution, tmp_path / "a.html", compare=False, **options)


def test_unusable_files_are_refused(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be a Solution or a path"):
        hamsym.report(3, tmp_path / "a.html")  # type: ignore[arg-type]
    with pytest.raises(FileError, match="cannot be read"):
        hamsym.report(tmp_path / "none", tmp_path / "a.html")
    with pytest.raises(FileError, match="cannot be read"):
        hamsym.report(saved, tmp_path / "a.html", certificate=tmp_path / "none")
    (tmp_path / "text").write_text("no solution", encoding="utf-8")
    with pytest.raises(FileError, match="not a file of hamsym"):
        hamsym.report(tmp_path / "text", tmp_path / "a.html")
    with pytest.raises(InputError, match="does not exist; create it first"):
        hamsym.report(saved, tmp_path / "no" / "a.html")
    with pytest.raises(InputError, match="is a directory"):
        hamsym.report(saved, tmp_path)
    assert not (tmp_path / "a.html").exists()


def test_report_replaces_none_of_its_sources(saved: Path, tmp_path: Path) -> None:
    before = saved.read_bytes()
    os.link(saved, tmp_path / "link")
    (tmp_path / "symbolic").symlink_to(saved)
    for name in ("orbit.hamsym", "link", "symbolic", "orbit.hamsym.certificate"):
        with pytest.raises(InputError, match="would replace"):
            hamsym.report(saved, tmp_path / name, compare=False)
    certificate = tmp_path / "c"
    certificate.write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="would replace"):
        hamsym.report(saved, certificate, certificate=certificate, compare=False)
    assert saved.read_bytes() == before


@pytest.mark.slow
def test_failed_writing_leaves_the_old_report(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.html").write_text("old", encoding="utf-8")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match="No space left on device"):
        hamsym.report(saved, tmp_path / "a.html", compare=False)
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "orbit.hamsym"]


@pytest.mark.slow
def test_command_writes_beside_the_file(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(saved), "--no-compare"]) == 0
    assert capsys.readouterr().out.startswith("Not proven: there is no certificate\nwrote ")
    assert (tmp_path / "orbit.html").exists()
    assert main(["report", str(saved), "-o", str(saved)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_command_fails_where_nothing_is_proven(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hamsym.solve("p**2/2 + abs(x)", [1, 0], (0, 5)).save(tmp_path / "a")
    output = str(tmp_path / "a.html")
    options = ["--certify", "--no-compare", "--time-limit", "5", "-o", output]
    assert main(["report", str(tmp_path / "a"), *options]) == 1
    assert "Not proven" in capsys.readouterr().out
    assert "Not proven" in Path(output).read_text(encoding="utf-8")


@pytest.mark.slow
def test_names_that_are_no_text_are_written(solution: hamsym.Solution, tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(b"orbit-\xff.hamsym")
    solution.save(file)
    hamsym.report(file, tmp_path / "report.html", compare=False)
    assert r"orbit-\udcff.hamsym" in (tmp_path / "report.html").read_text("utf-8")


def test_too_long_a_name_is_an_error_of_files(solution: hamsym.Solution, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        hamsym.report(solution, tmp_path / ("x" * 300 + ".html"), compare=False)


def test_notes_are_escaped_paragraphs(tmp_path: Path) -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 3))
    path = tmp_path / "r.html"
    hamsym.report(solution, path, notes="First <b>one</b>.\n\nSecond.", compare=False)
    text = path.read_text("utf-8")
    assert "<p>First &lt;b&gt;one&lt;/b&gt;.</p>" in text
    assert "<p>Second.</p>" in text
    assert "Physical Review E 105" in text
    with pytest.raises(hamsym.InputError, match="notes must be text, not list"):
        hamsym.report(solution, path, notes=["a"], compare=False)  # type: ignore[arg-type]
