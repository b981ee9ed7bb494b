"""Families of periodic orbits: hamsym.orbit_family."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.branching import LEAVING, first_of_branch
from hamsym.orbits.continuation import Aim, Bifurcation, Continuation
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.support.progress import stepping_progress
from hamsym.support.shown import Drawn, Listed, Saved
from hamsym.support.suggestions import checked_keywords, did_you_mean, suggest_attributes
from hamsym.support.validation import require, require_number, require_positive, require_whole


@suggest_attributes
@dataclass(frozen=True, eq=False)
class OrbitFamily(Drawn, Saved, Listed[PeriodicOrbit]):
    """Orbits along a family, in the order of their computation; a sequence of PeriodicOrbit.

    ``plot()`` draws period, orbits and largest multiplier over the energy or the parameter;
    ``plot("period")`` and ``plot("multipliers")`` one of them, with stability and bifurcations; two
    or three components draw orbits of the family in their plane or space.

    Attributes
    ----------
    orbits : tuple of PeriodicOrbit
    bifurcations : tuple of Bifurcation
    success : bool
        Whether the target was reached.
    message : str
    parameter : str or None
        The parameter that varies.
    """

    _FIELD = "orbits"

    orbits: tuple[PeriodicOrbit, ...]
    bifurcations: tuple[Bifurcation, ...]
    success: bool
    message: str
    parameter: str | None = None

    def check(self) -> None:
        """Raise ValueError unless it has orbits of one system, and bifurcations between them."""
        if not self.orbits or len({orbit.H.names for orbit in self.orbits}) > 1:
            raise ValueError("its orbits are not those of one system")
        if self.parameter is not None and self.parameter not in self.H.parameter_names:
            raise ValueError("it varies a parameter that H does not have")
        if not all(found.after < len(self) for found in self.bifurcations):
            raise ValueError("a bifurcation belongs to no orbit")

    @property
    def H(self) -> Hamiltonian:
        """Hamiltonian of the first orbit."""
        return self.orbits[0].H

    def __repr__(self) -> str:
        return (
            f"OrbitFamily({len(self)} orbits, energy {self.energies.min():.6g} to "
            f"{self.energies.max():.6g}, period {self.periods.min():.6g} to "
            f"{self.periods.max():.6g}, {len(self.bifurcations)} bifurcations; {self.message})"
        )

    @property
    def z0(self) -> np.ndarray:
        """The starts of the orbits, shape (n, dim)."""
        return np.array([orbit.z0 for orbit in self.orbits])

    @property
    def seconds(self) -> float:
        """Run time of the orbits."""
        return sum(orbit.seconds for orbit in self.orbits)

    @property
    def energies(self) -> np.ndarray:
        """Energies of the orbits, shape (n,)."""
        return np.array([orbit.energy for orbit in self.orbits])

    @property
    def periods(self) -> np.ndarray:
        """Periods of the orbits, shape (n,)."""
        return np.array([orbit.period for orbit in self.orbits])

    @property
    def values(self) -> np.ndarray:
        """Values of the parameter that varies."""
        if self.parameter is None:
            raise InputError("no parameter varies along this family; see energies and periods")
        return np.array([orbit.H.parameters[self.parameter] for orbit in self.orbits])

    @property
    def branches(self) -> tuple[Bifurcation, ...]:
        """Bifurcations at which another family of periodic orbits leaves: those at which the
        symmetry breaks, the period doubles, or a pair of multipliers meets at 1.
        """
        return tuple(found for found in self.bifurcations if found.kind in LEAVING)

    def branch(self, k: int, *, side: int = 1, tol: float = 1e-10, **target: Any) -> OrbitFamily:
        """Continue the family that leaves at a bifurcation.

        Its first orbit is found next to the bifurcation, along the second null vector of Newton's
        system without the symmetry that breaks, or over two periods.

        Parameters
        ----------
        k : int
            Number of the bifurcation in ``branches``.
        side : int
            1 or -1. Orbits of the two sides may be images of each other under a symmetry, as the
            northern and the southern halo orbits are, or the same orbit half a period later.
        tol : float
            As in :func:`hamsym.periodic_orbit`.
        target
            ``energy``, ``period`` or ``parameter`` at the end, and other keywords of
            :func:`hamsym.orbit_family`.

        Returns
        -------
        OrbitFamily
            It begins next to the bifurcation.

        Raises
        ------
        InputError
            If there is no such bifurcation, or no orbit of another family was found near it.

        Examples
        --------
        >>> import hamsym
        >>> H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
        >>> z0 = H.state_at_energy(0.13, {"x": 0, "y": 0, "p_x": 0})
        >>> family = hamsym.periodic_orbit(H, z0).family(energy=0.14)
        >>> [found.kind for found in family.branches]
        ['period doubling']
        >>> doubled = family.branch(0, energy=0.14)
        >>> doubled.success, round(doubled[-1].period / family[-1].period, 2)
        (True, 1.96)
        """
        if not (isinstance(k, int) and 0 <= k < len(self.branches)):
            count = len(self.branches)
            raise InputError(
                f"k must be a number from 0 to {count - 1}, a place in family.branches, not {k!r}"
                if count
                else "no other family leaves here: family.branches is empty"
            )
        if side not in (1, -1):
            raise InputError(f"side must be 1 or -1, not {side!r}")
        found = self.branches[k]
        beside = self.orbits[min(found.after + 1, len(self) - 1)]
        size = 1.0 if self.parameter is None else float(np.abs(self.values).max()) or 1.0
        first = first_of_branch(found, beside, self.parameter, size, side, tol)
        return orbit_family(first, tol=tol, **target)

    @property
    def stabilities(self) -> list[str]:
        """Stability of each orbit, as :attr:`hamsym.PeriodicOrbit.stability`."""
        return [orbit.stability for orbit in self.orbits]


@checked_keywords
def orbit_family(
    orbit: PeriodicOrbit,
    *,
    energy: float | None = None,
    period: float | None = None,
    parameter: tuple[str, float] | None = None,
    max_orbits: int = 200,
    max_step: float = 0.3,
    tol: float = 1e-10,
    progress: bool | None = None,
) -> OrbitFamily:
    """Continue a periodic orbit along its family until a target.

    Parameters
    ----------
    orbit : PeriodicOrbit
        Successful; of an H without explicit time for ``energy`` and ``period``.
    energy, period : float, optional
        Where to end. The family starts towards it, and may turn at folds.
    parameter : (str, float), optional
        A parameter of H and its value at the end. The energy, or the period if the orbit was
        found with one, stays.
    max_orbits : int
    max_step : float
        Largest distance between neighbours, in states relative to their largest sizes, relative
        period and relative parameter.
    tol : float
        As in :func:`hamsym.periodic_orbit`, for every orbit.
    progress : bool, optional

    Returns
    -------
    OrbitFamily
        ``success`` is false if the target is not reached; ``message`` says why.

    Raises
    ------
    InputError
        If an argument is not valid.

    Examples
    --------
    >>> import hamsym
    >>> orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    >>> family = orbit_family(orbit, energy=2.0)
    >>> family.success, round(family[-1].energy, 9), round(family[-1].period, 6)
    (True, 2.0, 4.00431)
    """
    require(isinstance(orbit, PeriodicOrbit), "orbit", orbit, "a PeriodicOrbit")
    if not orbit.success:
        raise InputError("the orbit did not succeed; find one first")
    given = [value for value in (energy, period, parameter) if value is not None]
    if len(given) != 1:
        raise InputError("give one of energy, period and parameter as the target")
    require_whole("max_orbits", max_orbits, 2)
    require_positive("max_step", max_step)
    require_positive("tol", tol)
    problem = orbit.problem
    if parameter is not None:
        name, value = _parameter(orbit, parameter)
        size = max(abs(value), abs(orbit.H.parameters[name])) or 1.0
        problem = replace(problem, parameter=name, parameter_size=size)
        aim = Aim(f"parameter {name}", value, lambda o: o.H.parameters[name])
    else:
        if not problem.conservative:
            raise InputError(
                "orbits of this H do not come in families of energies; give parameter=(name, value)"
            )
        problem = replace(problem, energy=None, period=None, exact_period=None)
        if energy is not None:
            require_number("energy", energy)
            aim = Aim("energy", float(energy), lambda o: o.energy)
        else:
            require_positive("period", period)
            aim = Aim("period", float(period), lambda o: o.period)  # type: ignore[arg-type]
    run = Continuation(orbit, problem, aim, max_step, tol)
    with stepping_progress(max_orbits, progress, "continuing") as advance:
        while run.open and len(run.orbits) < max_orbits:
            run.advance()
            advance(1)
    message = run.problem or f"{aim.name} {aim.value:.10g} reached in {len(run.orbits)} orbits"
    if run.open:
        message = f"{aim.name} {aim.value:.10g} not reached in {max_orbits} orbits"
    return OrbitFamily(
        tuple(run.orbits),
        tuple(run.bifurcations),
        not run.open and not run.problem,
        message,
        problem.parameter,
    )


def _parameter(orbit: PeriodicOrbit, parameter: Any) -> tuple[str, float]:
    if not (isinstance(parameter, (tuple, list)) and len(parameter) == 2):
        raise InputError('parameter must be a pair of a name and a value, such as ("mu", 0.1)')
    name, value = parameter
    if name not in orbit.H.parameter_names:
        known = ", ".join(orbit.H.parameter_names) or "none"
        hint = did_you_mean(name, orbit.H.parameter_names)
        raise InputError(f"H has no parameter '{name}'{hint}; its parameters are: {known}")
    require_number(f"the value of {name}", value)
    if orbit.problem.exact_period is not None and orbit.problem.exact_period.formula.free_symbols:
        raise InputError(
            "the period depends on parameters; continue an orbit with a period that is a number"
        )
    return str(name), float(value)
