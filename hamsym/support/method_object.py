"""Methods of solution as frozen dataclasses, whose fields carry their documentation.

The docstrings of the methods and the options of the command line are made from the fields, so that
names, types, defaults and explanations are written once.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np

from hamsym.errors import InputError
from hamsym.support.suggestions import checked_keywords, did_you_mean
from hamsym.support.validation import require

M = TypeVar("M", bound="type[Any]")


def option(
    default: Any,
    help: str,
    more: str = "",
    *,
    default_text: str | None = None,
    unit: str | None = None,
    choices: Sequence[str] | Mapping[str, Any] | None = None,
) -> Any:
    """Return a dataclass field with a default and its documentation.

    - help: A sentence for the command line and the docstring.
    - more: Further sentences, for the docstring.
    - default_text: The default in words, where it is computed.
    - unit: Placeholder of the value on the command line. Without ``help`` there is no such option.
    - choices: The texts that are accepted, or the values that they mean.
    """
    metadata = {
        "help": help,
        "more": more,
        "default_text": default_text,
        "unit": unit,
        "choices": choices,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, repr=False)
class Method:
    """A method of solution with its options: immutable, equal if all options are.

    Attributes
    ----------
    name : str
        Name that stands for the method with its default options.
    usual_tol : float
        Tolerance of :func:`hamsym.solve` by default.
    marches : bool
        Whether its trial solution is a march of windows of features instead of networks.
    joint : bool
        Whether all weights of a network are trained together.
    """

    name: ClassVar[str]
    usual_tol: ClassVar[float]
    marches: ClassVar[bool] = False
    joint: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, choices = getattr(self, entry.name), entry.metadata.get("choices")
            if isinstance(value, list | range | np.ndarray):
                value = tuple(value.tolist() if isinstance(value, np.ndarray) else value)
                object.__setattr__(self, entry.name, value)
            if choices and not (isinstance(value, str) and value in choices):
                hint, known = did_you_mean(value, choices), ", ".join(choices)
                raise InputError(
                    f"{entry.name}={value!r} cannot be used{hint}; choose one of {known}"
                )
            if isinstance(entry.default, bool):
                require(isinstance(value, bool), entry.name, value, "True or False")
        self.check()

    def check(self) -> None:
        """Raise InputError if an option is invalid."""

    def solve(self, problem: Any) -> Any:
        """Solve a :class:`~hamsym.problems.problem.InitialValueProblem`; return a Solution."""
        raise NotImplementedError

    @cached_property
    def given(self) -> dict[str, Any]:
        """Options that differ from their defaults, by name."""
        values = {entry.name: (getattr(self, entry.name), entry.default) for entry in fields(self)}
        return {
            name: value
            for name, (value, default) in values.items()
            if type(value) is not type(default) or value != default
        }

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.given.items())
        return f"{type(self).__name__}({given})"


def documented(cls: M) -> M:
    """Let a dataclass, a subclass of :class:`Method`, document its fields and check keywords.

    Examples
    --------
    >>> @documented
    ... @dataclass(frozen=True, kw_only=True, repr=False)
    ... class Euler(Method):
    ...     '''The method of Euler.'''
    ...     steps: int = option(100, "Number of steps.")
    >>> Euler(), Euler(steps=20), Euler(steps=20) == Euler(steps=20)
    (Euler(), Euler(steps=20), True)
    >>> print(Euler.__doc__)
    The method of Euler.
    <BLANKLINE>
    Parameters
    ----------
    steps : int, default 100
        Number of steps.
    """
    cls.__init__ = checked_keywords(cls.__init__)
    text, _, examples = inspect.cleandoc(cls.__doc__ or "").partition("\n\nExamples\n")
    lines = [text, "", "Parameters", "----------"]
    for entry in fields(cls):
        default = entry.metadata["default_text"] or repr(entry.default)
        lines.append(f"{entry.name} : {entry.type}, default {default}")
        about = f"{entry.metadata['help']} {entry.metadata['more']}".strip()
        lines += textwrap.wrap(about, 96, initial_indent="    ", subsequent_indent="    ")
    lines += ["", "Examples", examples] if examples else []
    cls.__doc__ = "\n".join(lines)
    return cls
