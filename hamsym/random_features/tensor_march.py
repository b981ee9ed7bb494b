"""The march of many members in tensors, on a graphics processor or another device of torch.

It does what the compiled loop (:mod:`hamsym.random_features.window_loop`) does for one member
after the other: the same tables, iteration, judgement and lengths of windows. Here members are a
dimension of the tensors. In a round each of them, at its own time and with its own length, tries
one window; a member that converges leaves the iteration, and one that ends leaves the march.

Tensors have the shape (rows, members, points), or (members,). The host waits for the device once
in each iteration, for the number of members that have converged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias, TypeVar

import torch
from torch import Tensor

from hamsym.random_features.window_loop import (
    AIM,
    ENOUGH,
    EPS,
    FIRST,
    GOOD,
    GROW,
    ITERATIONS,
    NEAR,
    NOISE,
    RETRIES,
    ROUND_OFF,
    ROUND_OFF_TESTS,
    SHRINK,
    SLIVER,
    SLOW,
    SMALL,
    TINY,
)

__all__ = [
    "Functions",
    "MarchTables",
    "Marched",
    "Settings",
    "change",
    "disturbed",
    "evaluate",
    "first_lengths",
    "largest_of",
    "march",
    "take",
    "taken",
]

CROWDED = 0.75  # share of members in progress below which the others are removed from the tensors

Rates: TypeAlias = Callable[[Tensor | list[Tensor], Tensor, Tensor, Tensor], None]
Fields = TypeVar("Fields", bound=tuple[Tensor, ...])


class Functions(NamedTuple):
    """Generated functions (states, times, parameters, out) of tensors.

    States have the shape (dim, members, points), times (members, points), parameters
    (k, members, 1), and out has a row for each value.
    """

    velocity: Rates
    force: Rates
    hessian: Rates
    energy: Rates
    argument: Rates


class MarchTables(NamedTuple):
    """Tables of :class:`~hamsym.random_features.window_loop.Tables`, without columns of zeros."""

    nodes: Tensor
    integration: Tensor
    fit: Tensor
    between: Tensor
    to_between: Tensor
    rates_between: Tensor
    end: Tensor
    end_low: Tensor
    extrapolation: Tensor


class Settings(NamedTuple):
    """Constants of a march.

    Attributes
    ----------
    end : float
        Time at which it ends.
    longest, shortest : float
        Lengths of windows.
    order : float
        Order at which the residual falls with the length of the window.
    signs : Tensor
        1 and -1 at random, shape (dim, 1, points).
    separable : bool
        Whether H is separable.
    rounds : int
        After which the members that have not ended are given up.
    """

    end: float
    longest: float
    shortest: float
    order: float
    signs: Tensor
    separable: bool
    rounds: int


class Lanes(NamedTuple):
    """Members that have not ended, each on its own clock.

    Attributes
    ----------
    member : (n,)
        Number of the member.
    states, sizes : (dim, n)
        State, and largest magnitude of each component so far.
    times, lengths, last_lengths : (n,)
        Time, and lengths of the next and of the last window, infinite before the first.
    tails : (dim, n, terms)
        Chebyshev series of the rates in the last window.
    evaluations, failures : (n,)
        Evaluations of the vector field; iterations that failed since the last window.
    tolerances : (n,)
    parameters : (k, n, 1)
    """

    member: Tensor
    states: Tensor
    sizes: Tensor
    times: Tensor
    lengths: Tensor
    last_lengths: Tensor
    tails: Tensor
    evaluations: Tensor
    failures: Tensor
    tolerances: Tensor
    parameters: Tensor


class Marched(NamedTuple):
    """Windows of members, in the order in which they were found.

    Attributes
    ----------
    finished : (members,)
        Whether the member reached the end; the others may have windows too.
    evaluations : (members,)
    sizes : (dim, members)
    member, ends : (windows,)
        Number of the member, and time at the end of the window.
    states : (dim, windows)
        At its end.
    readouts : (dim, windows, m)
    """

    finished: Tensor
    evaluations: Tensor
    sizes: Tensor
    member: Tensor
    ends: Tensor
    states: Tensor
    readouts: Tensor


# -- tensors of members ----------------------------------------------------------------------------


def take(tensor: Tensor, members: Tensor) -> Tensor:
    """Select members from a tensor of shape (members,) or (rows, members, ...)."""
    return tensor.index_select(min(tensor.dim() - 1, 1), members)


def taken(fields: Fields, members: Tensor) -> Fields:
    """Select members from all tensors of a named tuple."""
    return type(fields)(*(take(tensor, members) for tensor in fields))


def largest_of(rows: Tensor) -> Tensor:
    """Largest magnitude over the last dimension; NaN if there is one."""
    # The infinity norm ignores NaN on some devices; the maximum does not.
    return rows.abs().amax(-1)


def change(rows: Tensor, others: Tensor) -> Tensor:
    """Largest magnitude of rows - others over the last dimension; NaN if there is one."""
    return (rows - others).abs_().amax(-1)


def evaluate(
    functions: Functions, states: Tensor, times: Tensor, parameters: Tensor, out: Tensor
) -> Tensor:
    """Write the rates of all components at states to out, and return it."""
    half = len(states) // 2
    functions.velocity(states, times, parameters, out[:half])
    functions.force(states, times, parameters, out[half:])
    return out


def disturbed(
    functions: Functions,
    signs: Tensor,
    share: float,
    states: Tensor,
    times: Tensor,
    parameters: Tensor,
) -> Tensor:
    """Evaluate the rates after states and times have changed by a share of themselves."""
    signs = signs[..., : states.shape[-1]] * share + 1.0
    late = times * signs[0]
    return evaluate(functions, states * signs, late, parameters, torch.empty_like(states))


def _round_off(
    functions: Functions,
    signs: Tensor,
    states: Tensor,
    times: Tensor,
    parameters: Tensor,
    rates: Tensor,
    factor: Tensor,
) -> Tensor:
    """Typical change of the rates for one unit in the last place, times a factor."""
    changes = (disturbed(functions, signs, EPS, states, times, parameters) - rates).abs()
    # Without the largest, which may lie at a jump.
    return (changes.sum(-1) - changes.amax(-1)) / (states.shape[-1] - 1) * factor


def _polynomials(x: Tensor, count: int) -> Tensor:
    """Chebyshev polynomials at x of shape (n, points), shape (n, count, points)."""
    values = [torch.ones_like(x), x]
    twice = 2.0 * x
    for _ in range(count - 2):
        values.append(twice * values[-1] - values[-2])
    return torch.stack(values, 1)


# -- one window of each member ---------------------------------------------------------------------


class _Iterates(NamedTuple):
    """Members whose window is iterated: their place, constants and present values."""

    place: Tensor
    alive: Tensor
    h: Tensor
    enough: Tensor
    times: Tensor  # (1, n, nodes)
    parameters: Tensor
    scale: Tensor
    base: Tensor  # (dim, n, 1)
    coordinates: Tensor
    momenta: Tensor
    rates: Tensor
    last: Tensor
    tests: Tensor


def _iterate(
    functions: Functions, tables: MarchTables, settings: Settings, lanes: Lanes, h: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Solve the collocation equations of windows of lengths h by fixed-point iteration.

    Returns
    -------
    found : (dim, n, nodes)
        Rates at the nodes, NaN without convergence.
    iterations, evaluations : (n,)
        Iterations until convergence, 0 without; evaluations of the vector field.
    """
    dim, count = lanes.states.shape
    half, nodes = dim // 2, len(tables.nodes)
    ratios = (lanes.lengths / lanes.last_lengths)[:, None]
    series = _polynomials(1.0 + 2.0 * ratios * tables.nodes, lanes.tails.shape[-1])
    guess = torch.bmm(lanes.tails.transpose(0, 1), series).transpose(0, 1).contiguous()
    base = lanes.states[..., None]
    z = torch.addcmul(base, guess @ tables.integration, h[:, None])
    scale = torch.maximum(lanes.sizes, torch.maximum(lanes.states.abs(), largest_of(z)))
    its = _Iterates(
        place=torch.arange(count, device=h.device),
        alive=torch.ones_like(h, dtype=torch.bool),
        h=h,
        enough=(ENOUGH * lanes.tolerances).clamp(min=4e-16),
        times=(lanes.times[:, None] + h[:, None] * tables.nodes)[None],
        parameters=lanes.parameters,
        scale=scale.clamp(min=TINY),
        base=base,
        coordinates=z[:half],
        momenta=z[half:],
        rates=torch.empty_like(z),
        last=torch.full_like(h, math.inf),
        tests=torch.zeros_like(lanes.failures),
    )
    found = h.new_full((dim, count, nodes), math.nan)
    iterations, evaluations = torch.zeros_like(its.tests), torch.zeros_like(its.tests)
    left = count
    for iteration in range(1, ITERATIONS + 1):
        length, times = its.h[:, None], its.times[0]
        speeds, slopes = its.rates[:half], its.rates[half:]
        # The functions take rows, of a tensor or in a list.
        rows = [*its.coordinates, *its.momenta]
        functions.force(rows, times, its.parameters, slopes)
        momenta = torch.addcmul(its.base[half:], slopes @ tables.integration, length)
        rows[half:] = momenta
        functions.velocity(rows, times, its.parameters, speeds)
        coordinates = torch.addcmul(its.base[:half], speeds @ tables.integration, length)
        moves, kicks = change(coordinates, its.coordinates), change(momenta, its.momenta)
        changes = torch.cat((moves, kicks))
        ratios = changes / its.scale
        largest, kick, last = ratios[:half].amax(0), ratios[half:].amax(0), its.last
        if settings.separable:
            # The momenta follow the coordinates of the last iteration: their next change is
            # smaller by as much as that of the coordinates is.
            later = kick * (largest / last) if iteration > 1 else largest
            kick = torch.where(largest <= last, later, kick)
        largest = torch.maximum(largest, kick)
        its = its._replace(coordinates=coordinates, momenta=momenta, last=largest)
        done = (largest <= its.enough) | ((largest < 1e-12) & (largest >= last))
        tested = its.alive & ~done & (largest >= last) & (its.tests < ROUND_OFF_TESTS)
        failed = ~(largest < 1e9)
        if iteration > 31:
            failed |= largest > 0.9 * last
        stopped = its.alive & (done | failed)
        stops, tests = torch.stack((stopped.sum(), tested.sum())).tolist()
        if tests:
            # A component may stay away from its limit by the round-off of its rate.
            its.tests.add_(tested)
            some = tested.nonzero()[:, 0]
            part = taken(its, some)
            z = torch.cat((part.coordinates, part.momenta))
            noise = _round_off(
                functions,
                settings.signs,
                z,
                part.times[0],
                part.parameters,
                part.rates,
                NOISE * part.h.abs(),
            )
            noise += part.enough * part.scale
            done[some] = (take(changes, some) / noise).amax(0) <= 1
            stopped = its.alive & (done | failed)
            stops = int(stopped.sum())
        if stops:
            some = stopped.nonzero()[:, 0]
            places = its.place[some]
            converged = done[some]
            rates = take(its.rates, some)
            rates.masked_fill_(~converged[:, None], math.nan)
            found.index_copy_(1, places, rates)
            iterations[places] = converged * iteration
            evaluations[places] = iteration + its.tests[some]
            left -= stops
            if left == 0:
                return found, iterations, evaluations
            its = its._replace(alive=its.alive & ~stopped)
            if left < CROWDED * len(its.h):
                its = taken(its, its.alive.nonzero()[:, 0])
    some = its.alive.nonzero()[:, 0]
    evaluations[its.place[some]] = ITERATIONS + its.tests[some]
    return found, iterations, evaluations


