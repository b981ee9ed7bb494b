"""Navigation and links: pages stay ordinary Markdown, which GitHub shows too.

The lists of links in index.md become the tables of contents of the site. Links to files of the
repository outside the folder of the pages become links to their pages of the site.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_ROOT = Path(__file__).parents[2]
_GUIDE = "examples/guide"
# Files outside the guide that are copied to pages of the site.
_COPIES = {
    "CONTRIBUTING.md": "generated/contributing.md",
    "CHANGELOG.md": "generated/changes.md",
    "examples/paper/results/page.md": "generated/experiments.md",
}
# Where other files of the repository are on the site.
_PLACES = _COPIES | {
    "README.md": "index.md",
    "hamsym/__init__.pyi": "generated/reference/index.rst",
    "hamsym/cli/commands.py": "generated/reference/commands.rst",
    "examples/gallery": "generated/gallery/index.rst",
}
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")


def _target(path: str, folder: str, anchor: str) -> str | None:
    """Return where a link to a path of the repository leads from a folder of the site."""
    if path in _PLACES:
        found = _PLACES[path] + (anchor if path in _COPIES else "")
    elif re.fullmatch(r"examples/gallery/plot_\w+\.py", path):
        found = f"generated/gallery/{Path(path).stem}.rst"
    elif path.startswith("examples/") and (_ROOT / path).is_file():
        found = posixpath.relpath(path, _GUIDE) + anchor
    else:
        return None
    return posixpath.relpath(found, folder or ".")


def with_site_links(text: str, place: str, folder: str) -> str:
    """Return Markdown with its relative links as the site has them.

    ``place`` is the folder of the file in the repository, ``folder`` that of its page in the site.
    A link to a file that is no page of the site becomes its text.
    """

    def changed(match: re.Match[str]) -> str:
        picture, label, path, anchor = match[1], match[2], match[3], match[4] or ""
        target = _target(posixpath.normpath(posixpath.join(place, path)), folder, anchor)
        return label if target is None else f"{picture}[{label}]({target})"

    parts = re.split(r"(^```.*?^```$|`[^`\n]*`)", text, flags=re.DOTALL | re.MULTILINE)
    # A label may contain code, which is put back afterwards.
    kept: list[str] = []
    for i in range(1, len(parts), 2):
        kept.append(parts[i])
        parts[i] = f"\x00{len(kept) - 1}\x00"
    text = _LINK.sub(changed, "".join(parts))
    return re.sub("\x00(\\d+)\x00", lambda match: kept[int(match[1])], text)


def contents(text: str) -> str:
    """Return index.md with a hidden table of contents for each of its lists of links."""
    sections = re.split(r"^## (.*)$", text, flags=re.MULTILINE)
    found = []
    for title, body in zip(sections[1::2], sections[2::2], strict=True):
        pages = re.findall(r"^[-*] \[[^\]]*\]\(([^)#]+)\.(?:md|rst)\)", body, flags=re.MULTILINE)
        if pages:
            lines = ["```{toctree}", ":hidden:", f":caption: {title}", "", *pages, "```"]
            found.append("\n".join(lines))
    return text + "\n\n" + "\n\n".join(found) + "\n"


def _copy_pages(app: Sphinx) -> None:
    for source, target in _COPIES.items():
        path = Path(app.srcdir) / target
        path.parent.mkdir(parents=True, exist_ok=True)
        text = (_ROOT / source).read_text(encoding="utf-8")
        text = with_site_links(text, posixpath.dirname(source), posixpath.dirname(target))
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _read(app: Sphinx, docname: str, content: list[str]) -> None:
    if not str(app.env.doc2path(docname)).endswith(".md") or docname.startswith("generated/"):
        return
    folder = posixpath.dirname(docname)
    place = posixpath.join(_GUIDE, folder).rstrip("/")
    content[0] = with_site_links(content[0], place, folder)
    if docname == "index":
        content[0] = contents(content[0])


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("builder-inited", _copy_pages)
    app.connect("source-read", _read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
