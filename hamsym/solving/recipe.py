"""The lines of Python that compute a solution again.

They have every number with all digits, so that on the same machine the result is the same to the
last bit. What they cannot contain, :func:`omissions` names.
"""

from __future__ import annotations

import textwrap
from typing import Any

from hamsym.errors import HamsymError
from hamsym.hamiltonian import Hamiltonian
from hamsym.solution.solution import Solution
from hamsym.solving.methods import METHODS

_WIDTH = 88


def python_lines(solution: Solution) -> str:
    """Return lines of Python that compute a solution again.

    Examples
    --------
    >>> import hamsym
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-6)
    >>> print(python_lines(solution))
    import hamsym
    <BLANKLINE>
    H = hamsym.Hamiltonian("p**2/2 + x**2/2")
    solution = hamsym.solve(H, {"x": 1.0, "p": 0.0}, (0.0, 5.0), tol=1e-06)
    """
    H = solution.H
    about: dict[str, Any] = {}
    again = _made_again(H)  # which may find other pairs, or another order
    if again is None or again.names != H.names:
        about["q"] = [symbol.name for symbol in H.q]
        about["p"] = [symbol.name for symbol in H.p]
    about["parameters"] = dict(H.parameters)
    about["units"] = {name: unit for name, unit in H.units.items() if name != "t"}
    about["forces"] = H.force_texts
    given = {name: value for name, value in about.items() if value}
    how = {name: _literal(value) for name, value in _asked(solution).items()}
    settings, name = solution.settings, solution.method
    if settings.options:
        options = {option: _literal(value) for option, value in settings.options.items()}
        how["method"] = _call(f"hamsym.{METHODS[name].__name__}", [], options)
    elif name != "features":
        how["method"] = repr(name)
    start = dict(zip(H.names, solution.z0.tolist(), strict=True))
    literals = {name: _literal(value) for name, value in given.items()}
    construct = _call("H = hamsym.Hamiltonian", [_quoted(H.formula)], literals)
    times = repr(tuple(map(float, settings.span)))
    solve = _call("solution = hamsym.solve", ["H", _literal(start), times], how)
    return f"import hamsym\n\n{construct}\n{solve}"


def _asked(solution: Solution) -> dict[str, Any]:
    """Return the arguments of solve that differ from its defaults, beside the method."""
    settings = solution.settings
    values: dict[str, Any] = {
        "tol": settings.tol if settings.tol_given else None,
        "atol": settings.atol[0] if len(settings.atol) == 1 else list(settings.atol),
        "breakpoints": list(settings.breakpoints),
        "seed": settings.seed,
        "prove": settings.prove,
        "invariants": list(settings.invariants),
    }
    return {name: value for name, value in values.items() if value not in (None, 0, False, [])}


def omissions(solution: Solution) -> list[str]:
    """Return sentences about what the lines do not contain; none if they are complete."""
    found, settings = [], solution.settings
    if settings.missing:
        found.append(
            f"The values of {', '.join(settings.missing)} are objects of the caller's program, "
            "which the lines cannot contain."
        )
    H = solution.H
    if _made_again(H, q=[s.name for s in H.q], p=[s.name for s in H.p]) != H:
        found.append(
            "H has binary fractions that its text does not have exactly; the saved solution does."
        )
    return found


def _made_again(H: Hamiltonian, **pairs: Any) -> Hamiltonian | None:
    """Return the Hamiltonian of the text of another; None if that text alone has none."""
    try:
        return Hamiltonian(H.formula, parameters=H.parameters, forces=H.force_texts, **pairs)
    except HamsymError:
        return None


def _call(start: str, positional: list[str], named: dict[str, str]) -> str:
    texts = positional + [f"{name}={text}" for name, text in named.items()]
    line = f"{start}({', '.join(texts)})"
    if len(line) <= _WIDTH and "\n" not in line:
        return line
    body = "".join(textwrap.indent(text, "    ") + ",\n" for text in texts)
    return f"{start}(\n{body})"


def _literal(value: Any) -> str:
    """Return a value as Python writes it; a long one over several lines."""
    if isinstance(value, dict):
        return _enclosed("{", [f"{_quoted(k)}: {_literal(v)}" for k, v in value.items()], "}")
    if isinstance(value, list):
        return _enclosed("[", [_literal(part) for part in value], "]")
    return _quoted(value) if isinstance(value, str) else repr(value)


def _enclosed(left: str, texts: list[str], right: str) -> str:
    line = left + ", ".join(texts) + right
    if len(line) <= _WIDTH - 20:
        return line
    lines = [""]
    for text in texts:
        if lines[-1] and len(lines[-1]) + len(text) > _WIDTH - 12:
            lines.append("")
        lines[-1] += f"{' ' if lines[-1] else ''}{text},"
    return left + "\n" + "".join(f"    {part}\n" for part in lines) + right


def _quoted(text: str) -> str:
    """Return a literal of a formula, over several lines if it is long."""
    if len(text) <= _WIDTH - 8:
        return '"' + text + '"' if text.isprintable() and not {*text} & {*'"\\'} else repr(text)
    pieces = textwrap.wrap(
        text, _WIDTH - 12, drop_whitespace=False, break_on_hyphens=False, break_long_words=False
    )
    if "".join(pieces) != text:
        return repr(text)
    return "(\n" + "\n".join(f"    {piece!r}" for piece in pieces) + "\n)"
