"""describe(): the facts of a result, found by its type.

The functions are found by the name of the type: importing all types would import most of the
package.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import hamsym.facts
from hamsym.errors import InputError
from hamsym.facts.facts import Facts
from hamsym.facts.wording import DESCRIBED

for _module in pkgutil.iter_modules(hamsym.facts.__path__, "hamsym.facts."):
    importlib.import_module(_module.name)  # they register their functions


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
    for kind in type(result).__mro__:
        if kind.__module__.startswith("hamsym.") and kind.__name__ in DESCRIBED:
            return DESCRIBED[kind.__name__](result)
    raise InputError(f"{type(result).__name__} has no facts; give a result of hamsym")
