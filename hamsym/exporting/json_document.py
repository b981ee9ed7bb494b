"""Export of a solution to JSON, for JavaScript and others."""

from __future__ import annotations

import json
from typing import Any

from hamsym.exporting.about import About
from hamsym.exporting.closed_form import ClosedForm, FeatureForm

_FORMAT, _VERSION = "hamsym trajectory", 1


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
    names = ("edges", "states", "readouts", "series", "rates")
    return {"origin": form.origin, **{name: getattr(form, name).tolist() for name in names}}


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
