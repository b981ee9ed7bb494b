"""The benchmarks by name. A new one is a module with ``measure`` and ``table``, and a row here."""

from __future__ import annotations

from typing import Protocol

from . import (
    certificates,
    derivation,
    dimension,
    enclosures,
    ensembles,
    epoch,
    equal_error,
    families,
    first_call,
    flow_map_queries,
    flow_maps,
    implicit,
    long_spans,
    loops,
    objectives,
    periodic_orbits,
    pyhamsys_steps,
    span,
    trained_networks,
    training_peers,
    work_precision,
)
from .results import Section


class Benchmark(Protocol):
    """A module that measures one thing."""

    __doc__: str | None

    def measure(self, quick: bool) -> Section:
        """Run the benchmark; ``quick`` takes seconds and shows only that it runs."""

    def table(self, section: Section) -> str:
        """The results as a Markdown table with its notes."""


#: In the order of the documentation page.
BENCHMARKS: dict[str, Benchmark] = {
    "work-precision": work_precision,
    "first-call": first_call,
    "dimension": dimension,
    "span": span,
    "long-spans": long_spans,
    "loops": loops,
    "pyhamsys": pyhamsys_steps,
    "ensembles": ensembles,
    "families": families,
    "equal-error": equal_error,
    "implicit": implicit,
    "flow-maps": flow_maps,
    "flow-map-queries": flow_map_queries,
    "trained-networks": trained_networks,
    "training-peers": training_peers,
    "objectives": objectives,
    "epoch": epoch,
    "derivation": derivation,
    "certificates": certificates,
    "enclosures": enclosures,
    "periodic-orbits": periodic_orbits,
}
