"""Panel of the kinetic and the potential energy over time."""

from __future__ import annotations

import numpy as np
import sympy
from matplotlib.axes import Axes

from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.figure import legend_above
from hamsym.plotting.motions import Motion
from hamsym.plotting.names import energy_unit
from hamsym.plotting.style import line_style
from hamsym.plotting.time_axes import envelope, fill_time, name_curves


def energies_of(H: Hamiltonian) -> dict[str, sympy.Expr]:
    """Return the parts of H with and without momenta by their names, and H.

    The first is called kinetic where it depends on momenta alone or is quadratic in them.

    Examples
    --------
    >>> energies_of(Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r"))["potential"]
    -1/r
    >>> list(energies_of(Hamiltonian("p_x**2/2 + p_y**2/2 + y*p_x - x*p_y")))
    ['with momenta', 'without', '$H$']
    >>> list(energies_of(Hamiltonian("x*log(p)")))
    ['$H$']
    """
    rest = H.expr.xreplace({p: sympy.Integer(0) for p in H.p})
    if rest.has(sympy.nan, sympy.zoo, sympy.oo):
        return {"$H$": H.expr}
    kinetic = H.expr - rest
    twice = kinetic.xreplace({p: 2 * p for p in H.p})
    if H.is_separable or sympy.expand(twice - 4 * kinetic) == 0:
        return {"kinetic": kinetic, "potential": rest, "$H$": H.expr}
    return {"with momenta": kinetic, "without": rest, "$H$": H.expr}


def draw_energies(axes: Axes, motion: Motion) -> None:
    """Draw the kinetic and the potential energy of one trajectory, and their sum."""
    H = motion.H
    for k, (name, expr) in enumerate(reversed(energies_of(H).items())):
        with np.errstate(all="ignore"):
            values = H.observable(expr).values(motion.z[0, :, : H.dim], motion.t)
        t, values = envelope(motion.t, np.broadcast_to(values, motion.t.shape))
        style = {"color": "black", "linewidth": 0.8} if name == "$H$" else line_style(k - 1)
        axes.plot(t, values, **style, label=name)
    axes.margins(y=0.12)
    name_curves(axes, H, "Energies", "energy", energy_unit(H))
    fill_time(axes, motion.t)
    legend_above(axes)
