"""The suite's own cache folder, fixtures over the catalogue, and a report of slow cases."""

from __future__ import annotations

import gc
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# Compiled code is kept from one run to the next, beside what pytest keeps. Workers of xdist and all
# other processes that tests start inherit the folder.
os.environ.setdefault(
    "HAMSYM_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "hamsym")
)
from numba.core import event as numba_events

from hamsym.codegen.backends import BACKENDS, runnable
from hamsym.systems import CATALOGUE, Problem

#: Seconds of processor time beyond which a case that is not marked slow fails. Beside another
#: worker on the same core a case takes up to twice as many.
LIMIT = 6.0 if "PYTEST_XDIST_WORKER" in os.environ else 3.0
if "HAMSYM_NO_TIME_LIMIT" in os.environ:  # of mutations, which a slow case has not caught
    LIMIT = math.inf

_BEGAN, _SECONDS = pytest.StashKey[float](), pytest.StashKey[float]()


def pytest_configure(config: pytest.Config) -> None:
    """Let workers side by side use one thread each; otherwise they would wait for each other.

    They inherit the variable, which libraries read when they are imported.
    """
    # Nothing that collection makes is garbage, and to look for garbage among it takes seconds.
    gc.disable()
    if getattr(config.option, "numprocesses", None):
        os.environ.setdefault("OMP_NUM_THREADS", "1")


# One system of each form; tests/systems has the others.
_FEW = [
    *("charged_particle", "coupled_oscillators", "double_pendulum", "driven_oscillator"),
    *("harmonic_oscillator", "henon_heiles", "kepler", "morse_oscillator", "nonlinear_oscillator"),
    *("paul_trap", "pendulum", "spring_pendulum"),
]
_MORE = ["calogero_moser", "fermi_pasta_ulam_tsingou", "three_bodies", "toda_chain"]


@pytest.fixture(params=[*_FEW, *(pytest.param(name, marks=pytest.mark.slow) for name in _MORE)])
def problem(request: pytest.FixtureRequest) -> Problem:
    return CATALOGUE[request.param]()


@pytest.fixture(params=runnable())
def backend(request: pytest.FixtureRequest) -> str:
    if package := BACKENDS[request.param].package:
        # Not an extra of dev: it takes 400 MB.
        pytest.importorskip(package, reason=f"needs pip install 'hamsym[{package}]'")
    if request.param == "jax":
        import jax

        jax.config.update("jax_enable_x64", True)
    return request.param


# -- slow cases, and the time that each folder takes ----------------------------------------------


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 50)  # by default a twentieth of the time goes into looking for it


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    sampled: dict[tuple[str, str], list[pytest.Item]] = {}
    for item in items:
        mark = item.get_closest_marker("slow_cases")
        if mark is not None and item.callspec.id in mark.args:  # type: ignore[attr-defined]
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("sampled") and not item.get_closest_marker("slow"):
            test = item.originalname  # type: ignore[attr-defined]
            sampled.setdefault((str(item.path), test), []).append(item)
    for cases in sampled.values():
        (count,) = cases[0].get_closest_marker("sampled").args  # type: ignore[union-attr]
        kept = {i * len(cases) // count for i in range(count)}
        for i in {*range(len(cases))} - kept:
            cases[i].add_marker(pytest.mark.slow)


def _used() -> float:
    """Return the seconds of processor time of this process and of those that have ended in it."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class _Compiling(numba_events.Listener):
    """A clock that runs while numba compiles: whichever case comes first pays for all."""

    def __init__(self) -> None:
        self.seconds, self._depth, self._began = 0.0, 0, 0.0

    def on_start(self, event: numba_events.Event) -> None:
        if self._depth == 0:
            self._began = _used()
        self._depth += 1

    def on_end(self, event: numba_events.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += _used() - self._began


_COMPILING = _Compiling()
numba_events.register("numba:compiler_lock", _COMPILING)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[object]:
    item.stash[_BEGAN] = _used()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    began, compiled, imported = _used(), _COMPILING.seconds, "torch" in sys.modules
    try:
        return (yield)
    finally:
        own = _used() - began - (_COMPILING.seconds - compiled)
        # Whichever case comes first imports torch for all, which takes seconds.
        item.stash[_SECONDS] = own if imported or "torch" not in sys.modules else 0.0


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Iterator[pytest.TestReport]:
    report = yield
    if call.when == "call" and report.passed and not {"slow", "page"} & {*report.keywords}:
        seconds = item.stash[_SECONDS]
        if not seconds <= LIMIT:
            report.outcome = "failed"
            report.longrepr = (
                f"{item.nodeid} took {seconds:.1f} s of processor time; "
                f"make it faster than {LIMIT:g} s, or mark it slow"
            )
    if call.when == "teardown":
        report.user_properties.append(("cpu", _used() - item.stash[_BEGAN]))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the processor time of each folder, with fixtures and compilation."""
    rooms: dict[str, float] = {}
    for report in (r for found in terminalreporter.stats.values() for r in found):
        if getattr(report, "when", None) == "teardown":
            room = report.nodeid.split("::")[0].removeprefix("tests/").split("/")[0]
            rooms[room] = rooms.get(room, 0.0) + dict(report.user_properties).get("cpu", 0.0)
    terminalreporter.section(f"{sum(rooms.values()):.0f} CPU s, by folder")
    ordered = sorted(rooms.items(), key=lambda pair: -pair[1])
    terminalreporter.line(", ".join(f"{room} {seconds:.0f}" for room, seconds in ordered))
