"""Fixtures that run a test once for every system of the catalogue and every backend."""

from __future__ import annotations

import pytest

from hamsym.printing import PRINTERS
from hamsym.systems import CATALOGUE, Problem


@pytest.fixture(params=list(CATALOGUE))
def problem(request: pytest.FixtureRequest) -> Problem:
    return CATALOGUE[request.param]()


@pytest.fixture(params=list(PRINTERS))
def backend(request: pytest.FixtureRequest) -> str:
    return request.param
