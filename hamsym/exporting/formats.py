"""Exports of a solution: a module of Python, JSON for JavaScript and others, a header in C99."""

from __future__ import annotations

import base64
import json
import re
from typing import Any

import numpy as np

from hamsym.codegen.generate import environment, generate
from hamsym.codegen.printers import NUMPY_DEFINITIONS
from hamsym.exporting.about import About
from hamsym.exporting.closed_form import ClosedForm, FeatureForm, envelope_text
from hamsym.formula.parser import canonical_name

_WIDTH = 96  # characters of a line
_WRITTEN_OUT = 64  # numbers of an array that is written in decimals, not as bytes
_FEATURES = ("edges", "states", "readouts", "series", "rates")  # arrays of a form
_FORMAT, _VERSION = "hamsym trajectory", 1
_PER_LINE = 4
# Functions and names of the generated code, which become those of the header.
_GLOBAL = ("DIM", "sign", "smaller", "larger")


# -- Python ----------------------------------------------------------------------------------------


def python_module(about: About, form: ClosedForm, _: str) -> bytes:
    """Return the module as text in UTF-8."""
    H = about.solution.H
    errors = [e if np.isfinite(e) else None for e in about.solution.largest_error.tolist()]
    energy = H.source("numpy", part="energy").replace("def energy(", "def _hamiltonian(", 1)
    energy = energy.replace("    z = _floating(z)\n", "", 1)
    used = [own for own in NUMPY_DEFINITIONS.values() if re.search(rf"\b{own[0]}\b", energy)]
    values = {
        "about": [_in_docstring(line) for line in about.lines()],
        "names": tuple(H.names),
        "span": tuple(map(float, about.solution.span)),
        "parameters": dict(H.parameters),
        "success": bool(about.solution.success),
        "errors": dict(zip(H.names, errors, strict=True)),
        "has_time": H.time is not None,
        "definitions": used,
        "energy": energy,
        "form": form,
        "arrays": [(name, _array(array)) for name, array in _arrays(form)],
        "envelope": envelope_text(form),
    }
    return environment().get_template("orbit.py.jinja").render(m=values).encode()


def _arrays(form: ClosedForm) -> list[tuple[str, Any]]:
    networks = ("edges", "taus", "starts", "weights")
    names = ("origin", *_FEATURES) if isinstance(form, FeatureForm) else networks
    return [(name.upper(), getattr(form, name)) for name in names]


def _array(array: Any) -> str:
    """An expression of an array: decimals with all digits if it is short, else bytes."""
    if isinstance(array, float):
        return repr(array)
    if array.size <= _WRITTEN_OUT:
        rows = array.tolist()
        line = f"np.array({rows!r})"
        if len(line) <= _WIDTH - 12:
            return line
        inner = re.sub(r"(.{1,88})(?: |$)", r"    \1\n", repr(rows))
        return f"np.array(\n{inner})"
    content = np.ascontiguousarray(array, dtype="<f8").tobytes()
    data = base64.b64encode(content).decode()
    text = "\n".join(data[k : k + _WIDTH] for k in range(0, len(data), _WIDTH))
    return f'_array(\n    """\n{text}\n""",\n    {", ".join(map(str, array.shape))},\n)'


def _in_docstring(text: str) -> str:
    """Escape what would end a docstring or mean another character in it."""
    return text.replace("\\", "\\\\").replace('"""', '\\"\\"\\"')


# -- JSON ------------------------------------------------------------------------------------------


def json_document(about: About, form: ClosedForm, _: str) -> bytes:
    """Return the document; every number is a decimal that is read back to the last bit."""
    solution = about.solution
    values: dict[str, Any] = {
        "format": _FORMAT,
        "version": _VERSION,
        "about": about.values(),
        "names": list(solution.H.names),
        "span": list(map(float, solution.span)),
        "parameters": dict(solution.H.parameters),
        "kind": form.kind,
    }
    values |= _features(form) if isinstance(form, FeatureForm) else _networks(form)
    # One entry a line: the first lines are read by people.
    entries = (f"{json.dumps(key)}: {_text(value)}" for key, value in values.items())
    return ("{\n" + ",\n".join(entries) + "\n}\n").encode()


def _text(value: Any) -> str:
    return json.dumps(value, allow_nan=False, indent=1 if isinstance(value, dict) else None)


def _features(form: FeatureForm) -> dict[str, Any]:
    return {"origin": form.origin, **{name: getattr(form, name).tolist() for name in _FEATURES}}


def _networks(form: Any) -> dict[str, Any]:
    networks = [
        [[{"matrix": m.tolist(), "bias": b.tolist()} for m, b in layers] for layers in window]
        for window in form.networks
    ]
    parts = zip(form.starts.tolist(), form.taus.tolist(), networks, strict=True)
    windows = [{"start": start, "tau": tau, "networks": own} for start, tau, own in parts]
    return {
        "activation": form.activation,
        "envelope": form.envelope,
        "edges": form.edges.tolist(),
        "windows": windows,
    }


# -- C ---------------------------------------------------------------------------------------------


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
