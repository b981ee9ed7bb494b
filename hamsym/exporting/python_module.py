"""Export of a solution to a module of Python that needs only numpy."""

from __future__ import annotations

import base64
import re
from typing import Any

import numpy as np

from hamsym.codegen.generate import environment
from hamsym.codegen.printers import NUMPY_DEFINITIONS
from hamsym.exporting.about import About
from hamsym.exporting.closed_form import ClosedForm, FeatureForm, envelope_text

_WIDTH = 96  # characters of a line
_WRITTEN_OUT = 64  # numbers of an array that is written in decimals, not as bytes


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
    features = ("origin", "edges", "states", "readouts", "series", "rates")
    networks = ("edges", "taus", "starts", "weights")
    names = features if isinstance(form, FeatureForm) else networks
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
