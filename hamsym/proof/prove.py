"""Certificates: proven bounds on the error of a neural trajectory.

:mod:`hamsym.proof.windows.window_proof` encloses the exact solution on windows, takes the
trajectory as the real function that its weights define, and bounds the difference. Upper bounds are
rounded up and lower bounds down to the decimals of a :class:`Certificate`.

:func:`verify` repeats a proof from the solution and checks every claim of the certificate. It
assumes nothing in the certificate, and the size of the certificate does not determine its run time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from typing import Any, overload

import numpy as np

import hamsym
from hamsym.archive import certificate_from, load_as
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.linear_systems import blas_on_one_core
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.boxes.box_certificate import BoxCertificate, map_digest
from hamsym.proof.boxes.box_proof import certify_box, proven_bound
from hamsym.proof.boxes.public_map import check_map
from hamsym.proof.independent import (
    verify_equilibrium,
    verify_flow_map,
    verify_invariant,
    verify_orbit,
    verify_solution,
)
from hamsym.proof.limits import Deadline
from hamsym.proof.windows.certificate import (
    LEAST_RTOL,
    MOST_RTOL,
    Certificate,
    rounded_down,
    rounded_up,
)
from hamsym.proof.windows.public_windows import check_solution
from hamsym.proof.windows.window_proof import WindowProof
from hamsym.solution.digest import digest
from hamsym.solution.path import TRIALS
from hamsym.solution.solution import Solution
from hamsym.support.progress import share_progress
from hamsym.support.records import MALFORMED, as_json
from hamsym.support.suggestions import checked_keywords, require_known
from hamsym.support.validation import require, require_number

# Default time limit of verify() in seconds: its own, per second of certify, and at most.
_PATIENCE, _PATIENCE_FACTOR, _MOST_PATIENCE = 60.0, 10.0, 600.0
_CHECKERS = ("kernel", "independent")
# Bounds that are found on another processor, or on windows that end at the edges of a certificate,
# differ by round-off: by a share of themselves, and by a share of what counts as zero.
_MARGIN, _MARGIN_OF_FLOOR = 1e-7, 1e-9
# Most parts of a proof over a box: own, and those that a certificate claims.
_MOST_PARTS = 4_096, 100_000


# -- proving ------------------------------------------------------------------------------------


@overload
def certify(
    solution: Solution,
    rtol: float = ...,
    time_limit: float | None = ...,
    progress: bool | None = ...,
    *,
    bound: float | Sequence[float] | None = ...,
) -> Certificate: ...


@overload
def certify(
    solution: FlowMap,
    *,
    box: Mapping[str, tuple[float, float]] | None = ...,
    time_limit: float | None = ...,
    max_parts: int = ...,
) -> BoxCertificate: ...


@checked_keywords
def certify(
    solution: Solution | FlowMap,
    rtol: float = 0.02,
    time_limit: float | None = None,
    progress: bool | None = None,
    *,
    bound: float | Sequence[float] | None = None,
    **options: Any,
) -> Certificate | BoxCertificate:
    """Compute rigorous bounds on the error of a solution, or of a flow map over a box.

    See :meth:`hamsym.Solution.certify` and :meth:`hamsym.FlowMap.certify` for the arguments.
    """
    if isinstance(solution, FlowMap):
        if (rtol, progress, bound) != (0.02, None, None):
            raise InputError(
                "rtol, progress and bound are not options for a flow map; give box, time_limit or "
                "max_parts"
            )
        return certify_box(solution, time_limit=time_limit, **options)
    if options:
        raise InputError(f"'{min(options)}' is not an option for a solution; leave it out")
    require(isinstance(solution, Solution), "solution", solution, "a Solution or a FlowMap")
    require_number("rtol", rtol, LEAST_RTOL)
    require(rtol <= MOST_RTOL, "rtol", rtol, "a number such as 0.02")
    asked = None if bound is None else _asked(bound, solution.H.names)
    began = time.monotonic()
    require_float64()
    known_by = _digest_of(solution)
    deadline = Deadline.after(time_limit)
    with blas_on_one_core():  # the products of a window are too small for more
        claims = _on_windows(solution, rtol, asked, deadline, progress)
        if asked is not None:
            _require_below(claims, asked, solution.H.names)
            claims["asked"] = asked
        check_solution(solution)
    return Certificate(
        **claims,
        rtol=float(rtol),
        digest=known_by,
        seconds=time.monotonic() - began,
        components=tuple(solution.H.names),
    )


def _digest_of(solution: Solution) -> str:
    """SHA-256 of a solution, all of whose numbers are finite, of exact types, in arrays that fit.

    Raise CertificationError otherwise, or if its trial solution has no enclosure.
    """
    if TRIALS.form_of(type(solution.trial)) is None:
        raise CertificationError(
            f"the trial solution is a {type(solution.trial).__name__}, which has no enclosure; "
            "solve by 'features', or with a network of hamsym"
        )
    try:
        return digest(solution)
    except (FileError, InputError) as error:
        raise CertificationError(f"{error}; solve again") from None


def _asked(bound: Any, names: Sequence[str]) -> tuple[float, ...]:
    """One bound for each component."""
    try:
        values = np.broadcast_to(np.asarray(bound, dtype=float), (len(names),))
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"bound={bound!r} is neither a number nor {len(names)} numbers, one for each component"
        ) from None
    # A component that rests at zero may be asked to be exactly zero.
    if not ((values >= 0) & np.isfinite(values)).all() or (np.ndim(bound) == 0 and not bound > 0):
        raise InputError(f"bound={bound!r} must be positive and finite; give e.g. 1e-9")
    return tuple(values.tolist())


def _require_below(claims: Mapping[str, Any], asked: Sequence[float], names: Sequence[str]) -> None:
    pairs = zip(claims["component_lowers"], claims["component_bounds"], strict=True)
    for name, (lower, upper), allowed in zip(names, pairs, asked, strict=True):
        if lower > allowed:
            raise CertificationError(
                f"the error of {name} is proven to be at least {lower:.3g}, above the bound "
                f"{allowed:.3g}; solve with a smaller tolerance"
            )
        if not upper <= allowed:
            raise CertificationError(
                f"the error of {name} is proven to be at most {upper:.3g}, but not below the bound "
                f"{allowed:.3g}; ask for a looser bound"
            )


def _on_windows(
    solution: Solution,
    rtol: float,
    asked: tuple[float, ...] | None,
    deadline: Deadline,
    progress: bool | None,
) -> dict[str, Any]:
    """The numbers of a certificate by enclosures on windows."""
    with share_progress(progress, "proving") as report:
        found = WindowProof(solution, deadline, report).bounds(rtol, asked)
    margins = _MARGIN_OF_FLOOR * np.where(found.uppers > 0, found.floors, 0.0)
    higher = found.uppers * (1 + _MARGIN) + margins
    lower = np.maximum(found.lowers * (1 - _MARGIN) - margins, 0.0)
    uppers, lowers = [*map(rounded_up, higher.tolist())], [*map(rounded_down, lower.tolist())]
    begin, end = map(float, solution.span)
    inner = (float(found.time(edge)) for edge in found.edges[1:-1])
    edges = tuple(dict.fromkeys((begin, *inner, end)))
    # Of the error in all windows that reach in between.
    wider = np.array(found.bounds_between(edges)) * (1 + _MARGIN) + margins[0]
    return {
        "bound": uppers[0],
        "lower": lowers[0],
        "component_bounds": tuple(uppers[1:-2]),
        "component_lowers": tuple(lowers[1:-2]),
        "energy_bound": uppers[-2],
        "energy_lower": lowers[-2],
        "ell_max_bound": uppers[-1],
        "ell_max_lower": lowers[-1],
        "edges": edges,
        "piece_bounds": tuple(map(rounded_up, wider.tolist())),
    }


@checked_keywords
def verify(
    certificate: Certificate
    | BoxCertificate
    | hamsym.OrbitCertificate
    | hamsym.SectionCertificate
    | hamsym.Equilibrium
    | hamsym.Invariant
    | str,
    result: Solution
    | FlowMap
    | hamsym.PeriodicOrbit
    | hamsym.Section
    | Hamiltonian
    | str
    | os.PathLike[str],
    time_limit: float | None = None,
    progress: bool | None = None,
    *,
    checker: str = "kernel",
) -> None:
    """Repeat the proof from a result and check every claim of its certificate.

    Parameters
    ----------
    certificate : Certificate, BoxCertificate, OrbitCertificate, SectionCertificate or str
        The text is that of ``to_json``.
    result : Solution, FlowMap, PeriodicOrbit, Section or path
        What the certificate is about; the path is that of a file that :func:`hamsym.save` wrote.
    time_limit : float, optional
        Seconds. By default 60 s plus ten times the run time of certify, at most 600 s, because a
        forged certificate may claim any run time; give a limit for longer proofs.
    progress : bool, optional
    checker : {"kernel", "independent"}
        What proves the claims: the program that proved them, or :mod:`hamsym.proof.checker`, a
        small one on python-flint that shares no line with it. It parses H itself, encloses the
        exact solution by another lemma in ball arithmetic, and proves the very numbers of the
        certificate, in two to fifty times the time of certify; ten times the default limit is
        allowed.
        It covers certificates of solutions; of flow maps with one leg or split across inputs; of
        periodic orbits of an H without explicit time and without further integrals; and beside
        certificates an equilibrium that :func:`hamsym.equilibria` found (its ball, its type and its
        stability, not that a list is complete) and an invariant, each with its Hamiltonian as the
        result.

    Raises
    ------
    CertificationError
        If a claim is not proven, naming the first one, or if the time limit is exceeded.
    FileError
        If the text is not a certificate, or the file cannot be read.
    InputError
        If an argument has another type.
    """
    require_known(checker, _CHECKERS, "a checker")
    independent = checker == "independent"
    if independent and isinstance(certificate, (hamsym.Equilibrium, hamsym.Invariant)):
        H = _of_kind(Hamiltonian, result)
        if isinstance(certificate, hamsym.Invariant):
            verify_invariant(certificate, H)
        else:
            verify_equilibrium(certificate, H)
        return
    if isinstance(certificate, str):
        certificate = certificate_from(certificate)
    known = (Certificate, BoxCertificate, hamsym.OrbitCertificate, hamsym.SectionCertificate)
    if not isinstance(certificate, known):
        raise InputError(
            f"certificate must be a certificate or its text, not {type(certificate).__name__}"
        )
    if independent and isinstance(certificate, hamsym.SectionCertificate):
        raise InputError(
            'checker="independent" covers certificates of solutions, flow maps and orbits, '
            'equilibria and invariants, not those of sections; give checker="kernel" for these'
        )
    patience = 10.0 if independent else 1.0
    if isinstance(certificate, Certificate):
        solution = _of_kind(Solution, result)
        _require_form(certificate, solution)
        deadline = _deadline(time_limit, certificate.seconds, patience)
        if independent:
            verify_solution(certificate, solution, deadline.check)
        else:
            with blas_on_one_core(), share_progress(progress, "proving") as report:
                WindowProof(solution, deadline, report).require(certificate)
        check_solution(solution)
    elif isinstance(certificate, BoxCertificate):
        flow = _of_kind(FlowMap, result)
        _require_form_of_box(certificate, flow)
        deadline = _deadline(time_limit, certificate.seconds, patience)
        if independent:
            verify_flow_map(certificate, flow, deadline.check)
            check_map(flow, [tuple(certificate.box[name] for name in flow.inputs)])
        else:
            _verify_box(certificate, flow, deadline)
    elif isinstance(certificate, hamsym.SectionCertificate):
        certificate.verify(_of_kind(hamsym.Section, result))
    else:
        orbit = _of_kind(hamsym.PeriodicOrbit, result)
        deadline = _deadline(time_limit, certificate.seconds, patience)
        if independent:
            verify_orbit(certificate, orbit, deadline.check)
        else:
            certificate.verify(orbit, time_limit=deadline.left)


def _of_kind(kind: type, result: Any) -> Any:
    """What a certificate is about, read from its file if it is a path."""
    if isinstance(result, (str, os.PathLike)):
        result = load_as(kind, result)
    if not isinstance(result, kind):
        raise InputError(
            f"this certificate needs a {kind.__name__} or its path, not {type(result).__name__}"
        )
    return result


def _require_form(claims: Certificate, solution: Solution) -> None:
    """Raise CertificationError unless a certificate is one about a solution."""
    require_float64()
    try:
        as_json(claims)
    except MALFORMED as error:
        raise CertificationError(f"not a valid certificate: {error}") from None
    if _digest_of(solution) != claims.digest:
        raise CertificationError(
            "the certificate does not belong to this solution (SHA-256 mismatch)"
        )
    if (claims.edges[0], claims.edges[-1]) != tuple(float(edge) for edge in solution.span):
        raise CertificationError("the certificate and the solution have different spans")
    if len(claims.component_bounds) != solution.H.dim:
        raise CertificationError("the certificate and the solution have different dimensions")
    if claims.components != tuple(solution.H.names):
        raise CertificationError("the certificate and the solution name components differently")


def _deadline(time_limit: float | None, seconds: float, factor: float) -> Deadline:
    if time_limit is not None:
        return Deadline.after(time_limit)
    own, share, most = (factor * x for x in (_PATIENCE, _PATIENCE_FACTOR, _MOST_PATIENCE))
    return Deadline.after(
        min(own + share * seconds, most),
        f", by default {own:g} s and {share:g} times what certify took, at most {most:g} s,",
    )


def _require_form_of_box(claims: BoxCertificate, flow: FlowMap) -> None:
    """Raise CertificationError unless a certificate is one about a flow map."""
    try:
        checked = BoxCertificate.from_json(claims.to_json())
    except (FileError, ValueError, TypeError) as error:
        raise CertificationError(f"not a valid certificate: {error}") from None
    if checked != claims:
        raise CertificationError("not a valid certificate: it is not the one that its text gives")
    if map_digest(flow) != claims.digest:
        raise CertificationError(
            "the certificate does not belong to this flow map (SHA-256 mismatch)"
        )
    stated = {
        "components": tuple(flow.H.names),
        "fixed": dict(flow.fixed),
        "expressions": dict(flow.region.expressions),
        "span": tuple(float(t) for t in flow.span),
        "formula": flow.H.formulas,
    }
    for name, value in stated.items():
        if getattr(claims, name) != value:
            raise CertificationError(f"the certificate and the flow map have different {name}")
    if claims.box.keys() != flow.box.keys():
        raise CertificationError("the certificate and the flow map have different inputs")
    for name, (low, high) in flow.box.items():
        if not low <= claims.box[name][0] < claims.box[name][1] <= high:
            raise CertificationError(
                f"the certificate claims {name} from {claims.box[name][0]!r} to "
                f"{claims.box[name][1]!r}, outside the box of the flow map"
            )


def _verify_box(claims: BoxCertificate, flow: FlowMap, deadline: Deadline) -> None:
    """Prove a certificate of a flow map again; see :func:`hamsym.verify`."""
    parts = max(_MOST_PARTS[0], min(claims.parts, _MOST_PARTS[1]))
    _, bound, _ = proven_bound(flow, claims.box, deadline, parts)
    proven = bound <= np.array(claims.bound)
    if not proven.all():
        i = int(np.argmin(proven))
        raise CertificationError(
            f"the bound of {claims.components[i]}, {claims.bound[i]!r}, is not proven: the proof "
            f"gives {float(bound[i])!r}"
        )
