"""The command and the lines of Python that compute a solution again.

Both have every number with all digits, so that on the same machine the result is the same to the
last bit. What they cannot contain, :func:`omissions` names.
"""

from __future__ import annotations

import shlex
import textwrap
from dataclasses import MISSING, Field, fields
from typing import Any

from hamsym.errors import HamsymError
from hamsym.hamiltonian import Hamiltonian
from hamsym.methods import METHODS
from hamsym.solution.solution import Solution

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
    if not _pairs_are_found(H):
        about["q"] = [symbol.name for symbol in H.q]
        about["p"] = [symbol.name for symbol in H.p]
    about["parameters"] = dict(H.parameters)
    about["units"] = {name: unit for name, unit in H.units.items() if name != "t"}
    about["forces"] = H.force_texts
    given = {name: value for name, value in about.items() if value}
    how: dict[str, Any] = {}
    settings = solution.settings
    if solution.method != "features":
        how["method"] = solution.method
    if _seed(solution):
        how["seed"] = _seed(solution)
    if settings is not None:
        if settings.prove:
            how["prove"] = True
        if settings.invariants:
            how["invariants"] = list(settings.invariants)
        how |= settings.options
    start = dict(zip(H.names, solution.z0.tolist(), strict=True))
    construct = _call("H = hamsym.Hamiltonian", [_quoted(H.formula)], given)
    times = repr(tuple(map(float, _span(solution))))
    solve = _call("solution = hamsym.solve", ["H", _literal(start), times], how)
    return f"import hamsym\n\n{construct}\n{solve}"


def command_line(solution: Solution, output: str | None = None) -> str:
    """Return the command that computes a solution again, over several lines if it is long.

    - output: File to which the command writes.

    Examples
    --------
    >>> import hamsym
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-6)
    >>> print(command_line(solution))
    hamsym solve 'p**2/2 + x**2/2' --z0 x=1.0,p=0.0 --t-end 5.0 --tol 1e-06
    """
    H = solution.H
    formula = f"({H.formula})" if H.formula.startswith("-") else H.formula
    parts = [["hamsym", "solve", formula]]
    if not _pairs_are_found(H):
        parts.append(["--q", ",".join(symbol.name for symbol in H.q)])
        parts.append(["--p", ",".join(symbol.name for symbol in H.p)])
    parts += [["--param", f"{name}={float(value)!r}"] for name, value in H.parameters.items()]
    parts += [["--force", f"{name}={text}"] for name, text in H.force_texts.items()]
    values = zip(H.names, solution.z0.tolist(), strict=True)
    parts.append(["--z0", ",".join(f"{name}={value!r}" for name, value in values)])
    start, end = map(float, _span(solution))
    if start:
        parts.append(["--t-start", repr(start)])
    parts.append(["--t-end", repr(end)])
    if solution.method != "features":
        parts.append(["--method", solution.method])
    if seed := _seed(solution):
        parts.append(["--seed", str(seed)])
    if solution.settings is not None:
        for name, value in solution.settings.options.items():
            parts.append(_option(solution, name, value) or [])
        parts += [["--prove"]] if solution.settings.prove else []
        parts += [["--invariant", text] for text in solution.settings.invariants]
    if output is not None:
        parts.append(["-o", output])
    lines = [""]
    for part in filter(None, parts):
        text = shlex.join(part)
        if lines[-1] and len(lines[-1]) + len(text) > _WIDTH:
            lines.append("  ")
        lines[-1] += text if not lines[-1].strip() else f" {text}"
    return " \\\n".join(lines)


def omissions(solution: Solution) -> list[str]:
    """Return sentences about what command and lines do not contain; none if they are complete."""
    found = []
    H, settings = solution.H, solution.settings
    if settings is None:
        found.append(
            "It is not recorded with which options this solution was computed; the lines have the "
            "defaults."
        )
    else:
        if settings.missing:
            found.append(
                f"The values of {', '.join(settings.missing)} are objects of the caller's program, "
                "which the lines cannot contain."
            )
        absent = [n for n, v in settings.options.items() if _option(solution, n, v) is None]
        if absent:
            found.append(f"The command has no option for these values: {', '.join(absent)}.")
    if H.units:
        found.append("The command has no units; they change no number.")
    if not _same_again(H):
        found.append(
            "H has binary fractions that its text does not have exactly; the saved solution does."
        )
    return found


def _seed(solution: Solution) -> int:
    if solution.settings is not None:
        return solution.settings.seed
    return int(getattr(solution.record, "seed", 0))


def _span(solution: Solution) -> tuple[float, float]:
    return solution.span if solution.settings is None else solution.settings.span


def _pairs_are_found(H: Hamiltonian) -> bool:
    """Return whether the names alone give the same pairs in the same order."""
    try:
        again = Hamiltonian(H.formula, parameters=H.parameters, forces=H.force_texts)
    except HamsymError:
        return False
    return again.names == H.names


def _same_again(H: Hamiltonian) -> bool:
    names = ([symbol.name for symbol in part] for part in (H.q, H.p))
    q, p = names
    try:
        again = Hamiltonian(H.formula, q=q, p=p, parameters=H.parameters, forces=H.force_texts)
    except HamsymError:
        return False
    return again == H


def _option(solution: Solution, name: str, value: Any) -> list[str] | None:
    """Return words of the command line, none for a default, or None if it has no such option."""
    field = _field(solution.method, name)
    if field is None:
        return None
    default = field.default_factory() if field.default_factory is not MISSING else field.default
    if isinstance(default, tuple):
        default = list(default)
    if type(value) is type(default) and value == default:
        return []
    flag = "--" + name.replace("_", "-")
    choices = field.metadata["choices"]
    if isinstance(choices, dict):
        return [
            flag,
            next(
                text
                for text, meant in choices.items()
                if meant is value or (type(meant) is type(value) and meant == value)
            ),
        ]
    if isinstance(value, bool):
        return [flag if value else flag.replace("--", "--no-", 1)]
    if value is None:
        return None
    if isinstance(value, list):
        if not value or field.type == "int | Sequence[float] | np.ndarray":
            return None if value else []
        texts = [repr(part) for part in value]
        return [flag, *texts] if field.type == "tuple[float, float]" else [flag, ",".join(texts)]
    return [flag, value if isinstance(value, str) else repr(value)]


def _field(method: str, name: str) -> Field[Any] | None:
    """The field of an option; None if the command line has no option of this name."""
    own = {entry.name: entry for entry in fields(METHODS[method].options)}
    if name not in own:
        return None
    if own[name].metadata:
        return own[name]
    # A method may change the default alone; the command line takes the option from another one.
    for other in METHODS.values():
        for entry in fields(other.options):
            if entry.name == name and entry.metadata:
                return entry
    return None


def _call(start: str, positional: list[str], named: dict[str, Any]) -> str:
    texts = positional + [f"{name}={_literal(value)}" for name, value in named.items()]
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
