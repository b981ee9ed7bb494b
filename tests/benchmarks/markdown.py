"""Tables as Markdown, aligned so that they can be read in a terminal too."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A table whose first ``left`` columns are aligned to the left and the others to the right."""
    lines = [list(head), *(list(row) for row in rows)]
    widths = [max(3, *(len(line[k]) for line in lines)) for k in range(len(head))]

    def text(cells: Sequence[str]) -> str:
        padded = (
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        return f"| {' | '.join(padded)} |"

    rule = ["-" * width if k < left else "-" * (width - 1) + ":" for k, width in enumerate(widths)]
    return "\n".join([text(lines[0]), text(rule), *map(text, lines[1:])])


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, in full where that is short; a dash for none."""
    if value is None or math.isnan(value):
        return "-"
    if not math.isfinite(value):
        return "inf"
    if value and not 1e-3 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:,.{places}f}"


def plain(value: float) -> str:
    """An error or a tolerance in powers of ten."""
    return f"{value:.1e}" if math.isfinite(value) else "inf"


def skipped(names: Sequence[str]) -> str:
    """The line below a table that names the packages that were not installed."""
    return f"\n\nNot installed, and skipped: {', '.join(names)}." if names else ""
