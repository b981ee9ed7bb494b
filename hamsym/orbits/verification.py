"""Verification of certificates of periodic orbits."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import hamsym
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.orbits.claims import orbit_digest, statement_of
from hamsym.orbits.proven_stability import WEAKER
from hamsym.proof.ball import Ball


def verify_orbit(
    claims: hamsym.OrbitCertificate, orbit: hamsym.PeriodicOrbit, time_limit: float | None
) -> None:
    """Prove a certificate of an orbit again; see :func:`hamsym.verify`."""
    if not isinstance(orbit, hamsym.PeriodicOrbit):
        raise InputError(
            f"a certificate of an orbit needs its PeriodicOrbit, not {type(orbit).__name__}"
        )
    try:
        type(claims).from_json(claims.to_json())
    except (FileError, ValueError, TypeError) as error:
        raise CertificationError(f"not a valid certificate: {error}") from None
    if orbit_digest(orbit) != claims.digest:
        raise CertificationError("the certificate does not belong to this orbit (SHA-256 mismatch)")
    stated = statement_of(
        orbit.problem,
        claims.period,
        claims.bound,
        claims.unique_within,
        claims.stability,
        claims.pieces,
    )
    if claims.statement != stated:
        raise CertificationError("the statement of the certificate does not match its numbers")
    found = hamsym.prove_orbit(orbit, time_limit=time_limit)
    proven = {
        "z0": _is_within(found.z0, claims.z0),
        "period": _is_within(found.period, claims.period),
        "monodromy": _is_within(found.monodromy, claims.monodromy),
        "bound": found.bound <= claims.bound,
        "unique_within": claims.unique_within <= found.unique_within,
        "stability": claims.stability in (found.stability, *WEAKER[found.stability]),
        "pieces": claims.pieces == found.pieces,
    }
    for name, holds in proven.items():
        if not holds:
            raise CertificationError(f"the {name} of the certificate is not proven")


def _is_within(inner: Ball, outer: Ball) -> bool:
    """Whether every number of a ball is in another one, decided exactly."""
    if np.shape(inner.mid) != np.shape(outer.mid):
        return False
    numbers = (
        np.ravel(part).tolist() for ball in (inner, outer) for part in (ball.mid, ball.radius)
    )
    return all(
        abs(Fraction(a) - Fraction(b)) + Fraction(r) <= Fraction(s)
        for a, r, b, s in zip(*numbers, strict=True)
        if np.isfinite(s)
    )
