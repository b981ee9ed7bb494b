"""What pages need for screen readers and keys, where the theme leaves it out.

Scrolled regions can be focused, headings have levels, landmarks and links have names.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

_CHANGES: tuple[tuple[str, str], ...] = (
    (r'(<p class="caption" role="heading")>', r'\1 aria-level="2">'),
    (r"<pre>", r'<pre tabindex="0">'),
    (r'<div class="(formula|table-wrapper)', r'<div tabindex="0" class="\1'),
    (r'<aside class="sidebar-drawer"', r'<aside aria-label="contents" class="sidebar-drawer"'),
    (r'<aside class="toc-drawer', r'<aside aria-label="this page" class="toc-drawer'),
    (r'<th class="([^"]*)"><p></p></th>', r'<td class="\1"></td>'),
    # The theme hides these words, because the title below shows them.
    (
        r'<a class="reference internal" (href="plot_[^"]*")><span class="doc">([^<]*)</span></a>',
        r'<a class="reference internal" aria-label="\2" \1><span class="doc">\2</span></a>',
    ),
    (r'<div id="search-results">', r'<h1>Search</h1>\n<div id="search-results">'),
)


def accessible(page: str) -> str:
    """Return a page with what it lacks."""
    for old, new in _CHANGES:
        page = re.sub(old, new, page)
    return page


def _mend(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        for path in Path(app.outdir).rglob("*.html"):
            path.write_text(accessible(path.read_text("utf-8")), "utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("build-finished", _mend)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
