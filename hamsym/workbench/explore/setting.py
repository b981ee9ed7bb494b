"""What the fields and sliders of the page say, and where their sliders end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from hamsym.errors import InputError

_POSITIONS = 200  # of a slider


@dataclass(frozen=True)
class SliderRange:
    """A slider with whole positions from 0 to ``positions``.

    Sliders of browsers count in decimals and are useless for a momentum of 1e-24, so that the
    positions are whole numbers and the values are computed here.

    Examples
    --------
    >>> slider = SliderRange.around(1.3)
    >>> slider.low, slider.high
    (-3.0, 3.0)
    >>> slider.value(slider.position(1.3))
    1.29
    """

    #: low, high: Values at the ends.
    low: float
    high: float
    positions: int = _POSITIONS

    @classmethod
    def around(cls, value: float, size: float = 0.0, *, positive: bool = False) -> SliderRange:
        """Make a range with round ends that contains a value and as much again.

        Raise InputError if the value is not finite.

        - size: Usual size of such values, for a value of zero.
        - positive: Begin above zero, at a hundredth of the largest value.
        """
        if not math.isfinite(value):
            raise InputError(f"{value} is not a finite number; give one such as 1.3")
        largest = _round_up(2 * abs(value) or 2 * abs(size) or 2.0)
        if positive and value > 0:
            return cls(largest / _POSITIONS, largest, _POSITIONS - 1)
        return cls(-largest, largest)

    def suits(self, value: float) -> bool:
        """Return whether a value is between the ends, and far enough from zero to be moved."""
        return self.low <= value <= self.high and not 0 < abs(value) < 0.05 * self.high

    def value(self, position: float) -> float:
        """Return the value at a position, with as many digits as tell positions apart."""
        exact = self.low + (self.high - self.low) * position / self.positions
        step = (self.high - self.low) / self.positions
        digits = 2 - math.floor(math.log10(step))
        return round(exact, digits) if digits < 300 else exact

    def position(self, value: float) -> int:
        """Return the position next to a value; an end if it is outside."""
        share = (value - self.low) / (self.high - self.low)
        return min(max(round(share * self.positions), 0), self.positions)


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 3, 5, 10 times a power of ten."""
    power = math.floor(math.log10(value))
    unit = 10.0**power if power > -300 else 1e-300
    for factor in (1, 2, 3, 5, 10):
        if value <= factor * unit * (1 + 1e-12):
            return float(f"{factor}e{power}") if power > -300 else factor * unit
    return value


def usual_state(names: Sequence[str]) -> dict[str, float]:
    """Return an initial state for a new H: different coordinates, so that nothing collides.

    Examples
    --------
    >>> usual_state(("x", "y", "p_x", "p_y"))
    {'x': 1.0, 'y': 0.54, 'p_x': 0.0, 'p_y': 0.67}
    """
    dof = len(names) // 2
    coordinates = {name: round(math.cos(k), 2) for k, name in enumerate(names[:dof])}
    return coordinates | {name: round(0.8 * math.sin(k), 2) for k, name in enumerate(names[dof:])}


@dataclass(frozen=True)
class Setting:
    """A problem as the page has it, ready to be sent to a worker."""

    #: formula, q, p: H; coordinates and momenta between commas, or empty to find them from the
    #: names.
    formula: str
    q: str = ""
    p: str = ""
    #: Lines such as ``p = -c*p``.
    forces: str = ""
    z0: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 20.0)
    tol: float = 1e-9

    def with_names(self, names: Sequence[str], parameter_names: Sequence[str]) -> Setting:
        """Return the setting of an H with these names: values of names that stay are kept.

        Examples
        --------
        >>> Setting("p**2/2 + k*x**2/2", z0={"x": 2.0}).with_names(("x", "p"), ("k",)).z0
        {'x': 2.0, 'p': 0.0}
        """
        usual = usual_state(names)
        return replace(
            self,
            z0={name: self.z0.get(name, usual[name]) for name in names},
            parameters={name: self.parameters.get(name, 1.0) for name in parameter_names},
        )

    def summary(self, limit: int = 6) -> str:
        """Return the values in one line.

        Examples
        --------
        >>> Setting("p**2/2 + x**2/2", z0={"x": 1.3, "p": 1.0}).summary()
        'x = 1.3, p = 1, t from 0 to 20, tol 1e-09'
        """
        values = {**self.z0, **self.parameters}
        shown = [f"{name} = {value:g}" for name, value in list(values.items())[:limit]]
        if len(values) > limit:
            shown.append(f"{len(values) - limit} more values")
        start, end = self.span
        return ", ".join([*shown, f"t from {start:g} to {end:g}", f"tol {self.tol:g}"])
