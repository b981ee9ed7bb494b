"""Fixtures that run a test once for every system of the catalogue and every backend."""

from __future__ import annotations

import os

import pytest

from hamsym.codegen.printers import PRINTERS
from hamsym.systems import CATALOGUE, Problem

# Workers side by side, each with as many threads as there are cores, would wait for each other.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# Many components are slow to derive and compile; test_systems.py has all but the largest.
_LARGE = {"calogero_moser", "fermi_pasta_ulam_tsingou", "three_bodies", "toda_chain"}


@pytest.fixture(
    params=[
        pytest.param(name, marks=pytest.mark.slow if name in _LARGE else ()) for name in CATALOGUE
    ]
)
def problem(request: pytest.FixtureRequest) -> Problem:
    return CATALOGUE[request.param]()


@pytest.fixture(params=list(PRINTERS))
def backend(request: pytest.FixtureRequest) -> str:
    return request.param
