"""Verification of certificates of flow maps."""

from __future__ import annotations

import numpy as np

from hamsym.errors import CertificationError, FileError
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.proof.box_certificate import BoxCertificate, map_digest
from hamsym.proof.box_proof import proven_bound
from hamsym.proof.limits import Deadline

_MOST_PARTS = 4_096, 100_000  # of a proof; with the parts that a certificate claims


def verify_box(claims: BoxCertificate, flow: FlowMap, deadline: Deadline) -> None:
    """Prove a certificate of a flow map again; see :func:`hamsym.verify`."""
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
    parts = max(_MOST_PARTS[0], min(claims.parts, _MOST_PARTS[1]))
    _, bound, _ = proven_bound(flow, claims.box, deadline, parts)
    proven = bound <= np.array(claims.bound)
    if not proven.all():
        i = int(np.argmin(proven))
        raise CertificationError(
            f"the bound of {claims.components[i]}, {claims.bound[i]!r}, is not proven: the proof "
            f"gives {float(bound[i])!r}"
        )
