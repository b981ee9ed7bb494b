"""The error estimate of many members in tensors, on a device of torch.

It does what the compiled loops (:mod:`hamsym.random_features.error_loop` and the checks of
:mod:`hamsym.random_features.member_loop`) do for one member after the other, window by window for
all members that have one. The vectors are in the units of H.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from hamsym.random_features.error_loop import (
    ACCURACY,
    COHERENT,
    CURVED,
    FEWEST,
    ITERATIONS,
    LARGEST,
    MISSED,
    PASSING,
    PERTURBATIONS,
    RESOLVED,
    SLACK,
    TESTED,
    Actions,
)
from hamsym.random_features.member_loop import (
    BRIEF,
    FUNCTION,
    SPLITTER,
    UNSETTLED,
)
from hamsym.random_features.tensor_march import (
    CROWDED,
    Functions,
    MarchTables,
    change,
    disturbed,
    evaluate,
    largest_of,
    take,
    taken,
)
from hamsym.random_features.window_loop import EPS, ROUND_OFF, TINY

__all__ = [
    "ErrorSettings",
    "ErrorTables",
    "Errors",
    "Path",
    "carry_errors",
    "keeps_energy",
    "narrow",
]

_EACH = PERTURBATIONS + 2  # vectors


class ErrorTables(NamedTuple):
    """Tables of :class:`~hamsym.random_features.error_loop.ErrorTables` that are needed here."""

    nodes: Tensor
    at_nodes: Tensor
    places: Tensor
    values: Tensor
    values_low: Tensor
    rates: Tensor
    rates_low: Tensor
    drift: Tensor
    drift_inside: Tensor
    drift_end: Tensor
    integration: Tensor
    lift: Tensor
    end: Tensor
    to_series: Tensor
    dense: Tensor


class Half(NamedTuple):
    """Terms of one half of J Hess v: for each row (source, second derivative) pairs, and a sign."""

    rows: list[list[tuple[int, int]]]
    sign: float

    @classmethod
    def of(cls, actions: Actions, rows: int, sign: float) -> Half:
        """Make it from terms whose factors are all ``sign``."""
        ends = [*actions.starts[1:].tolist(), len(actions.sources)]
        terms = list(zip(actions.sources.tolist(), actions.entries.tolist(), strict=True))
        found: list[list[tuple[int, int]]] = [[] for _ in range(rows)]
        parts = zip(actions.rows.tolist(), actions.starts.tolist(), ends, strict=True)
        for row, start, end in parts:
            found[row] = terms[start:end]
        return cls(found, sign)

    def apply(self, second: Tensor, vectors: Sequence[Tensor], out: Tensor) -> None:
        """Write the half to out of shape (rows, vectors, n, nodes)."""
        for target, terms in zip(out, self.rows, strict=True):
            if not terms:
                target.zero_()
            for k, (source, entry) in enumerate(terms):
                if k:
                    target.addcmul_(second[entry], vectors[source], value=self.sign)
                else:
                    torch.mul(second[entry], vectors[source], out=target)
                    if self.sign < 0:
                        target.neg_()


class ErrorSettings(NamedTuple):
    """Constants of the estimate.

    Attributes
    ----------
    forces, velocities : Half
    entries : int
        Second derivatives that are not zero, in the upper triangle.
    whole : float
        Length of the span.
    rounded : float
        1 if H has numbers that float64 cannot represent, else 0.
    signs : (sets, dim, 1, places)
        1 and -1 at random, for the disturbance of the states.
    kicks : (period, dim, PERTURBATIONS, 1)
        1 and -1 at random, for each window in turn.
    """

    forces: Half
    velocities: Half
    entries: int
    whole: float
    rounded: float
    signs: Tensor
    kicks: Tensor


class Path(NamedTuple):
    """Windows of members: those of a member follow those of the members before it.

    Attributes
    ----------
    counts, firsts : (members,)
        Windows of each member, and the first of them.
    edges, states : (windows + members,), (dim, windows + members)
        A member with n windows has n + 1 of them.
    readouts : (dim, windows, m)
    member : (windows,)
        Number of the member.
    """

    counts: Tensor
    firsts: Tensor
    edges: Tensor
    states: Tensor
    readouts: Tensor
    member: Tensor

    @classmethod
    def of(
        cls,
        start: float,
        states: Tensor,
        member: Tensor,
        ends: Tensor,
        end_states: Tensor,
        readouts: Tensor,
    ) -> Path:
        """Arrange windows, those of each member in order, of members that start at states."""
        count = states.shape[1]
        order = member.argsort(stable=True)
        member = member[order]
        counts = member.bincount(minlength=count)
        firsts = counts.cumsum(0) - counts
        numbers = torch.arange(len(order), device=member.device)
        slots = numbers + member + 1
        starts = firsts + torch.arange(count, device=member.device)
        edges = ends.new_empty(len(order) + count)
        edges[slots], edges[starts] = ends[order], start
        joined = states.new_empty((len(states), len(edges)))
        joined[:, slots], joined[:, starts] = take(end_states, order), states
        return cls(counts, firsts, edges, joined, take(readouts, order), member)

    @property
    def slots(self) -> Tensor:
        """Edge at the start of each window."""
        return torch.arange(len(self.member), device=self.member.device) + self.member

    @property
    def owners(self) -> Tensor:
        """Number of the member of each edge."""
        members = torch.arange(len(self.counts), device=self.counts.device)
        return members.repeat_interleave(self.counts + 1)


class Errors(NamedTuple):
    """Estimated errors of members.

    Attributes
    ----------
    known : (members,)
        Whether all windows were estimated.
    marked : (members,)
        Whether the residual in a window is large relative to the rates, or exceeds its limit.
    bent : (members,)
        Whether the error in a window is so large that its equation is not linear.
    largest : (dim, members)
        Largest error and round-off.
    series, floors : (dim, windows, k), (dim, windows)
        Chebyshev series of the error, and the accumulated round-off; without columns if they were
        not asked for.
    """

    known: Tensor
    marked: Tensor
    bent: Tensor
    largest: Tensor
    series: Tensor
    floors: Tensor


# -- one window of each member ---------------------------------------------------------------------


class _Vectors(NamedTuple):
    """Members whose tangent equation is solved, with rows for component and vector."""

    place: Tensor
    alive: Tensor
    h: Tensor
    accuracy: Tensor
    second: Tensor
    base: Tensor  # (dim * vectors, n, nodes)
    coordinates: Tensor
    momenta: Tensor
    moved: Tensor


class _Transported(NamedTuple):
    """What is needed of the vectors.

    Attributes
    ----------
    solved : (n,)
    ends : (dim, vectors, n)
        Integral of A V over the window, in units of its length.
    error : (dim, n, nodes)
        The first vector.
    spread : (dim, n)
        Largest round-off: three standard deviations of the perturbations, and the last vector.
    """

    solved: Tensor
    ends: Tensor
    error: Tensor
    spread: Tensor


def _transport(
    tables: ErrorTables,
    settings: ErrorSettings,
    second: Tensor,
    base: Tensor,
    h: Tensor,
    accuracy: Tensor,
) -> _Transported:
    """Solve the tangent equation of a window for all vectors, base of (dim, vectors, n, nodes)."""
    dim, each, count, nodes = base.shape
    rows, half = base.reshape(dim * each, count, nodes), dim // 2 * each
    now = _Vectors(
        place=torch.arange(count, device=h.device),
        alive=torch.ones_like(h, dtype=torch.bool),
        h=h,
        accuracy=accuracy,
        second=second,
        base=rows,
        coordinates=rows[:half],
        momenta=rows[half:],
        moved=torch.empty_like(rows),
    )
    out = _Transported(
        torch.zeros_like(now.alive),
        base.new_empty((dim, each, count)),
        base.new_empty((dim, count, nodes)),
        base.new_empty((dim, count)),
    )
    # The vectors at three nodes show their size.
    some_nodes = torch.tensor([0, (nodes - 1) // 2, nodes - 1], device=h.device)
    left = count
    for iteration in range(1, ITERATIONS + 1):
        shape, length = (-1, each, *now.base.shape[1:]), now.h[:, None]
        speeds, slopes = now.moved[:half], now.moved[half:]
        vectors = [*now.coordinates.view(shape), *now.momenta.view(shape)]
        settings.forces.apply(now.second, vectors, slopes.view(shape))
        momenta = torch.addcmul(now.base[half:], slopes @ tables.integration, length)
        vectors[dim // 2 :] = momenta.view(shape)
        settings.velocities.apply(now.second, vectors, speeds.view(shape))
        coordinates = torch.addcmul(now.base[:half], speeds @ tables.integration, length)
        before = now.coordinates, now.momenta
        now = now._replace(coordinates=coordinates, momenta=momenta)
        if iteration <= 2:
            continue
        changes = torch.cat((change(coordinates, before[0]), change(momenta, before[1])))
        few = torch.cat([rows.index_select(2, some_nodes) for rows in (coordinates, momenta)])
        sizes = largest_of(few).view(dim, each, -1).amax(1).clamp(min=TINY)
        ratios = changes.view(dim, each, -1).amax(1) / (now.accuracy * sizes)
        largest = ratios.amax(0)
        done = largest <= 1
        stopped = now.alive & (done | ~(largest < 1e100))
        stops = int(stopped.sum())
        if not stops:
            continue
        some = stopped.nonzero()[:, 0]
        places = now.place[some]
        out.solved[places] = done[some]
        out.ends[..., places] = (take(now.moved, some) @ tables.end).view(dim, each, -1)
        found = torch.cat((take(coordinates, some), take(momenta, some))).view(dim, each, stops, -1)
        out.error[:, places] = found[:, 0]
        noise = found[:, 1:-1].square().mean(1).amax(-1).sqrt()
        out.spread[:, places] = 3 * noise + largest_of(found[:, -1])
        left -= stops
        if not left:
            break
        now = now._replace(alive=now.alive & ~stopped)
        if left < CROWDED * len(now.h):
            now = taken(now, now.alive.nonzero()[:, 0])
    return out


def _second_order(
    functions: Functions,
    tables: ErrorTables,
    z: Tensor,
    times: Tensor,
    parameters: Tensor,
    h: Tensor,
    error: Tensor,
    base: Tensor,
) -> Tensor:
    """Compute what the linear equation of the error lacks over a window, (dim, n).

    ``base`` is the error without the part that the equation adds.
    """
    rates = evaluate(functions, z, times, parameters, torch.empty_like(z))
    changes = evaluate(functions, z + error, times, parameters, torch.empty_like(z)) - rates
    return largest_of((changes @ tables.integration) * h - (error - base))


def _rounding(starts: Tensor, ends: Tensor, readouts: Tensor, tables: MarchTables) -> Tensor:
    """Compute z - z^ at the end of windows, due to the rounding of the state, (dim, n).

    The sum has twice the digits (Dekker, Knuth).
    """
    total, rest = starts.clone(), torch.zeros_like(starts)
    products = readouts * tables.end
    high, weights = _high(readouts), _high(tables.end)
    low, low_weights = readouts - high, tables.end - weights
    lost = low * low_weights - (((products - high * weights) - low * weights) - high * low_weights)
    lost += readouts * tables.end_low
    for m in range(readouts.shape[-1]):
        product = products[..., m]
        added = total + product
        part = added - total
        rest += (total - (added - part)) + (product - part) + lost[..., m]
        total = added
    return (total - ends) + rest


def _high(values: Tensor) -> Tensor:
    """Leading half of the digits."""
    c = SPLITTER * values
    return c - (c - values)


# -- all windows -----------------------------------------------------------------------------------


def carry_errors(
    functions: Functions,
    march_tables: MarchTables,
    tables: ErrorTables,
    settings: ErrorSettings,
    path: Path,
    sizes: Tensor,
    tolerances: Tensor,
    parameters: Tensor,
    keep: bool,
) -> Errors:
    """Estimate the errors of all members that have windows.

    Parameters
    ----------
    sizes : (dim, members)
        Sizes of the components to which tolerances are relative.
    tolerances : (members,)
        Local tolerances of the march.
    parameters : (k, members, 1)
    keep : bool
        Whether to keep series and floors.
    """
    dim, members = sizes.shape
    windows = len(path.member) if keep else 0
    scale = torch.where(sizes > 0, sizes, 1.0)
    lengths = path.edges[path.slots + 1] - path.edges[path.slots]
    usual = torch.zeros_like(tolerances).index_add_(0, path.member, lengths.square())
    usual /= settings.whole
    accuracy = ACCURACY / path.counts.to(sizes.dtype).clamp(min=FEWEST)
    joint = sizes.new_zeros((dim, _EACH, members))
    roots, last = torch.zeros_like(tolerances), torch.zeros_like(tolerances)
    errors = Errors(
        path.counts > 0,
        torch.zeros_like(tolerances, dtype=torch.bool),
        torch.zeros_like(tolerances, dtype=torch.bool),
        torch.zeros_like(sizes),
        sizes.new_empty((dim, windows, tables.lift.shape[1])),
        sizes.new_empty((dim, windows)),
    )
    for number in range(int(path.counts.max())):
        active = (errors.known & (path.counts > number)).nonzero()[:, 0]
        if not len(active):
            break
        window = path.firsts[active] + number
        slot = window + active
        z, ends = take(path.states, slot), take(path.states, slot + 1)
        t, h = path.edges[slot], lengths[window]
        readouts, size = take(path.readouts, window), take(sizes, active)
        own, units, tolerance = take(parameters, active), take(scale, active), tolerances[active]
        which = number % len(tables.places)
        # -- the residual
        inside = readouts @ tables.values[which]
        # A rounded table would push every window the same way.
        inside += readouts @ tables.values_low[which]
        inside += z[..., None]
        times = h[:, None] * tables.places[which] + t[:, None]
        residual = readouts @ tables.rates[which]
        residual += readouts @ tables.rates_low[which]
        rates = evaluate(functions, inside, times, own, torch.empty_like(inside))
        residual /= h[:, None]
        residual -= rates
        length, left, speeds = h.abs(), largest_of(residual), largest_of(rates)
        # The rates of components that are nothing but round-off are noise.
        resolved = (left <= RESOLVED * speeds) | (usual[active] * left <= RESOLVED * units)
        allowed = tolerance * size + ROUND_OFF * length * speeds
        good = resolved & (length * left <= SLACK * allowed)
        errors.marked[active] |= ~good.all(0)
        # -- round-off, as the change of the rates for half a unit in the last place
        changes = disturbed(functions, settings.signs[which], EPS / 2, inside, times, own) - rates
        noise = changes.square_().mean(-1).sqrt()
        # -- the tangent equation
        at_nodes = readouts @ tables.at_nodes
        at_nodes += z[..., None]
        second = at_nodes.new_empty((settings.entries, *at_nodes.shape[1:]))
        node_times = h[:, None] * tables.nodes + t[:, None]
        functions.hessian(at_nodes, node_times, own, second)
        drift = residual @ tables.drift
        drift *= h[:, None]
        vectors = joint[..., active]
        # The places average the round-off, but not independently.
        kick = COHERENT * length * (noise + EPS * speeds) / math.sqrt(tables.places.shape[1])
        vectors[:, 1:-1] += kick[:, None] * settings.kicks[number % len(settings.kicks)]
        vectors[:, -1] += settings.rounded * (EPS / 2) * (ends - z)
        base = vectors[..., None].repeat(1, 1, 1, len(tables.nodes))
        base[:, 0] -= drift
        # The mean root is the typical size of the error, also if it has short peaks beside a pole.
        elapsed = (t - path.edges[path.firsts[active] + active]).abs().clamp(min=TINY)
        typical, before = PASSING * (roots[active] / elapsed).square(), last[active]
        share = torch.where(typical < before, typical / before, 1.0)
        found = _transport(tables, settings, second, base, h, accuracy[active] * share)
        largest = (largest_of(found.error) / units).amax(0)
        roots[active] += length * largest.sqrt()
        last[active] = largest
        # -- whether the equation is linear
        some = (~(largest <= TESTED)).nonzero()[:, 0]
        if len(some):
            lacking = _second_order(
                functions,
                tables,
                take(at_nodes, some),
                node_times[some],
                take(own, some),
                h[some, None],
                take(found.error, some),
                take(base[:, 0], some),
            )
            limit = CURVED * largest[some] * take(units, some)
            errors.bent[active[some]] |= ~(lacking <= limit).all(0)
        vectors += h * found.ends
        vectors[:, 0] += _rounding(z, ends, readouts, march_tables)
        vectors[:, 0] -= h * (residual @ tables.drift_end)
        joint[..., active] = vectors
        valid = (vectors.abs() <= LARGEST * units[:, None]).all(1).all(0)
        errors.known[active] = found.solved & valid
        # -- the error inside the window: its smooth part, and the integral of the residual
        smooth = (found.error + drift) @ tables.lift
        smooth -= (residual @ tables.drift_inside) * h[:, None]
        # At worst in the window, and with the rounding of z^ itself.
        floor = found.spread + EPS / 2 * largest_of(inside)
        most = MISSED * largest_of(smooth @ tables.dense) + floor
        errors.largest[:, active] = torch.maximum(take(errors.largest, active), most)
        if keep:
            errors.series[:, window] = smooth @ tables.to_series
            errors.floors[:, window] = floor
    return errors


# -- further checks --------------------------------------------------------------------------------


def keeps_energy(
    functions: Functions, path: Path, sizes: Tensor, tolerances: Tensor, parameters: Tensor
) -> Tensor:
    """Return whether H changes in no window by more than the local tolerance explains.

    See :func:`hamsym.random_features.member_loop.keeps_energy`; shape (members,).
    """
    z, own = path.states[..., None], take(parameters, path.owners)
    times = path.edges[:, None]
    energies = z.new_empty((1, *z.shape[1:]))
    functions.energy(z, times, own, energies)
    # The gradient of H is the vector field with its halves exchanged, up to signs.
    gradient = evaluate(functions, z, times, own, torch.empty_like(z))[..., 0]
    slopes = gradient.roll(len(gradient) // 2, 0).abs()
    start, energy, some = path.slots, energies[0, :, 0], path.member
    slope = torch.maximum(take(slopes, start), take(slopes, start + 1))
    size = path.states.abs()
    size = torch.maximum(take(size, start), take(size, start + 1))
    rounding = energy[start].abs() + (slope * size).sum(0)
    allowed = tolerances[some] * (slope * take(sizes, some)).sum(0)
    allowed = SLACK * (allowed + ROUND_OFF * rounding)
    failed = ~((energy[start + 1] - energy[start]).abs() <= allowed)
    return torch.zeros_like(tolerances).index_add_(0, some, failed.to(tolerances.dtype)) == 0


def narrow(
    functions: Functions, tables: ErrorTables, kinds: Tensor, path: Path, parameters: Tensor
) -> Tensor:
    """Return in which windows an argument may be zero or turn steeply, or is not resolved.

    See :func:`hamsym.random_features.member_loop.mark_narrow`; shape (windows,).
    """
    inside = tables.lift.shape[1]
    start = path.slots
    before, after = take(path.states, start), take(path.states, start + 1)
    z = torch.cat(
        (
            before[..., None],
            path.readouts @ tables.values[0, :, :inside] + before[..., None],
            after[..., None],
        ),
        -1,
    )
    places = tables.places[0, :inside]
    s = torch.cat((places.new_zeros(1), places, places.new_ones(1)))
    t, h = path.edges[start], path.edges[start + 1] - path.edges[start]
    g = z.new_empty((len(kinds), *z.shape[1:]))
    own = take(parameters, path.member)
    functions.argument(z, t[:, None] + h[:, None] * s, own, g)
    sizes = (g[..., 1:-1] @ tables.to_series).abs()
    suspect = ~(sizes < math.inf).all(-1)
    suspect |= ~(sizes[..., -4:].amax(-1) <= UNSETTLED * sizes.amax(-1))
    widths, changes = s.diff(), g.diff(dim=-1)
    function = (kinds == FUNCTION)[:, None, None]
    acts = ~function | (changes.abs() * BRIEF > widths)
    suspect |= (acts & ~(g[..., :-1] * g[..., 1:] > 0.0)).any(-1)
    shares = (BRIEF / (widths[1:] + widths[:-1])).clamp(max=1.0)
    drops = torch.maximum(changes[..., 1:].abs(), changes[..., :-1].abs()) * 2 * shares.square()
    units = torch.where(function, 1.0, g[..., 1:-1].abs())
    turns = changes[..., 1:] * changes[..., :-1] <= 0.0
    suspect |= (turns & ~(drops <= units)).any(-1)
    return suspect.any(0)
