"""Tasks of processes in tests, which import little."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hamsym.errors import InputError, ParseError
from hamsym.support.machine import available_cores


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


def unsendable() -> Any:
    return lambda: None


def vanish() -> None:
    os._exit(1)


def talk() -> tuple[int, str]:
    print("to the reader")
    warnings.warn("of no use", UserWarning, stacklevel=1)
    return available_cores(), input_or_nothing()


def input_or_nothing() -> str:
    try:
        return input()
    except EOFError:
        return "nothing"


def squared(number: int, report: Callable[[Any], None]) -> int:
    report(f"begun {number}")
    if number < 0:
        raise InputError(f"{number} is negative")
    time.sleep(0.01 * number)
    return number**2


def beating(file: Path, report: Callable[[Any], None]) -> None:
    """Change a file as long as the process runs."""
    while True:
        file.write_text(str(time.monotonic()))
        report("begun")
        time.sleep(0.01)
