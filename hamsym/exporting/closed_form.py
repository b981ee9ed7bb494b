"""The numbers of a solution as a closed form, in the arrangement that all exports share."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.random_features.basis import rate_series
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution

if TYPE_CHECKING:  # torch is imported only by solutions that are networks
    from torch import Tensor

    from hamsym.networks.trial import TrialSolution

#: Matrix and bias of each layer, shapes (neurons, inputs) and (neurons,).
Layers = list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class FeatureForm:
    """z^ = z_a + f(s) (T(2 s - 1) series) readout on each window, with s = (t - t_a)/(t_b - t_a).

    Here f(s) = 1 - exp(-s), T are the Chebyshev polynomials from degree 0 on, and t_a and t_b the
    ends of the window, which are counted from the origin.
    """

    origin: float
    #: Ends of the windows, shape (n + 1,).
    edges: np.ndarray
    #: z_a of the windows, and z at the end, shape (n + 1, dim).
    states: np.ndarray
    #: Shape (n, m, dim).
    readouts: np.ndarray
    #: series, rates: Chebyshev series of the m columns, and of their derivatives in s, shape
    #: (degree + 1, m).
    series: np.ndarray
    rates: np.ndarray

    kind = "features"

    @property
    def windows(self) -> int:
        """Number of windows."""
        return len(self.readouts)

    @property
    def dim(self) -> int:
        """Number of components."""
        return self.states.shape[1]

    @property
    def numbers(self) -> int:
        """Number of float64 numbers."""
        arrays = (getattr(self, entry.name) for entry in fields(self))
        return sum(np.size(array) for array in arrays)


@dataclass(frozen=True, eq=False)
class NetworkForm:
    """z^ = z_a + f(s) N(s) on each window, with s = (t - t_a)/tau and a network N of the window."""

    #: Of all layers but the last.
    activation: str
    #: f(s) = 1 - exp(-s) or f(s) = s.
    envelope: str
    #: Ends of the windows, shape (n + 1,).
    edges: np.ndarray
    #: z_a, shape (n, dim).
    starts: np.ndarray
    #: Shape (n,); negative for a span that runs backwards.
    taus: np.ndarray
    #: For each window one network with dim outputs, or dim networks with one output; for each
    #: network matrix and bias of its layers, shapes (neurons, inputs) and (neurons,).
    networks: list[list[Layers]]

    kind = "networks"

    @property
    def windows(self) -> int:
        """Number of windows."""
        return len(self.taus)

    @property
    def dim(self) -> int:
        """Number of components."""
        return self.starts.shape[1]

    @property
    def per_window(self) -> int:
        """Number of networks in a window."""
        return len(self.networks[0])

    @property
    def sizes(self) -> list[list[int]]:
        """Inputs of each layer, and outputs, of the networks of each window."""
        return [[1, *(len(bias) for _, bias in networks[0])] for networks in self.networks]

    @property
    def offsets(self) -> list[int]:
        """Place of the first of the :attr:`weights` of each window."""
        counts = [
            sum(matrix.size + bias.size for layers in networks for matrix, bias in layers)
            for networks in self.networks
        ]
        return [0, *itertools.accumulate(counts[:-1])]

    @property
    def weights(self) -> np.ndarray:
        """All weights by window, network and layer: each matrix by rows, then its bias."""
        layers = itertools.chain.from_iterable(itertools.chain.from_iterable(self.networks))
        return np.concatenate([part.ravel() for layer in layers for part in layer])

    @property
    def numbers(self) -> int:
        """Number of float64 numbers."""
        return self.edges.size + self.starts.size + self.taus.size + self.weights.size


ClosedForm = FeatureForm | NetworkForm


def envelope_text(form: ClosedForm) -> str:
    """Return the equation of the factor f of a form."""
    linear = isinstance(form, NetworkForm) and form.envelope == "linear"
    return "f(s) = s" if linear else "f(s) = 1 - exp(-s)"


def closed_form(solution: Solution) -> ClosedForm:
    """Return the numbers that define a solution; float32 weights are widened.

    Raise InputError if its network is a module of the caller's, or its windows have networks of
    several kinds.
    """
    trial: Any = solution.trial
    if isinstance(trial, FeatureTrial):
        arrays = trial.edges, trial.states, trial.readouts, trial.series
        return FeatureForm(float(trial.origin), *arrays, rate_series(trial.series))
    from hamsym.networks.chain import Chain
    from hamsym.networks.trial import TrialSolution

    pieces = trial.pieces if isinstance(trial, Chain) else (trial,)
    if not all(isinstance(piece, TrialSolution) for piece in pieces):
        raise InputError(
            "the network of this solution is a module of your own, which has no closed form; save "
            "solution.trial.network.state_dict() with torch.save"
        )
    form = NetworkForm(
        pieces[0].parts[0].activation,
        pieces[0].envelope,
        trial.edges if isinstance(trial, Chain) else np.array(solution.span),
        np.array([piece.z0.numpy() for piece in pieces], dtype=float),
        np.array([piece.tau for piece in pieces]),
        [_networks(piece) for piece in pieces],
    )
    kinds = {
        (piece.parts[0].activation, piece.envelope, len(piece.parts), len(piece.parts[0].sizes))
        for piece in pieces
    }
    if len(kinds) > 1 or any(
        piece.t0 != start for piece, start in zip(pieces, form.edges, strict=False)
    ):
        raise InputError("the windows of this solution have networks of several kinds; solve again")
    return form


def _networks(piece: TrialSolution) -> list[Layers]:
    """Return the layers of the networks of a window."""

    def numbers(part: Tensor) -> np.ndarray:
        return part.detach().numpy().astype(float)

    return [
        [(numbers(matrix), numbers(bias)) for matrix, bias in network.layers]
        for network in piece.parts
    ]
