"""plot(): the figure of a result, chosen by its type."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from matplotlib.figure import Figure

from hamsym.dynamics.chaos_indicators import ChaosIndicators
from hamsym.dynamics.equilibrium import Equilibria, Equilibrium
from hamsym.dynamics.lyapunov import LyapunovExponents
from hamsym.dynamics.lyapunov_map import LyapunovMap
from hamsym.dynamics.monodromy import TangentMap
from hamsym.dynamics.sections import Section
from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.fitting.fitted import Fit
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.integrators.trajectory import Trajectory
from hamsym.orbits.certificate import OrbitCertificate
from hamsym.orbits.family import OrbitFamily
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.plotting.certificates import draw_box_certificate, draw_certificate, draw_enclosure
from hamsym.plotting.chaos import draw_chaos_indicators, draw_lyapunov, draw_lyapunov_map
from hamsym.plotting.comparisons import draw_comparison
from hamsym.plotting.equilibria import draw_equilibria, draw_equilibrium
from hamsym.plotting.fits import draw_fit
from hamsym.plotting.flow_maps import draw_flow_map
from hamsym.plotting.orbits import draw_family, draw_orbit, draw_orbit_certificate
from hamsym.plotting.sections import draw_section
from hamsym.plotting.solutions import draw_solution, draw_solutions
from hamsym.plotting.spectra import draw_tangent_map
from hamsym.plotting.sweeps import draw_stored_sweep, draw_sweep
from hamsym.plotting.trajectories import draw_trajectory
from hamsym.proof.box_certificate import BoxCertificate
from hamsym.proof.certificate import Certificate
from hamsym.proof.enclose import Enclosure
from hamsym.solution.solution import Solution
from hamsym.study.compare import Comparison
from hamsym.study.grid import StoredSweep
from hamsym.study.sweep import Sweep
from hamsym.support.suggestions import checked_keywords


@singledispatch
def plot(result: Any, *args: Any, **options: Any) -> Figure:
    """Draw a result: an overview, or the panel that names choose.

    Every figure has one style, names as mathematics, and a caption with H, its parameters and the
    method. It belongs to no window: a notebook shows it, ``savefig`` writes it. Settings of
    matplotlib are not changed.

    Parameters
    ----------
    result : Solution, Solutions, Trajectory, Fit, FlowMap, Section, Comparison, LyapunovExponents
        Or another result with a method ``plot``.
    *args, **options
        As in the method ``plot`` of the result; most take names of what to draw, and ``ax``, axes
        of matplotlib for one panel.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with ``.savefig(path)``, as .png, .svg or .pdf.

    Raises
    ------
    InputError
        If the result is of another type.

    Examples
    --------
    >>> import hamsym
    >>> figure = plot(hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 10)))
    >>> [axis.get_ylabel() for axis in figure.axes]
    ['$x$', '$p$', '$p$', '$|H - H_0|$']
    """
    raise InputError(
        f"{type(result).__name__} cannot be plotted; give a solution or many, a trajectory, a fit, "
        "a flow map, a section, a comparison, Lyapunov exponents or chaos indicators"
    )


_FIGURES = (
    (Solution, draw_solution),
    (Solutions, draw_solutions),
    (Trajectory, draw_trajectory),
    (Fit, draw_fit),
    (FlowMap, draw_flow_map),
    (Section, draw_section),
    (Comparison, draw_comparison),
    (Sweep, draw_sweep),
    (StoredSweep, draw_stored_sweep),
    (LyapunovExponents, draw_lyapunov),
    (LyapunovMap, draw_lyapunov_map),
    (ChaosIndicators, draw_chaos_indicators),
    (PeriodicOrbit, draw_orbit),
    (OrbitFamily, draw_family),
    (OrbitCertificate, draw_orbit_certificate),
    (TangentMap, draw_tangent_map),
    (Equilibria, draw_equilibria),
    (Equilibrium, draw_equilibrium),
    (Enclosure, draw_enclosure),
    (Certificate, draw_certificate),
    (BoxCertificate, draw_box_certificate),
)
for _type, _draw in _FIGURES:
    plot.register(_type, checked_keywords(_draw, "plot"))
