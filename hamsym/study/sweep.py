"""Many solutions of one problem side by side: settings by name, several seeds, all cores.

Every run is one file in a folder, named after what it is and a digest of all that it depends on.
What is there is not run again, and what was stopped halfway goes on from its checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import multiprocessing.connection
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from hamsym.archive import load
from hamsym.errors import CertificationError, FileError, HamsymError, InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.problem import InitialValueProblem
from hamsym.proof.certificate import Certificate
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.solving import checked_options, solve
from hamsym.study.compare import Row, measure
from hamsym.support.atomic import write_atomically
from hamsym.support.locking import exclusive
from hamsym.support.validation import plain, require_positive, require_whole

if TYPE_CHECKING:  # torch is slow to import
    from hamsym.networks.record import TrainingState

__all__ = ["Sweep", "sweep"]

#: Settings of a run: options of :func:`hamsym.solve`, or a function that gives them for a seed.
Settings = Mapping[str, Any] | Callable[[int], Mapping[str, Any]]

_REPORT_EVERY = 0.5  # seconds between what a run says of itself
_REVISION = 2  # counts changes of the methods after which runs on disk are no longer theirs
# What the weights do not depend on, or what is taken account of apart.
_APART = {"checkpoint", "checkpoint_every", "regularizers", "initial"}


@dataclass(frozen=True)
class Sweep:
    """Solutions of one problem by settings and seed.

    Attributes
    ----------
    seeds : tuple of int
    span : (float, float)
        As asked for; a march that broke off spans less.
    solutions : mapping
        Name of the settings -> one :class:`Solution` for each seed.
    certificates : mapping
        Name of the settings -> for each seed a :class:`Certificate`, or why there is none, in
        words. Empty if none were asked for.
    """

    seeds: tuple[int, ...]
    span: tuple[float, float]
    solutions: Mapping[str, tuple[Solution, ...]]
    certificates: Mapping[str, tuple[Certificate | str, ...]] = field(default_factory=dict)

    def rows(self, truth: Callable[[np.ndarray], np.ndarray]) -> dict[str, tuple[Row, ...]]:
        """Errors of every solution; infinite where one does not reach the end of the span.

        Parameters
        ----------
        truth : callable
            The exact solution or a reference, t -> states, shape (len(t), dim).
        """
        return {
            name: tuple(self._row(solution, truth, name) for solution in found)
            for name, found in self.solutions.items()
        }

    def median(self, name: str, truth: Callable[[np.ndarray], np.ndarray]) -> Solution:
        """Of the solutions with these settings that with the median error.

        Of an even number that with the lower of the two in the middle.
        """
        errors = [self._row(solution, truth, name).error for solution in self.solutions[name]]
        order = sorted(range(len(errors)), key=errors.__getitem__)
        return self.solutions[name][order[(len(order) - 1) // 2]]

    def _row(self, solution: Solution, truth: Callable[[np.ndarray], np.ndarray], name: str) -> Row:
        row = measure(solution, truth, name)
        if solution.span != self.span:
            row = replace(row, error=math.inf, energy_error=math.inf)
        return row


def sweep(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    settings: Mapping[str, Settings],
    *,
    folder: str | os.PathLike[str],
    seeds: int | Sequence[int] = 3,
    certify: float | None = None,
    workers: int | None = None,
    progress: bool | None = None,
) -> Sweep:
    """Solve one problem with several settings and seeds, in processes side by side.

    Parameters
    ----------
    H, z0, span
        As in :func:`hamsym.solve`.
    settings : mapping
        Name -> options of :func:`hamsym.solve`, or a function that gives them for a seed.
    folder : path
        Where each run is kept; made if it is not there. Runs that are there, with the same
        settings, are read and not run again; those that were stopped go on. While runs are
        carried out no other process may carry out runs in it.
    seeds : int or sequence of int
        How many, from 0, or which.
    certify : float, optional
        Prove the error of each solution too, in at most so many seconds.
    workers : int, optional
        Processes; by default as many as there are cores. Each trains on one thread. With 1 all
        is done in this process.
    progress : bool, optional
        By default a bar is drawn on standard error where that is a terminal; True says there,
        if it is not a terminal, when each run has ended.

    Returns
    -------
    Sweep

    Raises
    ------
    InputError
        If a setting cannot be used.
    FileError
        If the folder cannot be written, or another process carries out runs in it.

    Notes
    -----
    A process begins by importing the main script anew: guard what it does with
    ``if __name__ == "__main__":``.

    Examples
    --------
    >>> import tempfile
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> settings = {"1e-6": {"tol": 1e-6}, "1e-9": {"tol": 1e-9}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found = sweep(H, [1, 0], (0, 6), settings, folder=folder, seeds=2, workers=1)
    >>> [solution.success for solution in found.solutions["1e-9"]]
    [True, True]
    >>> exact = lambda t: np.column_stack((np.cos(t), -np.sin(t)))
    >>> all(row.error < 1e-6 for row in found.rows(exact)["1e-6"])
    True
    """
    chosen = tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)
    for seed in chosen:
        require_whole("seeds", seed, 0)
    if not settings or not chosen or len(set(chosen)) < len(chosen):
        raise InputError("settings or seeds is empty or repeats one; name each once")
    if workers is not None:
        require_whole("workers", workers)
    if certify is not None:
        require_positive("certify", certify)
    try:
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
    except (OSError, TypeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"'{folder}' cannot be made: {reason}") from None
    problem = InitialValueProblem.checked(H, z0, span, 0, None)
    runs = [
        _run(problem, name, dict(given(seed) if callable(given) else given), seed, place, certify)
        for name, given in settings.items()
        for seed in chosen
    ]
    missing = [run for run in runs if not run.is_done]
    if missing:
        with exclusive(place):
            _carry_out(missing, min(workers or _cores(), len(missing)), progress)
    groups = [runs[k : k + len(chosen)] for k in range(0, len(runs), len(chosen))]
    named = dict(zip(settings, groups, strict=True))
    solutions = {name: tuple(load(run.file) for run in group) for name, group in named.items()}
    certificates = {
        name: tuple(
            run.certificate(solution) for run, solution in zip(group, solutions[name], strict=True)
        )
        for name, group in named.items()
        if certify is not None
    }
    return Sweep(chosen, problem.span, solutions, certificates)


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class _Run:
    """One solution that is wanted, complete enough to be made in another process."""

    label: str
    H: Hamiltonian
    z0: np.ndarray
    span: tuple[float, float]
    seed: int
    options: Mapping[str, Any]
    initial: Path | None
    certify: float | None
    base: Path

    @property
    def file(self) -> Path:
        return self._beside(".hamsym")

    @property
    def _proof(self) -> Path:
        return self._beside(".certificate")

    @property
    def _refusal(self) -> Path:
        return self._beside(f".refused-{self.certify:g}s")

    @property
    def is_done(self) -> bool:
        proof = self.certify is None or self._proof.exists() or self._refusal.exists()
        return self.file.exists() and proof

    def carry_out(self, progress: Callable[[TrainingState], None]) -> None:
        if not self.file.exists():
            self._solve(progress)
        if not self.is_done:
            try:
                proof = load(self.file).certify(time_limit=self.certify, progress=False)
                write_atomically(self._proof, proof.to_json().encode())
            except CertificationError as error:
                write_atomically(self._refusal, str(error).encode())

    def certificate(self, solution: Solution) -> Certificate | str:
        if self._proof.exists():
            proof = Certificate.from_json(self._proof.read_text(encoding="utf-8", errors="replace"))
            if proof.digest != digest(solution):
                raise FileError(f"'{self._proof}' is the proof of another solution; remove it")
            return proof
        return self._refusal.read_text(encoding="utf-8", errors="replace")

    def _solve(self, progress: Callable[[TrainingState], None]) -> None:
        options = dict(self.options)
        checkpoint = self._beside(".checkpoint")
        if options.get("method", "features") != "features":
            options["checkpoint"] = checkpoint
        if self.initial is not None:
            options["initial"] = load(self.initial)
        begun = checkpoint.exists()

        def solved() -> Solution:
            return solve(self.H, self.z0, self.span, seed=self.seed, progress=progress, **options)

        try:
            solution = solved()
        except FileError:
            if not begun:
                raise
            checkpoint.unlink()  # damaged, or of another version: there is no going on from it
            solution = solved()
        if getattr(solution.record, "stopped", "") == "interrupted":
            raise KeyboardInterrupt
        for proof in (self._proof, *self.base.parent.glob(f"{self.base.name}.refused-*")):
            proof.unlink(missing_ok=True)  # of another solution, whose file is gone
        solution.save(self.file)
        checkpoint.unlink(missing_ok=True)

    def _beside(self, ending: str) -> Path:
        return self.base.with_name(self.base.name + ending)


def _run(
    problem: InitialValueProblem,
    name: str,
    options: dict[str, Any],
    seed: int,
    folder: Path,
    certify: float | None,
) -> _Run:
    for taken in ("seed", "progress", "checkpoint"):
        if taken in options:
            raise InputError(f"'{taken}' in the settings {name!r} is what sweep itself gives")
    if options.get("regularizers"):
        raise InputError("regularizers are functions, which no file can hold; solve one by one")
    checked = checked_options(
        problem.H,
        options.get("method", "features"),
        {key: value for key, value in options.items() if key != "method"},
    )
    known = {
        entry.name: repr(plain(getattr(checked, entry.name)))
        for entry in fields(checked)
        if entry.name not in _APART
    }
    initial = options.pop("initial", None)
    path = None
    if initial is not None:
        if not isinstance(initial, Solution):
            raise InputError(f"initial in the settings {name!r} is not a Solution; give one")
        known["initial"] = digest(initial)
        path = folder / f"initial-{known['initial'][:16]}.hamsym"
        if not path.exists():
            initial.save(path)
    known |= {
        "H": repr((problem.H.formula, problem.H.names, sorted(problem.H.parameters.items()))),
        "z0": repr(problem.z0.tolist()),
        "span": repr(problem.span),
        "seed": repr(seed),
        "method": options.get("method", "features"),
        "torch": torch.__version__,
        "revision": str(_REVISION),
    }
    text = json.dumps(known, sort_keys=True)
    short = re.sub(r"[^a-z0-9.]+", "-", name.lower()).strip("-")[:60]
    base = folder / f"{short}-{seed}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    label = f"{name}, seed {seed}"
    return _Run(label, problem.H, problem.z0, problem.span, seed, options, path, certify, base)


# -- side by side --------------------------------------------------------------------------------


class _Queue(Protocol):
    def put(self, item: tuple[str, float, float]) -> None: ...


def _carry_out(runs: Sequence[_Run], workers: int, progress: bool | None) -> None:
    with _board(runs, progress) as board:
        if workers == 1:
            threads = torch.get_num_threads()
            torch.set_num_threads(1)
            try:
                for run in runs:
                    _reporting(run, board)
                    board.ended(run.label)
            finally:
                torch.set_num_threads(threads)
            return
        context = multiprocessing.get_context("spawn")
        queue: Any = context.Queue()
        pool = ProcessPoolExecutor(workers, context, initializer=_prepare, initargs=(queue,))
        try:
            with _interrupts_held():
                waiting = {pool.submit(_in_process, run): run for run in runs}
            while waiting:
                done = [future for future in waiting if future.done()]
                for future in done:
                    run = waiting.pop(future)
                    future.result()
                    board.ended(run.label)
                while not queue.empty():
                    board.put(queue.get())
                if not done:
                    time.sleep(0.1)
        except BrokenProcessPool:
            raise HamsymError(
                "a process ended before its run did: for want of memory (give fewer workers), or "
                "because the script that calls sweep is not guarded by "
                "if __name__ == '__main__'; what was done is kept"
            ) from None
        except BaseException:
            # What a run has done is in its checkpoint.
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C waits: a process begun here never hears of it, not even while it imports."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_queue: _Queue | None = None


def _prepare(queue: _Queue) -> None:
    """In a new process: one thread, and Ctrl-C is for the parent to answer."""
    global _queue
    _queue = queue
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that was killed could not say so, and nobody would wait for the run."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _in_process(run: _Run) -> None:
    assert _queue is not None
    _reporting(run, _queue)


def _reporting(run: _Run, queue: _Queue) -> None:
    told = -math.inf

    def report(state: TrainingState) -> None:
        nonlocal told
        if time.monotonic() - told > _REPORT_EVERY:
            told = time.monotonic()
            queue.put((run.label, state.iteration / state.iterations, state.best_loss))

    run.carry_out(report)


class _Silent:
    """How far the runs are, told to nobody."""

    def __init__(self, total: int) -> None:
        self.total, self.count = total, 0

    def put(self, item: tuple[str, float, float]) -> None:
        """Take what a run says of itself."""

    def ended(self, label: str) -> None:
        """Take that a run has ended."""
        self.count += 1


class _Lines(_Silent):
    def __init__(self, total: int) -> None:
        super().__init__(total)
        self.began = time.monotonic()

    def ended(self, label: str) -> None:
        super().ended(label)
        minutes = (time.monotonic() - self.began) / 60
        line = f"{self.count}/{self.total} after {minutes:.1f} min: {label}"
        print(line, file=sys.stderr, flush=True)


class _Bar(_Silent):
    def __init__(self, total: int, progress: Progress) -> None:
        super().__init__(total)
        self.progress, self.shares, self.over = progress, dict[str, float](), set[str]()
        self.task = progress.add_task("", total=total, of=total, ended=0, now="")

    def put(self, item: tuple[str, float, float]) -> None:
        label, share, loss = item
        if label in self.over:  # it took its time in the queue
            return
        self.shares[label] = share
        self.draw(f"{label}: loss {loss:.1e}")

    def ended(self, label: str) -> None:
        super().ended(label)
        self.shares.pop(label, None)
        self.over.add(label)
        self.draw("")

    def draw(self, now: str) -> None:
        completed = self.count + sum(self.shares.values())
        self.progress.update(self.task, completed=completed, ended=self.count, now=now)


@contextmanager
def _board(runs: Sequence[_Run], show: bool | None) -> Iterator[_Silent]:
    console = Console(stderr=True)
    if console.is_terminal and show is not False:
        columns = (
            TextColumn("{task.fields[ended]} of {task.fields[of]} runs"),
            BarColumn(bar_width=16),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            TextColumn("{task.fields[now]}"),
        )
        with Progress(*columns, console=console, transient=True) as progress:
            yield _Bar(len(runs), progress)
    else:
        yield _Lines(len(runs)) if show else _Silent(len(runs))
