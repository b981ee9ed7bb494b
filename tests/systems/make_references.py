"""Make ``hamsym/systems/references.json``: end states of the catalogue, to 30 digits.

Run it from the repository: ``python -m tests.systems.make_references [name ...]``; without names it
makes the missing references. Every trajectory is computed twice, with Taylor series of different
orders and precisions, and a third time from a start moved by 1e-20 to measure the growth of errors.
"""

from __future__ import annotations

import inspect
import json
import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import mpmath
from flint import arb, ctx

import hamsym.systems
from hamsym.systems import CATALOGUE, Problem
from tests.audit.taylor import Equations, integrate

FILE = Path(hamsym.systems.__file__).with_name("references.json")
DIGITS = 30
_NUDGE = 1e-20  # relative change of the start
_ORDERS = (48, 40)
_BITS = (240, 210)
_STEP_DIGITS = (44.0, 41.0)


def problems(names: list[str]) -> Iterator[tuple[str, Problem]]:
    """Problems with usual arguments, from every named start, as their functions compute them."""
    for name in names or CATALOGUE:
        function = inspect.unwrap(CATALOGUE[name])
        usual = function()
        yield name, usual
        for start in usual.starts:
            if start != usual.start:
                yield name, function(start=start)


def row_of(name: str, problem: Problem) -> dict[str, object]:
    began = time.process_time()
    H, end = problem.H, problem.span[1]
    half = H.dim // 2
    equations = Equations(H.formula, H.names[:half], H.names[half:], dict(H.parameters))
    runs = [
        integrate(equations, problem.z0, problem.span[0], [end], order=order, bits=bits, digits=d)
        for order, bits, d in zip(_ORDERS, _BITS, _STEP_DIGITS, strict=True)
    ]
    sizes = [scale if scale > 0 else 1.0 for scale in runs[0].scales]
    generator = random.Random(1)
    before, ctx.prec = ctx.prec, 240
    nudged = [
        arb(value) + size * _NUDGE * generator.choice((-1, 1))
        for value, size in zip(problem.z0, sizes, strict=True)
    ]
    moved = integrate(equations, nudged, problem.span[0], [end], order=30, bits=128, digits=28)
    agreement, change = (
        max(
            abs(float(a - b)) / size
            for a, b, size in zip(runs[0].states[0], other.states[0], sizes, strict=True)
        )
        for other in (runs[1], moved)
    )
    state = [mpmath.nstr(_mpf(value), DIGITS, strip_zeros=False) for value in runs[0].states[0]]
    ctx.prec = before
    spent = time.process_time() - began
    print(
        f"{name:24s} {problem.start:22s} {runs[0].steps:5d} steps, agreement {agreement:.1e}, "
        f"growth {change / _NUDGE:.1e}, {spent:.1f} s",
        flush=True,
    )
    if not agreement < 0.1 * 10.0**-DIGITS:
        raise SystemExit(f"{name}: two computations differ by {agreement:.1e}")
    return {
        "system": name,
        "start": problem.start,
        "parameters": dict(H.parameters),
        "z0": list(problem.z0),
        "t": end,
        "z": state,
        "digits": DIGITS,
        "growth": float(f"{max(1.0, change / _NUDGE):.2g}"),
        "source": "tests/systems/make_references.py",
        "method": f"Taylor series of orders {_ORDERS[0]} and {_ORDERS[1]} with {_BITS[0]} and "
        f"{_BITS[1]} bits (python-flint), which agree to {DIGITS} digits",
    }


def _mpf(value: arb) -> mpmath.mpf:
    mantissa, exponent = (int(part) for part in value.mid().man_exp())
    with mpmath.workdps(80):
        return mpmath.ldexp(mpmath.mpf(mantissa), exponent)


def main(names: list[str]) -> None:
    present = {(row["system"], row["start"]) for row in json.loads(FILE.read_text())}
    for name, problem in problems(names):
        if not names and (name, problem.start) in present:
            continue
        made = row_of(name, problem)
        kept = [
            row
            for row in json.loads(FILE.read_text())
            if (row["system"], row["start"]) != (name, problem.start)
        ]
        places = list(CATALOGUE)
        rows = sorted([*kept, made], key=lambda row: (places.index(row["system"]), row["start"]))
        FILE.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")


if __name__ == "__main__":
    main(sys.argv[1:])
