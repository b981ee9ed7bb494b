"""The suite's own cache folder, fixtures over the catalogue, and a report of slow cases."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator

import pytest

# Workers of xdist and all other processes that tests start inherit both. A folder that is given
# from outside may be kept from one run to the next.
if "HAMSYM_CACHE_DIR" not in os.environ:
    os.environ["HAMSYM_CACHE_DIR"] = tempfile.mkdtemp(prefix="hamsym-tests-")
    atexit.register(shutil.rmtree, os.environ["HAMSYM_CACHE_DIR"], ignore_errors=True)
# Workers side by side, each with as many threads as there are cores, would wait for each other.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

from hamsym.codegen.backends import BACKENDS, runnable
from hamsym.systems import CATALOGUE, Problem

#: Seconds of processor time beyond which a case is to be marked slow.
LIMIT = 2.5

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


# -- slow cases ------------------------------------------------------------------------------------


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        mark = item.get_closest_marker("slow_cases")
        if mark is not None and item.callspec.id in mark.args:  # type: ignore[attr-defined]
            item.add_marker(pytest.mark.slow)


def _used() -> float:
    """Seconds of processor time of this process and of those that have ended in it."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    began = _used()
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu", _used() - began))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    found = {
        report.nodeid: seconds
        for outcome in ("passed", "failed")
        for report in terminalreporter.getreports(outcome)
        if report.when == "call" and "slow" not in report.keywords
        for name, seconds in report.user_properties
        if name == "cpu" and not seconds <= LIMIT
    }
    if found:
        terminalreporter.section(f"more than {LIMIT:g} CPU s, not marked slow", yellow=True)
        for nodeid, seconds in sorted(found.items(), key=lambda pair: -pair[1]):
            terminalreporter.line(f"{seconds:6.1f} s  {nodeid}")
