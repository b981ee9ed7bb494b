"""The settings of ``make test-portable``: libraries that start with them run other code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba.core.registry import cpu_target

from tests.older_processor import settings

# What libraries say of themselves, and of the processor for which numba keeps compiled code.
_REPORT = """
import ctypes, json, pathlib
import torch
from numba.core.registry import cpu_target
from tests.older_processor import dispatched
extensions = dispatched()
import scipy.linalg
cores = {}
maps = pathlib.Path("/proc/self/maps")
for line in maps.read_text().splitlines() if maps.exists() else ():
    path = line.split()[-1]
    for name in ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename"):
        if "openblas" in path and (get := getattr(ctypes.CDLL(path), name, None)):
            get.restype = ctypes.c_char_p
            cores[path] = get().decode().lower()
print(json.dumps({
    "numpy": extensions,
    "openblas": sorted(set(cores.values())),
    "numba": cpu_target.target_context.codegen().magic_tuple()[1:],
    "torch": torch.backends.cpu.get_cpu_capability(),
}))
"""


def report() -> dict[str, Any]:
    """What libraries report in a process with the settings."""
    found = subprocess.run(
        [sys.executable, "-W", "error", "-c", _REPORT],
        env=os.environ | settings(),
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert not found.stderr  # no library complains of a setting
    return json.loads(found.stdout)


@pytest.mark.slow
def test_settings_of_an_older_processor_act() -> None:
    older = report()
    assert older["numpy"] == []
    if older["openblas"]:  # the library that numpy and scipy have on Linux
        assert older["openblas"] == [settings()["OPENBLAS_CORETYPE"].lower()]
    # A part of the key of numba's cache.
    assert tuple(older["numba"]) == ("generic", "")
    assert cpu_target.target_context.codegen().magic_tuple()[1:] != ("generic", "")
    assert older["torch"] == "DEFAULT"
