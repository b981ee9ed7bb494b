"""Integration with equal steps, given or chosen, and by adaptive methods with equal outputs.

Input:  an ensemble, a method, a span and checked options.
Output: a :class:`Trajectory` with the drift of H.

With fixed steps the force between the states is tested for features that the steps pass over.
"""

from __future__ import annotations

import math
import time
import warnings
from typing import Any

import numpy as np

from hamsym.errors import StepSizeWarning
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.adaptive import Adaptive
from hamsym.integrators.automatic_steps import AIM, Choice, choose_steps, fastest_rate
from hamsym.integrators.coefficients import RungeKutta, Splitting
from hamsym.integrators.energy_drift import COARSE, EnergyDrift
from hamsym.integrators.hidden_features import Path, hidden_features, passed_over
from hamsym.integrators.invariant_drift import invariant_drifts
from hamsym.integrators.stepper import INTERRUPTED, Run, Stepper, require_memory, run_steps
from hamsym.integrators.table import INTEGRATORS, resolved_angle, too_fast
from hamsym.integrators.trajectory import Trajectory
from hamsym.problems.conservation import KnownInvariants
from hamsym.problems.ensemble import Ensemble

# Saved states of a trajectory at which the drift of H is computed; 20,000 steps and the start.
_MAX_TESTED = 20_001


