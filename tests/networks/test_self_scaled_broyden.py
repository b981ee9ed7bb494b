"""The self-scaled Broyden method: its update against the theory, its search, its restarts."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch

import hamsym
from hamsym import InputError
from hamsym.networks.self_scaled_broyden import InverseHessian, SelfScaledBroyden, _coefficients
from tests.networks.objectives import squares_of

_SIZE = 6


def _quadratic(seed: int, size: int = _SIZE) -> torch.Tensor:
    """Return a Hessian with eigenvalues from 0.1 to 100."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.randn(size, size, generator=generator, dtype=torch.float64)
    basis = torch.linalg.qr(random)[0]
    return basis @ torch.diag(torch.logspace(-1, 2, size, dtype=torch.float64)) @ basis.T


def _vectors(seed: int, count: int, size: int = _SIZE) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, size, generator=generator, dtype=torch.float64)


def _after_steps(hessian: torch.Tensor, count: int) -> InverseHessian:
    """Return the matrix after random steps along its own directions."""
    inverse = InverseHessian(len(hessian))
    for gradient in _vectors(1, count, len(hessian)):
        direction = -(inverse @ gradient)
        step = 0.3 * direction
        assert inverse.update(step, hessian @ step, -0.3 * float(step @ gradient))
    return inverse


@pytest.mark.parametrize("length", [1e-3, 0.1, 1.0, 40.0])
@pytest.mark.parametrize("steps", [0, 1, 9])
def test_update_fulfils_the_secant_equation(length: float, steps: int) -> None:
    hessian = _quadratic(0)
    inverse = _after_steps(hessian, steps)
    place = inverse.matrix.data_ptr()
    gradient = _vectors(2, 1)[0]
    step = -length * (inverse @ gradient)
    change = hessian @ step
    assert inverse.update(step, change, -length * float(step @ gradient))
    torch.testing.assert_close(inverse @ change, step, rtol=1e-10, atol=1e-12)
    torch.testing.assert_close(inverse.matrix, inverse.matrix.T, rtol=1e-10, atol=1e-12)
    assert torch.linalg.eigvalsh(inverse.matrix)[0] > 0
    assert inverse.matrix.data_ptr() == place


@pytest.mark.parametrize("length", [1e-3, 0.1, 1.0, 40.0])
def test_update_is_the_inverse_of_the_direct_one(length: float) -> None:
    """Derived independently: the update of B with theta instead of that of H with phi."""
    hessian = _quadratic(0)
    inverse = _after_steps(hessian, 4)
    direct = torch.linalg.inv(inverse.matrix)
    gradient = _vectors(2, 1)[0]
    s = -length * (inverse @ gradient)
    y, Bs = hessian @ s, direct @ s
    sy, sBs, yHy = float(s @ y), float(s @ Bs), float(y @ (inverse @ y))
    tau, phi = _coefficients(sBs / sy, yHy / sy, len(s))
    a = sBs * yHy / sy**2 - 1
    theta = (1 - phi) / (1 + phi * a)
    w = y / sy - Bs / sBs
    expected = tau * (direct - torch.outer(Bs, Bs) / sBs + theta * sBs * torch.outer(w, w))
    expected += torch.outer(y, y) / sy
    assert inverse.update(s, y, -length * float(s @ gradient))
    torch.testing.assert_close(torch.linalg.inv(inverse.matrix), expected, rtol=1e-8, atol=1e-8)


def test_coefficients_stay_in_the_bounds_of_the_theory() -> None:
    """0 < tau <= 1 and theta in [theta-, theta+], where B stays positive definite."""
    for b in np.logspace(-6, 6, 25):
        for excess in np.logspace(-12, 8, 21):
            h = (1 + excess) / b
            tau, phi = _coefficients(b, h, 50)
            a = b * h - 1
            theta = (1 - phi) / (1 + phi * a)
            assert 0 < tau <= 1 + 1e-12
            assert 1 + theta * a > 0
            c = math.sqrt(excess / (1 + excess))
            assert theta <= (1 + 1e-6) / min(1.0, h * (1 - c))


def test_exact_searches_minimise_a_quadratic_in_as_many_steps() -> None:
    hessian, x = _quadratic(3), _vectors(4, 1)[0]
    inverse = InverseHessian(_SIZE)
    gradients = [float((hessian @ x).norm())]
    for _ in range(_SIZE):
        gradient = hessian @ x
        direction = -(inverse @ gradient)
        length = -float(direction @ gradient) / float(direction @ hessian @ direction)
        step = length * direction
        assert inverse.update(step, hessian @ step, -length * float(step @ gradient))
        x = x + step
        gradients.append(float((hessian @ x).norm()))
    assert gradients[-1] < 1e-10 * gradients[0] < gradients[-2]


