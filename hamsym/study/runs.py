"""Runs of a sweep: one solution each, with its files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hamsym.archive import load_solution
from hamsym.description import settings_text
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.methods import METHODS
from hamsym.networks.options import LevenbergMarquardtOptions
from hamsym.problem import InitialValueProblem
from hamsym.proof.certificate import Certificate
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.solving import checked_options, solve
from hamsym.support.atomic import write_atomically

if TYPE_CHECKING:
    from hamsym.networks.record import TrainingState

# Increased by changes of the methods after which existing runs are not reused.
_REVISION = 3
# Options that do not affect the solution, or that are handled separately.
_SEPARATE = frozenset({"checkpoint", "checkpoint_every", "regularizers", "initial"})


@dataclass(frozen=True)
class Run:
    """A picklable description of one run: a solution, and its proof if wanted."""

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
    #: Time limit of the proof, in seconds.
    certify: float | None
    #: The run's files without their endings.
    base: Path

    @property
    def file(self) -> Path:
        """File of the solution."""
        return self._beside(".hamsym")

    @property
    def _proof(self) -> Path:
        return self._beside(".certificate")

    @property
    def _refusal(self) -> Path:
        return self._beside(f".refused-{self.certify:g}s")

    @property
    def is_done(self) -> bool:
        """Whether all files of the run exist."""
        proof = self.certify is None or self._proof.exists() or self._refusal.exists()
        return self.file.exists() and proof

    def carry_out(self, progress: Callable[[TrainingState], None]) -> None:
        """Solve and prove, unless the files exist."""
        if not self.file.exists():
            self._solve(progress)
        if not self.is_done:
            try:
                proof = load_solution(self.file).certify(time_limit=self.certify, progress=False)
                write_atomically(self._proof, proof.to_json().encode())
            except CertificationError as error:
                write_atomically(self._refusal, str(error).encode())

    def certificate(self, solution: Solution) -> Certificate | str:
        """Return the certificate of a solution, or the reason for which there is none."""
        if self._proof.exists():
            proof = Certificate.from_json(self._proof.read_text(encoding="utf-8", errors="replace"))
            if proof.digest != digest(solution):
                raise FileError(
                    f"'{self._proof}' is the certificate of another solution; remove it"
                )
            return proof
        return self._refusal.read_text(encoding="utf-8", errors="replace")

    def _solve(self, progress: Callable[[TrainingState], None]) -> None:
        options = dict(self.options)
        checkpoint = self._beside(".checkpoint")
        if self.initial is not None:
            options["initial"] = load_solution(self.initial)
        if _has_checkpoints(options):
            options["checkpoint"] = checkpoint
        resumed = checkpoint.exists()

        def solved() -> Solution:
            return solve(self.H, self.z0, self.span, seed=self.seed, progress=progress, **options)

        try:
            solution = solved()
        except FileError:
            if not resumed:
                raise
            checkpoint.unlink()  # damaged, or of another version
            solution = solved()
        if getattr(solution.record, "stopped", "") == "interrupted":
            raise KeyboardInterrupt
        for proof in (self._proof, *self.base.parent.glob(f"{self.base.name}.refused-*")):
            proof.unlink(missing_ok=True)  # of an earlier solution, whose file was removed
        solution.save(self.file)
        checkpoint.unlink(missing_ok=True)

    def _beside(self, ending: str) -> Path:
        return self.base.with_name(self.base.name + ending)


def _has_checkpoints(options: Mapping[str, Any]) -> bool:
    """Return whether these options train one network, which can be resumed."""
    given = dict(options)
    method = METHODS[given.pop("method", "features")]
    if method.options is LevenbergMarquardtOptions:
        # A checkpoint is an option of joint training: with it no chain is trained.
        return bool(method.options(**given).joint)
    return not method.marches


def planned_run(
    problem: InitialValueProblem,
    name: str,
    options: dict[str, Any],
    seed: int,
    folder: Path,
    certify: float | None,
) -> Run:
    """Return the run of some settings with a seed, its files named after a digest of them all.

    Raise InputError if a setting is invalid.
    """
    for reserved in ("seed", "progress", "checkpoint"):
        if reserved in options:
            raise InputError(f"'{reserved}' in the settings {name!r} is set by sweep; remove it")
    if options.get("trial") is not None:
        raise InputError("trial cannot be serialised; call solve for each run")
    if options.get("regularizers"):
        raise InputError("regularizers cannot be serialised; call solve for each run")
    checked = checked_options(
        problem.H,
        options.get("method", "features"),
        {key: value for key, value in options.items() if key != "method"},
    )
    values = settings_text(problem.H, problem.z0, problem.span, seed, checked, without=_SEPARATE)
    initial = options.pop("initial", None)
    path = None
    if initial is not None:
        if not isinstance(initial, Solution):
            raise InputError(f"initial in the settings {name!r} is not a Solution; give one")
        values["initial"] = digest(initial)
        path = folder / f"initial-{values['initial'][:16]}.hamsym"
        if not path.exists():
            initial.save(path)
    values |= {
        "method": options.get("method", "features"),
        "torch": torch.__version__,
        "revision": str(_REVISION),
    }
    text = json.dumps(values, sort_keys=True)
    short = re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-")[:60]
    base = folder / f"{short}-{seed}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    label = f"{name}, seed {seed}"
    return Run(label, problem.H, problem.z0, problem.span, seed, options, path, certify, base)