def integrate_fixed(
    members: Ensemble,
    name: str,
    span: tuple[float, float],
    steps: int | None,
    save_every: int | None,
    known: KnownInvariants,
    options: dict[str, Any],
) -> Trajectory:
    """Integrate with a number of equal steps, or without one with as many as conserve H.

    Warn with StepSizeWarning, at the caller of :func:`hamsym.integrate`, of steps that are too
    long.

    - options: Tolerances of an adaptive method, or those of :func:`run_steps`.
    """
    H, choice, (start, end) = members.H, None, span
    scheme = INTEGRATORS[name].scheme
    began = time.perf_counter()
    if steps is None:
        choice = choose_steps(members, name, span, save_every, **options)
        run, steps = choice.run, choice.steps
    elif isinstance(scheme, Adaptive):
        run = _run_adaptive(members, scheme, span, steps // (save_every or 1), **options)
    else:
        run = run_steps(members, name, span, steps, save_every or 1, **options)
    seconds = time.perf_counter() - began
    z, times, problem = _cut_at_end(run.z, run.times, run.problem)
    drift = _drift(members, z, steps)
    drifts, changed = invariant_drifts(members, known, z, times, COARSE)
    found, warning = _describe_accuracy(H, drift, choice)
    message = f"{name}: {steps:,} steps to t = {end:.6g}" + (f", {found}" if found else "")
    if changed and not warning:
        formula, _ = next(iter(changed.values()))
        warning = (
            f"the invariant {formula} changes by more than errors of 1 % explain; take more steps"
        )
    unseen = ""
    if not (problem or warning or isinstance(scheme, Adaptive)):
        share = COARSE if choice is None else max(AIM, min(choice.found, COARSE))
        unseen = _between_steps(members, name, z, times, steps, share, options["omega"])
    given = choice is None and isinstance(scheme, Splitting | RungeKutta)
    if given and not (H.conserves_energy or warning or unseen):
        fastest = fastest_rate(members, z, times)
        if not fastest * abs(end - start) / steps <= resolved_angle(name):
            warning = too_fast(fastest, name)
    if warning and not problem:
        message = f"{message}: {warning}"
        warnings.warn(message, StepSizeWarning, stacklevel=4)
    lost = H.conserves_energy and not math.isfinite(drift)
    problem = problem or unseen or (message if lost else "")
    return Trajectory(
        t=times,
        z=z.reshape(*members.shape, *z.shape[1:]),
        names=H.names,
        method=name,
        steps=steps,
        dt=(end - start) / steps,
        evaluations=run.evaluations,
        seconds=seconds,
        success=not problem,
        message=problem or message,
        ensemble=members,
        interrupted=run.interrupted,
        drift=drift,
        invariant_drift=drifts,
    )


def _run_adaptive(
    members: Ensemble,
    scheme: Adaptive,
    span: tuple[float, float],
    saves: int,
    rtol: float,
    atol: float | None,
) -> Run:
    require_memory(saves, members)
    times = np.linspace(*span, saves + 1)
    z = np.full((len(members), len(times), members.H.dim), np.nan)
    z[:, 0] = members.states
    evaluations, message = 0, ""
    for i, state in enumerate(members.states):
        try:
            states, count, problem = scheme.run(members.hamiltonian(i), state, times, rtol, atol)
        except KeyboardInterrupt:
            return Run(times, z, True, evaluations, INTERRUPTED)
        z[i, : len(states)] = states
        evaluations += count
        message = message or problem
    return Run(times, z, False, evaluations, message)


def _cut_at_end(
    z: np.ndarray, times: np.ndarray, message: str
) -> tuple[np.ndarray, np.ndarray, str]:
    """Cut trajectories where the longest of them ends, and complete the message."""
    # A component that is not finite stays so in every method.
    if not message and np.isfinite(z[:, -1]).all():
        return z, times, message
    finite = np.logical_and.accumulate(np.isfinite(z).all(axis=-1), axis=1)
    z[~finite] = np.nan
    counts = finite.sum(axis=1)
    if counts.min() < len(times):
        message = message or "the state is no longer finite"
    if message:
        stopped = f"stopped after t = {times[counts.min() - 1]:.6g}: {message}"
        if len(z) > 1:
            which = int(np.argmin(counts))
            number = int((counts < len(times)).sum())
            stopped = (
                f"{number} of {len(z):,} trajectories stopped, number {which} first, {stopped}"
            )
        message = stopped
    end = max(int(counts.max()), 1)
    return z[:, :end], times[:end], message


def _drift(members: Ensemble, z: np.ndarray, steps: int) -> float:
    """Compute the largest drift of H at the saved states, or at a sample of them."""
    if z.shape[1] > _MAX_TESTED:
        z = z[:, np.linspace(0, z.shape[1] - 1, _MAX_TESTED).astype(int)]
    kept = EnergyDrift(members.H, len(members), members.own_parameters())
    kept.add(z)
    return float(kept.relative(steps).max())


def _describe_accuracy(H: Hamiltonian, drift: float, choice: Choice | None) -> tuple[str, str]:
    """Describe the accuracy of the steps, with a warning or ""."""
    if H.conserves_energy:
        kept = "kept to round-off" if drift == 0 else f"kept to {drift:.1e} of its scale"
        said = f"H {kept}" if math.isfinite(drift) else "H is not finite on the trajectory"
        fine = drift <= COARSE
    elif choice is not None:
        said = f"halving the steps changes the motion by {choice.found:.1e} of its range"
        fine = True
    else:
        return "", ""
    if choice is None:
        return said, "" if fine else "take more steps"
    if choice.met and fine:
        return said, ""
    return said, (
        f"the target of {AIM:.0e} is not met; use an earlier end time, before a close encounter, "
        "or give a method and steps"
    )


def _between_steps(
    members: Ensemble,
    name: str,
    z: np.ndarray,
    times: np.ndarray,
    steps: int,
    share: float,
    omega: float | None,
) -> str:
    """Describe the first feature of the force between the steps that matters, or return "".

    - z, times: Saved states and their times.
    - steps: Of the whole trajectories, the same number between two saved states.
    - share: Of the sizes of the components, that such features may change.
    """
    features = hidden_features(members.H)
    if features is None:
        return ""

    def stepper(rows: np.ndarray, states: np.ndarray, starts: np.ndarray) -> Stepper:
        sizes = np.full(len(rows), (times[-1] - times[0]) / steps)
        parameters = members.parameters[rows]
        return Stepper(members.H, name, states, starts, sizes, parameters=parameters, omega=omega)

    path = Path(z, times, steps, stepper)
    found = features.passed(path, members.own_parameters(), share)
    if np.isnan(found).all():
        return ""
    index = int(np.nanargmin(np.abs(found - times[0])))
    return (f"trajectory {index}: " if members.shape else "") + passed_over(found[index])
