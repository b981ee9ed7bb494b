"""Trial solutions with a network of the user's own: any module of torch.

The derivative in time is that of forward mode, so that a layer needs no more than torch's own
derivatives. A module is tested before it is trained; whether its derivative is that of its values
is tested again before an error is estimated from it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from hamsym.errors import InputError
from hamsym.networks.trial import EnvelopedNetwork
from hamsym.support.record_fields import NotDataError, convert
from hamsym.support.tensor_files import one_line

_PROBES = 33  # inputs at which a module is tested
_INTERVALS = 2_000  # of the quadrature of dz^/dt
# Largest defect of a derivative before a training, relative to the change of the values: the
# quadrature of a module with kinks is off by far less, a missing term by far more.
_DEFECT = 0.01


class ModuleTrial(EnvelopedNetwork):
    """z^(t) = z0 + f(s) N(s) with s = (t - t0) / tau, for any module N of torch.

    - network: s of shape (K, 1) -> N(s) of shape (K, dim), each row from its own s alone.
    - z0, t0, tau, envelope: As of :class:`~hamsym.networks.trial.EnvelopedNetwork`.
    """

    def network_at(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return N(s) and dN/ds at s of shape (K,); each of shape (K, dim)."""
        return _with_rate(self.network, s)

    @torch.no_grad()
    def check_evaluation(self) -> None:
        """Raise InputError unless the module works on its device, and in float64 on the CPU."""
        where = f"on device {self.z0.device}"
        try:
            self.network_at(self.z0.new_zeros(3))
            where = "with weights in float64"
            self.states_and_rates(np.full(3, self.t0))
        except Exception as error:  # whatever the module's own code raises
            raise InputError(
                f"trial cannot be evaluated {where}: {one_line(error)}; "
                "register its constant tensors as buffers"
            ) from error


def _with_rate(network: Callable[[Tensor], Tensor], s: Tensor) -> tuple[Tensor, Tensor]:
    x = s.unsqueeze(-1)
    with forward_ad.dual_level():
        value, rate = forward_ad.unpack_dual(network(forward_ad.make_dual(x, torch.ones_like(x))))
    return value, torch.zeros_like(value) if rate is None else rate


def checked_copy(
    module: torch.nn.Module, dim: int, longest: float, dtype: torch.dtype
) -> torch.nn.Module:
    """Return a copy of a module on the CPU that has passed the tests of a trial network.

    Raise InputError if the module cannot be copied or evaluated, its outputs have another shape or
    type, are not finite, random, or dependent on other rows, or they have no derivative.

    - dim: Number of outputs.
    - longest: Largest input s; the smallest is 0.
    - dtype: Type of the copy's weights.
    """
    if not isinstance(module, torch.nn.Module):
        raise InputError(
            f"trial={module!r} is not a torch.nn.Module; give one that returns shape (K, {dim}) "
            "for s of shape (K, 1)"
        )
    tensors = [*module.parameters(), *module.buffers()]
    if any(torch.nn.parameter.is_lazy(tensor) for tensor in tensors):
        raise InputError("trial has weights without a shape; call it once before")
    if any(tensor.is_complex() for tensor in tensors):
        raise InputError("trial has complex weights; give a module with real ones")
    try:
        network = copy.deepcopy(module).to(device="cpu", dtype=dtype)
    except Exception as error:  # whatever the module's own code raises
        raise InputError(f"trial cannot be copied: {one_line(error)}") from error
    weights = [weight for weight in network.parameters() if weight.requires_grad]
    if not weights:
        raise InputError("trial has no weights to train; give a module with parameters")
    s = longest * torch.linspace(0, 1, _PROBES, dtype=dtype, device="cpu")
    with torch.random.fork_rng(devices=[]):  # a random module leaves the global state alone
        _check_values(network, s, dim)
        _check_rates(network, s, weights)
    return network


