"""The contents of a report: numbers and sentences about a solution, as a template shows them."""

from __future__ import annotations

import importlib.metadata
import math
import platform
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from markupsafe import Markup

from hamsym.codegen.backends import BACKENDS
from hamsym.conservation import KnownInvariants
from hamsym.errors import HamsymError
from hamsym.formula.printer import FormulaPrinter
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import ratios
from hamsym.proof.certificate import Certificate
from hamsym.solution.digest import digest
from hamsym.solution.invariant_check import judged_by_invariants
from hamsym.solution.solution import Solution
from hamsym.workbench.mathml import derivative, equation, mathml, second_derivative

_MATRIX = 8  # components of a Hessian that is shown as a matrix
_LONG = 2_000  # operations of a formula beyond which it is shown as text
_LONGEST = 4_000  # characters of it that are shown
_FEW_NAMES = 12  # components that are listed
_MOST_ENTRIES = 60  # of a Hessian that are shown
_MOST_WINDOWS = 12  # that are shown
_LARGE = 2e9  # operations of an analysis that takes longer than a reader waits
_EXPONENT = re.compile(r"\d[\d.]*e[+-]\d+")
_PACKAGES = ("numpy", "scipy", "sympy", "numba", "python-flint", "torch", "matplotlib")


# -- numbers ---------------------------------------------------------------------------------------


def number(value: float) -> str:
    """Return a number with six digits."""
    return f"{value:.6g}" if math.isfinite(value) else "not finite"


def size(value: float) -> str:
    """Return the size of an error, with two digits."""
    if math.isnan(value):
        return "unknown"
    return f"{value:.2g}" if math.isfinite(value) else "infinite"


def unbroken(text: str) -> Markup:
    """Return a text, escaped, in which no line ends inside a number such as 1e-9."""
    return Markup(_EXPONENT.sub(r'<span class="one">\g<0></span>', str(Markup.escape(text))))


def _in_unit(value: str, unit: str) -> str:
    return value if unit in ("", "1") else f"{value} {unit}"


# -- the verdict -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """Whether a solution is what was asked for, in sentences."""

    success: bool
    headline: str
    #: asked, error: What was asked, and the largest estimated error against it.
    asked: str
    error: str


def verdict(solution: Solution) -> Verdict:
    """Judge a solution, in sentences."""
    success = bool(solution.success)
    wanted, error = _asked_and_error(solution)
    headline = "Succeeded" if success else "Failed: this solution is not what was asked for"
    return Verdict(success, headline, wanted, error)


def _asked_and_error(solution: Solution) -> tuple[str, str]:
    H = solution.H
    start, end = solution.settings.span
    time = H.units.get("t", "")
    span = f"{number(start)} to {_in_unit(number(end), time)}"
    allowed, largest = solution.allowed_error, solution.largest_error
    shares = ratios(largest, allowed)
    worst = int(np.argmax(shares))
    unit = H.units.get(H.names[worst], "")
    wanted = (
        f"For t from {span}, each component with an error of at most "
        f"{solution.settings.tol:g} of its largest value"
    )
    if any(solution.settings.atol):
        wanted += f", and {', '.join(f'{value:g}' for value in solution.settings.atol)} more"
    if not math.isfinite(shares[worst]):
        return wanted, f"unknown: the estimate is infinite for {H.names[worst]}"
    return wanted, (
        f"{shares[worst]:.2g} times what was asked, in {H.names[worst]}: "
        f"{_in_unit(size(largest[worst]), unit)} where "
        f"{_in_unit(size(allowed[worst]), unit)} is allowed"
    )


# -- equations -------------------------------------------------------------------------------------


def _math(pieces: list[str] | str) -> Markup:
    """Return elements ``math``; lines may end between them."""
    pieces = [pieces] if isinstance(pieces, str) else pieces
    return Markup(" ".join(f'<math displaystyle="true">{piece}</math>' for piece in pieces))


