"""Fixtures that run a test once for every system of the catalogue and every backend."""

from __future__ import annotations

import pytest

from hamsym.printing import PRINTERS
from hamsym.systems import CATALOGUE, Problem

# Twelve components are slow to compile; what is quick with them is tested by name.
_LARGE = {"three_bodies"}


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
