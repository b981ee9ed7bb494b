"""Runs of a sweep: one solution each, with its files, side by side in processes."""

from __future__ import annotations

import hashlib
import json
import math
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch

from hamsym.archive import load_solution
from hamsym.errors import HamsymError, InputError, KeywordError
from hamsym.hamiltonian import Hamiltonian
from hamsym.parallel.processes import ProcessEndedError, in_processes
from hamsym.problems.description import settings_text
from hamsym.problems.problem import (
    InitialValueProblem,
    checked_atol,
    checked_breakpoints,
    checked_tol,
)
from hamsym.solution.digest import digest
from hamsym.solution.settings import Settings
from hamsym.solution.solution import Solution
from hamsym.solving.methods import method_of, option_message
from hamsym.solving.solve import problem_of, solve
from hamsym.support.progress import share_progress
from hamsym.support.suggestions import keyword_message
from hamsym.support.validation import plain

if TYPE_CHECKING:
    from hamsym.networks.record import TrainingState

_REPORT_EVERY = 0.5  # seconds between two reports of a run
# Increased by changes of the methods after which existing runs are not reused.
_REVISION = 4
# Options that do not affect the solution, or that are handled separately.
_SEPARATE = frozenset({"regularizers", "initial"})
# Arguments of solve in settings, beside the method.
_ARGUMENTS = ("tol", "atol", "breakpoints", "prove", "invariants")


@dataclass(frozen=True)
class Run:
    """A picklable description of one run, whose outcome is a solution."""

    #: Name of the settings and seed, as shown.
    label: str
    #: H, z0, span, seed, options: Arguments of :func:`hamsym.solve`.
    H: Hamiltonian
    z0: np.ndarray
    span: tuple[float, float]
    seed: int
    options: Mapping[str, Any]
    #: File of the solution with the initial weights.
    initial: Path | None
    #: File of the solution.
    file: Path

    def carry_out(self, progress: Callable[[TrainingState], None]) -> None:
        """Solve, and write the file."""
        options = self._options()
        solution = solve(self.H, self.z0, self.span, seed=self.seed, progress=progress, **options)
        if getattr(solution.record, "stopped", "") == "interrupted":
            raise KeyboardInterrupt
        solution.save(self.file)

    def asked(self) -> Settings:
        """Return the settings that the solution of the run has."""
        options = self._options()
        method = options.pop("method")
        return Settings.of(
            problem_of(self.H, self.z0, self.span, method, self.seed, **options), method
        )

    def _options(self) -> dict[str, Any]:
        """Return the options, with the initial weights."""
        options = dict(self.options)
        if self.initial is not None:
            options["method"] = replace(options["method"], initial=load_solution(self.initial))
        return options


def arguments_of(given: Any, where: str = "the settings") -> dict[str, Any]:
    """Return settings as arguments of solve with a method object.

    Raise InputError if there is no such argument or method.

    Examples
    --------
    >>> arguments_of("adam"), arguments_of({"tol": 1e-6})
    ({'method': Adam()}, {'tol': 1e-06, 'method': Features()})
    """
    found = dict(given) if isinstance(given, Mapping) else {"method": given}
    method = found.pop("method", "features")
    for name, value in found.items():
        if name in ("seed", "progress"):
            raise InputError(f"'{name}' in {where} is set by sweep; remove it")
        if name not in _ARGUMENTS:
            known = ("method", *_ARGUMENTS)
            message = option_message(name, value, method, known) or keyword_message(
                name, "solve", known
            )
            raise KeywordError(message)
    return {**found, "method": method_of(method)}


def planned_run(
    problem: InitialValueProblem, name: str, given: Any, seed: int, folder: Path
) -> Run:
    """Return the run of some settings with a seed, its files named after a digest of them all.

    Raise InputError if a setting is invalid.
    """
    options = arguments_of(given, f"the settings {name!r}")
    if options.get("tol") is not None:
        checked_tol(options["tol"])
    checked_atol(options.get("atol", 0.0), problem.H.dim)
    checked_breakpoints(options.get("breakpoints", ()), problem.span)
    method = options["method"]
    if method.joint and (method.trial is not None or method.regularizers):
        which = "regularizers" if method.regularizers else "trial"
        raise InputError(f"{which} cannot be serialised; call solve for each run")
    values = settings_text(problem.H, problem.z0, problem.span, seed, method, without=_SEPARATE)
    path = None
    if method.joint and method.initial is not None:
        initial = method.initial
        if not isinstance(initial, Solution):
            raise InputError(f"initial in the settings {name!r} is not a Solution; give one")
        values["initial"] = digest(initial)
        path = folder / f"initial-{values['initial'][:16]}.hamsym"
        if not path.exists():
            initial.save(path)
        options["method"] = replace(method, initial=None)
    values |= {option: repr(plain(options[option])) for option in _ARGUMENTS if option in options}
    values |= {
        "method": method.name,
        "torch": torch.__version__,
        "revision": str(_REVISION),
    }
    text = json.dumps(values, sort_keys=True)
    short = re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-")[:60]
    file = folder / f"{short}-{seed}-{hashlib.sha256(text.encode()).hexdigest()[:12]}.hamsym"
    label = f"{name}, seed {seed}"
    return Run(label, problem.H, problem.z0, problem.span, seed, options, path, file)


# -- processes -------------------------------------------------------------------------------------

# Label of a run, share of its iterations, best loss.
_Report: TypeAlias = tuple[str, float, float]


class Board:
    """The shares of the runs that go on, and the run that reported last, drawn as a bar.

    - total: Number of runs.
    - draw: (share of all runs, note) -> None.
    """

    def __init__(self, total: int, draw: Callable[[float, str], None]) -> None:
        self._total, self._draw = total, draw
        self._shares, self._finished = dict[str, float](), set[str]()
        self._lock = threading.Lock()  # several threads report

    def put(self, item: _Report) -> None:
        """Show the report of a run."""
        label, share, loss = item
        if label not in self._finished:  # else the report was delayed
            self._show(label, share, f"{label}: loss {loss:.1e}")

    def ended(self, label: str) -> None:
        """Count a run that has ended."""
        self._finished.add(label)
        self._show(label, 1.0, f"{len(self._finished)} of {self._total} runs")

    def _show(self, label: str, share: float, note: str) -> None:
        with self._lock:
            self._shares[label] = share
            self._draw(sum(self._shares.values()) / self._total, note)


def carry_out(runs: Sequence[Run], workers: int, progress: bool | None) -> None:
    """Carry out runs in this process or in several.

    Raise HamsymError if a run fails in another process, or its process ended.

    - workers: Processes; 1 for this process.
    - progress: As of :func:`hamsym.support.progress.stepping_progress`.
    """
    with share_progress(progress, "sweep") as draw:
        board = Board(len(runs), draw)
        with closing(in_processes(_reporting, runs, workers, board.put)) as done:
            try:
                for run, _ in done:
                    board.ended(run.label)
            except ProcessEndedError:
                raise HamsymError(
                    "a process ended before its run: give fewer workers if memory was short; "
                    "finished runs are kept"
                ) from None


def _reporting(run: Run, report: Callable[[_Report], None]) -> None:
    """Carry out a run, with regular reports of its progress."""
    reported = -math.inf

    def tell(state: TrainingState) -> None:
        nonlocal reported
        if time.monotonic() - reported > _REPORT_EVERY:
            reported = time.monotonic()
            report((run.label, state.iteration / state.iterations, state.best_loss))

    run.carry_out(tell)
