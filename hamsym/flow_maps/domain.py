"""Domains of the legs of a flow map: a box, a part of one, or the image of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hamsym.errors import InputError
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.expansion import affine, starts
from hamsym.numerics.lower_sets import chebyshev_coefficients, interpolated

_MARGIN = 0.02  # of a half-width, around the samples of an image
_ROUND_OFF = 4e-15  # of expressions in z0, relative
_MOST_START = 3_000  # terms of their expansion
_FEWEST = 100  # samples of a half of an image
_THIN = 1e-9  # smallest half-width of an image, relative to the size of its component


@dataclass(frozen=True)
class Domain:
    """Inputs of a leg, and their scaling y = scaling @ inputs + shift to [-1, 1]."""

    #: scaling, shift: Shapes (d, d) and (d,).
    scaling: np.ndarray
    shift: np.ndarray
    #: selection, offset: The start is selection @ inputs + offset, shapes (dim, d) and (dim,), with
    #: the expansion ``start`` of shape (n, dim) in the multi-indices ``start_degrees``, shape (n,
    #: d).
    selection: np.ndarray
    offset: np.ndarray
    start_degrees: np.ndarray
    start: np.ndarray
    #: Inputs, shape (n, d) -> initial states, shape (n, dim).
    states: Callable[[np.ndarray], np.ndarray]
    #: Inputs -> values of the parameters that vary, by name.
    values: Callable[[np.ndarray], Mapping[str, np.ndarray]]
    #: Of an image: inputs in it, shape (n, d); with the arguments ``names`` and ``scale`` of
    #: :func:`image_domain`.
    samples: np.ndarray | None = None
    names: tuple[str, ...] = ()
    scale: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __len__(self) -> int:
        return len(self.shift)

    def at(self, y: np.ndarray) -> np.ndarray:
        """Return the inputs of scaled ones, shape (n, d)."""
        return np.linalg.solve(self.scaling, (y - self.shift).T).T

    def start_states(self, inputs: np.ndarray) -> np.ndarray:
        """Return the starts as they are expanded, shape (n, dim)."""
        return starts(self, inputs, affine(inputs, self.scaling, self.shift))


def box_domain(box: Box) -> Domain:
    """Return a box as the domain of the first leg."""
    half = 0.5 * (box.high - box.low)
    dim, d = box.H.dim, len(box)
    selection, offset = np.zeros((dim, d)), np.zeros(dim)
    for i, name in enumerate(box.H.names):
        if name in box.components:
            selection[i, box.names.index(name)] = 1.0
        else:
            offset[i] = box.fixed.get(name, 0.0)
    domain = Domain(
        np.diag(1 / half),
        -0.5 * (box.low + box.high) / half,
        selection,
        offset,
        np.empty((0, d), dtype=int),
        np.empty((0, dim)),
        box.states,
        box.values,
    )
    return _with_start(domain, box) if box.expressions else domain


def _with_start(domain: Domain, box: Box) -> Domain:
    """Expand the components of z0 that are expressions of the parameters, to round-off."""
    given = np.array([name in box.expressions for name in box.H.names])
    sample = box.states(box.at(np.cos(np.linspace(0, np.pi, 33))[:, None] * np.ones(len(box))))
    accuracy = _ROUND_OFF * np.maximum(np.abs(sample).max(axis=0), _ROUND_OFF)
    try:
        degrees, values = interpolated(
            lambda y: np.where(given, box.states(box.at(y)), 0.0), len(box), accuracy, _MOST_START
        )
    except ValueError:
        raise InputError(
            "the expressions in z0 are not smooth over the intervals of their parameters; give "
            "shorter intervals"
        ) from None
    return replace(domain, start_degrees=degrees, start=chebyshev_coefficients(degrees, values))


def random_places(random: np.random.Generator, count: int, d: int, at_end: float) -> np.ndarray:
    """Return random scaled inputs, shape (count, d).

    Each is uniform in [-1, 1], or with the probability ``at_end`` an end of it.
    """
    y = random.uniform(-1, 1, (count, d))
    return np.where(random.random(y.shape) < at_end, np.sign(y), y)


def split_domain(domain: Domain, direction: int) -> tuple[Domain | None, Domain | None]:
    """Return the halves of a domain along one of its scaled inputs, the lower one first.

    The halves of an image are fitted to its samples, if there are many; None without any.
    """
    found: list[Domain | None] = []
    for side in (1.0, -1.0):
        scaling, shift = domain.scaling.copy(), domain.shift.copy()
        scaling[direction] *= 2
        shift[direction] = 2 * shift[direction] + side
        half = replace(domain, scaling=scaling, shift=shift)
        if domain.samples is not None:
            there = side * (domain.samples @ domain.scaling.T + domain.shift)[:, direction] <= 0
            samples = domain.samples[there]
            if len(samples) > _FEWEST:
                half = image_domain(samples, domain.names, domain.scale)
            else:
                half = replace(half, samples=samples)
        found.append(half if half.samples is None or len(half.samples) else None)
    return found[0], found[1]


def image_domain(samples: np.ndarray, names: tuple[str, ...], scale: np.ndarray) -> Domain:
    """Return a domain around the states in which a leg ends.

    It is a parallelepiped along the principal axes of the states, after the part that is linear in
    the parameters is subtracted.

    - samples: States and parameters in the image, shape (n, dim + k).
    - names: Names of these parameters that H has, with "" for the others.
    - scale: Sizes of the components, shape (dim,).
    """
    count, dim = len(samples), len(scale)
    states, kept = samples[:, :dim], samples[:, dim:]
    low, high = kept.min(axis=0), kept.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low) * (1 + _MARGIN)
    theta = (kept - centre) / half
    design = np.column_stack((np.ones(count), theta))
    linear = np.linalg.lstsq(design, states / scale, rcond=None)[0].T  # (dim, 1 + k)
    rest = states / scale - design @ linear.T
    axes = np.linalg.svd(rest, full_matrices=False)[2]  # rows
    along = rest @ axes.T
    middle = 0.5 * (along.max(axis=0) + along.min(axis=0))
    width = (1 + _MARGIN) * 0.5 * np.ptp(along, axis=0) + _THIN
    d = dim + kept.shape[1]
    scaling, shift = np.zeros((d, d)), np.zeros(d)
    # The scaled states are turn @ (z / scale - linear @ (1, theta)) - middle / width.
    turn = axes / width[:, None]
    scaling[:dim, :dim] = turn / scale
    scaling[:dim, dim:] = -turn @ linear[:, 1:] / half
    scaling[dim:, dim:] = np.diag(1 / half)
    shift[:dim] = -turn @ (linear[:, 0] - linear[:, 1:] @ (centre / half)) - middle / width
    shift[dim:] = -centre / half
    return Domain(
        scaling,
        shift,
        np.eye(dim, d),
        np.zeros(dim),
        np.empty((0, d), dtype=int),
        np.empty((0, dim)),
        lambda inputs: inputs[:, :dim],
        lambda inputs: {name: inputs[:, dim + i] for i, name in enumerate(names) if name},
        samples,
        names,
        scale,
    )
