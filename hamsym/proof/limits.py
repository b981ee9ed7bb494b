"""The limit of a proof on wall time."""

from __future__ import annotations

import time
from dataclasses import dataclass

from hamsym.errors import CertificationError
from hamsym.support.validation import require_positive


class TimeLimitError(CertificationError):
    """The wall time of a proof exceeds its limit."""


@dataclass(frozen=True)
class Deadline:
    """A limit on wall time."""

    #: Seconds.
    limit: float | None
    #: Start, by ``time.monotonic``.
    began: float
    #: Origin of the limit, for the message.
    origin: str = ""

    @classmethod
    def after(cls, limit: float | None, origin: str = "") -> Deadline:
        """A limit that starts now; raise InputError unless it is a positive number or None."""
        if limit is not None:
            require_positive("time_limit", limit)
        return cls(limit, time.monotonic(), origin)

    @property
    def exceeded(self) -> bool:
        """Whether the limit has passed."""
        return self.limit is not None and not time.monotonic() - self.began <= self.limit

    @property
    def left(self) -> float | None:
        """Seconds until the limit, at least a millisecond; None without a limit."""
        if self.limit is None:
            return None
        return max(self.limit - (time.monotonic() - self.began), 1e-3)

    def check(self, stage: str) -> None:
        """Require that the limit is not exceeded.

        Raises
        ------
        TimeLimitError
            Naming the stage of the proof.
        """
        if self.exceeded:
            raise TimeLimitError(
                f"time limit of {self.limit:g} s{self.origin} reached while {stage}; increase it"
            )
