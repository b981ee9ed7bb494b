"""Hamiltonians written down, solved by neural networks, with errors that can be trusted.

From a formula to a trajectory, one module a stage:

    parsing -> hamiltonian -> codegen + templates -> system
    system + z0 + span -> trial -> training -> solution -> comparison, plotting

Conventions: the state is z = (q_1..q_d, p_1..p_d); arrays are (time, component); float64 unless
asked otherwise; times, states and energies are in the units of the Hamiltonian.

Examples
--------
>>> import hamsym
>>> H = hamsym.Hamiltonian("p**2/2 + x**2/2 + x**4/4")
>>> print(H.source("torch", part="residual").splitlines()[-1].strip())
return torch.stack((dx - p, dp + x + x**3), dim=-1)
"""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from hamsym.errors import CertificationError, FileError, HamsymError, InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.system import System

if TYPE_CHECKING:
    from hamsym import systems
    from hamsym.archive import load
    from hamsym.certificates import Certificate, verify
    from hamsym.comparison import Comparison, compare
    from hamsym.integrators import Trajectory, integrate
    from hamsym.sections import Section, section
    from hamsym.solution import Solution
    from hamsym.solving import solve
    from hamsym.sweeps import Sweep, sweep
    from hamsym.training import Regularizer
    from hamsym.variational import LyapunovExponents, lyapunov, monodromy

__all__ = [
    "Certificate",
    "CertificationError",
    "Comparison",
    "FileError",
    "Hamiltonian",
    "HamsymError",
    "InputError",
    "LyapunovExponents",
    "Regularizer",
    "Section",
    "Solution",
    "Sweep",
    "System",
    "Trajectory",
    "compare",
    "integrate",
    "load",
    "lyapunov",
    "monodromy",
    "section",
    "solve",
    "sweep",
    "systems",
    "verify",
]

__version__ = version("hamsym")

# Deriving and generating must not wait for torch and scipy to be imported.
_LAZY = {
    "Certificate": "hamsym.certificates",
    "Comparison": "hamsym.comparison",
    "LyapunovExponents": "hamsym.variational",
    "Regularizer": "hamsym.training",
    "Section": "hamsym.sections",
    "Solution": "hamsym.solution",
    "Sweep": "hamsym.sweeps",
    "Trajectory": "hamsym.integrators",
    "compare": "hamsym.comparison",
    "integrate": "hamsym.integrators",
    "load": "hamsym.archive",
    "lyapunov": "hamsym.variational",
    "monodromy": "hamsym.variational",
    "section": "hamsym.sections",
    "solve": "hamsym.solving",
    "sweep": "hamsym.sweeps",
    "verify": "hamsym.certificates",
}


def __getattr__(name: str) -> Any:
    if name == "systems":
        return importlib.import_module("hamsym.systems")
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'hamsym' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
