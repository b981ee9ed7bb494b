"""The table of mistakes, which table.toml has."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Mutation:
    """A mistake in the package.

    Attributes
    ----------
    name : str
    file : str
        In the package, with ``templates`` as one of its folders.
    old, new : str
        A passage that occurs once in the file, and what takes its place.
    tests : list of str
        Files of tests, or tests in them, one of which must fail.
    """

    name: str
    file: str
    old: str
    new: str
    tests: list[str]

    def applied(self, text: str) -> str:
        """Return the text of the file with the mistake."""
        if text.count(self.old) != 1:
            raise ValueError(f"{self.file} does not contain this once: {self.old}")
        return text.replace(self.old, self.new)


_TEXT = Path(__file__).with_name("table.toml").read_text(encoding="utf-8")
#: By room.
MUTATIONS = {room: [Mutation(**row) for row in rows] for room, rows in tomllib.loads(_TEXT).items()}
