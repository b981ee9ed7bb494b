"""Pictures of states: points in a plane, joined by rods.

A pendulum, a chain, bodies in a plane and a point of a phase plane are one kind of picture: each
state becomes the places of some points, of which some are joined by rods and some leave a tail.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.captions import axis_words
from hamsym.plotting.names import math_name, math_unit, quantity
from hamsym.support.validation import is_positive
from hamsym.workbench.animations.motion import Motion
from hamsym.workbench.animations.polar import (
    ANGLE,
    DOWN,
    RADIUS,
    RIGHT,
    coupled,
    direction_of_zero,
    is_angle,
    polar_pairs,
)

#: Kinds of pictures that are made from names of components.
KINDS = ("plane", "phase", "polar", "pendulum", "chain")

_MOST_RODS = 3  # of a pendulum that is recognised by the names of its angles alone


@dataclass(frozen=True)
class Scene:
    """A picture of states."""

    #: States, shape (..., dim), and times, shape (...), to places of points, (..., points, 2).
    places: Callable[[np.ndarray, np.ndarray], np.ndarray]
    #: Of the axes: a text and a unit each.
    labels: tuple[tuple[str, str], tuple[str, str]]
    #: Names of the points for a legend; empty for one without.
    points: tuple[str, ...] = ()
    #: Pairs of points that are joined.
    rods: tuple[tuple[int, int], ...] = ()
    #: Points that leave a tail.
    traced: tuple[int, ...] = (0,)
    #: Points that are drawn small.
    pivots: tuple[int, ...] = ()
    #: Whether a unit is as long on both axes.
    equal: bool = True
    #: The components of the axes, if level sets of H belong to the picture.
    level_sets: tuple[int, int] | None = None
    #: What was chosen, in words.
    note: str = ""


def scene_of(
    motion: Motion,
    names: tuple[Any, ...],
    kind: str | None,
    lengths: Any,
    points: Callable[..., Any] | None,
    rods: Sequence[tuple[int, int]],
) -> Scene:
    """Return the picture that was asked for, or the one that the names of coordinates suggest.

    Raise InputError if a name is unknown, options do not fit together, or no picture is suggested.
    """
    H = motion.H
    if points is not None:
        if names or kind is not None or lengths is not None:
            raise InputError("points makes the whole picture; leave names, kind and lengths out")
        return _of_points(motion, points, rods)
    if len(rods):
        raise InputError("rods joins points; give points as well, or kind='pendulum'")
    drawn = [H.observable(name) for name in names]
    chosen = [each.place for each in drawn if each.place is not None]
    if len(chosen) < len(drawn):
        if kind not in (None, "plane") or lengths is not None:
            formula = next(each.text for each in drawn if each.place is None)
            raise InputError(f"'{formula}' is a formula, which is drawn in a plane; leave kind out")
        return _plane(motion, drawn)
    if kind is None:
        kind, chosen = suggested_kind(H, chosen) if lengths is None else ("pendulum", chosen)
    if kind not in KINDS:
        raise InputError(f"kind={kind!r} is unknown; give one of {', '.join(KINDS)}")
    if lengths is not None and kind != "pendulum":
        raise InputError(f"lengths are those of a pendulum, not of kind='{kind}'; leave them out")
    if kind == "polar":
        return _polar(H, chosen)
    if kind == "pendulum":
        return _pendulum(motion, chosen or list(range(H.dof)), lengths)
    if kind == "chain":
        return _chain(H, chosen or list(range(H.dof)))
    if kind == "phase":
        return _phase(motion, chosen or [0, H.dof])
    places = chosen or list(range(H.dof))
    return _plane(motion, [H.observable(H.names[place]) for place in places])


def _listed(names: Sequence[str]) -> str:
    if len(names) <= 8:
        return ", ".join(names)
    return f"{', '.join(names[:4])} ... {names[-1]}"


def suggested_kind(H: Hamiltonian, chosen: list[int]) -> tuple[str, list[int]]:
    """Return the kind of picture that the names of coordinates suggest, and components.

    Raise InputError if they suggest none.

    - chosen: Components that were named.
    """
    d = H.dof
    if chosen:
        phase = len(chosen) == 2 and abs(chosen[0] - chosen[1]) == d
        return ("phase" if phase else "plane"), chosen
    names = list(H.names[:d])
    parts = [re.fullmatch(r"(.*?)_?(\d*)", name) for name in names]
    stems = [part[1] if part else name for part, name in zip(parts, names, strict=True)]
    numbers = [part[2] if part else "" for part in parts]
    angles = all(map(ANGLE.fullmatch, names)) and len(set(stems)) == 1
    hanging = angles and coupled(H, list(range(d)))
    if hanging and d <= _MOST_RODS:
        return "pendulum", list(range(d))
    if polar_pairs(H):
        return "polar", []
    if d == 1:
        return "phase", [0, 1]
    at = dict(zip(zip(stems, numbers, strict=True), range(d), strict=True))
    bodies = sorted({number for stem, number in at if stem == "x"}, key=lambda n: int(n or 0))
    if bodies and all(stem in ("x", "y", "z") for stem in stems):
        pairs = [at.get((stem, number)) for number in bodies for stem in ("x", "y")]
        if None not in pairs:
            return "plane", [place for place in pairs if place is not None]
    if d > 2 and len(set(stems)) == 1 and all(numbers) and not ANGLE.fullmatch(names[0]):
        return "chain", list(range(d))
    fitting = "kind='pendulum', " if hanging else ""
    fitting += "kind='chain', " if len(set(stems)) == 1 and not angles else ""
    raise InputError(
        f"the coordinates {_listed(names)} have no usual picture; name two components, such as "
        f"'{H.names[0]}', '{H.names[d]}', or give {fitting}points=, places of points by a function "
        "of the state"
    )


def _plane(motion: Motion, drawn: list[Observable]) -> Scene:
    H = motion.H
    if len(drawn) < 2 or len(drawn) % 2:
        raise InputError(
            "a plane needs two components for each body, such as 'x', 'y' or 'x1', 'y1', 'x2', 'y2'"
        )
    pairs = list(zip(drawn[::2], drawn[1::2], strict=True))

    def places(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        found = [each.values(z, t, motion.parameters) for each in drawn]
        columns = np.stack(np.broadcast_arrays(z[..., 0], *found)[1:], axis=-1)
        return columns.reshape(*columns.shape[:-1], -1, 2)

    several = len(pairs) > 1
    labels = [_shared(drawn[::2]), _shared(drawn[1::2])]
    chosen = [each.place for each in drawn if each.place is not None]
    left = [name for i, name in enumerate(H.names[: H.dof]) if i not in chosen]
    note = ""
    if left and len(chosen) == len(drawn) and all(i < H.dof for i in chosen):
        note = f"Projected along {_listed(left)}"
    return Scene(
        places,
        (labels[0], labels[1]),
        points=tuple(f"{axis_words(x)[0]}, {axis_words(y)[0]}" for x, y in pairs)
        if several
        else (),
        traced=tuple(range(len(pairs))),
        equal=len(chosen) == len(drawn) and _alike(H, chosen),
        note=note,
    )


def _shared(drawn: Sequence[Observable]) -> tuple[str, str]:
    """Return the label of an axis for a component or formula of one or of several bodies."""
    if len(drawn) == 1:
        return axis_words(drawn[0])
    names, units = [each.text for each in drawn], {each.unit for each in drawn}
    if len(units) > 1:
        raise InputError(f"{_listed(names)} have different units; draw them one by one")
    stems = {re.sub(r"_?\d+$", "", name) for name in names}
    shared = len(stems) == 1 and all(each.place is not None for each in drawn)
    own = [math_name(stems.pop())] if shared else [axis_words(each)[0] for each in drawn]
    return ", ".join(own), math_unit(units.pop())


def _alike(H: Hamiltonian, chosen: list[int]) -> bool:
    """Whether components are lengths in space, or momenta, of one unit."""
    names = [H.names[i] for i in chosen]
    if len({i < H.dof for i in chosen}) > 1 or len({H.units.get(name) for name in names}) > 1:
        return False
    own = [H.names[i % H.dof] for i in chosen]
    return not any(ANGLE.fullmatch(name) or RADIUS.fullmatch(name) for name in own)


def _phase(motion: Motion, chosen: list[int]) -> Scene:
    H = motion.H
    if len(chosen) != 2:
        raise InputError("a phase plane needs two components, such as 'x', 'p_x'")
    i, j = chosen
    pictured = H.dof == 1 and H.time is None and not motion.varied
    note = ""
    if H.dof == 1 and not pictured:
        reason = "H depends on time" if H.time is not None else "parameters differ"
        note = f"No level sets of H: {reason}"
    return Scene(
        lambda z, t: z[..., None, [i, j]],
        (quantity(H, H.names[i]), quantity(H, H.names[j])),
        equal=False,
        level_sets=(i, j) if pictured else None,
        note=note,
    )


def _polar(H: Hamiltonian, chosen: list[int]) -> Scene:
    """Bodies at distances and angles from the origin."""
    pairs = list(zip(chosen[::2], chosen[1::2], strict=False)) if chosen else polar_pairs(H)
    if not pairs or len(chosen) % 2 or any(k >= H.dof for k in chosen):
        raise InputError(
            "polar coordinates are a distance and an angle for each body; name such pairs, for "
            "example 'r', 'theta'"
        )
    radii, angles = [i for i, _ in pairs], [j for _, j in pairs]
    if any(RADIUS.fullmatch(H.names[j]) for j in angles) or any(
        ANGLE.fullmatch(H.names[i]) for i in radii
    ):
        i, j = pairs[0]
        raise InputError(
            f"'{H.names[i]}', '{H.names[j]}' are not a distance and an angle; name these, the "
            "distance first"
        )
    units = {H.units.get(H.names[i], "1") for i in radii}
    if len(units) > 1:
        raise InputError(f"{_listed([H.names[i] for i in radii])} have different units")
    zero = direction_of_zero(H, pairs)

    def places(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        distance, angle = z[..., radii], z[..., angles] + zero
        ends = distance[..., None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        return np.concatenate((np.zeros_like(ends[..., :1, :]), ends), axis=-2)

    count, unit = len(pairs), math_unit(units.pop())
    named = ", ".join(H.names[j] for j in angles)
    rods: tuple[tuple[int, int], ...] = ()
    if zero == RIGHT:
        source = f"{named} from the horizontal axis"
    else:
        rods = tuple((0, k) for k in range(1, count + 1))
        source = f"{named} from the vertical, {'down' if zero == DOWN else 'up'}"
    return Scene(
        places,
        (("horizontal", unit), ("vertical", unit)),
        rods=rods,
        traced=tuple(range(1, count + 1)),
        pivots=(0,),
        note=f"Polar coordinates, {source}",
    )


def _pendulum(motion: Motion, chosen: list[int], lengths: Any) -> Scene:
    H = motion.H
    if any(i >= H.dof for i in chosen):
        raise InputError("a pendulum is drawn by its angles, which are coordinates; name those")
    for i in chosen:
        if not is_angle(H, i):
            polar = ", or give kind='polar'" if polar_pairs(H) else ""
            raise InputError(
                f"'{H.names[i]}' is no angle of a pendulum; name those that are{polar}"
            )
    values, source = _lengths(motion, chosen, lengths)

    def places(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        angles = z[..., chosen]
        x = np.cumsum(values * np.sin(angles), axis=-1)
        y = np.cumsum(-values * np.cos(angles), axis=-1)
        ends = np.stack((x, y), axis=-1)
        return np.concatenate((np.zeros_like(ends[..., :1, :]), ends), axis=-2)

    count = len(chosen)
    named = ", ".join(H.names[i] for i in chosen)
    return Scene(
        places,
        (("", ""), ("", "")),
        rods=tuple((k, k + 1) for k in range(count)),
        traced=(count,),
        pivots=(0,),
        note=f"Rods of {source} at {named} from the vertical",
    )


def rod_parameters(H: Hamiltonian, count: int, varied: Sequence[str] = ()) -> list[str]:
    """Return the parameters that are the lengths of rods by their names; none if H has no such."""
    known = [name for name in H.parameters if name not in varied]
    for shape in ("l{}", "L{}", "l_{}", "L_{}"):
        listed = [shape.format(k + 1) for k in range(count)]
        if all(name in known for name in listed):
            return listed
    return next(([name] * count for name in ("l", "L") if name in known), [])


def _lengths(motion: Motion, chosen: list[int], lengths: Any) -> tuple[np.ndarray, str]:
    """Return the lengths of rods, and where they are from."""
    H, count = motion.H, len(chosen)
    known = H.parameters
    if lengths is None:
        names = rod_parameters(H, count, motion.varied)
        if not names:
            return np.ones(count), "equal lengths"
        one = len(set(names)) == 1 and names[0][-1].isalpha()
        source = f"length {names[0]}" if one else "lengths " + ", ".join(names)
        return _checked([known[name] for name in names]), source
    given = [lengths] if isinstance(lengths, str) or np.ndim(lengths) == 0 else list(lengths)
    if len(given) == 1:
        given *= count
    if len(given) != count:
        raise InputError(f"lengths={lengths!r} are not {count}; give one for each angle")
    found = []
    for value in given:
        if isinstance(value, str) and (value not in known or value in motion.varied):
            raise InputError(f"lengths: '{value}' is no parameter with one value; give a number")
        found.append(known[value] if isinstance(value, str) else value)
    return _checked(found), "lengths " + ", ".join(
        value if isinstance(value, str) else f"{value:.4g}" for value in given
    )


def _checked(values: list[Any]) -> np.ndarray:
    if not all(map(is_positive, values)):
        raise InputError(f"lengths={values!r} are not all numbers above 0; give such numbers")
    return np.array(values, dtype=float)


def _chain(H: Hamiltonian, chosen: list[int]) -> Scene:
    count, names = len(chosen), [H.names[i] for i in chosen]
    sites = np.arange(1.0, count + 1)
    if len({H.units.get(name) for name in names}) > 1:
        raise InputError(f"{_listed(names)} have different units; a chain needs one")
    every = [math_name(name) for name in names]
    shared = f"{every[0]} ... {every[-1]}" if count > 2 else ", ".join(every)
    return Scene(
        lambda z, t: np.stack(np.broadcast_arrays(sites, z[..., chosen]), axis=-1),
        (("site", ""), (shared, math_unit(H.units.get(names[0], "1")))),
        rods=tuple((k, k + 1) for k in range(count - 1)),
        traced=(),
        equal=False,
    )


def _of_points(
    motion: Motion, points: Callable[..., Any], rods: Sequence[tuple[int, int]]
) -> Scene:
    """A picture from a user's function of a state, or of a state and the time."""
    if not callable(points):
        raise InputError("points is no function; give one of a state, such as lambda z: ...")
    with_time = _takes_time(points)

    def places(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        rows, times = z.reshape(-1, z.shape[-1]), np.broadcast_to(t, z.shape[:-1]).ravel()
        found = [
            points(row, time) if with_time else points(row)
            for row, time in zip(rows, times.tolist(), strict=True)
        ]
        return _places(found).reshape(*z.shape[:-1], -1, 2)

    start = np.array(motion.span[:1])
    count = places(motion.at(start), start[:, None]).shape[-2]
    pairs = []
    for pair in rods:
        numbers = np.ravel(pair)
        whole = numbers.dtype.kind in "iu" and len(numbers) == 2
        if not whole or not all(0 <= k < count for k in numbers.tolist()):
            raise InputError(
                f"rods: {pair!r} is no pair of points; they have the numbers 0 to {count - 1}"
            )
        pairs.append((int(numbers[0]), int(numbers[1])))
    return Scene(places, (("", ""), ("", "")), rods=tuple(pairs), traced=tuple(range(count)))


def _takes_time(points: Callable[..., Any]) -> bool:
    try:
        entries = inspect.signature(points).parameters.values()
    except (TypeError, ValueError):  # of builtins
        return False
    empty, positional = inspect.Parameter.empty, ("POSITIONAL_ONLY", "POSITIONAL_OR_KEYWORD")
    return sum(e.default is empty and e.kind.name in positional for e in entries) > 1


def _places(found: list[Any]) -> np.ndarray:
    try:
        places = np.array(found, dtype=float)
    except (TypeError, ValueError):
        places = np.zeros(0)
    if places.ndim == 2:
        places = places[:, None]
    if places.ndim != 3 or places.shape[1] == 0 or places.shape[2] != 2:
        raise InputError("points must return pairs x, y: an array of shape (points, 2)")
    return places
