"""The site builds without a warning and has an entry for every public attribute."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx", reason="needs pip install 'hamsym[docs]'")

from docstrings import described
from links import problems
from test_reference import CLASSES, PUBLIC, found, public_attributes

from hamsym.support.method_object import Method

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built from a copy of the pages; scripts of the gallery are not run."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(
        ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("generated")
    )
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff"):
        shutil.copy(ROOT / name, folder)
    options = ["-W", "--keep-going", "-q", "-D", "plot_gallery=0", "-d", str(folder / "doctrees")]
    examples = folder / "examples"
    places = ["-c", str(examples / "site"), str(examples / "guide"), str(folder / "built")]
    run = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, *places], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    return folder / "built"


@pytest.mark.slow
def test_every_link_leads_somewhere_and_nothing_is_fetched(site: Path) -> None:
    assert problems(site) == []


@pytest.mark.slow
def test_every_public_attribute_has_an_entry(site: Path) -> None:
    from sphinx.util.inventory import InventoryFile

    with open(site / "objects.inv", "rb") as file:
        inventory = InventoryFile.load(file, "", lambda base, path: path)
    entries = {name for kind in inventory.values() for name in kind}
    wanted = set(PUBLIC)
    for path in CLASSES:
        arguments = described(found(path), "Parameters")  # entries of their own kind
        # What all methods of solution have is described in their common class.
        common = described(Method) if issubclass(found(path), Method) else ()
        names = public_attributes(found(path)).keys() - {*arguments, *common}
        wanted |= {f"{path}.{name}" for name in names}
    assert sorted(wanted - entries) == []


@pytest.mark.slow
def test_pages_are_operable_by_keys_and_screen_readers(site: Path) -> None:
    for path in site.rglob("*.html"):
        page = path.read_text("utf-8")
        assert 'role="heading">' not in page
        assert "<pre>" not in page
        assert '<aside class="' not in page
