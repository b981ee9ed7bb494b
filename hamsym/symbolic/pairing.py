"""Pairs of coordinates and momenta, found from the names of symbols.

Input:  names, for example ``{"x", "p_x", "m"}``.
Output: ordered pairs, ``[("x", "p_x")]``; the remaining names are parameters.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from hamsym.errors import VariableError
from hamsym.formula.parser import canonical_name

# A bare p belongs to q or x; without these, to the only other conventional coordinate.
_FIRST_CHOICE = ("q", "x")
_CONVENTIONAL = frozenset(
    "q x y z r s u rho theta phi psi varphi chi alpha beta gamma xi eta zeta".split()
)
_REMEDY = (
    "name the pairs with q=[...] and p=[...] (--q and --p at the command line), or give "
    "parameters their values"
)


def natural_order(name: str) -> list[tuple[int, int | str]]:
    """Sort key for the natural order of names: q1, q2, q10.

    Examples
    --------
    >>> sorted(["q10", "q2", "q1", "a"], key=natural_order)
    ['a', 'q1', 'q2', 'q10']
    """
    parts = re.split(r"(\d+)", canonical_name(name).replace("_", ""))
    return [(0, int(part)) if part.isdigit() else (1, part) for part in parts if part]


def conventional(name: str) -> bool:
    """Whether a name is one that coordinates usually have, with or without an index.

    Examples
    --------
    >>> conventional("theta1"), conventional("m1")
    (True, False)
    """
    return re.sub(r"_?\d+$", "", canonical_name(name)) in _CONVENTIONAL


def find_pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    """Pair every momentum with its coordinate by name.

    ``p`` pairs with ``q`` or ``x`` (or with the only conventional coordinate), ``px`` and ``p_x``
    with ``x``, ``p1`` with ``q1`` or ``x1``, ``p_theta`` with ``theta``. Greek letters and their
    names are equivalent. A cyclic coordinate need not occur: ``p_phi`` adds ``phi``.

    Raise VariableError if there is no pair, or the pairs are ambiguous; the message lists the
    candidates and the remedy.

    - names: The symbols of a Hamiltonian without its parameters and without the time.
    - returns: Pairs (coordinate, momentum) in natural order of the coordinate.

    Examples
    --------
    >>> find_pairs(["p_y", "k", "x", "y", "p_x"])
    [('x', 'p_x'), ('y', 'p_y')]
    """
    spelled = {canonical_name(name): name for name in names}
    found: dict[str, str] = {}  # momentum -> coordinate, canonical names
    unmatched = []
    bare_last = sorted(spelled, key=lambda name: (name in ("p", "P"), natural_order(name)))
    for momentum in bare_last:
        if momentum[0] not in "pP":
            continue
        free = [name for name in spelled if name != momentum and name not in found]
        candidates = _coordinates_for(momentum, free, taken=set(found.values()))
        if len(candidates) > 1:
            listed = " or ".join(sorted(spelled.get(name, name) for name in candidates))
            raise VariableError(
                f"'{spelled[momentum]}' could be the momentum of {listed}; {_REMEDY}"
            )
        if candidates:
            found[momentum] = candidates[0]
        elif momentum == "p" and (rivals := _rivals(spelled, found)):
            raise VariableError(
                f"'{spelled[rivals[0]]}' and '{spelled[momentum]}' both look like the momentum of "
                f"{spelled.get(found[rivals[0]], found[rivals[0]])}; {_REMEDY}"
            )
        elif re.fullmatch(r"[pP](_?\d+)?", momentum):
            unmatched.append(momentum)
    claims: dict[str, str] = {}
    for momentum, coordinate in found.items():
        if coordinate in claims:
            raise VariableError(
                f"'{spelled[claims[coordinate]]}' and '{spelled[momentum]}' both look like the "
                f"momentum of {spelled.get(coordinate, coordinate)}; {_REMEDY}"
            )
        claims[coordinate] = momentum
    indexed = any(re.fullmatch(r"[pP]_?\d+", momentum) for momentum in found)
    lost = [name for name in unmatched if not found or (indexed and name not in ("p", "P"))]
    listed = ", ".join(sorted(spelled.values(), key=natural_order)) or "no names"
    if lost:
        raise VariableError(f"'{spelled[lost[0]]}' has no coordinate among {listed}; {_REMEDY}")
    if not found:
        raise VariableError(f"no pair such as x, p_x or q1, p1 among {listed}; {_REMEDY}")
    pairs = [(spelled.get(q, q), spelled[p]) for p, q in found.items()]
    return sorted(pairs, key=lambda pair: natural_order(pair[0]))


def _rivals(spelled: dict[str, str], found: dict[str, str]) -> list[str]:
    """Momenta paired with the coordinate of a bare p, if that is the only pair."""
    return [m for m, q in found.items() if q in _FIRST_CHOICE and q in spelled and len(found) == 1]


def _coordinates_for(momentum: str, free: list[str], taken: set[str]) -> list[str]:
    """Candidates for the coordinate of a momentum."""
    rest = momentum[1:].lstrip("_")
    if momentum == "P":
        return [name for name in ("Q", "X") if name in free]
    if not rest:
        left = [name for name in free if name not in taken]
        first = [name for name in _FIRST_CHOICE if name in left]
        return first or [name for name in left if name in _CONVENTIONAL]
    if rest.isdigit():
        stems = {"Q", "X"} if momentum[0] == "P" else _CONVENTIONAL
        matches = (re.fullmatch(r"(.+?)_?(\d+)", name) for name in free)
        return [m.string for m in matches if m and m.group(1) in stems and m.group(2) == rest]
    if momentum[0] == "P":
        return []
    # p_x1, px_1 and p1_x all belong to x1, however the underscores fall.
    index_last = re.sub(r"^(\d+)_?([^\d]+)$", r"\2\1", rest).replace("_", "")
    same = [name for name in free if name.replace("_", "") == index_last]
    if not same and rest in _CONVENTIONAL:
        return [rest]
    return same