@torch.no_grad()
def _check_values(network: torch.nn.Module, s: Tensor, dim: int) -> None:
    x = s.unsqueeze(-1)
    try:
        value = network(x)
        again, parts = network(x), [network(x[: len(x) // 3]), network(x[len(x) // 3 :])]
    except Exception as error:
        raise InputError(
            f"trial cannot be evaluated at s of shape ({len(x)}, 1) and type {x.dtype}: "
            f"{one_line(error)}"
        ) from error
    if not isinstance(value, Tensor):
        raise InputError(f"trial returns a {type(value).__name__}; return a tensor (K, {dim})")
    if value.shape != (len(x), dim):
        raise InputError(
            f"trial returns shape {tuple(value.shape)} for s of shape ({len(x)}, 1); "
            f"return ({len(x)}, {dim})"
        )
    if value.dtype != x.dtype:
        raise InputError(f"trial returns {value.dtype} for s of {x.dtype}; return the same type")
    if not bool(torch.isfinite(value).all()):
        raise InputError(
            f"trial returns values that are not finite for s from 0 to {float(s[-1]):g}; "
            "give another module"
        )
    if not torch.equal(value, again):
        raise InputError(
            "trial returns other values each time it is called, as with dropout; "
            "call its eval() first"
        )
    # Products of other sizes round differently.
    tolerance = 1e5 * torch.finfo(x.dtype).eps * float(value.abs().max())
    if not float((torch.cat(parts) - value).abs().max()) <= tolerance:
        raise InputError(
            "a row of trial depends on the other rows of s, as with batch normalisation; "
            "call its eval() first"
        )


def _check_rates(network: torch.nn.Module, s: Tensor, weights: list[torch.nn.Parameter]) -> None:
    try:
        value, rate = _with_rate(network, s)
    except Exception as error:
        raise InputError(
            f"a layer of trial has no derivative in forward mode: {one_line(error)}; "
            "replace the layer, or give its autograd.Function a jvp"
        ) from error
    slopes: tuple[Tensor | None, ...] = ()
    try:
        if (total := value.sum() + rate.sum()).requires_grad:
            slopes = torch.autograd.grad(total, weights, allow_unused=True)
    except Exception as error:
        raise InputError(
            f"a layer of trial has no derivative in its weights: {one_line(error)}; replace it"
        ) from error
    if all(slope is None for slope in slopes):
        raise InputError("the values of trial do not depend on its weights; give another module")
    if not bool(torch.isfinite(rate).all()):
        raise InputError("the derivative of trial in s is not finite; give another module")
    defect, change = _defect(
        lambda t: _numpy(_with_rate(network, torch.from_numpy(t).to(s.dtype))), 0.0, float(s[-1])
    )
    if not bool((defect <= _DEFECT * change.max()).all()):
        raise InputError(
            "the derivative of trial in forward mode is not that of its values, as where a part "
            "is detached, or a step; give another module"
        )


def _numpy(pair: tuple[Tensor, Tensor]) -> tuple[np.ndarray, np.ndarray]:
    value, rate = pair
    return value.detach().numpy().astype(float), rate.detach().numpy().astype(float)


def rate_defect(trial: ModuleTrial, span: tuple[float, float]) -> np.ndarray:
    """Return max_t |z^(t) - z0 - int dz^/dt| over a span, of each component, shape (dim,)."""
    return _defect(trial.states_and_rates, *span)[0]


def _defect(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], start: float, end: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest differences of values and integrated rates, and of the values alone."""
    t = np.linspace(start, end, 2 * _INTERVALS + 1)
    value, rate = (part.astype(float) for part in function(t))
    # Simpson's rule.
    areas = (end - start) / (6 * _INTERVALS) * (rate[:-2:2] + 4 * rate[1::2] + rate[2::2])
    change = value[2::2] - value[0]
    return np.abs(change - areas.cumsum(0)).max(0), np.abs(change).max(0)


def _not_data(trial: ModuleTrial) -> NoReturn:
    raise NotDataError(
        "a file of hamsym holds networks of hamsym only, not a module of your own; save "
        "solution.trial.network.state_dict() with torch.save"
    )


convert(ModuleTrial, Any, _not_data, _not_data)
