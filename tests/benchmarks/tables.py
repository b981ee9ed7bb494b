"""Write the tables of the documentation page from the results.

Run it with ``python -m tests.benchmarks.tables``.

A table of the page stands between ``<!-- benchmark NAME -->`` and ``<!-- end -->``. The figure of
the work-precision benchmark is drawn too.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

from .registry import BENCHMARKS
from .results import Section, read
from .work_precision import draw

_ROOT = Path(__file__).parents[2]
PAGE = _ROOT / "examples" / "guide" / "benchmarks.md"
FIGURE = PAGE.parent / "pictures" / "work-precision.png"

_MARKED = re.compile(r"(<!-- benchmark (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(page: str, sections: Mapping[str, Section]) -> str:
    """The page with the tables of the results between its marks."""

    def replacement(match: re.Match[str]) -> str:
        opening, name, closing = match.groups()
        section = sections[name]
        return f"{opening}\n{BENCHMARKS[name].table(section)}\n\n{origin(section)}\n\n{closing}"

    return _MARKED.sub(replacement, page)


def origin(section: Section) -> str:
    """Where and when the results were measured."""
    found = section["environment"]
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    quick = " Quick run: figures without meaning." if section["quick"] else ""
    measured = f" at {found['commit']}" if found.get("commit") else ""
    return (
        f"<sub>{found['processor']}, {found['date']}{measured}, Python {found['python']}, "
        f"{versions}.{quick}</sub>"
    )


def main() -> None:
    sections = read()
    if missing := [name for name in BENCHMARKS if name not in sections]:
        sys.exit(f"no results of {', '.join(missing)}; run python -m tests.benchmarks with them")
    PAGE.write_text(filled(PAGE.read_text("utf-8"), sections), "utf-8")
    print(f"wrote {PAGE.relative_to(_ROOT)}")
    draw(sections["work-precision"], FIGURE)
    print(f"wrote {FIGURE.relative_to(_ROOT)}")


if __name__ == "__main__":
    main()
