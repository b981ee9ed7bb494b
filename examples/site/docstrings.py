"""Docstrings for Sphinx: plain text with the sections of numpydoc, made safe for its markup."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import TYPE_CHECKING, Any

import hamsym

if TYPE_CHECKING:
    from sphinx.application import Sphinx

# Classes that users make themselves; others are results, whose constructors nobody calls.
_MADE = {"Hamiltonian", "Ball", "Regularizer"}
_CODE = re.compile(r"(``.*?``|:\w+:`[^`]*`|`[^`]*`)")
_ROLE = re.compile(r":(mod|func|meth|attr|class|data):`(~?)([\w.]+)`")


def described(thing: Any, section: str = "Attributes") -> list[str]:
    """Return the names in a section of the docstring of a class."""
    text = inspect.getdoc(thing) or ""
    match = re.search(
        rf"^{section}\n-+\n(.*?)(?=^\S[^\n]*\n-{{3,}}$|\Z)", text, re.MULTILINE | re.DOTALL
    )
    names: list[str] = []
    for line in (match[1] if match else "").splitlines():
        if re.match(r"[\w, ]+( : .*)?$", line) and not line[0].isspace():
            names += re.findall(r"\w+", line.partition(" : ")[0])
    return names


def _escaped(line: str) -> str:
    """Return a line in which |x| is a magnitude and a*b a product, not markup."""
    parts = _CODE.split(line)
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(r"([\\|*])", r"\\\1", parts[i])
        parts[i] = re.sub(r"(?<=\w)_(?!\w)", r"\\_", parts[i])
    return "".join(parts)


def _is_page(path: str) -> bool:
    """Return whether the reference has a page for this name."""
    from reference import RETURNED

    parts = path.split(".")
    public = len(parts) > 1 and parts[0] == "hamsym" and parts[1] in hamsym.__all__
    if public and parts[1] == "systems" and len(parts) > 2:
        public = parts[2] in hamsym.systems.__all__
    return public or any(path == name or path.startswith(f"{name}.") for name in RETURNED)


def _object(path: str) -> Any:
    """Return what a dotted name names; None if there is nothing."""
    parts = path.split(".")
    if "<locals>" in parts or not all(parts):
        return None
    for count in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:count]))
        except ImportError:
            continue
        for name in parts[count:]:
            if not hasattr(found, name) and name not in described(found):
                return None
            found = getattr(found, name, name)
        return found
    return None


def _link(match: re.Match[str]) -> str:
    """Return a reference in full, or as code if it names something that has no page."""
    role, short, path = match.groups()
    if not path.startswith("hamsym.") and path.split(".")[0] in hamsym.__all__:
        return f":{role}:`{short or '~'}hamsym.{path}`"
    if path.startswith("hamsym.") and not _is_page(path) and _object(path) is not None:
        return f"``{path.rpartition('.')[2] if short else path}``"
    return match[0]


def prepared(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with its prose escaped and its references in full."""
    session, found = False, []
    for line, after in zip(lines, [*lines[1:], ""], strict=True):
        session = line.lstrip().startswith(">>>") or (session and bool(line.strip()))
        found.append(line if session else _ROLE.sub(_link, _escaped(line)))
        nested = re.match(r"( {4,})\w[\w, ]* : \S", line)
        if nested and not re.match(rf"{nested[1]} +\S", after):
            found.append(f"{nested[1]}    \\ ")  # a term needs a definition
    return found


def _process(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = prepared(lines)


def _compact(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Put the type of each attribute beside its name, and give each of several an entry."""
    place = None
    for i, line in enumerate(lines):
        if line.startswith(".. attribute::"):
            place, lines[i] = i, line.replace(", ", "\n" + " " * len(".. attribute:: "))
        elif place is not None and line.startswith("   :type: "):
            lines[i], lines[place] = "", f"{lines[place]}\n{line}"
    lines[:] = "\n".join(lines).split("\n")


def _help_text(app: Sphinx, context: Any, lines: list[str]) -> None:
    """Escape the help texts of commands likewise."""
    lines[:] = [_escaped(line) for line in lines]


def _signature(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, arguments: str, returned: str
) -> tuple[str, str] | None:
    return ("", "") if what == "class" and name.rpartition(".")[2] not in _MADE else None


def _without_links_back(
    app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any
) -> None:
    """Remove links from source texts to the reference: some lead nowhere."""
    if pagename.startswith("_modules/"):
        context["body"] = re.sub(r'<a class="viewcode-back".*?</a>', "", context["body"])


def _skip(app: Sphinx, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """Leave out what the docstring of the class describes, and fields of tuples."""
    function = getattr(thing, "fget", None) or getattr(thing, "func", None) or thing
    path = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', '')}"
    owner = _object(path.rpartition(".")[0]) if "." in path.strip(".") else None
    if type(thing).__name__ == "_tuplegetter":
        return True
    return True if name in described(owner) else None


def setup(app: Sphinx) -> dict[str, Any]:
    # Before napoleon, which is at the usual priority, 500.
    app.connect("autodoc-process-docstring", _process, priority=400)
    app.connect("autodoc-process-docstring", _compact, priority=600)
    app.connect("autodoc-process-signature", _signature)
    app.connect("sphinx-click-process-description", _help_text)
    app.connect("autodoc-skip-member", _skip)
    app.connect("html-page-context", _without_links_back)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
