"""Runs of a sweep: one solution each, with its files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hamsym.archive import load_solution
from hamsym.errors import InputError, KeywordError
from hamsym.hamiltonian import Hamiltonian
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
from hamsym.support.suggestions import keyword_message
from hamsym.support.validation import plain

if TYPE_CHECKING:
    from hamsym.networks.record import TrainingState

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
