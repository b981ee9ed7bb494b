"""Errors and warnings of hamsym.

Invalid input raises :class:`InputError`, which is also a ``ValueError``. Its message is one
sentence with the expected value, the given one and a suggestion.
"""

from __future__ import annotations

import traceback
from pathlib import Path


class HamsymError(Exception):
    """Base class of all errors of hamsym."""


class InputError(HamsymError, ValueError):
    """Invalid argument or input."""

    def _render_traceback_(self) -> list[str]:
        """Return what a notebook shows: the lines of the caller, and the sentence."""
        inside = str(Path(__file__).parent)
        frames = traceback.extract_tb(self.__traceback__)
        own = [frame for frame in frames if not frame.filename.startswith(inside)]
        beyond = [frame for frame in own if "IPython" not in Path(frame.filename).parts]
        return [
            "Traceback (most recent call last):\n",
            *traceback.format_list(beyond),
            *traceback.format_exception_only(self),
        ]


class KeywordError(InputError, TypeError):
    """A keyword argument that a function does not have, or needs and was not given."""


class ParseError(InputError):
    """A text that is not a valid formula.

    Attributes
    ----------
    token : str
        The invalid part of the text.
    column : int
        Its first column, counted from 1.
    remedy : str
        Suggestion.
    """

    def __init__(self, token: str, column: int, problem: str, remedy: str) -> None:
        self.token, self.column, self.remedy = token, column, remedy
        shown = token if len(token) <= 40 else token[:37] + "..."
        super().__init__(f"'{shown}' at column {column} {problem}; {remedy}")
        self._given = token, column, problem, remedy

    def __reduce__(self) -> tuple[type, tuple[str, int, str, str]]:
        return type(self), self._given


class VariableError(InputError):
    """Coordinates and momenta cannot be identified, or a state does not match them."""


class ParameterError(InputError):
    """A parameter without a value, with an invalid one, or that does not occur in H."""


class SeparabilityError(InputError):
    """A method for H = T(p) + V(q) was applied to a Hamiltonian that is not separable."""


class CodeGenerationError(InputError):
    """A Hamiltonian with a function that a backend cannot evaluate."""


class CertificationError(HamsymError):
    """A refused proof; the message gives the place, the reason and a suggestion."""


class FileError(HamsymError):
    """A file that cannot be read or written, or is not of the expected kind."""


class VacuousBoundWarning(UserWarning):
    """An infinite error bound, because the Hessian is singular along the trajectory."""


class EventWarning(UserWarning):
    """Events that cannot be decided: a surface is touched, or crossed too often to be resolved."""


class StepSizeWarning(UserWarning):
    """Time steps that are too long: H drifts, or halving the step changes the result."""