def equations(H: Hamiltonian) -> dict[str, Any]:
    """Return H, the forces, the equations of motion and the Hessian as MathML, or as text."""
    left = "<mi>H</mi>"
    return {
        "H": _shown(left, H.expr, H.formula),
        "forces": [
            _shown(f"<msub><mi>F</mi>{mathml(p)}</msub>", H.forces[p.name], H.force_texts[p.name])
            for p in H.p
            if p.name in H.forces
        ],
        "rates": [
            _shown(derivative(symbol), rate)
            for symbol, rate in zip(H.z, H.vector_field, strict=True)
        ],
        **_hessian(H),
        "facts": list(_facts(H)),
    }


def _shown(left: str, right: sympy.Expr, text: str = "") -> Markup:
    """An equation; its right-hand side as text if it is long."""
    if right.count_ops() > _LONG:
        text = text or FormulaPrinter()(right)
        short = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
        return Markup(
            f"{_math(f'<mrow>{left}<mo>=</mo></mrow>')} <code>{Markup.escape(short)}</code>"
        )
    return _math(equation(left, right))


def _hessian(H: Hamiltonian) -> dict[str, Any]:
    matrix = H.hessian
    entries = {(i, j): entry for (i, j), entry in matrix.todok().items() if i <= j and entry != 0}
    ops = sum(int(entry.count_ops()) for entry in entries.values())
    if H.dim <= _MATRIX and ops <= _LONG / 8:
        left = "<mrow><msup><mo>∇</mo><mn>2</mn></msup><mi>H</mi><mo>=</mo></mrow>"
        return {"matrix": _math(f"<mrow>{left}{mathml(matrix)}</mrow>"), "entries": [], "more": 0}
    chosen = sorted(entries.items())[:_MOST_ENTRIES]
    rows = [_shown(second_derivative(H.z[i], H.z[j]), entry) for (i, j), entry in chosen]
    return {"matrix": "", "entries": rows, "more": len(entries) - len(rows)}


