"""Compiled functions of proofs, as one module in hamsym's cache of compiled code.

numba's own cache would not notice that a function called from another file has changed. So the
texts of the modules become one text, whose digest the compiled code in the cache must have.
"""

from __future__ import annotations

import ast
import functools
import importlib.resources
from typing import Any

from hamsym.codegen.numba_cache import load_module
from hamsym.proof.float64_arithmetic import require_float64

_PARTS = ("ball_arithmetic", "chebyshev_models", "window_steps", "taylor_products")


def _text() -> str:
    folder = importlib.resources.files("hamsym.proof")
    texts = []
    for part in _PARTS:
        text = folder.joinpath(f"{part}.py").read_text("utf-8")
        lines = text.splitlines()
        for node in ast.parse(text).body:
            between = isinstance(node, ast.ImportFrom) and node.module in {
                f"hamsym.proof.{name}" for name in _PARTS
            }
            future = isinstance(node, ast.ImportFrom) and node.module == "__future__"
            if between or future:
                lines[node.lineno - 1 : node.end_lineno] = [""] * (
                    (node.end_lineno or node.lineno) - node.lineno + 1
                )
        texts.append("\n".join(lines))
    return "\n\n".join(texts) + "\n"


@functools.cache
def loops() -> Any:
    """The module with all functions, compiled on first use or loaded from the cache."""
    require_float64()  # also for the constants of the text
    return module_of(_text(), "enclosures")


def module_of(text: str, name: str) -> Any:
    """The module of a text, with its functions that are marked as compiled in the checked cache."""
    from hamsym.codegen.checked_cache import cache_functions  # imports numba

    module = load_module(text, name)
    marked = [
        node.name
        for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef)
        and any(
            isinstance(mark, ast.Name) and mark.id == "compiled" for mark in node.decorator_list
        )
    ]
    cache_functions(module, marked, text)
    return module


def require_compiled_float64() -> None:
    """Require IEEE 754 arithmetic in this thread, in numpy and in the compiled functions.

    Raises
    ------
    CertificationError
        Naming what is missing.
    """
    require_float64(loops().basic_operations)
