"""Figures of matplotlib as SVG elements for a page of HTML."""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree

import matplotlib
from matplotlib.figure import Figure

_SVG, _LINK = "http://www.w3.org/2000/svg", "{http://www.w3.org/1999/xlink}href"
_DIGITS = re.compile(r"(\.\d\d)\d+")  # hundredths of a point are enough
_REFERENCE = re.compile(r"#([^)\s]+)")
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def inline_svg(figure: Figure, prefix: str, label: str) -> str:
    """Return a figure as an element ``svg`` that may stand beside others in one page.

    Texts are drawn as paths, so that no font is needed.

    - prefix: Beginning of all identifiers; different for each figure of a page.
    - label: The figure in words, for readers who do not see it.

    Examples
    --------
    >>> figure = Figure()
    >>> _ = figure.subplots().plot([1, 2])
    >>> text = inline_svg(figure, "a", "A line")
    >>> text.startswith("<svg"), 'aria-label="A line"' in text, 'id="a-0"' in text
    (True, True, True)
    """
    buffer = io.StringIO()
    # The same figure gives the same text.
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": prefix}):
        figure.savefig(buffer, format="svg", metadata=_NO_METADATA)
    root = ElementTree.fromstring(buffer.getvalue())
    for parent in list(root.iter()):
        for child in list(parent):
            # A style sheet would apply to the whole page.
            if child.tag in (f"{{{_SVG}}}metadata", f"{{{_SVG}}}style"):
                parent.remove(child)
    # Numbers, since what matplotlib makes of rounded sizes differs between equal figures.
    order = dict.fromkeys(one.get("id") for one in root.iter() if one.get("id"))
    names = {old: f"{prefix}-{number}" for number, old in enumerate(order)}

    def renamed(match: re.Match[str]) -> str:
        return f"#{names.get(match[1], match[1])}"

    for element in root.iter():
        if not isinstance(element.tag, str):
            continue
        element.tag = element.tag.removeprefix(f"{{{_SVG}}}")
        for name, value in list(element.attrib.items()):
            if name == "d":
                element.set(name, _DIGITS.sub(r"\1", value.replace("\n", "")))
            elif name == "id":
                element.set(name, names[value])
            elif name == _LINK:
                del element.attrib[name]
                element.set("href", _REFERENCE.sub(renamed, value))
            elif "url(#" in value:
                element.set(name, _REFERENCE.sub(renamed, value))
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    root.set("style", "stroke-linejoin: round; stroke-linecap: butt")
    root.set("role", "img")
    root.set("aria-label", label)
    return ElementTree.tostring(root, encoding="unicode")
