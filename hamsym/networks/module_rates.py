"""The derivative of the rows of a least-squares problem in the weights of any module of torch.

Rows at one time depend on the network at this time alone. The few rows of a time need fewer passes
in reverse mode than its many weights in forward mode; all times are one batch.
"""

from __future__ import annotations

import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.networks.module_trial import ModuleTrial
from hamsym.support.tensor_files import one_line

_LARGEST = 200_000_000  # numbers in J: 1.6 GB in float64


class ModuleRates:
    """Products with the derivative J of the rows (component, point) in the weights.

    Raise InputError if J is too large, or a layer cannot be differentiated in batches.

    - t: Times, shape (K,).
    - in_z, in_dz: Derivatives of the rows in z and in dz, each of shape (K, m, dim).
    """

    def __init__(self, trial: ModuleTrial, t: Tensor, in_z: Tensor, in_dz: Tensor) -> None:
        network, weights = trial.network, trial.weights
        trained = {
            name: weight.detach()
            for name, weight in network.named_parameters()
            if weight.requires_grad
        }
        to_value, to_rate = trial.to_network(t, in_z, in_dz)
        m, count, _ = to_value.shape
        total = sum(weight.numel() for weight in weights)
        if m * count * total > _LARGEST:
            raise InputError(
                f"trial has {total:,} weights, too many for the least squares of {m * count:,} "
                "residuals; give fewer points, or method 'lbfgs' or 'adam'"
            )
        s, *_ = trial.envelope_at(t)

        def row(at: Tensor, to_value: Tensor, to_rate: Tensor) -> dict[str, Tensor]:
            def jet(values: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
                def output(at: Tensor) -> Tensor:
                    found = torch.func.functional_call(network, values, (at.reshape(1, 1),))
                    return found[0]

                value, rate, *_ = torch.func.jvp(output, (at,), (torch.ones_like(at),))
                return value, rate

            pulled = torch.func.vjp(jet, trained)[1]
            return torch.func.vmap(lambda u, v: pulled((u, v))[0])(to_value, to_rate)

        try:
            found = torch.func.vmap(row, in_dims=(0, 1, 1), out_dims=1)(s, to_value, to_rate)
        except Exception as error:  # whatever the module's own code raises
            raise InputError(
                "trial cannot be differentiated in batches by torch.func, which "
                f"'levenberg-marquardt' needs: {one_line(error)}; use method 'lbfgs' or 'adam'"
            ) from error
        self._shapes = [weight.shape for weight in trained.values()]
        self._jacobian = torch.cat([part.reshape(m * count, -1) for part in found.values()], 1)

    def gram(self) -> Tensor:
        """Return J J^T."""
        return self._jacobian @ self._jacobian.T

    def transposed(self, y: Tensor) -> list[Tensor]:
        """Return J^T y, one tensor for each parameter."""
        whole = self._jacobian.T @ y
        parts = whole.split([shape.numel() for shape in self._shapes])
        return [part.reshape(shape) for part, shape in zip(parts, self._shapes, strict=True)]
