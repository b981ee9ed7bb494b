"""Links of the Markdown pages lead to files and headings; the check of a site finds broken ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from links import problems
from navigation import contents, with_site_links

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "examples" / "guide"
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted(GUIDE.glob("*.md")),
    ROOT / "examples" / "paper" / "results" / "page.md",
]


def _prose(page: Path) -> str:
    text = re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    return re.sub(r"(?<!\[)`[^`\n]*`(?!\])", "", text)


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub makes of the headings of a page."""
    text = re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    titles = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_somewhere(page: Path) -> None:
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", _prose(page)):
        path, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", path):
            continue
        target = page.parent / path if path else page
        if not target.exists() or (
            anchor and target.suffix == ".md" and anchor not in anchors(target)
        ):
            broken.append(link)
    assert broken == []


def test_front_page_lists_every_page() -> None:
    listed = re.findall(r"^- \[[^\]]*\]\((\w+\.md)\)", _prose(GUIDE / "index.md"), re.MULTILINE)
    pages = {path.name for path in GUIDE.glob("*.md")} - {"index.md"}
    assert sorted(listed) == sorted(pages)


def test_lists_of_links_become_tables_of_contents() -> None:
    text = contents("# A\n\n## B\n\n- [x](one.md): y\n- [z](two/three.rst)\n")
    assert ":caption: B\n\none\ntwo/three\n```" in text


def test_links_out_of_the_folder_lead_to_pages() -> None:
    text = "[a](../../CHANGELOG.md#b) [c](../gallery/plot_kepler.py) [d](../../LICENSE) `[e](f.md)`"
    assert with_site_links(text, "examples/guide", "") == (
        "[a](generated/changes.md#b) [c](generated/gallery/plot_kepler.rst) d `[e](f.md)`"
    )
    assert with_site_links("[f](examples/guide/faq.md)", "", "generated") == "[f](../faq.md)"
    page = "![](scheme.png) [g](../../chaos.py)"
    assert with_site_links(page, "examples/paper/results", "generated") == (
        "![](../../paper/results/scheme.png) [g](../../chaos.py)"
    )


def test_broken_links_of_a_site_are_found(tmp_path: Path) -> None:
    (tmp_path / "one.html").write_text(
        '<a href="two.html#here">x</a><a href="two.html#there">x</a><a href="three.html">x</a>'
        '<a href="https://example.org">x</a><script src="https://example.org/a.js"></script>'
    )
    (tmp_path / "two.html").write_text('<p id="here">y</p>')
    assert problems(tmp_path) == [
        "one.html: fetches https://example.org/a.js",
        "one.html: two.html#there has no such place",
        "one.html: three.html does not exist",
    ]


def test_an_empty_site_is_no_site(tmp_path: Path) -> None:
    assert len(problems(tmp_path)) == 1
