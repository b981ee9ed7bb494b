"""What the independent checker is given: results and claims as plain data.

:mod:`hamsym.proof.checker` imports nothing of hamsym beside itself. Here numbers of results become
Python's own, exactly, and what it refuses becomes a CertificationError.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import numpy as np

import hamsym
from hamsym.errors import CertificationError
from hamsym.flow_maps.expansion import Leg, Split
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.hamiltonian import Hamiltonian
from hamsym.problems.description import described, described_formula
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.boxes.box_certificate import BoxCertificate
from hamsym.proof.checker.equilibria import check_equilibrium
from hamsym.proof.checker.flow_maps import check_flow_map
from hamsym.proof.checker.formulas import NotProvenError
from hamsym.proof.checker.invariants import check_invariant
from hamsym.proof.checker.orbits import check_orbit
from hamsym.proof.checker.solutions import check_solution
from hamsym.proof.windows.certificate import Certificate
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution
from hamsym.support.record_fields import fields_of

_BITS = 64  # until a checker sets its own precision


@contextmanager
def checking() -> Iterator[None]:
    """Turn refusals of the checker into errors of hamsym; keep what it sets of Arb to itself."""
    try:
        with working(_BITS):
            yield
    except NotProvenError as error:
        raise CertificationError(f"the certificate does not hold: {error}") from None


def _check(
    checker: Callable[..., None],
    given: Sequence[Any],
    claims: Certificate | hamsym.OrbitCertificate | BoxCertificate,
    check_time: Callable[[str], None],
) -> None:
    """Run a checker on a result and the claims of its certificate."""
    with checking():
        checker(
            *given,
            json.loads(claims.to_json()),
            lambda: check_time("the independent checker ran"),
        )


def verify_solution(
    claims: Certificate, solution: Solution, check_time: Callable[[str], None]
) -> None:
    """Prove a certificate of a solution again by the independent checker."""
    span = [float(time) for time in solution.span]
    given = described(solution.H), solution.z0.tolist(), span, _trial_data(solution)
    _check(check_solution, given, claims, check_time)


def verify_orbit(
    claims: hamsym.OrbitCertificate, orbit: hamsym.PeriodicOrbit, check_time: Callable[[str], None]
) -> None:
    """Prove a certificate of a periodic orbit again by the independent checker."""
    claims.require_form(orbit)
    _check(check_orbit, (described(orbit.H), _orbit_data(orbit)), claims, check_time)


def _orbit_data(orbit: hamsym.PeriodicOrbit) -> dict[str, Any]:
    problem, closing, arc = orbit.problem, orbit.problem.closing, orbit.arc
    maps = [
        None if each is None else ([*each.places], [*each.signs])
        for each in (closing.shift, closing.first, closing.last)
    ]
    exact, period = problem.exact_period, None
    if problem.period is not None:
        if exact is None:
            raise CertificationError("the orbit has no exact period; find it with period=")
        period = described_formula(exact.formula, orbit.H.names)
    return {
        "shift": maps[0],
        "reversing": None if maps[1] is None else maps[1:],
        "energy": problem.energy,
        "period": period,
        "edges": arc.edges.tolist(),
        "ends": arc.ends.tolist(),
        "sizes": problem.scale_of(arc).tolist(),
    }


def verify_flow_map(
    claims: BoxCertificate, flow: FlowMap, check_time: Callable[[str], None]
) -> None:
    """Prove a certificate of a flow map again by the independent checker."""
    _check(check_flow_map, (described(flow.H), _flow_data(flow)), claims, check_time)


def _flow_data(flow: FlowMap) -> dict[str, Any]:
    region, names = flow.region, flow.H.names
    curves = {name: described_formula(expr, names) for name, expr in region.formulas.items()}
    return {
        "span": [float(time) for time in flow.span],
        "inputs": [*flow.inputs],
        "fixed": {name: float(value) for name, value in region.fixed.items()},
        "expressions": curves,
        "map": _map_data(flow.map),
    }


_ARRAYS = ("edges", "scaling", "shift", "selection", "offset", "start_degrees", "start")


def _map_data(map: Any) -> dict[str, Any]:
    if isinstance(map, Split):
        sides = {"low": _map_data(map.low), "high": _map_data(map.high)}
        plane = {"normal": map.normal.tolist(), "threshold": float(map.threshold)}
        return {"kind": "split"} | plane | sides
    if isinstance(map, Leg):
        pieces = [_arrays(piece, ("degrees", "readouts", "columns")) for piece in map.pieces]
        return {"kind": "leg", "begin": float(map.begin), "pieces": pieces} | _arrays(map, _ARRAYS)
    return {"kind": "chain"}


def _arrays(part: Any, names: Sequence[str]) -> dict[str, Any]:
    return {name: np.asarray(getattr(part, name)).tolist() for name in names}


def verify_equilibrium(found: hamsym.Equilibrium, H: Hamiltonian) -> None:
    """Prove that one equilibrium is in the ball of a found one, and its type."""
    H.require_parameters()
    if found.enclosure is None:
        raise CertificationError("the equilibrium has no enclosure, so that nothing is claimed")
    if found.names != tuple(H.names):
        raise CertificationError("the equilibrium and H have different components")
    linear = found.linear
    claims = {
        "mid": np.asarray(found.enclosure.mid, dtype=float).tolist(),
        "radius": np.asarray(found.enclosure.radius, dtype=float).tolist(),
        "type": "degenerate" if linear is None else linear.type,
        "stable": None if linear is None else linear.stable,
        "definite": 0 if linear is None else linear.definite,
    }
    with checking():
        check_equilibrium(described(H), claims)


def verify_invariant(found: hamsym.Invariant, H: Hamiltonian) -> None:
    """Prove that an invariant is one, for all values of the parameters or for those it names."""
    known = dict(found.holds_for)
    free = [name for name in H.parameter_names if name not in known]
    with checking():
        data = described(H) | {"parameters": known}
        check_invariant(data, free, described_formula(found.expr, H.names))


def _trial_data(solution: Solution) -> dict[str, Any]:
    trial = solution.trial
    if isinstance(trial, FeatureTrial):
        found = {name: np.asarray(getattr(trial, name)) for name in fields_of(FeatureTrial)}
        return {"kind": "features"} | {name: array.tolist() for name, array in found.items()}
    from hamsym.networks.chain import Chain  # needs torch

    parts: Any = trial.pieces if isinstance(trial, Chain) else [trial]
    pieces = [asdict(part.data) for part in parts]
    for piece in pieces:
        piece |= {name: piece[name].astype(float).tolist() for name in ("z0", "weights")}
    end = trial.end if isinstance(trial, Chain) else solution.span[1]
    return {"kind": "networks", "pieces": pieces, "end": float(end)}
