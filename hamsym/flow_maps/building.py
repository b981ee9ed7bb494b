"""Expansion of the solutions over a box: legs, one after the other, and splits of the box.

Input:  a box, a span, the allowed error.
Output: :class:`Built`, the map with the time up to which it holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.domain import Domain, box_domain, image_domain, random_places, split_domain
from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.flow_maps.legs import FailedError, LegBuilder
from hamsym.flow_maps.time_order import ended

_CORNERS, _IMAGE = 1_000, 20_000  # samples of an image: corners, and others
_DEEPEST = 10  # splits of a domain, one after the other
_SHORTEST = 0.005  # of the span, of a leg that ends where a solution fails
_AT_END = 0.3  # probability that an input of a sample is an end of its interval


@dataclass(frozen=True)
class Built:
    """An expansion over a box."""

    map: Any
    #: Time up to which it holds.
    reached: float
    #: Why it does not reach the end of the span; empty if it does.
    failure: str
    #: Ends of the pieces of all its legs, from the start to ``reached``.
    edges: np.ndarray


class Builder:
    """Construction of the expansion of one box over one span.

    - solve: (initial states, parameter values, span) -> Solutions.
    - scale: Size of each component, shape (dim,).
    - note: Takes a text about the progress, and the time that is reached.
    """

    def __init__(
        self,
        box: Box,
        span: tuple[float, float],
        solve: Callable[..., Solutions],
        scale: np.ndarray,
        random: np.random.Generator,
        note: Callable[..., None],
    ) -> None:
        self._box, self._span, self._solve = box, span, solve
        self._scale, self._random, self._note = scale, random, note

    def build(self, allowed: np.ndarray) -> Built:
        """Return an expansion with an allowed error of each component, shape (dim,).

        Raise InputError if a solution fails at the start of the span, or too many solutions would
        be needed.
        """
        self._allowed = allowed
        try:
            return self._over(box_domain(self._box), self._span[0])
        except FailedError as error:
            raise InputError(f"there is no flow map over this box: {error}") from None

    def _over(self, domain: Domain, begin: float, depth: int = 0) -> Built:
        """Return the expansion over a domain from a time to the end of the span."""
        end, dim = self._span[1], self._box.H.dim
        maps: list[Any] = []
        starts, edges = [begin], [begin]
        horizon, failure = end, ""
        while True:
            try:
                trial = LegBuilder(
                    domain,
                    (starts[-1], horizon),
                    self._solutions,
                    self._allowed,
                    self._random,
                    may_end=self._box.is_whole,
                    note=self._note,
                )
            except FailedError as error:
                if not maps:
                    raise
                starts.pop()
                failure = str(error)
                break
            if trial.splits:
                part = self._split(domain, starts[-1], trial.widest, depth + 1)
                maps.append(part.map)
                edges.extend(part.edges[1:].tolist())
                failure = part.failure
                break
            maps.append(trial.leg())
            edges.extend((starts[-1] + maps[-1].edges[1:]).tolist())
            if horizon == end and trial.is_complete:
                edges[-1] = end
                break
            failure = trial.failure
            short = not abs(edges[-1] - starts[-1]) > _SHORTEST * abs(end - begin)
            if failure and (short or domain.samples is None):
                break
            # The image may contain less than what failed: a further leg may reach the end.
            failure = ""
            # Nothing is computed beyond twice the last leg.
            horizon = edges[-1] + 2 * (edges[-1] - starts[-1])
            if not abs(horizon - begin) < abs(end - begin):
                horizon = end
            domain = self._image(maps[-1], trial.domain, edges[-1])
            starts.append(edges[-1])
        kept = np.arange(dim, len(domain))
        whole = maps[0] if len(maps) == 1 else Chain(maps, np.array(starts[1:]), kept)
        return Built(whole, edges[-1], failure, np.array(edges))

    def _split(self, domain: Domain, begin: float, direction: int, depth: int) -> Built:
        """Return the expansions over two halves of a domain."""
        if depth > _DEEPEST:
            raise FailedError("the solutions depend too strongly on the start for an expansion")
        halves = [half for half in split_domain(domain, direction) if half is not None]
        parts = [self._over(half, begin, depth) for half in halves]
        if len(parts) == 1:
            return parts[0]
        threshold = -float(domain.shift[direction])
        sign = np.sign(self._span[1] - self._span[0])
        reached = float(sign * min(sign * part.reached for part in parts))
        maps = [p.map if p.reached == reached else ended(p.map, reached) for p in parts]
        split = Split(domain.scaling[direction], threshold, *maps)
        edges = np.unique(np.concatenate([part.edges for part in parts]))[:: int(sign)]
        failures = [part.failure for part in parts if part.failure]
        return Built(
            split, reached, failures[0] if failures else "", edges[sign * edges <= sign * reached]
        )

    def _solutions(self, domain: Domain, y: np.ndarray, span: tuple[float, float]) -> Solutions:
        """Return the solutions from scaled inputs of a domain."""
        inputs = domain.at(y)
        return self._solve(domain.states(inputs), domain.values(inputs), span)

    def _image(self, leg: Leg, domain: Domain, time: float) -> Domain:
        """Return a domain around the states of a leg at a time; all components are its inputs."""
        d, H = len(domain), self._box.H
        y = random_places(self._random, _IMAGE, d, _AT_END)
        corners = self._random.choice((-1.0, 1.0), (_CORNERS, d))
        inputs = domain.at(np.concatenate((corners, y)))
        states = leg.evaluate(np.full(len(inputs), time), inputs)
        of_H = set(H.parameter_names)
        names = tuple(name if name in of_H else "" for name in self._box.parameters)
        return image_domain(np.column_stack((states, inputs[:, H.dim :])), names, self._scale)