def _judge(
    functions: Functions,
    tables: MarchTables,
    settings: Settings,
    lanes: Lanes,
    h: Tensor,
    found: Tensor,
    readouts: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compare the residuals between the nodes with the tolerance.

    Returns
    -------
    errors : (n,)
        Largest ratio of the residual to the allowed one.
    sizes : (dim, n)
        Largest magnitude of each component so far, this window included.
    evaluations : (n,)
    """
    times = lanes.times[:, None] + h[:, None] * tables.between
    middle = readouts @ tables.to_between
    middle += lanes.states[..., None]
    flow = evaluate(functions, middle, times, lanes.parameters, torch.empty_like(middle))
    residuals = readouts @ tables.rates_between
    residuals /= h[:, None]
    residuals -= flow
    sizes = torch.maximum(lanes.sizes, largest_of(middle))
    lengths = h.abs()
    defects = largest_of(residuals) * lengths
    allowed = lanes.tolerances * sizes + ROUND_OFF * lengths * largest_of(found)
    allowed = allowed.clamp(min=TINY)
    errors = (defects / allowed).amax(0)
    evaluations = torch.ones_like(lanes.evaluations)
    some = (~(errors <= GOOD)).nonzero()[:, 0]
    if len(some):
        # Where large terms cancel, the round-off is many units of the rates.
        noise = _round_off(
            functions,
            settings.signs,
            take(middle, some),
            times[some],
            take(lanes.parameters, some),
            take(flow, some),
            NOISE * lengths[some],
        )
        errors[some] = (take(defects, some) / (take(allowed, some) + noise)).amax(0)
        evaluations[some] = 2
    return errors, sizes, evaluations


# -- the march -------------------------------------------------------------------------------------


def first_lengths(
    functions: Functions,
    states: Tensor,
    rates: Tensor,
    parameters: Tensor,
    span: tuple[float, float],
) -> Tensor:
    """Lengths for the first windows, from the times in which the components change.

    States have the shape (dim, n) and rates (dim, n, 1); see
    :func:`hamsym.random_features.window_loop.first_length`.
    """
    start, end = span
    whole = abs(end - start)
    rates = rates[..., 0]

    def shortest(times: Tensor, possible: Tensor) -> Tensor:
        return torch.where(possible, times, whole).amin(0).clamp(max=whole)

    times = (states / rates).abs()
    step = math.copysign(NEAR, end - start) * shortest(times, (states != 0.0) & (times < whole))
    near = (states + step * rates)[..., None]
    late = (start + step)[:, None]
    later = evaluate(functions, near, late, parameters, torch.empty_like(near))[..., 0]
    slopes = ((later - rates) / step).abs()
    own = torch.maximum((states.abs() / slopes).sqrt(), rates.abs() / slopes)
    return FIRST * shortest(own, (slopes > 0.0) & (slopes < math.inf) & (own > 0.0))


def march(
    functions: Functions,
    tables: MarchTables,
    settings: Settings,
    start: float,
    states: Tensor,
    rates: Tensor,
    lengths: Tensor,
    evaluations: Tensor,
    tolerances: Tensor,
    parameters: Tensor,
    room: float,
) -> Marched | None:
    """March members from their states, shape (dim, members), to the end.

    Parameters
    ----------
    start : float
        Time of the states.
    rates : (dim, members, 1)
        Rates there.
    lengths : (members,)
        Of the first windows.
    evaluations : (members,)
        Evaluations so far.
    tolerances : (members,)
    parameters : (k, members, 1)
    room : float
        Windows beyond which there is no result.
    """
    dim, count = states.shape
    direction = 1.0 if settings.end > start else -1.0
    retries = 0 if dim * len(tables.nodes) <= SMALL else RETRIES
    tails = states.new_zeros((dim, count, tables.extrapolation.shape[1]))
    tails[..., 0] = rates[..., 0]
    lanes = Lanes(
        member=torch.arange(count, device=states.device),
        states=states,
        sizes=states.abs(),
        times=torch.full_like(lengths, start),
        lengths=lengths,
        last_lengths=torch.full_like(lengths, math.inf),
        tails=tails,
        evaluations=evaluations,
        failures=torch.zeros_like(evaluations),
        tolerances=tolerances,
        parameters=parameters,
    )
    finished = torch.zeros_like(lengths, dtype=torch.bool)
    all_sizes, all_evaluations = torch.empty_like(states), torch.empty_like(evaluations)
    parts: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
    going, stored = ~finished, 0
    for turn in range(settings.rounds + 1):
        lefts = (settings.end - lanes.times).abs()
        lengths = torch.minimum(lanes.lengths, lefts).clamp(max=settings.longest)
        # Equal windows may miss the end by round-off: no sliver is left before it.
        lengths = torch.where(lefts - lengths < SLIVER * lengths, lefts, lengths)
        lanes = lanes._replace(lengths=lengths)
        kept = (going & (lengths >= settings.shortest)).nonzero()[:, 0]
        if len(kept) < len(lengths) or turn == settings.rounds:
            all_sizes[:, lanes.member] = lanes.sizes
            all_evaluations[lanes.member] = lanes.evaluations
            lanes, lefts = taken(lanes, kept), lefts[kept]
        if not len(kept) or turn == settings.rounds:
            break
        h = direction * lanes.lengths
        found, iterations, spent = _iterate(functions, tables, settings, lanes, h)
        solved = iterations > 0
        readouts = found @ tables.fit
        readouts *= h[:, None]
        errors, sizes, more = _judge(functions, tables, settings, lanes, h, found, readouts)
        accepted = solved & (errors <= 1)
        # Rounding Q(1) would push every window the same way, and energies would drift.
        ends = readouts @ tables.end + readouts @ tables.end_low + lanes.states
        last = lanes.lengths == lefts
        times = torch.where(last, settings.end, lanes.times + h)
        some = accepted.nonzero()[:, 0]
        stored += len(some)
        if stored > room:
            return None
        if len(some):
            parts.append((lanes.member[some], times[some], take(ends, some), take(readouts, some)))
        finished[lanes.member] = accepted & last
        growth = (AIM / errors.clamp(min=1e-30)).pow(1 / settings.order).clamp(max=GROW)
        growth = torch.where(errors <= GOOD, growth.clamp(min=1.0), growth)
        growth = torch.where(iterations > SLOW + 1, SHRINK, growth)
        factor = (GOOD / errors).pow(1 / settings.order).clamp(0.3, 0.9)
        factor = torch.where(errors < math.inf, factor, 0.3)
        factor = torch.where(solved, factor, SHRINK)
        going = torch.where(accepted, ~last, solved | (lanes.failures < retries))
        lanes = lanes._replace(
            states=torch.where(accepted, ends, lanes.states),
            sizes=torch.where(accepted, sizes, lanes.sizes),
            times=torch.where(accepted, times, lanes.times),
            lengths=lanes.lengths * torch.where(accepted, growth, factor),
            last_lengths=torch.where(accepted, lanes.lengths, lanes.last_lengths),
            tails=torch.where(accepted[:, None], found @ tables.extrapolation, lanes.tails),
            evaluations=lanes.evaluations + spent + solved * more,
            failures=torch.where(accepted, 0, lanes.failures + ~solved),
        )
    if not parts:
        none, columns = lanes.member[:0], tables.fit.shape[1]
        empty = states.new_empty((dim, 0, columns))
        parts = [(none, lengths[:0], empty[..., 0], empty)]
    member, times, ends, readouts = (
        torch.cat(part, min(part[0].dim() - 1, 1)) for part in zip(*parts, strict=True)
    )
    return Marched(finished, all_evaluations, all_sizes, member, times, ends, readouts)
