"""Tasks of a worker in tests, which import little."""

from __future__ import annotations

import os
import time

from hamsym.errors import InputError, ParseError


def double(number: float) -> float:
    return 2 * number


def sleep(seconds: float) -> str:
    time.sleep(seconds)
    return "awake"


def refuse() -> None:
    raise InputError("this cannot be used; give another")


def misread() -> None:
    raise ParseError("^", 2, "is not a power", "write ** for powers")


def fail() -> None:
    raise ZeroDivisionError("division by zero")


def vanish() -> None:
    os._exit(1)


TASKS = {function.__name__: function for function in (double, sleep, refuse, misread, fail, vanish)}