def _listed(names: Sequence[str]) -> str:
    if len(names) > _FEW_NAMES:
        names = [*names[: _FEW_NAMES // 2], "...", names[-1]]
    return ", ".join(names)


def _facts(H: Hamiltonian) -> Iterator[str]:
    freedom = "1 degree" if H.dof == 1 else f"{H.dof} degrees"
    yield f"{freedom} of freedom, {H.dim} components: {_listed(H.names)}."
    kind = "H is the sum of a function of the momenta and a function of the coordinates"
    yield f"{kind}." if H.is_separable else "The equations are not separable."
    if cyclic := [symbol.name for symbol in H.cyclic_coordinates]:
        yield f"Cyclic coordinates: {_listed(cyclic)}."
    if H.forces:
        yield "Forces act, so that H is not conserved; its change is compared with their work."
    elif H.time is not None:
        yield "H depends on time, so that it is not conserved."
    else:
        yield "H is conserved."


# -- settings and components -----------------------------------------------------------------------


def settings(solution: Solution) -> list[tuple[str, str]]:
    """Return names and values of settings and costs."""
    H, given, record = solution.H, solution.settings, solution.record
    time = H.units.get("t", "")
    start, end = (repr(float(value)) for value in solution.span)
    found = [("method", solution.method), ("span", f"{start} to {_in_unit(end, time)}")]
    if tuple(given.span) != tuple(solution.span):
        found.append(("span that was asked for", " to ".join(map(repr, given.span))))
    found.append(("seed", str(given.seed)))
    found.append(("tolerance", f"tol {given.tol:g}"))
    found.append(("absolute tolerance", ", ".join(f"{part:g}" for part in given.atol)))
    if given.breakpoints:
        found.append(("breakpoints", ", ".join(f"{part:g}" for part in given.breakpoints)))
    found += [(name, str(value)) for name, value in given.options.items()]
    found += [(name, "an object of the caller's program") for name in given.missing]
    if given.invariants:
        found.append(("invariants", ", ".join(given.invariants)))
    found.append(("proof asked for", "yes" if given.prove else "no"))
    if solution.energy_weight:
        found.append(("energy weight", number(solution.energy_weight)))
    if record.edges is not None:
        found.append(("windows", f"{len(record.edges) - 1:,}"))
    found += [
        ("collocation points", f"{solution.points:,}"),
        ("evaluations of the vector field", f"{solution.evaluations:,}"),
        ("time of the search", f"{record.seconds:.3g} s"),
    ]
    return found


def components(solution: Solution, certificate: Certificate | None) -> list[dict[str, str]]:
    """Return a row for each component: start, end, size, and errors."""
    H, allowed = solution.H, solution.allowed_error
    ends, largest, rows = solution(solution.span[1]), solution.largest_error, []
    for i, name in enumerate(H.names):
        row = {
            "name": name,
            "unit": H.units.get(name, ""),
            "start": repr(float(solution.z0[i])),
            "end": f"{ends[i]:.12g}",
            "largest": number(float(solution.scale[i])),
            "error": size(float(largest[i])),
            "allowed": "" if allowed is None else size(float(allowed[i])),
            "proven": "",
        }
        if certificate is not None:
            row["proven"] = f"{certificate.component_bounds[i]:.3e}"
        rows.append(row)
    return rows


# -- errors ----------------------------------------------------------------------------------------


def errors(solution: Solution) -> dict[str, Any]:
    """Return every statement about the error of a solution that is not a proof."""
    return {
        "energy": _energy(solution),
        "invariants": _invariants(solution),
        "check": _check(solution),
        "paper": _paper(solution),
    }


def _energy(solution: Solution) -> str:
    start = float(solution.energy(solution.span[0]))
    with np.errstate(all="ignore"):
        drift = np.abs(solution.energy_drift(solution.scan_times))
    largest = float(np.nan_to_num(drift, nan=np.inf).max())
    what = "|H(t) - H(start)|" if solution.H.conserves_energy else "|H(t) - H(start) - work(t)|"
    return (
        f"The largest {what} is {size(largest)}; H is {number(start)} at the start"
        f"{', in the unit of q times p over t' if solution.H.units else ''}."
    )


def _invariants(solution: Solution) -> list[tuple[str, str]]:
    drifts = solution.invariant_drift
    formulas = solution.settings.invariants
    if formulas and not drifts:  # they are not part of files
        known = KnownInvariants(solution.H, list(formulas))
        drifts = judged_by_invariants(solution, known).invariant_drift
    return [(formula, size(float(change))) for formula, change in drifts.items()]


def _check(solution: Solution) -> str:
    """How much the estimate changes at a finer resolution."""
    if not np.isfinite(solution.largest_error).all():
        return "The estimated error is infinite, so that it is not resolved."
    if solution.record.seconds > 20:
        return "The estimate was not repeated at a finer resolution, which would take long."
    t = np.linspace(*solution.span, 1_001)
    change = solution.error_estimate_check(t).max(axis=0)
    worst = float(ratios(change, solution.largest_error).max())
    return (
        "At a finer resolution the estimate changes by at most "
        f"{size(worst)} of itself, so that it is {'' if worst < 0.5 else 'not '}resolved."
    )


def _paper(solution: Solution) -> str:
    """The bound ell_max / sigma_min with its limits."""
    work = len(solution.scan_times) * float(solution.H.dim) ** 3
    if not work <= _LARGE:
        return "The paper's bound was not computed, because the trajectory is long."
    residual = f"The largest residual |dz^/dt - J grad H(z^)| is {size(solution.ell_max)} (ell_max)"
    bound = solution.analysis.bound
    if not bound < math.inf:
        return f"{residual}. There is no bound from it: {solution.analysis.vacuous}."
    return (
        f"{residual}, and the smallest singular value of the Hessian along the trajectory is "
        f"{solution.sigma_min:.3g} (sigma_min). The paper's bound on each component of the error, "
        f"ell_max/sigma_min = {size(bound)}, is a heuristic: it assumes an error in one component "
        "only, does not hold where the residual is in resonance with the motion, and mixes the "
        "units of coordinates and momenta."
    )


def windows(solution: Solution) -> dict[str, Any] | None:
    """Return lengths of the windows and estimated errors in some of them; None for one network."""
    edges, error = solution.record.edges, solution.error
    if edges is None or error is None:
        return None
    times = solution.record.origin + np.asarray(edges)
    lengths, count = np.abs(np.diff(times)), len(times) - 1
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_WINDOWS)).round().astype(int))
    allowed, rows = solution.allowed_error, []
    sizes = solution.scale if allowed is None else allowed
    for k in chosen.tolist():
        t = np.linspace(times[k], times[k + 1], 26)[1:-1]
        found = np.abs(error(t)).max(axis=0)
        shares = ratios(found, sizes)
        worst = int(np.argmax(shares))
        rows.append(
            {
                "number": f"{k + 1:,}",
                "start": number(times[k]),
                "end": number(times[k + 1]),
                "error": size(float(found[worst])),
                "component": solution.H.names[worst],
                "ratio": size(float(shares[worst])),
            }
        )
    return {
        "count": f"{count:,}",
        "shortest": number(float(lengths.min())),
        "longest": number(float(lengths.max())),
        "rows": rows,
        "of": "the largest value" if allowed is None else "what is allowed",
        "all": len(chosen) == count,
    }


