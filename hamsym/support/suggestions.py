"""Suggestions in messages: similar names, and what replaces the arguments of scipy."""

from __future__ import annotations

import difflib
import functools
import inspect
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ParamSpec, TypeVar

from hamsym.errors import InputError, KeywordError

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_SIMILAR = 0.7  # ratio of difflib from which a name is suggested
_LEAST = 3  # characters of a beginning that selects a name


def similar(name: object, names: Iterable[str]) -> str | None:
    """Return the one of some names that is probably meant, or None.

    Upper case, underscores and hyphens do not matter. A name may also be the beginning or the end
    of exactly one of them.

    Examples
    --------
    >>> similar("keppler", ["kepler", "toda_chain"]), similar("px", ["x", "p_x"])
    ('kepler', 'p_x')
    >>> similar("henon", ["kepler", "henon_heiles"]), similar("spam", ["kepler"])
    ('henon_heiles', None)
    """
    known: dict[str, str] = {}
    for each in names:
        known.setdefault(_plain(each), each)
    wanted = _plain(str(name))
    if not wanted:
        return None
    if wanted in known:
        return known[wanted]
    found = difflib.get_close_matches(wanted, known, n=1, cutoff=_SIMILAR)
    if found:
        return known[found[0]]
    if len(wanted) >= _LEAST:
        parts = [key for key in known if key.startswith(wanted) or key.endswith(wanted)]
        if len(parts) == 1:
            return known[parts[0]]
    return None


def _plain(name: str) -> str:
    return name.casefold().replace("_", "").replace("-", "").strip()


