"""The table of the methods of solution by their names.

Nothing that solves is imported here: the command line builds its options from this table, also to
complete a word in a shell.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

from hamsym.errors import InputError
from hamsym.networks.methods import LBFGS, Adam, LevenbergMarquardt, NetworkChain, SSBroyden
from hamsym.random_features.features import Features
from hamsym.support.method_object import Method
from hamsym.support.suggestions import did_you_mean, require_known, similar, unknown

_ALL: tuple[type[Method], ...] = (
    Features,
    NetworkChain,
    LevenbergMarquardt,
    SSBroyden,
    LBFGS,
    Adam,
)
#: Methods of solution by name; the first is the default of :func:`hamsym.solve`.
METHODS: dict[str, type[Method]] = {method.name: method for method in _ALL}


def method_of(given: str | Method) -> Method:
    """Return a method: one that is given, or that of a name with its default options.

    Raise InputError if there is no such method.

    Examples
    --------
    >>> method_of("adam"), method_of(Features(max_window=0.5))
    (Adam(), Features(max_window=0.5))
    """
    if isinstance(given, Method):
        return given
    if isinstance(given, str) and given in METHODS:
        return _by_default(given)
    if isinstance(given, type) and issubclass(given, Method):
        raise InputError(f"method={given.__name__} is a class; give hamsym.{given.__name__}()")
    if isinstance(given, str):
        from hamsym.integrators.table import ALIASES, INTEGRATORS  # slow to import

        if given in {*INTEGRATORS, *ALIASES}:
            raise InputError(
                f"'{given}' is a method of integrate; call hamsym.integrate, or choose one of "
                f"{', '.join(METHODS)}"
            )
    raise InputError(unknown(given, METHODS, "a method", "choose one of"))


@functools.cache
def _by_default(name: str) -> Method:
    return METHODS[name]()


def option_message(
    name: str, value: Any, method: Any = None, arguments: Iterable[str] = ()
) -> str | None:
    """Return the sentence about an option of a method that is given as an argument of its own.

    - method: The method that was asked for, if any.
    - arguments: Names of the arguments that there are.

    Examples
    --------
    >>> option_message("epochs", 400)
    "'epochs' is an option of a method; give method=hamsym.Adam(epochs=400)"
    """
    every = {option for kind in METHODS.values() for option in option_names(kind)}
    option = name if name in every else similar(name, [*arguments, *every])
    kinds = _methods_with(option)
    if not kinds:
        return None
    asked = METHODS.get(method) if isinstance(method, str) else type(method)
    kind = asked if asked in kinds else kinds[0 if method is None else -1]
    text = repr(value)
    call = f"hamsym.{kind.__name__}({option}={text if len(text) < 60 else '...'})"
    if option != name:
        return f"'{name}' is not an argument of solve (did you mean method={call}?)"
    return f"'{name}' is an option of a method; give method={call}"


def option_names(kind: type[Method]) -> list[str]:
    """Return the names of the options of a method."""
    return [entry.name for entry in fields(kind)]


def _methods_with(option: str | None) -> list[type[Method]]:
    return [kind for kind in METHODS.values() if option in option_names(kind)]


def made_method(name: str, options: dict[str, Any]) -> Method:
    """Make a method from its name and options as data.

    Raise InputError if the method has no such option.
    """
    require_known(name, METHODS, "a method")
    kind = METHODS[name]
    known = option_names(kind)
    for option in options:
        if option not in known:
            others = [f"'{other.name}'" for other in _methods_with(option)]
            hint = f", but of {', '.join(others)}" if others else did_you_mean(option, known)
            raise InputError(
                f"'{option}' is not an option of method '{name}'{hint}; it has {', '.join(known)}"
            )
    return kind(**options)
