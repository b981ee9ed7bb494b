"""Solutions, members, estimates and enclosures have the same bits on every x86-64 processor."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from hamsym.kernel.library import LEVEL_VARIABLE, supported_levels
from tests import older_processor

ROOT = Path(__file__).parents[2]
#: Of what the script below computes. It changes when the march or the proofs do, never with the
#: processor.
STORED = "ccfc78d80a6028f96c57909d58306ac9ee69a4041bb0f1529ca565415066ad9c"
SCRIPT = """
import hashlib
import numpy as np
import hamsym
from hamsym.systems import CATALOGUE

found = hashlib.sha256()
names = "henon_heiles pendulum kepler driven_oscillator double_pendulum morse_oscillator toda_chain"
for name in [*names.split(), "paul_trap", "calogero_moser", "nonlinear_oscillator"]:
    problem = CATALOGUE[name]()
    span = 0.0, min(7.0, problem.span[1])
    for tol in (1e-4, 1e-6, 1e-9, 1e-11):
        solution = hamsym.solve(problem.H, problem.z0, span, tol=tol)
        assert solution.success, (name, tol, solution.message)
        if solution.history.newton_windows:  # they are solved by LAPACK
            continue
        for array in (solution.history.edges, solution.history.states, solution.history.readouts):
            found.update(array.tobytes())
        for array in (solution.error.series, solution.error.floors, solution.error.largest):
            found.update(array.tobytes())
starts = np.array(CATALOGUE["henon_heiles"]().z0) * np.linspace(0.5, 1, 10)[:, None]
for member in hamsym.solve_many(CATALOGUE["henon_heiles"]().H, starts, (0, 20)):
    found.update(member.history.readouts.tobytes())
proofs = [("henon_heiles", 7.0), ("pendulum", 7.0), ("kepler", 7.0), ("driven_oscillator", 7.0)]
cases = [(CATALOGUE[name](), end) for name, end in proofs]
enclosures = [hamsym.enclose(problem.H, problem.z0, (0, end)) for problem, end in cases]
enclosures.append(hamsym.enclose("p**2/2 - cos(x)", ["1 +- 1e-4", 0], (0, 7)))  # wide sets
for enclosure in enclosures:
    for window in enclosure.windows:
        for name in "high low V G R beside derivative units J J_error".split():
            found.update(getattr(window, name).tobytes())
    found.update(enclosure(5.0).mid.tobytes() + enclosure(5.0).radius.tobytes())
    found.update(enclosure.derivative(5.0).radius.tobytes())
print(found.hexdigest())
"""


def _digest(settings: dict[str, str]) -> str:
    """Digest computed by another process with these environment variables."""
    run = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(
        run, env=os.environ | settings, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"),
    reason="the tables are rounded from the extended precision of x86-64",
)
@pytest.mark.parametrize("level", supported_levels())
@pytest.mark.parametrize(
    "libraries",
    [
        "of this processor",
        pytest.param("of an older one", marks=pytest.mark.slow),
        pytest.param("of many threads", marks=pytest.mark.slow),
    ],
)
def test_bits_are_those_of_every_processor(level: str, libraries: str) -> None:
    settings = {
        "of this processor": {},
        "of an older one": older_processor.settings(),
        "of many threads": {"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "4"},
    }
    assert _digest(settings[libraries] | {LEVEL_VARIABLE: level}) == STORED
