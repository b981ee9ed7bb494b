"""Texts for a terminal: wrapped paragraphs and tables that fit, with what was left out."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence

WIDTH = 80  # columns of text
_NARROWEST = 40
#: What shows the rows that are left out, at the command line and in Python.
ALL = "--full, summary(rows=None)"
ROWS = 12  # of a table, unless more are asked for


def columns() -> int:
    """Return the columns of text: 80, fewer in a narrower terminal."""
    if not sys.stdout.isatty():
        return WIDTH
    return max(_NARROWEST, min(WIDTH, shutil.get_terminal_size().columns))


def wrapped(text: str, start: str = "", width: int | None = None) -> str:
    """Return a text after a label, wrapped, with further lines below the text.

    Examples
    --------
    >>> print(wrapped("one two three", "x = ", 12))
    x = one two
        three
    """
    return textwrap.fill(
        text,
        width or columns(),
        initial_indent=start,
        subsequent_indent=" " * len(start),
        break_long_words=False,
        break_on_hyphens=False,
    )


def table(
    header: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[bool] = (True,)
) -> list[str]:
    """Return the lines of a table: some columns flush left, by default the first, others right.

    A column whose cells are all empty is left out.

    Examples
    --------
    >>> print("\\n".join(table(["", "unit", "scale"], [["x", "", "1"], ["p_x", "", "0.25"]])))
         scale
    x        1
    p_x   0.25
    """
    cells = [list(map(str, row)) for row in rows]
    used = [k for k in range(len(header)) if k == 0 or any(row[k] for row in cells)]
    lines = [header, *cells]
    widths = [max(len(line[k]) for line in lines) for k in used]
    return [
        "  ".join(
            line[k].ljust(width) if k < len(left) and left[k] else line[k].rjust(width)
            for k, width in zip(used, widths, strict=True)
        ).rstrip()
        for line in lines
    ]


def share(part: float, whole: float) -> str:
    """Return a ratio in per cent.

    Examples
    --------
    >>> share(3e-12, 1e-9), share(2.0, 1.0), share(1.0, 0.0)
    ('0.3 %', '200 %', 'more')
    """
    if not whole > 0:
        return "0 %" if part == 0 else "more"
    ratio = 100 * part / whole
    return f"{ratio:.3g} %" if ratio >= 100 else f"{ratio:.2g} %"
