"""describe(): the facts of a result, found by its type.

They are made by the function of a module of this room that returns Facts and whose first argument
is annotated with the type.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from hamsym.errors import InputError
from hamsym.facts.facts import Facts
from hamsym.support.shown import by_type, function_of


def describe(result: Any) -> Facts:
    """Return the facts of a result; ``result.facts`` is the same.

    Parameters
    ----------
    result : object
        A Hamiltonian, its equations, generated code, or any result of the package.

    Returns
    -------
    Facts

    Raises
    ------
    InputError
        If it is none of these.

    Examples
    --------
    >>> import hamsym
    >>> describe(hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-6)).success
    True
    """
    make = function_of(result, described())
    if make is not None:
        found: Facts = make(result)
        return found
    raise InputError(f"{type(result).__name__} has no facts; give a result of hamsym")


@functools.cache
def described() -> dict[str, Callable[..., Any]]:
    """Return the functions that describe a result, by the names of the types."""
    return by_type("hamsym.facts", lambda _, signature: signature.return_annotation == "Facts")