def test_update_is_invariant_under_linear_maps_and_scaling() -> None:
    """The matrix for f(A x) c is A^-1 H A^-T / c."""
    factor, A = 1e-3, _vectors(5, _SIZE) + 3 * torch.eye(_SIZE, dtype=torch.float64)
    hessian = _quadratic(0)
    inverse, mapped = _after_steps(hessian, 3), InverseHessian(_SIZE)
    back = torch.linalg.inv(A)
    mapped.matrix = back @ inverse.matrix @ back.T / factor
    for gradient in _vectors(6, 4):
        length = 0.7
        step = -length * (inverse @ gradient)
        change = hessian @ step
        curvature = -length * float(step @ gradient)
        assert inverse.update(step, change, curvature)
        assert mapped.update(back @ step, factor * (A.T @ change), factor * curvature)
    expected = back @ inverse.matrix @ back.T / factor
    torch.testing.assert_close(mapped.matrix, expected, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("factor", [-1.0, 0.0, math.nan, math.inf])
def test_curvature_that_is_not_positive_leaves_the_matrix(factor: float) -> None:
    inverse = InverseHessian(_SIZE, 2.0)
    step = _vectors(7, 1)[0]
    assert not inverse.update(step, factor * step, 1.0)
    assert not inverse.update(step, step, factor)
    torch.testing.assert_close(inverse.matrix, 2 * torch.eye(_SIZE, dtype=torch.float64))


# -- the optimizer --------------------------------------------------------------------------------


class _Point(torch.nn.Module):
    """A trial solution whose state is its weights at all times."""

    def __init__(self, *start: float) -> None:
        super().__init__()
        self.theta = torch.nn.Parameter(torch.tensor(start, dtype=torch.float64))

    def forward(self, t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        z = self.theta.expand(len(t), -1)
        return z, torch.ones_like(z)


def _bound(point: _Point, residual, refresh: int = 200) -> SelfScaledBroyden:
    optimizer = SelfScaledBroyden(hamsym.SSBroyden(points=3))
    optimizer.refresh = refresh
    objective = squares_of(lambda t, z, dz: residual(z[:, 0], z[:, 1]))
    optimizer.bind(point, objective, torch.Generator().manual_seed(0))
    return optimizer


def _rosenbrock(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    return torch.stack((1 - x, 10 * (y - x * x)), 1)


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_rosenbrock_is_minimised_in_any_units(factor: float) -> None:
    point = _Point(-1.2, 1.0)
    optimizer = _bound(point, lambda x, y: factor * _rosenbrock(x, y), refresh=1000)
    losses = [optimizer.iterate((0.0, 1.0), 1.0, 0.0)[0] for _ in range(60)]
    assert all(after <= before for before, after in itertools.pairwise(losses))
    assert point.theta.detach().numpy() == pytest.approx([1.0, 1.0], abs=1e-7)


def test_undefined_losses_on_the_way_are_avoided() -> None:
    """The first step leads to the logarithm of a negative number."""
    point = _Point(0.3, 2.0)
    optimizer = _bound(point, lambda x, y: torch.stack((torch.log(x) - 1, y), 1))
    for _ in range(40):
        loss, _ = optimizer.iterate((0.0, 1.0), 1.0, 0.0)
        assert math.isfinite(loss)
    assert point.theta.detach().numpy() == pytest.approx([math.e, 0.0], abs=1e-6)


def test_searches_without_a_step_stall() -> None:
    point = _Point(0.5, 0.5)
    optimizer = _bound(point, lambda x, y: torch.stack((0 * x + 1, 0 * y), 1))
    for _ in range(5):
        assert not optimizer.stalled
        optimizer.iterate((0.0, 1.0), 1.0, 0.0)
    assert optimizer.stalled
    assert point.theta.tolist() == [0.5, 0.5]


def test_matrix_survives_new_points() -> None:
    optimizer = _bound(_Point(-1.2, 1.0), _rosenbrock, refresh=3)
    seen = []
    for _ in range(7):
        optimizer.iterate((0.0, 1.0), 1.0, 0.0)
        seen.append((optimizer._t.clone(), optimizer._inverse.matrix.data_ptr()))
    assert [torch.equal(seen[0][0], t) for t, _ in seen] == [True] * 3 + [False] * 4
    assert len({place for _, place in seen}) == 1


def test_networks_too_large_for_a_matrix_are_refused() -> None:
    optimizer = SelfScaledBroyden(hamsym.SSBroyden(points=2))
    objective = squares_of(lambda t, z, dz: z)
    with pytest.raises(InputError, match="20,001 weights, more than the 20,000"):
        optimizer.bind(_Point(*[0.0] * 20_001), objective, torch.Generator())