# -- proofs ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Proof:
    """A certificate that was verified, or the reason why there is none."""

    certificate: Certificate | None
    #: The outcome in one sentence.
    sentence: str
    #: Where the certificate is from.
    how: str = ""

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Names with lower and upper bounds."""
        proven = self.certificate
        if proven is None:
            return []
        names = ["|z| (2-norm)", "H", "residual |dz^/dt - J grad H(z^)|"]
        lows = [proven.lower, proven.energy_lower, proven.ell_max_lower]
        highs = [proven.bound, proven.energy_bound, proven.ell_max_bound]
        return [
            (name, f"{low:.8e}", f"{high:.8e}" if math.isfinite(high) else "no bound")
            for name, low, high in zip(names, lows, highs, strict=True)
        ]


def proof(solution: Solution, certificate: Certificate | None, how: str) -> Proof:
    """Say what a verified certificate proves, or the reason why there is none."""
    if certificate is None:
        return Proof(None, f"Not proven: {how}")
    bounds, allowed = np.array(certificate.component_bounds), solution.allowed_error
    if allowed is None:
        worst = int(np.argmax(bounds / np.where(solution.scale > 0, solution.scale, 1.0)))
        unit = solution.H.units.get(solution.H.names[worst], "")
        bound = _in_unit(size(float(bounds[worst])), unit)
        name = solution.H.names[worst]
        sentence = f"Proven: the error of {name} is at most {bound}, the largest for its size"
        return Proof(certificate, sentence, how)
    shares = ratios(bounds, allowed)
    worst = int(np.argmax(shares))
    largest = f"at most {size(float(shares[worst]))} times that, in {solution.H.names[worst]}"
    if (bounds <= allowed).all():
        sentence = f"Proven: every error is within what was asked, {largest}"
    else:
        sentence = f"Proven, but not that every error is within what was asked: {largest}"
    return Proof(certificate, sentence, how)


def solution_digest(solution: Solution) -> str:
    """Return the SHA-256 of a solution as a function, or the reason why it has none."""
    try:
        return digest(solution)
    except HamsymError as error:
        return f"none: {error}"


def versions(solution: Solution) -> list[tuple[str, str]]:
    """Return names and versions of the programs that made the report."""
    found = [("hamsym", importlib.metadata.version("hamsym"))]
    if solution.settings.version:
        found = [("hamsym that solved", solution.settings.version), ("hamsym", found[0][1])]
    found.append(("Python", f"{platform.python_version()} on {platform.system()}"))
    for name in _PACKAGES:
        try:
            found.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def source(H: Hamiltonian, backend: str, most: int) -> tuple[str, int]:
    """Return generated code up to a number of lines, and how many lines it has."""
    lines = H.source(backend).rstrip("\n").splitlines()
    return "\n".join(lines[:most]) + "\n", len(lines)


def extension(backend: str) -> str:
    """Return the ending of files of a backend, which names the language."""
    return BACKENDS[backend].extension
