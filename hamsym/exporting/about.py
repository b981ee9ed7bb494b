"""What an exported file says about the solution in it."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from typing import Any

import hamsym
from hamsym.errors import InputError
from hamsym.proof.balls import decimal
from hamsym.proof.certificate import check
from hamsym.recipe import command_line, omissions, python_lines
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution

_WIDTH = 96  # characters of a line


@dataclass(frozen=True)
class About:
    """A solution, its certificate, and the statements about them."""

    solution: Solution
    #: Of this very solution.
    certificate: hamsym.Certificate | None

    @property
    def digest(self) -> str:
        """SHA-256 of the solution; "" if its network is a module of the caller's."""
        try:
            return digest(self.solution)
        except InputError:
            return ""

    @property
    def tolerance(self) -> float:
        """The relative tolerance that was asked for."""
        return self.solution.settings.tol

    @property
    def errors(self) -> dict[str, float | None]:
        """Largest estimated error of each component; None where it is unknown."""
        names, errors = self.solution.H.names, self.solution.largest_error.tolist()
        return {
            name: error if math.isfinite(error) else None
            for name, error in zip(names, errors, strict=True)
        }

    # -- as JSON values ------------------------------------------------------------------------

    def values(self) -> dict[str, Any]:
        """Return the statements as values that JSON can store."""
        solution, certificate, settings = self.solution, self.certificate, self.solution.settings
        H = solution.H
        return {
            "H": H.formula,
            "forces": dict(H.force_texts),
            "units": dict(H.units),
            "z0": solution.z0.tolist(),
            "success": bool(solution.success),
            "message": solution.message,
            "method": solution.method,
            "seed": settings.seed,
            "tolerance": self.tolerance,
            "estimated_error": self.errors,
            "certificate": None
            if certificate is None
            else {
                "bound": certificate.bound,
                "component_bounds": dict(zip(H.names, certificate.component_bounds, strict=True)),
            },
            "sha256": self.digest or None,
            "hamsym": hamsym.__version__,
            "python": None if settings is None else python_lines(solution),
            "command": None if settings is None else command_line(solution),
            "omissions": omissions(solution),
        }

    # -- as text -------------------------------------------------------------------------------

    def lines(self) -> list[str]:
        """Return the statements as lines of plain text of about 96 characters."""
        solution = self.solution
        H, (start, end) = solution.H, map(float, solution.span)
        lines: list[str] = []
        if not solution.success:
            lines += [
                *_filled(f"This solution did NOT converge (success=False): {solution.message}"),
                "",
            ]
        lines += _entry("H = ", H.formula)
        for name, force in H.force_texts.items():
            lines += _entry(f"Force of {name}: ", force)
        units = [f", {name} in {unit}" for name, unit in H.units.items()]
        lines += _entry("State: ", f"({', '.join(H.names)}){''.join(units)}")
        if H.parameters:
            lines += _entry(
                "Parameters: ",
                ", ".join(f"{name} = {value!r}" for name, value in H.parameters.items()),
            )
        lines += _entry(
            "Start: ",
            ", ".join(f"{n} = {v!r}" for n, v in zip(H.names, solution.z0.tolist(), strict=True)),
        )
        lines += [f"Span: t from {start!r} to {end!r}", ""]
        lines += [*self._accuracy(), "", *self._origin()]
        return [line.rstrip() for line in lines]

    def _accuracy(self) -> list[str]:
        solution = self.solution
        lines = _entry("Method: ", f"{solution.method}; {solution.message}")
        if (tol := self.tolerance) is not None:
            lines += _entry(
                "Tolerance: ",
                f"asked {tol!r} of the largest value of each component, reached "
                f"{_number(solution.relative_error_estimate)}, estimated",
            )
        errors = ", ".join(
            f"{n} {'unknown' if e is None else _number(e)}" for n, e in self.errors.items()
        )
        lines += _entry("Largest estimated error: ", errors)
        return lines + _entry("Certificate: ", self._proof())

    def _proof(self) -> str:
        own, certificate = self.digest, self.certificate
        if certificate is None:
            missing = "none, the errors are estimated and not proven"
            return f"{missing}. SHA-256 of the solution: {own}" if own else missing
        parts = ", ".join(
            f"{name} {decimal(bound)}"
            for name, bound in zip(self.solution.H.names, certificate.component_bounds, strict=True)
        )
        return (
            f"the error is proven to be at most {decimal(certificate.bound)} (2-norm) at all times "
            f"of the span, by component {parts}; the rounding of the evaluation comes on top. The "
            "certificate is that of this solution; its proof was not repeated for this file, "
            f"hamsym verify does that. SHA-256 of the solution: {own}"
        )

    def _origin(self) -> list[str]:
        solution, settings = self.solution, self.solution.settings
        version = f"Made by hamsym {hamsym.__version__}"
        lines = [f"{version}, seed {settings.seed}. To make the solution again:"]
        for text in (python_lines(solution), command_line(solution)):
            lines += ["", *(f"    {line}" for line in text.splitlines())]
        missing = " ".join(omissions(solution))
        return [*lines, "", *_entry("", missing)] if missing else lines


def _number(value: float) -> str:
    return f"{value:.3g}"


def _entry(label: str, text: str) -> list[str]:
    """A labelled text without control characters, wrapped and indented."""
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(text.split()))
    return textwrap.wrap(
        shown,
        _WIDTH,
        initial_indent=label,
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    ) or [label.rstrip()]


def _filled(text: str) -> list[str]:
    return _entry("", text)


def checked_certificate(
    solution: Solution, certificate: hamsym.Certificate | None
) -> hamsym.Certificate | None:
    """Return the certificate of a solution: the one that was given, else its own.

    Raise InputError if it is not a certificate, has numbers that certify does not return, or is
    that of another solution.
    """
    if certificate is None:
        certificate = solution.certificate
    if certificate is None:
        return None
    if not isinstance(certificate, hamsym.Certificate):
        raise InputError(
            f"certificate={certificate!r} is not a Certificate; give the result of "
            "solution.certify(), or Certificate.from_json(text)"
        )
    try:
        check(certificate)
    except ValueError as error:
        raise InputError(
            f"the certificate is not valid: {error}; give the result of solution.certify()"
        ) from None
    if certificate.digest != digest(solution):
        raise InputError(
            "the certificate is that of another solution: its SHA-256 differs; give the one of "
            "this solution, or certify it"
        )
    return certificate
