"""Sweeps: solutions of one problem with several settings and seeds, in parallel.

Each run is one file in a folder, with a name that contains a digest of all its settings. Existing
runs are reused.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.archive import load_solution
from hamsym.errors import FileError, InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.problems.problem import InitialValueProblem
from hamsym.solution.solution import Solution
from hamsym.study.compare import Row, measure
from hamsym.study.references import ReferenceSolution
from hamsym.study.runs import Run, arguments_of, carry_out, planned_run
from hamsym.support.locking import exclusive
from hamsym.support.machine import available_cores
from hamsym.support.method_object import Method
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import checked_keywords, require_known, suggest_attributes
from hamsym.support.tables import data_frame
from hamsym.support.tensor_files import one_line
from hamsym.support.validation import checked_mapping, plain, require, require_whole

if TYPE_CHECKING:  # an optional package
    import pandas

#: Options of :func:`hamsym.solve`, or a function from a seed to options.
Settings = Mapping[str, Any] | str | Method | Callable[[int], Any]


@suggest_attributes
@dataclass(frozen=True)
class Sweep(Drawn, Shown):
    """Solutions of one problem by settings and seed.

    ``plot()`` draws errors and times of all runs over the options in which the settings differ,
    ``plot("error")`` or ``plot("time")`` one of these panels. One option is the axis, a second one
    makes a series of each of its values. Where more differ, or none is a number, the settings are
    drawn by name. Failed runs are red.

    Attributes
    ----------
    seeds : tuple of int
    span : (float, float)
        The span requested; the solution of a march that stopped early has a shorter one.
    solutions : mapping
        Name of the settings -> one :class:`Solution` for each seed.
    settings : mapping
        Name of the settings -> values of all options that any settings give, defaults where these
        do not give them, None where their method has no such option. Of a function of the seed
        they are those of the first seed.
    """

    seeds: tuple[int, ...]
    span: tuple[float, float]
    solutions: Mapping[str, tuple[Solution, ...]]
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        solved = {name: sum(s.success for s in found) for name, found in self.solutions.items()}
        listed = ", ".join(f"{n}: {k} of {len(self.seeds)} succeeded" for n, k in solved.items())
        return f"Sweep({len(self.seeds)} seeds; {listed})"

    @property
    def H(self) -> Hamiltonian:
        """The Hamiltonian."""
        return self._runs[0].H

    @property
    def z0(self) -> np.ndarray:
        """The initial state, shape (dim,)."""
        return self._runs[0].z0

    @property
    def success(self) -> bool:
        """Whether every run is what was asked for."""
        return all(bool(solution.success) for solution in self._runs)

    @property
    def message(self) -> str:
        """How many runs failed, with the reason of the first; "" if none did."""
        failed = [solution for solution in self._runs if not solution.success]
        if not failed:
            return ""
        count = f"{len(failed):,} of {len(self._runs):,} runs failed"
        return f"{count}, for example: {failed[0].message}"

    @property
    def seconds(self) -> float:
        """Time of all runs."""
        return sum(solution.seconds for solution in self._runs)

    @property
    def _runs(self) -> list[Solution]:
        return [solution for found in self.solutions.values() for solution in found]

    @property
    def swept(self) -> dict[str, tuple[Any, ...]]:
        """Options in which the settings differ, each with its value in each of the settings.

        Examples
        --------
        >>> import tempfile
        >>> given = {"coarse": {"tol": 1e-4}, "fine": {"tol": 1e-8}, "as usual": {}}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     found = sweep("p**2/2 + x**2/2", [1, 0], (0, 1), given, folder=folder, workers=1)
        >>> found.swept
        {'tol': (0.0001, 1e-08, 1e-09)}
        """
        options = list(self.settings.values())
        values = {
            name: tuple(given[name] for given in options)
            for name in (options[0] if options else ())
        }
        return {
            name: found
            for name, found in values.items()
            if len({repr(plain(value)) for value in found}) > 1
        }

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a table of pandas with a row for each run.

        Columns are ``settings``, the options of :attr:`swept`, ``seed``, ``success``,
        ``error`` (:attr:`hamsym.Solution.relative_error`), ``seconds`` and ``message``.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        settings = {"settings": tuple(self.solutions), **self.swept}
        columns: dict[str, Any] = {
            name: [value for value in values for _ in self.seeds]
            for name, values in settings.items()
        }
        columns |= {
            "seed": [*self.seeds] * len(self.solutions),
            "success": [bool(solution.success) for solution in self._runs],
            "error": [solution.relative_error for solution in self._runs],
            "seconds": [solution.record.seconds for solution in self._runs],
            "message": [solution.message for solution in self._runs],
        }
        return data_frame(columns)

    def rows(self, truth: Callable[[np.ndarray], np.ndarray]) -> dict[str, tuple[Row, ...]]:
        """Return the errors of all solutions; infinite for one that does not reach the end.

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
        """Return the solution with the median error among those with these settings.

        Of an even number, the lower of the two medians is taken.
        """
        require_known(name, self.solutions, "a name of settings")
        errors = [self._row(solution, truth, name).error for solution in self.solutions[name]]
        order = sorted(range(len(errors)), key=errors.__getitem__)
        return self.solutions[name][order[(len(order) - 1) // 2]]

    def _row(self, solution: Solution, truth: Callable[[np.ndarray], np.ndarray], name: str) -> Row:
        row = measure(solution, ReferenceSolution.exact(truth), name)
        if solution.span != self.span:
            row = replace(row, error=math.inf, energy_error=math.inf)
        return row


@checked_keywords
def sweep(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    settings: Mapping[str, Settings],
    *,
    folder: str | os.PathLike[str],
    seeds: int | Sequence[int] = 3,
    workers: int | None = None,
    progress: bool | None = None,
) -> Sweep:
    """Solve one problem with several settings and seeds.

    Parameters
    ----------
    H, z0, span
        As in :func:`hamsym.solve`.
    settings : mapping
        Name -> arguments of :func:`hamsym.solve`, e.g. ``{"tol": 1e-6}``; or a method alone, e.g.
        ``hamsym.Adam(epochs=5_000)``; or a function from a seed to one of them.
    folder : path
        Directory with the files of all runs; created if it does not exist. Existing runs with
        the same settings are reused. It is locked against other processes while runs are carried
        out.
    seeds : int or sequence of int
        Number of seeds, counted from 0, or the seeds.
    workers : int, optional
        Number of processes, by default the number of cores; each uses one thread.
        With 1 all runs are carried out in this process.
    progress : bool, optional
        By default a bar is drawn if standard error is a terminal. True prints a line every ten
        seconds if it is not a terminal.

    Returns
    -------
    Sweep

    Raises
    ------
    InputError
        If a setting is invalid.
    FileError
        If the folder cannot be written, or is locked by another process.

    Examples
    --------
    >>> import hamsym, tempfile
    >>> H = hamsym.Hamiltonian("p**2/2 + x**2/2")
    >>> settings = {"1e-6": {"tol": 1e-6}, "1e-9": {"tol": 1e-9}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found = sweep(H, [1, 0], (0, 6), settings, folder=folder, seeds=2, workers=1)
    >>> [solution.success for solution in found.solutions["1e-9"]]
    [True, True]
    >>> exact = lambda t: np.column_stack((np.cos(t), -np.sin(t)))
    >>> all(row.error < 1e-6 for row in found.rows(exact)["1e-6"])
    True
    """
    if not isinstance(seeds, Iterable):
        require_whole("seeds", seeds, 1, 100_000)
    chosen = tuple(seeds if isinstance(seeds, Iterable) else range(seeds))
    for seed in chosen:
        require_whole("seeds", seed, 0)
    names = [*checked_mapping("settings", settings, '{"1e-6": {"tol": 1e-6}}')]
    require(all(isinstance(name, str) for name in names), "settings", names, "names as text")
    if not names or not chosen or len(set(chosen)) < len(chosen):
        raise InputError("settings or seeds is empty or repeats an entry; give each once")
    if workers is not None:
        require_whole("workers", workers)
    try:
        directory = Path(folder)
        directory.mkdir(parents=True, exist_ok=True)
    except (OSError, TypeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"'{folder}' cannot be created: {reason}") from None
    problem = InitialValueProblem.checked(H, z0, span)
    runs = [
        planned_run(problem, name, _of_seed(given, seed), seed, directory)
        for name, given in settings.items()
        for seed in chosen
    ]
    missing = [run for run in runs if not run.file.exists()]
    if missing:
        with exclusive(directory):
            carry_out(missing, min(workers or available_cores(), len(missing)), progress)
    groups = [runs[k : k + len(chosen)] for k in range(0, len(runs), len(chosen))]
    named = dict(zip(settings, groups, strict=True))
    solutions = {name: tuple(map(_loaded, group)) for name, group in named.items()}
    return Sweep(chosen, problem.span, solutions, _values(settings, chosen[0]))


def _loaded(run: Run) -> Solution:
    """Load the solution of a run; one of another problem or with other settings is refused."""
    found, asked = load_solution(run.file), run.asked()
    if (found.H, found.z0.tolist()) != (run.H, run.z0.tolist()):
        raise FileError(f"'{run.file}' has the solution of another problem; remove it")
    # A file of another version is that of a run if the methods are of one revision.
    asked = replace(asked, version=found.settings.version)
    if (found.method, found.settings) != (run.options["method"].name, asked):
        raise FileError(f"'{run.file}' has a solution with other settings; remove it")
    return found


def _values(settings: Mapping[str, Settings], seed: int) -> dict[str, dict[str, Any]]:
    """Return the values of the options that any settings give, for each of the settings."""
    every: dict[str, dict[str, Any]] = {}
    given: dict[str, None] = {}
    for name, entry in settings.items():
        arguments = arguments_of(_of_seed(entry, seed))
        method = arguments.pop("method")
        given |= dict.fromkeys(["method", *arguments, *method.given])
        asked = {"tol": method.usual_tol, "method": method.name, **arguments}
        every[name] = vars(method) | asked
    names = [name for name in given if name != "initial"]
    return {name: {n: values.get(n) for n in names} for name, values in every.items()}


def _of_seed(given: Any, seed: int) -> Any:
    if not callable(given) or isinstance(given, type):
        return given
    try:
        return given(seed)
    except Exception as error:  # whatever the user's own code raises
        raise InputError(
            f"the settings of seed {seed} cannot be made: {one_line(error)}; mend their function"
        ) from error
