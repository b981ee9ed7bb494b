"""Files of certificates."""

from __future__ import annotations

import stat
from pathlib import Path

from hamsym.errors import FileError
from hamsym.proof.certificate import Certificate

__all__ = ["read_certificate"]

_LARGEST = 2**25  # bytes


def read_certificate(path: Path) -> Certificate:
    """Read the file of a certificate; nothing is proven.

    Raises
    ------
    FileError
        If the file cannot be read, or has no certificate.
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
    return Certificate.from_json(text)
