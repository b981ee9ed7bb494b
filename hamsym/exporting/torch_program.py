"""Export of a solution to a program of torch.export."""

from __future__ import annotations

import copy
import io
import itertools
import json
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.exporting.about import About
from hamsym.exporting.closed_form import ClosedForm, FeatureForm, NetworkForm
from hamsym.networks.module_trial import ModuleTrial
from hamsym.support.tensor_files import one_line

_ABOUT = "about.json"
_EXAMPLES = 5  # times by which the program is traced; any number works afterwards
_SLACK = 4e-16  # relative, of times at the ends of the span


def torch_program(about: About, form: ClosedForm | None) -> bytes:
    """Return the content of a file that ``torch.export.load`` reads.

    The program maps times of shape (n,) to states of shape (n, dim) in float64.

    Raise InputError if torch cannot export the caller's network.

    - form: None for a network of the caller's own.
    """
    solution = about.solution
    trial: Any = solution.trial
    module: torch.nn.Module
    if form is None:
        module = _Own(trial)
    else:
        module = _Features(form) if isinstance(form, FeatureForm) else _Networks(form)
    whole = _InSpan(module, solution.span).requires_grad_(False)
    times = torch.from_numpy(np.linspace(*solution.span, _EXAMPLES))
    try:
        program = torch.export.export(
            whole, (times,), dynamic_shapes=({0: torch.export.Dim("n", min=1)},)
        )
        content = io.BytesIO()
        torch.export.save(program, content, extra_files={_ABOUT: json.dumps(about.values())})
    except Exception as error:  # whatever torch raises for a module
        raise InputError(f"torch cannot export the network: {one_line(error)}") from error
    return content.getvalue()


class _InSpan(torch.nn.Module):
    """The states of a module at times of the span, nan at others."""

    def __init__(self, module: torch.nn.Module, span: tuple[float, float]) -> None:
        super().__init__()
        self.module = module
        slack = _SLACK * max(map(abs, span))
        self.low, self.high = min(span) - slack, max(span) + slack

    def forward(self, t: Tensor) -> Tensor:
        inside = (t >= self.low) & (t <= self.high)
        states = self.module(torch.where(inside, t, self.low))
        return torch.where(inside.unsqueeze(-1), states, torch.nan)


class _Windows(torch.nn.Module):
    """Windows and what they have, as buffers."""

    edges: Tensor

    def __init__(self, edges: np.ndarray, **arrays: np.ndarray) -> None:
        super().__init__()
        self.direction = 1.0 if edges[-1] > edges[0] else -1.0
        for name, array in {"edges": edges, **arrays}.items():
            self.register_buffer(name, torch.from_numpy(np.array(array, dtype=float)))

    def window(self, t: Tensor) -> Tensor:
        """Return the number of the window of each time."""
        edges = self.direction * self.edges
        found = torch.searchsorted(edges, (self.direction * t).detach(), right=True) - 1
        return found.clamp(0, len(edges) - 2)


class _Features(_Windows):
    """A :class:`~hamsym.exporting.closed_form.FeatureForm` of torch."""

    states: Tensor
    readouts: Tensor
    series: Tensor

    def __init__(self, form: FeatureForm) -> None:
        super().__init__(form.edges, states=form.states, readouts=form.readouts, series=form.series)
        self.origin = form.origin

    def forward(self, t: Tensor) -> Tensor:
        t = t - self.origin
        window = self.window(t)
        start = self.edges[window]
        s = (t - start) / (self.edges[window + 1] - start)
        x = 2 * s - 1
        polynomials = [torch.ones_like(x), x]
        for _ in range(len(self.series) - 2):
            polynomials.append(2 * x * polynomials[-1] - polynomials[-2])
        network = torch.stack(polynomials, dim=-1) @ self.series
        columns = -torch.expm1(-s).unsqueeze(-1) * network
        change = torch.bmm(columns.unsqueeze(1), self.readouts[window]).squeeze(1)
        return self.states[window] + change


class _Networks(_Windows):
    """A :class:`~hamsym.exporting.closed_form.NetworkForm` of torch.

    Networks of one window that are narrower than those of others have neurons of zeros.
    """

    starts: Tensor
    taus: Tensor

    def __init__(self, form: NetworkForm) -> None:
        sizes = np.array(form.sizes).max(axis=0)
        arrays: dict[str, np.ndarray] = {"starts": form.starts, "taus": form.taus}
        for place, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
            matrices = np.zeros((form.windows, form.per_window, outputs, inputs))
            biases = np.zeros((form.windows, form.per_window, outputs))
            for k, networks in enumerate(form.networks):
                for j, layers in enumerate(networks):
                    matrix, bias = layers[place]
                    matrices[k, j, : matrix.shape[0], : matrix.shape[1]] = matrix
                    biases[k, j, : len(bias)] = bias
            arrays |= {f"matrix{place}": matrices, f"bias{place}": biases}
        super().__init__(form.edges, **arrays)
        self.layers, self.linear = len(sizes) - 1, form.envelope == "linear"
        self.activation = getattr(torch, form.activation)

    def forward(self, t: Tensor) -> Tensor:
        window = self.window(t)
        s = (t - self.edges[window]) / self.taus[window]
        h = s.view(-1, 1, 1)
        for place in range(self.layers):
            matrix, bias = getattr(self, f"matrix{place}"), getattr(self, f"bias{place}")
            if len(self.taus) == 1:
                a = torch.einsum("koi,nki->nko", matrix[0], h.expand(-1, len(matrix[0]), -1))
                a = a + bias[0]
            else:
                own = matrix[window]
                a = torch.einsum("nkoi,nki->nko", own, h.expand(-1, own.shape[1], -1))
                a = a + bias[window]
            h = self.activation(a) if place < self.layers - 1 else a
        f = s if self.linear else -torch.expm1(-s)
        return self.starts[window] + f.unsqueeze(-1) * h.flatten(1)


class _Own(torch.nn.Module):
    """A trial solution with a network of the caller's own, in float64."""

    def __init__(self, trial: ModuleTrial) -> None:
        super().__init__()
        self.network = copy.deepcopy(trial.network).cpu().double()
        self.register_buffer("z0", trial.z0.detach().cpu().double())
        moving = torch.ones(len(trial.z0), dtype=torch.float64)
        moving[trial.held] = 0
        self.register_buffer("moving", moving)
        self.t0, self.tau, self.linear = trial.t0, trial.tau, trial.envelope == "linear"

    def forward(self, t: Tensor) -> Tensor:
        s = (t - self.t0) / self.tau
        f = s if self.linear else -torch.expm1(-s)
        value = self.network(s.unsqueeze(-1)) * self.moving
        return self.z0 + f.unsqueeze(-1) * value
