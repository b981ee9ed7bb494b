"""Print the audit as a table: ``python -m tests.audit.table [name or class ...]``.

Errors are in units of the allowed error; the defects of a solve are listed below its line.
"""

from __future__ import annotations

import sys

from .judging import complaints, judged
from .systems import SYSTEMS


def main(wanted: list[str]) -> int:
    print(f"{'system':30s} {'tol':>7s} success estimate round-off     true  seconds", flush=True)
    wrong = solves = successes = 0
    for system in SYSTEMS:
        if wanted and not {system.name, system.kind} & set(wanted):
            continue
        for tol in system.tols:
            verdict = judged(system, tol)
            found = complaints(system, tol, verdict)
            solves, successes = solves + 1, successes + verdict.success
            wrong += bool(found)
            print(
                f"{system.name:30s} {tol:7.0e} {verdict.success!s:7s} {verdict.estimate:8.1e} "
                f"{verdict.floor:9.1e} {verdict.truth:8.1e} {verdict.seconds:8.2f}"
            )
            for complaint in found:
                print(f"    {complaint}")
            sys.stdout.flush()
    print(f"{solves} solves, {successes} successes, {wrong} with complaints")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
