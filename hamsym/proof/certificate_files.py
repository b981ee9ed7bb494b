"""Certificates of every kind in texts and files."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

import hamsym
from hamsym.errors import FileError
from hamsym.proof.box_certificate import BoxCertificate
from hamsym.proof.certificate import Certificate
from hamsym.proof.certificate_text import BOX_KIND, ORBIT_KIND, kind_of

_LARGEST = 2**25  # bytes


def certificate_from(text: str) -> Any:
    """Read the text of a certificate of a solution, a flow map or an orbit; nothing is proven.

    Raise FileError if the text is not a certificate.
    """
    kinds: dict[str, Any] = {BOX_KIND: BoxCertificate, ORBIT_KIND: hamsym.OrbitCertificate}
    return kinds.get(kind_of(text), Certificate).from_json(text)


def read_certificate(path: Path) -> Any:
    """Read the file of a certificate; nothing is proven.

    Raise FileError if the file cannot be read, or has no certificate.
    """
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode) and status.st_size > _LARGEST:
            raise FileError(f"'{path}' is too large for a certificate")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FileError(f"'{path}' is not a certificate") from None
    return certificate_from(text)