def did_you_mean(name: object, names: Iterable[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the probable name, or nothing.

    Examples
    --------
    >>> did_you_mean("blanes_moan", ["ruth3", "blanesmoan6"]), did_you_mean("a", ["b"])
    (" (did you mean 'blanesmoan6'?)", '')
    """
    found = similar(name, names)
    return "" if found is None else f" (did you mean '{found}'?)"


def unknown(name: object, names: Iterable[str], kind: str, remedy: str = "choose one of") -> str:
    """Return the sentence about a name that is not one of some names.

    - kind: What the names are, with its article.
    - remedy: Words before the list of the names.

    Examples
    --------
    >>> unknown("adma", ["features", "adam"], "a method")
    "'adma' is not a method (did you mean 'adam'?); choose one of features, adam"
    """
    known = list(names)
    hint = did_you_mean(name, known)
    given = f"'{name}'" if isinstance(name, str) else repr(name)
    return f"{given} is not {kind}{hint}; {remedy} {', '.join(known) or 'none'}"


# -- arguments of scipy ----------------------------------------------------------------------------

_TIMES = (
    "call the result with the times, solution(t); integrate keeps the states of saves=... or "
    "save_every=..."
)
_PARAMETERS = (
    "give the parameters of H by name: Hamiltonian(..., parameters={'m': 1.0}), or "
    "H.with_parameters(m=1.0)"
)

#: What takes the place of the keywords of ``scipy.integrate.solve_ivp``, and of others.
_ELSEWHERE = {
    "fun": "give H, a formula or a Hamiltonian, as the first argument: its equations follow",
    "y0": "give the initial state as the second argument, z0",
    "t_span": "give the times as the third argument, the pair span=(start, end)",
    "t_eval": _TIMES,
    "dense_output": _TIMES,
    "target_error": "give solve a tolerance, tol=...: a training stops when its error is within it",
    "rtol": "give tol=..., which is relative to the size of each component",
    "max_step": "give dt=... or steps=..., or method=hamsym.Features(max_window=...) to solve",
    "events": (
        "call solution.events('x = 0, p_x > 0') of the result, or section(H, z0, span, "
        "'x = 0, p_x > 0')"
    ),
    "jac": "leave it out: derivatives are derived from H",
    "args": _PARAMETERS,
    "parameters": _PARAMETERS,
}


def keyword_message(name: str, function: str, arguments: Sequence[str]) -> str:
    """Return the sentence about a keyword that a function does not have."""
    begin = f"'{name}' is not an argument of {function}"
    if name == "rtol" and "tol" not in arguments and "dt" in arguments:
        return f"{begin}; give dt=... or steps=..."
    if name in _ELSEWHERE:
        return f"{begin}; {_ELSEWHERE[name]}"
    hint = did_you_mean(name, arguments)
    return f"{begin}{hint}; it has {', '.join(arguments) or 'none'}"


def checked_keywords(
    function: Callable[P, R],
    title: str | None = None,
    answer: Callable[[str, Any, Any], str | None] | None = None,
) -> Callable[P, R]:
    """Let a function answer keywords that it lacks, and missing ones, with :class:`KeywordError`.

    Of a function with ``**options``, which checks them itself, a keyword is answered here if
    arguments are missing, e.g. ``solve(H, y0=z0, t_span=span)``.

    - title: Name of the method that calls this function with its object.
    - answer: (name, positional arguments, keywords) -> the sentence about a keyword that it lacks,
      or None for the usual one.

    Examples
    --------
    >>> @checked_keywords
    ... def section(H, z0, span, *, dt=None): ...
    >>> section("p**2/2 + x**2/2", [1, 0], (0, 1), jac=None)
    Traceback (most recent call last):
    hamsym.errors.KeywordError: 'jac' is not an argument of section; leave it out: derivatives are \
derived from H
    >>> section("p**2/2 + x**2/2", [1, 0])
    Traceback (most recent call last):
    hamsym.errors.KeywordError: section is called without span; give section(H, z0, span)
    """
    signature = inspect.signature(function)
    kinds = {name: parameter.kind for name, parameter in signature.parameters.items()}
    owner, _, last = function.__qualname__.rpartition(".")
    of_object = title is not None or next(iter(kinds), "") == "self"
    called = title or (owner if last == "__init__" else last)
    named = [
        name
        for name, kind in list(kinds.items())[of_object:]
        if kind in (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    ]
    open_ended = inspect.Parameter.VAR_KEYWORD in kinds.values()
    required = {  # with the number of positional arguments that include it
        name: place + 1 if kinds[name] != inspect.Parameter.KEYWORD_ONLY else math.inf
        for place, name in enumerate(kinds)
        if name in named and signature.parameters[name].default is inspect.Parameter.empty
    }

    @functools.wraps(function)
    def checked(*arguments: P.args, **keywords: P.kwargs) -> R:
        others = [name for name in keywords if name not in named]
        if others and open_ended:
            try:
                signature.bind(*arguments, **keywords)
            except TypeError:
                others = [n for n in others if n in _ELSEWHERE]
            else:
                others = []
        if others:
            own = answer and answer(others[0], arguments, keywords)
            raise KeywordError(own or keyword_message(others[0], called, named))
        missing = [n for n, k in required.items() if k > len(arguments) and n not in keywords]
        if missing:
            given = ", ".join(n if k < math.inf else f"{n}=..." for n, k in required.items())
            raise KeywordError(
                f"{called} is called without {', '.join(missing)}; give {called}({given})"
            )
        return function(*arguments, **keywords)

    return checked


# -- attributes ------------------------------------------------------------------------------------

_CALL = ("span", "it is a function of time: call it, solution(t)")

#: Attributes of results of scipy, as pairs of an attribute that an object has and what to do.
_ATTRIBUTES: dict[str, Sequence[tuple[str, str]]] = {
    "y": (("z", "the states are z"), _CALL),
    "t": (_CALL,),
    "sol": (_CALL,),
    "nfev": (("evaluations", "the number is evaluations"),),
    "status": (("success", "the verdict is success, and message"),),
    "t_events": (("events", "call events('x = 0')"),),
}


def attribute_message(owner: str, name: str, names: Iterable[str]) -> str:
    """Return the sentence about an attribute that does not exist.

    Examples
    --------
    >>> attribute_message("module 'hamsym'", "slove", ["solve", "fit"])
    "module 'hamsym' has no attribute 'slove' (did you mean 'solve'?)"
    """
    known = [each for each in names if not each.startswith("_")]
    begin = f"{owner} has no attribute '{name}'"
    for needed, text in _ATTRIBUTES.get(name, ()):
        if needed in known:
            return f"{begin}; {text}"
    return begin + did_you_mean(name, known)


#: Methods of results, which answer keywords that they do not have.
_METHODS = ("plot", "summary", "animate", "export", "certify", "save", "to_dataframe", "to_xarray")


def suggest_attributes(cls: type[T]) -> type[T]:
    """Let the objects of a class answer unknown attributes with a similar one.

    Their methods ``plot``, ``summary`` and others of results answer keywords that they do not have.

    Examples
    --------
    >>> @suggest_attributes
    ... class Path:
    ...     energy = 1.0
    >>> Path().enrgy
    Traceback (most recent call last):
    AttributeError: 'Path' object has no attribute 'enrgy' (did you mean 'energy'?)
    """

    def answer(self: Any, name: str) -> Any:
        # An attribute that exists raised AttributeError itself: raise that again.
        if name.startswith("_") or hasattr(type(self), name):
            return object.__getattribute__(self, name)
        owner = f"'{type(self).__name__}' object"
        names = {*dir(type(self)), *vars(self)}
        message = attribute_message(owner, name, sorted(names))
        raise AttributeError(message, name=name, obj=None)

    cls.__getattr__ = answer  # type: ignore[attr-defined]
    for name in _METHODS:
        if inspect.isfunction(method := vars(cls).get(name)):
            setattr(cls, name, checked_keywords(method))
    return cls


def require_known(
    name: object, names: Iterable[str], kind: str, remedy: str = "choose one of"
) -> None:
    """Raise InputError unless a name is one of some names."""
    known = [*names]
    if not isinstance(name, str) or name not in known:
        raise InputError(unknown(name, known, kind, remedy))
