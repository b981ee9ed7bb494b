"""Table of integrators by name, and which of them apply to a Hamiltonian."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

import numpy as np

from hamsym.errors import InputError, SeparabilityError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators import coefficients
from hamsym.integrators.adaptive import Adaptive, run_dop853, run_odeint
from hamsym.integrators.coefficients import Doubled, RungeKutta, Scheme, Splitting
from hamsym.integrators.energy_drift import COARSE
from hamsym.support.suggestions import did_you_mean


@dataclass(frozen=True)
class Integrator:
    """A row of the table: the scheme of a method, its order and its source."""

    order: int
    summary: str
    source: str
    scheme: Scheme | Adaptive = field(repr=False)

    @property
    def adaptive(self) -> bool:
        """Whether the method adapts its steps to rtol and atol."""
        return isinstance(self.scheme, Adaptive)

    @property
    def symplectic(self) -> bool:
        """Whether each step is a symplectic map of phase space."""
        return self.scheme.is_symplectic

    @property
    def kind(self) -> str:
        """Family: splitting (for separable H), implicit, doubled or adaptive (for any H)."""
        return _KINDS[type(self.scheme)]

    @property
    def stages(self) -> int | None:
        """Force or gradient evaluations per step; per iteration for implicit methods."""
        return None if isinstance(self.scheme, Adaptive) else self.scheme.stages


_KINDS: dict[type, str] = {
    Splitting: "splitting",
    RungeKutta: "implicit",
    Doubled: "doubled",
    Adaptive: "adaptive",
}


#: Every integrator by name.
INTEGRATORS: dict[str, Integrator] = {
    "symplectic_euler": Integrator(
        1,
        "q first with p_n, then p with q_n+1; implicit for non-separable H",
        "de Vogelaere 1956; the paper",
        coefficients.SYMPLECTIC_EULER,
    ),
    "symplectic_euler_p": Integrator(
        1,
        "its adjoint, p first; implicit for non-separable H",
        "de Vogelaere 1956",
        coefficients.SYMPLECTIC_EULER_P,
    ),
    "stormer_verlet": Integrator(
        2,
        "half a drift, a kick, half a drift",
        "Stormer 1907, Verlet 1967",
        coefficients.STORMER_VERLET,
    ),
    "ruth3": Integrator(3, "splitting", "Ruth 1983", coefficients.RUTH3),
    "forest_ruth": Integrator(
        4,
        "triple jump of Stormer-Verlet; alias yoshida4",
        "Forest & Ruth 1990, Yoshida 1990",
        coefficients.FOREST_RUTH,
    ),
    "mclachlan4": Integrator(
        4,
        "composition of symplectic Euler and its adjoint",
        "McLachlan 1995",
        coefficients.MCLACHLAN4,
    ),
    "blanes_moan4": Integrator(4, "splitting S6", "Blanes & Moan 2002", coefficients.BLANES_MOAN4),
    "blanes_moan6": Integrator(6, "splitting S10", "Blanes & Moan 2002", coefficients.BLANES_MOAN6),
    "yoshida6": Integrator(
        6, "composition of Stormer-Verlet, solution A", "Yoshida 1990", coefficients.YOSHIDA6
    ),
    "yoshida8": Integrator(
        8, "composition of Stormer-Verlet, solution D", "Yoshida 1990", coefficients.YOSHIDA8
    ),
    "sofroniou_spaletta10": Integrator(
        10,
        "composition of 35 Stormer-Verlet steps",
        "Sofroniou & Spaletta 2005",
        coefficients.SOFRONIOU_SPALETTA10,
    ),
    "implicit_midpoint": Integrator(
        2, "implicit, any H", "Hairer, Lubich & Wanner 2006, II.1", coefficients.IMPLICIT_MIDPOINT
    ),
    **{
        f"gauss{order}": Integrator(
            order, "implicit, any H", "Hairer, Lubich & Wanner 2006, II.1", scheme
        )
        for order, scheme in coefficients.GAUSS.items()
    },
    "tao2": Integrator(
        2, "explicit, any H; symplectic in a doubled phase space", "Tao 2016", coefficients.TAO2
    ),
    "tao4": Integrator(4, "triple jump of tao2", "Tao 2016", coefficients.TAO4),
    "dop853": Integrator(
        8,
        "Dormand-Prince 8(5,3) from scipy, adaptive, any H",
        "Hairer, Norsett & Wanner 1993, II.5",
        Adaptive(run_dop853),
    ),
    "odeint": Integrator(
        12,
        "LSODA from scipy, adaptive, any H; the paper's ground truth",
        "Hindmarsh 1983",
        Adaptive(run_odeint),
    ),
}


#: Alternative names of integrators.
ALIASES = {"yoshida4": "forest_ruth"}
#: Splitting methods that also have a loop with an implicit half, for a non-separable H.
NOT_ONLY_SEPARABLE = ("symplectic_euler", "symplectic_euler_p")


def usual_method(H: Hamiltonian) -> str:
    """Name of the default method: a splitting if the equations are separable, else Gauss."""
    return "blanes_moan6" if H.is_separable else "gauss6"


def usable_method(H: Hamiltonian, method: str) -> str:
    """Resolve aliases of a method and check that it applies to this H.

    Raise InputError if the table has no such method. Raise SeparabilityError if it is a splitting
    method, and H is not separable or a force depends on momenta.
    """
    name = ALIASES.get(method, method) if isinstance(method, str) else ""
    if name not in INTEGRATORS:
        hint = did_you_mean(method, [*INTEGRATORS, *ALIASES])
        raise InputError(
            f"'{method}' is not a method{hint}; choose one of {', '.join(INTEGRATORS)}"
        )
    split = isinstance(INTEGRATORS[name].scheme, Splitting) and name not in NOT_ONLY_SEPARABLE
    if H.forces:
        _require_general(H, name, method)
    if split and not H.is_separable:
        raise SeparabilityError(
            f"{method} needs H = T(p) + V(q), and this H is not separable; choose a method for any "
            "H: gauss4, implicit_midpoint or tao4"
        )
    return name


@functools.cache
def resolved_angle(method: str) -> float:
    """Return how many radians of the fastest linear motion a step may take.

    They are at most 0.6, and so few that a step errs by no more than 1 % of them: where H is not
    conserved nothing else tests steps that are given.

    - method: The name of a splitting or implicit Runge-Kutta method.

    Examples
    --------
    >>> [resolved_angle(name) for name in ("stormer_verlet", "blanes_moan6")]
    [0.24, 0.6]
    """
    scheme = INTEGRATORS[ALIASES.get(method, method)].scheme
    assert isinstance(scheme, Splitting | RungeKutta)
    for angle in (np.arange(60, 0, -1) / 100).tolist():
        cos, sin = math.cos(angle), math.sin(angle)
        error = scheme.oscillation(angle) - np.array([[cos, sin], [-sin, cos]])
        if np.linalg.norm(error, 2) <= COARSE * angle:
            break
    return float(angle)


def too_fast(rate: float, method: str) -> str:
    """Say that steps are too long for the fastest rate of the motion."""
    size = 0.9 * resolved_angle(method) / rate
    return f"the motion has rates up to {rate:.2g}: give {method} a dt of at most {size:.2g}"


def _require_general(H: Hamiltonian, name: str, method: str) -> None:
    """Refuse a method whose steps solve other equations than those with forces."""
    scheme = INTEGRATORS[name].scheme
    if isinstance(scheme, Doubled):
        raise InputError(
            f"{method} steps in a doubled phase space, which forces beyond H do not have; choose "
            "gauss4, gauss6 or dop853"
        )
    if isinstance(scheme, Splitting) and not H.is_separable:
        raise SeparabilityError(
            f"{method} alternates steps of q at constant p and of p at constant q, which needs H = "
            "T(p) + V(q) and forces without momenta; choose gauss4, gauss6 or dop853"
        )


def listing() -> str:
    """Format the table of integrators as text, one line of at most 80 columns each."""
    lines = [f"{'method':<18}{'order':>6}{'stages':>8}  {'kind':<11}source"]
    for name, row in INTEGRATORS.items():
        stages = "-" if row.stages is None else str(row.stages)
        lines.append(f"{name:<18}{row.order:>6}{stages:>8}  {row.kind:<11}{row.source}")
    return "\n".join(lines)
