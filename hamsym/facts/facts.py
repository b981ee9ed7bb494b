"""Facts: what was asked of a result, what holds, how it is known, and what it cost.

Input:  names, labels, values as plain data, and their texts with units, in the order of reading.
Output: a text for a terminal, and the values of ``--json``; pages and headers render the same.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

from hamsym.support.text_tables import ALL, ROWS, columns, table, wrapped
from hamsym.support.validation import require_whole

if TYPE_CHECKING:
    import numpy as np
    import sympy

    from hamsym.formula.notation import Notation

_WIDTH = 96  # characters of a line in the head of a file


@dataclass(frozen=True)
class Fact:
    """One statement about a result."""

    #: Its key in JSON; "" if it has none.
    name: str
    #: label, text: What is read, one after the other; it is not shown without a text.
    label: str = ""
    #: As plain data.
    value: Any = None
    text: str = ""
    #: Whether it is part of short descriptions.
    brief: bool = True


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a table."""

    label: str
    values: Sequence[Any] | np.ndarray
    #: A format, or a function of a value.
    form: str | Callable[[Any], str] = ""
    #: Its key in JSON; "" if it has none.
    name: str = ""
    #: Whether it is part of short descriptions.
    brief: bool = True
    #: Whether it is text, flush left; in the last column it is wrapped.
    left: bool = False

    def text(self, row: int) -> str:
        """Return a cell."""
        value = self.values[row]
        return self.form(value) if callable(self.form) else format(value, self.form)


@dataclass(frozen=True)
class Cells:
    """The texts of a table."""

    header: list[str]
    rows: list[list[str]]
    #: Which columns are text, flush left.
    left: list[bool]
    #: What was left out.
    more: str

    @property
    def lines(self) -> list[str]:
        """The header and a line for each row; text in the last column is wrapped."""
        if len(self.header) < 2 or not self.left[-1]:
            return table(self.header, self.rows, self.left)
        before = table(self.header[:-1], [row[:-1] for row in self.rows], self.left[:-1])
        width = max(map(len, before)) + 2
        last = [self.header[-1], *(row[-1] for row in self.rows)]
        return [wrapped(text, line.ljust(width)) for text, line in zip(last, before, strict=True)]

    def paragraph(self, row: Sequence[str], indent: str) -> str:
        """Return a row that is too wide for a line."""
        named = zip(self.header[1:], row[1:], strict=True)
        return wrapped(
            ", ".join(f"{label} {cell}".strip() for label, cell in named if cell),
            row[0].ljust(len(indent)),
        )


