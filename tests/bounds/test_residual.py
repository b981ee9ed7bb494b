"""Bounds of residuals on windows, by parts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hamsym import Hamiltonian
from hamsym.bounds.models import NODES
from hamsym.bounds.residual import Excess, ExcessSearch, Parts, Places
from hamsym.codegen.programs import programs_of

EDGES = np.arange(11.0)


def found(force: str, limit: float, first_only: bool = False, whole: bool = False) -> list[Excess]:
    """Windows of the motion x = 0, p = 0 in which a force matters."""
    H = Hamiltonian(f"p**2/2 - x*({force})")
    system = H.compile("numpy")

    def trial(parts: Parts) -> Places:
        start, end = EDGES[parts.window, None], EDGES[parts.window + 1, None]
        t = start + (end - start) * parts.places(NODES)
        return Places(np.zeros((*t.shape, 2)), np.zeros((*t.shape, 2)), t)

    with np.errstate(all="ignore"):
        return ExcessSearch(
            programs_of(H.real_equations),
            lambda z, t, window: system.vector_field(*system.arguments(z, t)),
            trial,
            np.stack((EDGES[:-1], EDGES[1:])),
            np.full((10, 2), limit),
            np.empty(0),
            noise=0.0,
            first_only=first_only,
            whole=whole,
        ).run()


@pytest.mark.parametrize("place", [0.3141, 4.5, 7.99999])
@pytest.mark.parametrize("width", [1e-2, 1e-5, 1e-9, 1e-12])
def test_pulses_of_any_width_are_found(width: float, place: float) -> None:
    """Each with the same impulse, 1.77."""
    windows = found(f"{1 / width}*exp(-((t - {place})/{width})**2)", 1e-6)
    assert int(place) in [excess.window for excess in windows]
    nearest = min(windows, key=lambda excess: abs(excess.time - place))
    assert abs(nearest.time - place) < 30 * width + 1e-14


@pytest.mark.parametrize("width", [1e-5, 1e-9, 1e-12])
def test_pulses_without_effect_pass(width: float) -> None:
    assert found(f"1e-9/{width}*exp(-((t - 4.5)/{width})**2)", 1e-6) == []


def test_residual_may_count_over_the_whole_window() -> None:
    pulse = "(sign(t - 4.5) - sign(t - 4.501))/100"
    assert found(pulse, 1e-3) == []
    (excess,) = found(pulse, 1e-3, whole=True)
    assert (excess.window, excess.ratio) == (4, pytest.approx(20))
    assert 4.5 <= excess.time <= 4.501


def test_train_of_pulses_ends_at_the_first() -> None:
    windows = found("1e5*exp(-1e12*sin(30*t)**2)", 1e-6, first_only=True)
    assert len(windows) == 1


@pytest.mark.parametrize("kink", ["abs(t - 3.3)", "max(t, 2.5)", "sqrt((t - 3.3)**2 + 1e-12)"])
def test_smooth_size_is_compared_with_limits(kink: str) -> None:
    assert found(f"({kink})/100", 1.0) == []
    assert len(found(f"({kink}) + 1", 1e-3)) == 10


@pytest.mark.parametrize("force", ["1/(t - 4.3)", "log(t - 4.3)", "sqrt(4.3 - t)"])
def test_forces_without_value_are_found(force: str) -> None:
    windows = found(f"1e-30*{force}", 1e-6)
    assert 4 in [excess.window for excess in windows]
    assert all(not math.isnan(excess.ratio) for excess in windows)
