"""The mistakes of the table are in the files as they are, and their tests exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutations.table import MUTATIONS, Mutation

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("room", MUTATIONS)
def test_every_passage_occurs_once(room: str) -> None:
    for mutation in MUTATIONS[room]:
        folder = ROOT if mutation.file.startswith("templates/") else ROOT / "hamsym"
        text = (folder / mutation.file).read_text(encoding="utf-8")
        assert mutation.applied(text) != text
        for test in mutation.tests:
            file, _, name = test.partition("::")
            found = (ROOT / "tests" / file).read_text(encoding="utf-8")
            assert not name or f"def {name}(" in found, test


def test_missing_passages_are_named() -> None:
    mutation = Mutation("", "file.py", "a", "b", ())
    with pytest.raises(ValueError, match=r"file\.py does not contain this once: a"):
        mutation.applied("aa")


def test_names_tell_mutations_apart() -> None:
    for mutations in MUTATIONS.values():
        names = [mutation.name for mutation in mutations]
        assert len(names) == len(set(names))
