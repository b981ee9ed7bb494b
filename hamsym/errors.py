"""The errors that hamsym raises on purpose.

Bad input is an :class:`InputError`, which is also a ``ValueError``: its message is one
sentence that names the offending token and says what to write instead.
"""

from __future__ import annotations

__all__ = [
    "CertificationError",
    "CodeGenerationError",
    "FileError",
    "HamsymError",
    "InputError",
    "ParameterError",
    "ParseError",
    "SeparabilityError",
    "StepSizeWarning",
    "VacuousBoundWarning",
    "VariableError",
]


class HamsymError(Exception):
    """Any error that hamsym raises on purpose."""


class InputError(HamsymError, ValueError):
    """The caller's input cannot be used as it stands."""


class ParseError(InputError):
    """A text is not a formula that hamsym reads.

    Attributes
    ----------
    token : str
        The offending piece of the text.
    column : int
        Where it starts, counted from 1.
    remedy : str
        What to write instead.
    """

    def __init__(self, token: str, column: int, problem: str, remedy: str) -> None:
        self.token, self.column, self.remedy = token, column, remedy
        shown = token if len(token) <= 40 else token[:37] + "..."
        super().__init__(f"'{shown}' at column {column} {problem}; {remedy}")


class VariableError(InputError):
    """Coordinates and momenta cannot be told apart, or a state does not fit them."""


class ParameterError(InputError):
    """A parameter has no value, an unusable one, or does not occur in the Hamiltonian."""


class SeparabilityError(InputError):
    """A method that needs H = T(p) + V(q) was asked to work on another Hamiltonian."""


class CodeGenerationError(InputError):
    """The Hamiltonian contains a function that a backend cannot evaluate."""


class CertificationError(HamsymError):
    """Nothing could be proven about a solution; the message says where, why and what may help."""


class FileError(HamsymError):
    """A file cannot be read or written, or does not hold what it should."""


class VacuousBoundWarning(UserWarning):
    """An error bound says nothing, because the Hessian is singular along the trajectory."""


class StepSizeWarning(UserWarning):
    """Time steps are too long: H drifts, or halving the step changes the result."""
