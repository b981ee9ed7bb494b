"""Hamiltonians written down, solved by neural networks, with errors that can be trusted.

From a formula to a proof, one folder a stage; each imports only what stands before it:

    formula -> symbolic -> codegen + templates -> hamiltonian
    -> integrators, solution -> random_features, networks -> solving
    -> families -> dynamics, proof -> study -> plotting, workbench -> cli

Conventions: the state is z = (q_1..q_d, p_1..p_d); arrays are (time, component); float64 unless
asked otherwise; times, states and energies are in the units of the Hamiltonian.

Examples
--------
>>> import hamsym
>>> H = hamsym.Hamiltonian("p**2/2 + x**2/2 + x**4/4")
>>> print(H.source("torch", part="residual").splitlines()[-1].strip())
return torch.stack((dx - p, dp + x + x**3), dim=-1)
"""

from importlib.metadata import version

import lazy_loader

from hamsym.support.suggestions import attribute_message

# The public names are in __init__.pyi; each is imported when it is first used, because sympy,
# torch and matplotlib are slow to import and few tasks need all of them.
_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name not in __all__ and not name.startswith("_"):
        message = attribute_message(f"module '{__name__}'", name, __all__)
        raise AttributeError(message, name=name)
    return _attribute(name)


__version__ = version("hamsym")
