"""One network by several packages: true error after the same time of training on one thread.

Two layers of 50 sines, 200 points, float64, and the start imposed exactly. neurodiffeq and DeepXDE
train with Adam at the rate of the paper for half of the time, and with L-BFGS for the other half.
The methods of hamsym have their default options. Adam with a decreasing rate needs its number of
epochs in advance: as many as fit, by a trial of 200.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import hamsym
from hamsym.solving.methods import made_method

from . import markdown
from .measuring import median
from .opponents import optional
from .problems import Case, henon_heiles
from .results import Section

_HIDDEN, _POINTS = (50, 50), 200
_RATE = 8e-3  # of Adam, as in the paper and in hamsym
_PAIRS = 100  # of L-BFGS, DeepXDE's default
_EPOCHS = 10**9  # more than fit into the time
_METHODS = ("adam", "lbfgs", "ssbroyden", "network-chain")


def measure(quick: bool) -> Section:
    limit, seeds = (3.0, 1) if quick else (15.0, 3)
    skipped: list[str] = []
    os.environ.setdefault("DDE_BACKEND", "pytorch")
    trainings: dict[str, Callable[[Case, float, int], _Trained]] = {
        f'hamsym, `"{method}"`': partial(_hamsym, method) for method in _METHODS
    }
    with _state_of_torch_kept():
        if optional("neurodiffeq", skipped):
            trainings["neurodiffeq, Adam and L-BFGS"] = _neurodiffeq
        with contextlib.redirect_stderr(io.StringIO()):  # DeepXDE names its backend
            deepxde = optional("deepxde", skipped)
        if deepxde:
            trainings["DeepXDE, Adam and L-BFGS"] = _deepxde
    rows = []
    end = hamsym.systems.henon_heiles().span[1]
    case = Case.of("Henon-Heiles, 6 pi", "henon_heiles", end, henon_heiles, 4_001)
    for method, train in trainings.items():
        for seed in range(seeds):
            with _state_of_torch_kept():
                row = train(case, limit, seed)
            rows.append({"method": method, "seed": seed, **row})
            print(f"{method}, seed {seed}: {row['error']:.1e}", flush=True)
    return {"limit": limit, "rows": rows, "skipped": skipped}


_Trained = dict[str, Any]  # error, seconds and iterations


@contextlib.contextmanager
def _state_of_torch_kept() -> Iterator[None]:
    """Train on one thread, in the precision and on the device that this process had before."""
    threads, dtype = torch.get_num_threads(), torch.get_default_dtype()
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_default_dtype(dtype)
        torch.set_default_device(None)  # neurodiffeq sets it


def _judged(case: Case, states: np.ndarray, seconds: float, iterations: int | None) -> _Trained:
    error = float(np.abs(states - case.truth).max())
    return {"error": error, "seconds": seconds, "iterations": iterations}


def _hamsym(method: str, case: Case, limit: float, seed: int) -> _Trained:
    def solve(**options: Any) -> Any:
        chosen = made_method(method, options)
        return hamsym.solve(case.H, case.z0, case.span, method=chosen, seed=seed, progress=False)

    options: dict[str, Any] = {"iterations": _EPOCHS}
    if method == "adam":
        epoch = solve(epochs=200).record.seconds / 200
        options = {"epochs": max(1, int(0.97 * limit / epoch))}
    elif method == "network-chain":
        options = {}
    solution = solve(time_limit=limit, **options)
    record = solution.record
    iterations = getattr(record, "iterations", None)
    return _judged(case, solution(case.t), record.seconds, iterations)


class _Clock:
    """Counts iterations of a training until its time is over."""

    def __init__(self, limit: float) -> None:
        self.began, self.limit, self.iterations = time.perf_counter(), limit, 0

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.began

    def is_over(self, share: float = 1.0) -> bool:
        return self.seconds > share * self.limit


def _lbfgs(parameters: Any) -> torch.optim.LBFGS:
    return torch.optim.LBFGS(
        parameters,
        max_iter=20,
        history_size=_PAIRS,
        line_search_fn="strong_wolfe",
        tolerance_grad=0,
        tolerance_change=0,
    )


# -- neurodiffeq -------------------------------------------------------------------------------


def _neurodiffeq(case: Case, limit: float, seed: int) -> _Trained:
    """Train with Adam for half of the time, then with L-BFGS on equally spaced points."""
    package, conditions, generators, networks, solvers = (
        importlib.import_module(f"neurodiffeq{part}")
        for part in ("", ".conditions", ".generators", ".networks", ".solvers")
    )
    package.utils.set_tensor_type(device="cpu", float_bits=64)
    torch.manual_seed(seed)
    start, end = case.span
    dim = len(case.z0)
    net = networks.FCNN(1, dim, hidden_units=_HIDDEN, actv=networks.SinActv)
    starts = [conditions.IVP(t_0=start, u_0=float(value)) for value in case.z0]
    for k, condition in enumerate(starts):
        condition.set_impose_on(k)  # one network with an output for each component

    def residual(*columns: Tensor) -> list[Tensor]:
        *z, t = columns
        rates = case.field(t, z)
        return [package.diff(x, t) - rate for x, rate in zip(z, rates, strict=True)]

    clock = _Clock(limit)
    phases: list[tuple[Any, str, float, int]] = [
        (torch.optim.Adam(net.parameters(), lr=_RATE), "equally-spaced-noisy", 0.5, 1),
        (_lbfgs(net.parameters()), "equally-spaced", 1.0, 20),
    ]
    for optimizer, spacing, share, steps in phases:
        solver = solvers.Solver1D(
            residual,
            starts,
            t_min=start,
            t_max=end,
            nets=[net] * dim,
            train_generator=generators.Generator1D(_POINTS, start, end, method=spacing),
            optimizer=optimizer,
            n_batches_valid=0,
        )

        def stop(running: Any, share: float = share, steps: int = steps) -> None:
            clock.iterations += steps
            running._stop_training = clock.is_over(share)

        solver.fit(_EPOCHS, callbacks=[stop], tqdm_file=None)
        if isinstance(optimizer, torch.optim.Adam):
            # The loss of L-BFGS is that before its step, and only ever falls.
            net.load_state_dict(solver.best_nets[0].state_dict())
    seconds = clock.seconds
    with torch.no_grad():
        t = torch.tensor(case.t)[:, None]
        states = torch.cat([condition.enforce(net, t) for condition in starts], dim=1).numpy()
    return _judged(case, states, seconds, clock.iterations)


# -- DeepXDE -----------------------------------------------------------------------------------


def _deepxde(case: Case, limit: float, seed: int) -> _Trained:
    """Train with Adam for half of the time, then with L-BFGS, on equally spaced points."""
    package = importlib.import_module("deepxde")
    package.config.set_default_float("float64")
    package.config.set_random_seed(seed)
    (start, end), z0, dim = case.span, torch.tensor(case.z0), len(case.z0)

    def residual(t: Tensor, z: Tensor) -> list[Tensor]:
        rates = case.field(t, [z[:, k : k + 1] for k in range(dim)])
        return [package.grad.jacobian(z, t, i=k, j=0) - rate for k, rate in enumerate(rates)]

    data = package.data.PDE(
        package.geometry.TimeDomain(start, end),
        residual,
        [],  # the transform of the output imposes the start
        num_domain=_POINTS,
        train_distribution="uniform",
    )
    net = package.nn.FNN([1, *_HIDDEN, dim], "sin", "Glorot uniform")
    net.apply_output_transform(lambda t, n: z0 + (1 - torch.exp(start - t)) * n)
    clock = _Clock(limit)

    class Stop(package.callbacks.Callback):  # type: ignore[misc, name-defined]
        def __init__(self, share: float) -> None:
            super().__init__()
            self.share = share

        def on_epoch_end(self) -> None:
            self.model.stop_training = clock.is_over(self.share)

    model = package.Model(data, net)
    package.optimizers.set_LBFGS_options(maxcor=_PAIRS, maxiter=_EPOCHS, gtol=0)
    steps = package.optimizers.config.LBFGS_options
    steps["iter_per_step"], steps["fun_per_step"] = 20, 25  # between two looks at the clock
    for optimizer, share in (("adam", 0.5), ("L-BFGS", 1.0)):
        model.compile(optimizer, lr=_RATE if optimizer == "adam" else None, verbose=0)
        count = None if optimizer == "L-BFGS" else _EPOCHS
        model.train(count, display_every=1_000, verbose=0, callbacks=[Stop(share)])
    seconds = clock.seconds
    return _judged(case, model.predict(case.t[:, None]), seconds, model.train_state.step)


def table(section: Section) -> str:
    rows = []
    for method in dict.fromkeys(row["method"] for row in section["rows"]):
        runs = [row for row in section["rows"] if row["method"] == method]
        errors = sorted(run["error"] for run in runs)
        counts = [run["iterations"] for run in runs]
        rows.append(
            [
                method,
                markdown.plain(median(errors)),
                f"{markdown.plain(errors[0])} to {markdown.plain(errors[-1])}",
                f"{median(run['seconds'] for run in runs):.1f}",
                "-" if None in counts else f"{median(counts):,.0f}",
            ]
        )
    head = ["method", "median error", "errors", "seconds", "iterations"]
    text = markdown.table(head, rows)
    count = len({run["seed"] for run in section["rows"]})
    text += (
        f"\n\nHenon-Heiles to 6 pi, {section['limit']:g} seconds of training on one thread, "
        f"{count} seed{'s' if count > 1 else ''}; true errors at 4,001 times."
    )
    return text + markdown.skipped(section["skipped"])
