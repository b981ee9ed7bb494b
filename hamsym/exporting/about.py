"""What an exported file says about the solution in it."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import hamsym
from hamsym.errors import InputError
from hamsym.facts.facts import Facts
from hamsym.facts.solutions import solution_facts
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.solving.recipe import omissions, python_lines
from hamsym.support.records import as_json

_WIDTH = 96  # characters of a line


@dataclass(frozen=True)
class About:
    """A solution, its certificate, and the statements about them."""

    solution: Solution
    #: Of this very solution.
    certificate: hamsym.Certificate | None

    @property
    def digest(self) -> str:
        """SHA-256 of the solution."""
        return digest(self.solution)

    @cached_property
    def facts(self) -> Facts:
        """What is known of the solution."""
        return solution_facts(self.solution, self.certificate)

    def values(self) -> dict[str, Any]:
        """Return the statements as values that JSON can store."""
        solution, known = self.solution, self.solution.settings is not None
        return {
            **self.facts.values(computed=False),
            "sha256": self.digest,
            "hamsym": hamsym.__version__,
            "python": python_lines(solution) if known else None,
            "omissions": omissions(solution),
        }

    def lines(self) -> list[str]:
        """Return the statements as lines of plain text of about 96 characters."""
        return [*self.facts.header(), "", *self._proof(), "", *self._origin()]

    def _proof(self) -> list[str]:
        text = "Certificate: none, the errors are estimated and not proven."
        if self.certificate is not None:
            text = (
                "The rounding of the evaluation comes on top of proven errors. The certificate is "
                "that of this solution; its proof was not repeated for this file, hamsym verify "
                "does that."
            )
        return textwrap.wrap(
            f"{text} SHA-256 of the solution: {self.digest}", _WIDTH, break_on_hyphens=False
        )

    def _origin(self) -> list[str]:
        solution, settings = self.solution, self.solution.settings
        version = f"Made by hamsym {hamsym.__version__}"
        lines = [f"{version}, seed {settings.seed}. To make the solution again:"]
        lines += ["", *(f"    {line}" for line in python_lines(solution).splitlines())]
        missing = " ".join(omissions(solution))
        return [*lines, "", *textwrap.wrap(missing, _WIDTH)] if missing else lines


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
        as_json(certificate)
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