@dataclass(frozen=True, eq=False)
class Table:
    """A row for each of some names."""

    #: What the rows are, in the plural.
    what: str
    names: Sequence[Any] | np.ndarray
    columns: tuple[Column, ...]
    #: Above the names, and above the table.
    head: str = ""
    title: str = ""
    #: Which rows are shown of so many, by default the first.
    choose: Callable[[int], Iterable[int]] | None = None
    #: Whether all rows are always shown.
    whole: bool = False
    #: Most columns of a short table.
    wide: int | None = None
    #: Below the rows, one for each; "" for none.
    notes: Sequence[str] = ()

    def rows_of(self, rows: int | None) -> list[int]:
        """Return the rows that are shown if there may be at most so many."""
        if rows is not None:
            require_whole("rows", rows, 0)
        if rows is None or self.whole or len(self.names) <= rows:
            return list(range(len(self.names)))
        return list(range(rows)) if self.choose is None else list(self.choose(rows))

    def cells(self, rows: int | None = ROWS, *, brief: bool = True) -> Cells:
        """Return the header, the rows that are shown, and what was left out.

        A column whose cells are all empty is left out.

        - brief: Whether only columns of short descriptions are shown.
        """
        shown = self.rows_of(rows)
        every = [column for column in self.columns if column.brief or not brief]
        wide = every if rows is None else every[: self.wide]
        texts = [[column.text(k) for k in shown] for column in wide]
        kept = [k for k, own in enumerate(texts) if any(own)]
        header = [self.head, *(wide[k].label for k in kept)]
        cells = [[str(self.names[k]), *(texts[j][i] for j in kept)] for i, k in enumerate(shown)]
        more = [(len(self.names) - len(shown), self.what), (len(every) - len(wide), "columns")]
        left = [True, *(wide[k].left for k in kept)]
        return Cells(header, cells, left, " and ".join(f"{n:,} {what}" for n, what in more if n))

    @property
    def fits(self) -> bool:
        """Whether the lines of the table fit the width of text."""
        return max(map(len, self.cells(None).lines)) <= columns()

    def lines(self, rows: int | None) -> list[str]:
        """Return the table as text, paragraphs if it is too wide, and what was left out."""
        cells = self.cells(rows)
        first, *lines = cells.lines
        indent = " " * (max(len(line[0]) for line in (cells.header, *cells.rows)) + 2)
        text = [first]
        if max(map(len, "\n".join((first, *lines)).splitlines()), default=0) > columns():
            text, lines = [], [cells.paragraph(row, indent) for row in cells.rows]
        for k, line in zip(self.rows_of(rows), lines, strict=True):
            note = self.notes[k] if self.notes else ""
            text += [line, *([wrapped(note, indent)] if note else [])]
        return [*text, *([f"... and {cells.more}; all with {ALL}"] if cells.more else [])]

    def column(self, name: str) -> Mapping[str, Any]:
        """Return the values of a column by the names of the rows."""
        (found,) = (column for column in self.columns if column.name == name)
        return dict(zip(map(str, self.names), found.values, strict=True))


#: What is part of a description: Facts that take a computation are given as a function.
Entry: TypeAlias = "Fact | Table | Callable[[], Sequence[Fact]]"


@dataclass(frozen=True)
class Formula:
    """An equation, or an expression without a left side."""

    left: str
    expr: sympy.Basic
    text: str
    notation: Notation | None = None


