"""Options of the methods that make a flow map; they are checked before torch is imported."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from hamsym.errors import KeywordError
from hamsym.flow_maps.network_map import ENVELOPES
from hamsym.suggestions import advice, did_you_mean
from hamsym.support.option_fields import option
from hamsym.support.validation import require, require_positive, require_whole

__all__ = ["FeatureMapOptions", "NetworkMapOptions", "checked_options"]

_MOST_NEURONS = 10_000  # of a layer
_OPTIMIZERS = ("levenberg-marquardt", "adam")
_DEVICES = ("cpu", "cuda")


@dataclass(frozen=True, kw_only=True)
class FeatureMapOptions:
    """Options of the method "features"; see :func:`hamsym.flow_map`."""

    max_solutions: int = option(100_000, "Largest number of solutions of which the map is made.")

    def __post_init__(self) -> None:
        require_whole("max_solutions", self.max_solutions, 1)


@dataclass(frozen=True, kw_only=True)
class NetworkMapOptions:
    """Options of the method "network"; see :func:`hamsym.flow_map`."""

    hidden: Sequence[int] = option((40, 40), "Neurons of each hidden layer.", unit="WIDTHS")
    envelope: str = option(
        "exponential", "Envelope that fixes the initial state.", choices=ENVELOPES
    )
    tau: float | None = option(
        None, "Unit of time of the envelope.", default_text="that of a window", unit="TIME"
    )
    frequency: float = option(2.0, "Largest initial weight of the first layer.")
    windows: int = option(1, "Networks, one after the other in time.")
    optimizer: str = option("levenberg-marquardt", "Optimizer.", choices=_OPTIMIZERS)
    collocation_points: int | None = option(
        None, "Points of an iteration in each process.", default_text="as many rows as weights"
    )
    stages: int = option(4, "Spans of sequential training in each window.")
    iterations: int = option(1_000, "Largest number of iterations for each window.")
    patience: int | None = option(None, "Stop after this many iterations without a lower loss.")
    learning_rate: float = option(3e-3, "Learning rate of Adam.")
    time_limit: float | None = option(None, "End the training after this time.", unit="SECONDS")
    checkpoint: str | os.PathLike[str] | None = option(
        None, "File from which the training is resumed."
    )
    checkpoint_every: int = option(20, "Iterations between two checkpoints.")
    device: str = option("cpu", "Device of the training.", choices=_DEVICES)

    def __post_init__(self) -> None:
        widths = self.hidden if isinstance(self.hidden, Sequence) else ()
        whole = [isinstance(n, int) and not isinstance(n, bool) for n in widths]
        valid = bool(whole) and all(whole) and all(1 <= n <= _MOST_NEURONS for n in widths)
        require(valid, "hidden", self.hidden, "a list of layer widths, e.g. (40, 40)")
        for name, among in (
            ("envelope", ENVELOPES),
            ("optimizer", _OPTIMIZERS),
            ("device", _DEVICES),
        ):
            value = getattr(self, name)
            require(value in among, name, value, " or ".join(f'"{entry}"' for entry in among))
        for name in ("windows", "stages", "iterations", "checkpoint_every"):
            require_whole(name, getattr(self, name), 1)
        for name in ("collocation_points", "patience"):
            if getattr(self, name) is not None:
                require_whole(name, getattr(self, name), 1)
        for name in ("frequency", "learning_rate"):
            require_positive(name, getattr(self, name))
        for name in ("tau", "time_limit"):
            if getattr(self, name) is not None:
                require_positive(name, getattr(self, name))


_METHODS: dict[str, type[FeatureMapOptions] | type[NetworkMapOptions]] = {
    "features": FeatureMapOptions,
    "network": NetworkMapOptions,
}


def checked_options(
    method: str, options: Mapping[str, Any]
) -> FeatureMapOptions | NetworkMapOptions:
    """Return the options of a method as its dataclass.

    Raises
    ------
    InputError
        If the method or one of its options does not exist, or a value is invalid.

    Examples
    --------
    >>> checked_options("network", {"hidden": (20, 20)}).windows
    1
    """
    known = isinstance(method, str) and method in _METHODS
    require(known, "method", method, " or ".join(f'"{name}"' for name in _METHODS))
    own = _METHODS[method]
    names = {name: [field.name for field in fields(kind)] for name, kind in _METHODS.items()}
    for name in options:
        if name not in names[method]:
            instead = advice(name, "flow_map", (*names[method], "tol", "atol"))
            if instead is not None:
                raise KeywordError(f"'{name}' is not an argument of flow_map; {instead}")
            others = [other for other, listed in names.items() if name in listed]
            hint = did_you_mean(name, names[method])
            belongs = f", but of method '{others[0]}'" if others else hint
            raise KeywordError(
                f"'{name}' is not an option of method '{method}'{belongs}; it has "
                f"{', '.join(names[method])}"
            )
    return own(**options)
