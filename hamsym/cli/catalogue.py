"""The command that lists the systems of the catalogue, or describes one of them."""

from __future__ import annotations

import inspect
import shlex
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Report, command, completing
from hamsym.errors import InputError
from hamsym.support.suggestions import did_you_mean
from hamsym.support.text_tables import table, wrapped

if TYPE_CHECKING:
    from hamsym.systems import Problem

_LEGEND = """
d: degrees of freedom, exact: solution known, T: period known,
F: number of known first integrals besides H"""


def _systems() -> list[str]:
    from hamsym.systems import CATALOGUE

    return sorted(CATALOGUE)


@command(
    "List the catalogue of systems, or show one.",
    "hamsym systems",
    'hamsym systems henon_heiles --start "E = 1/6, chaotic"',
)
@click.argument("name", required=False, shell_complete=completing(_systems))
@click.option("--start", metavar="START", help="One of the system's named initial states.")
def systems(name: str | None, start: str | None) -> Report:
    """List the catalogue of systems, or show one: H, start, what is known, how to solve it."""
    from hamsym.systems import CATALOGUE  # imports sympy

    if name is None:
        if start is not None:
            raise InputError("--start needs the name of a system; give one: hamsym systems NAME")
        problems = {name: CATALOGUE[name]() for name in sorted(CATALOGUE)}
        header = ("system", "d", "what it is", "exact", "T", "F")
        rows = [_row(name, problem) for name, problem in problems.items()]
        text = "\n".join([*table(header, rows, left=[True] * len(header)), _LEGEND])
        return Report(text, {"systems": {n: _brief(problem) for n, problem in problems.items()}})
    if name not in CATALOGUE:
        hint = did_you_mean(name, CATALOGUE)
        raise InputError(f"'{name}' is not a system{hint}; 'hamsym systems' lists them")
    make = CATALOGUE[name]
    if start is None:
        problem = make()
    elif "start" in inspect.signature(make).parameters:
        problem = make(start=start)
    else:
        raise InputError(f"'{name}' has one start only; leave --start out")
    return Report(_described(problem), _values_of(problem))


def _brief(problem: Problem) -> dict[str, Any]:
    return {
        "title": problem.name,
        "degrees_of_freedom": problem.H.dof,
        "H": problem.H.formula,
        "exact": problem.exact is not None,
        "period": problem.period,
        "conserved": problem.conserved,
    }


def _values_of(problem: Problem) -> dict[str, Any]:
    H, reference = problem.H, problem.reference
    return _brief(problem) | {
        "q": H.names[: H.dof],
        "p": H.names[H.dof :],
        "parameters": dict(H.parameters),
        "start": dict(zip(H.names, problem.z0, strict=True)),
        "name_of_start": problem.start or None,
        "starts": problem.starts,
        "span": problem.span,
        "source": problem.source,
        "end": None if reference is None else dict(zip(H.names, reference.z, strict=True)),
        "command": solving_command(problem).replace("\\\n  ", ""),
    }


def _row(name: str, problem: Problem) -> tuple[str, ...]:
    exact, period = ("-" if one is None else "+" for one in (problem.exact, problem.period))
    integrals = str(len(problem.conserved) or "-")
    return name, str(problem.H.dof), problem.name, exact, period, integrals


def _described(problem: Problem) -> str:
    H = problem.H
    lines = [f"{problem.name}\n", wrapped(H.formula, "H = ")]
    if H.parameters:
        values = ", ".join(f"{name} = {value!r}" for name, value in H.parameters.items())
        lines.append(wrapped(values, "parameters: "))
    state = ", ".join(f"{n} = {v!r}" for n, v in zip(H.names, problem.z0, strict=True))
    lines.append(wrapped(f"{problem.start}: {state}" if problem.start else state, "start: "))
    lines += [wrapped(one, "other start: ") for one in problem.starts if one != problem.start]
    lines.append(wrapped(f"{problem.span[0]:g} to {problem.span[1]!r}", "span: "))
    lines.append(wrapped(problem.source, "source: "))
    if problem.period is not None:
        lines.append(wrapped(repr(problem.period), "period: "))
    lines += [wrapped(formula, "conserved: ") for formula in problem.conserved]
    lines.append(f"exact solution: {'yes' if problem.exact is not None else 'not known'}")
    if problem.reference is not None:
        lines.append(f"end state, to {problem.reference.digits} digits")
        width = max(map(len, H.names))
        for name, value in zip(H.names, problem.reference.z, strict=True):
            sign = "" if value.startswith("-") else " "
            lines.append(f"  {name:<{width}} {sign}{value}")
    return "\n".join([*lines, f"\n{solving_command(problem)}"])


def solving_command(problem: Problem) -> str:
    """The command line that solves a problem, with a backslash at the end of each line but one."""
    H = problem.H
    half = H.dim // 2
    parts = [f"hamsym solve {shlex.quote(H.formula)}"]
    parts.append(f"--q {','.join(H.names[:half])} --p {','.join(H.names[half:])}")
    parts += [f"-P {name}={value!r}" for name, value in H.parameters.items()]
    parts.append(f"--z0={','.join(map(repr, problem.z0))}")
    parts.append(f"--t-end {problem.span[1]!r} --tol 1e-9")
    return " \\\n  ".join(parts)