@dataclass(frozen=True, eq=False)
class Facts:
    """What is known of a result: ``result.facts``.

    ``result.summary()``, the representation in a notebook, the report, ``--json`` and the header of
    an export are made from it.

    Attributes
    ----------
    kind : str
        Type of the result.
    headline : str
        What is asked first: the largest error against what was asked, in one sentence.
    message : str
        Outcome of the method.
    success : bool or None
        None if nothing can fail.
    verdict : str
        The same as a word.
    formulas : tuple of Formula
    given : tuple of Fact
        What was asked: H, parameters, span, method, tolerance.
    entries : tuple of Fact, Table or function
        What was found, in the order of reading; a function computes facts when they are read.
    drawn : float
        Numbers that a figure of the result evaluates, about; infinite if there is no figure.
    members : int
        Number of trajectories, or of runs, of which some may fail.

    Examples
    --------
    >>> import hamsym
    >>> facts = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-6).facts
    >>> facts.headline
    'largest estimated error ... in ..., ... % of the 1.0e-06 asked'
    >>> facts.values()["start"]
    {'x': 1.0, 'p': 0.0}
    """

    kind: str
    headline: str = ""
    message: str = ""
    success: bool | None = None
    verdict: str = ""
    formulas: tuple[Formula, ...] = ()
    given: tuple[Fact, ...] = ()
    entries: tuple[Entry, ...] = ()
    drawn: float = math.inf
    members: int = 1

    @cached_property
    def found(self) -> tuple[Fact | Table, ...]:
        """Facts and tables in the order of reading; those that are not known yet are computed."""
        found: list[Fact | Table] = []
        for entry in self.entries:
            found += [entry] if isinstance(entry, Fact | Table) else entry()
        return tuple(found)

    @property
    def contained(self) -> tuple[Fact | Table, ...]:
        """Those of ``found`` that take no computation."""
        return tuple(entry for entry in self.entries if isinstance(entry, Fact | Table))

    @property
    def tables(self) -> tuple[Table, ...]:
        """The tables of ``found``."""
        return tuple(entry for entry in self.entries if isinstance(entry, Table))

    @property
    def opening(self) -> tuple[str, ...]:
        """The first sentences: the headline with its verdict, or the reason of a failure."""
        if self.success is False:
            return tuple(filter(None, (self.message, self.headline)))
        first = ": ".join(filter(None, (self.verdict, self.headline)))
        return tuple(filter(None, (first, self.message)))

    @property
    def warning(self) -> str:
        """Why the result is not what was asked for; "" if it is."""
        if self.success is not False:
            return ""
        return f"{'Failed: ' if self.members == 1 else ''}{self.message or self.headline}"

    def __getitem__(self, name: str) -> Fact:
        """Return a fact by its name in JSON."""
        facts = (fact for fact in (*self.given, *self.found) if isinstance(fact, Fact))
        return next(fact for fact in facts if fact.name == name)

    def values(self, *, computed: bool = True) -> dict[str, Any]:
        """Return all values by their names, as strict JSON has them.

        - computed: Whether facts that take a computation are included.
        """
        entries = (*self.given, *(self.found if computed else self.contained))
        values: dict[str, Any] = {"success": self.success} if self.success is not None else {}
        values |= {name: text for name in ("message", "headline") if (text := getattr(self, name))}
        for entry in entries:
            if isinstance(entry, Table):
                values |= {c.name: entry.column(c.name) for c in entry.columns if c.name}
            elif entry.name:
                values[entry.name] = entry.value
        return dict(strict(values))

    def header(self) -> list[str]:
        """Return what the result contains as lines of plain text, for the head of a file."""
        lines = []
        if self.success is False:
            lines += [*_entry("", f"This result FAILED (success=False): {self.message}"), ""]
        for formula in self.formulas:
            lines += _entry(f"{formula.left} = " if formula.left else "", formula.text)
        entries = (*self.given, Fact("", "outcome", None, "; ".join(self.opening)), *self.contained)
        for entry in entries:
            if isinstance(entry, Fact):
                shown = entry.text and entry.brief
                lines += _labelled(entry.label, entry.text) if shown else []
                continue
            for column in entry.columns:
                texts = [f"{n} = {column.text(k)}" for k, n in enumerate(entry.names)]
                lines += _labelled(column.label, ", ".join(texts)) if column.name else []
        return [line.rstrip() for line in lines]

    def text(self, rows: int | None = ROWS) -> str:
        """Return the description as text of at most 80 columns.

        - rows: Most rows of a table; with None all, and facts that are not brief.
        """
        lines = [wrapped(sentence) for sentence in self.opening]
        for entry in self.found:
            if isinstance(entry, Table):
                title = [wrapped(entry.title)] if entry.title else []
                lines += ["", *title, *entry.lines(rows), ""] if len(entry.names) else []
            elif entry.text and (entry.brief or rows is None):
                lines.append(wrapped(f"{entry.label} {entry.text}".strip()))
        return "\n".join(lines).strip("\n").replace("\n\n\n", "\n\n")


def strict(value: Any) -> Any:
    """Return a value as strict JSON has it: nan is null, infinities are "inf" and "-inf".

    Arrays are lists, and a complex number is a pair of its real and imaginary part.

    Examples
    --------
    >>> strict({"t": (1, math.nan), "bound": math.inf, "multiplier": 1j})
    {'t': [1, None], 'bound': 'inf', 'multiplier': [0.0, 1.0]}
    """
    if isinstance(value, Mapping):
        return {str(name): strict(part) for name, part in value.items()}
    if hasattr(value, "tolist"):  # numpy
        return strict(value.tolist())
    if isinstance(value, (list, tuple)):
        return [strict(part) for part in value]
    if isinstance(value, complex):
        return strict([value.real, value.imag])
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def _labelled(label: str, text: str) -> list[str]:
    start = f"{label.rstrip(':')}: " if label else ""
    return _entry(start[:1].upper() + start[1:], text)


def _entry(label: str, text: str) -> list[str]:
    """A labelled text without control characters, wrapped and indented."""
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(text.split()))
    return textwrap.wrap(
        shown,
        _WIDTH,
        initial_indent=label,
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    ) or [label.rstrip()]
