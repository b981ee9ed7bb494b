"""Export of a solution to a header in C99."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from hamsym.codegen.generate import environment, generate
from hamsym.exporting.about import About
from hamsym.exporting.closed_form import ClosedForm, FeatureForm, envelope_text
from hamsym.formula.parser import canonical_name

_PER_LINE = 4
# Functions and names of the generated code, which become those of the header.
_GLOBAL = ("DIM", "sign", "smaller", "larger")


def prefix_of(stem: str) -> str:
    """Return the prefix of the names in a header from the name of its file.

    Examples
    --------
    >>> prefix_of("my orbit"), prefix_of("3body"), prefix_of("")
    ('my_orbit', 'orbit_3body', 'orbit')
    """
    name = re.sub(r"_+", "_", re.sub(r"\W", "_", stem, flags=re.ASCII)).strip("_")
    if not name:
        return "orbit"
    return f"orbit_{name}" if name[0].isdigit() else name


def c_header(about: About, form: ClosedForm, stem: str) -> bytes:
    """Return the header as text in ASCII.

    - stem: Name of the file without its ending, of which the prefix of all names is made.
    """
    name, H = prefix_of(stem), about.solution.H
    values: dict[str, Any] = {
        "name": name,
        "guard": f"{name.upper()}_H",
        "about": [_in_comment(line) for line in about.lines()],
        "form": form,
        "span": _numbers(np.array(about.solution.span)),
        "numbers": _numbers,
        "names": ", ".join(json.dumps(canonical_name(n)) for n in H.names),
        "energy": _energy(about, name),
        "has_time": H.time is not None,
        "envelope": envelope_text(form),
    }
    if isinstance(form, FeatureForm):
        values["origin"] = repr(form.origin) if form.origin >= 0 else f"({form.origin!r})"
    else:
        values["sizes"], values["offsets"] = np.array(form.sizes), np.array(form.offsets)
        values["widest"] = max(map(max, form.sizes))
    text = environment().get_template("orbit.h.jinja").render(m=values)
    return text.encode("ascii", errors="backslashreplace")


def _numbers(array: np.ndarray) -> list[str]:
    """Lines of numbers; decimals that are read back to the last bit."""
    texts = [repr(number) for number in np.asarray(array).ravel().tolist()]
    return [
        ", ".join(texts[k : k + _PER_LINE]) + "," * (k + _PER_LINE < len(texts))
        for k in range(0, len(texts), _PER_LINE)
    ]


def _energy(about: About, name: str) -> str:
    """The generated function of H, with the parameters as numbers and names of the header."""
    source = generate(about.solution.H.real_equations, "c")
    head, text = source.part("head"), source.part("energy")
    flags = re.MULTILINE | re.DOTALL
    definitions = [
        found[0]
        for function in _GLOBAL[1:]
        if (found := re.search(rf"^static double {function}\(.*?^}}\n", head + "\n", flags))
    ]
    text = re.sub(r",\s*const struct parameters \*parameters", "", text)
    text = text.replace("    (void)parameters;\n", "")
    values = dict(source.names.parameters)
    text = re.sub(r"parameters->(\w+);", lambda found: f"{values[found[1]]!r};", text)
    text = text.replace("double energy(", "static inline double energy(", 1)
    text = "\n".join([*definitions, text]).replace("static double", "static inline double")
    for own in _GLOBAL:
        text = re.sub(rf"\b{own}\b", f"{name}_{own}", text)
    text = re.sub(r"\benergy\(", f"{name}_hamiltonian(", text, count=1)
    return text.strip("\n")


def _in_comment(text: str) -> str:
    """Separate what would end a comment, begin another one or mean another character."""
    for pair in ("*/", "/*", "??"):
        text = text.replace(pair, " ".join(pair))
    return text
