"""Modules, classes and functions stay short enough to be read at once."""

from __future__ import annotations

import ast
from pathlib import Path

import hamsym

ROOT = Path(hamsym.__file__).parents[1]
#: Most lines of a module, and most lines without docstrings of a class and of a function.
MODULE, CLASS, FUNCTION = 600, 350, 80
#: Longer modules that are to be divided.
LONGER = {"hamsym/solution/solution.py"}

_FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef


def docstring_lines(node: ast.AST) -> int:
    """The lines of all docstrings in a class or a function."""
    found = 0
    for inner in ast.walk(node):
        if isinstance(inner, ast.ClassDef | _FUNCTIONS) and ast.get_docstring(inner) is not None:
            text = inner.body[0]
            found += (text.end_lineno or 0) - text.lineno + 1
    return found


def too_long(name: str, source: str) -> list[str]:
    """Descriptions of what exceeds the limits in a module."""
    length = len(source.splitlines())
    found = [f"{name} has {length} lines, above {MODULE}"] if length > MODULE else []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef | _FUNCTIONS):
            most = CLASS if isinstance(node, ast.ClassDef) else FUNCTION
            lines = (node.end_lineno or 0) - node.lineno + 1 - docstring_lines(node)
            if lines > most:
                found.append(f"{name}: {node.name} has {lines} lines of code, above {most}")
    return found


def test_nothing_exceeds_the_limits() -> None:
    sources = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for path in sorted((ROOT / "hamsym").rglob("*.py"))
    }
    found = {name: too_long(name, source) for name, source in sources.items()}
    assert [text for name, texts in found.items() if name not in LONGER for text in texts] == []
    assert [name for name in LONGER if not found.get(name)] == []


def test_long_code_is_named_and_docstrings_are_free() -> None:
    body = "    x = 1\n" * (FUNCTION - 1)
    text = '    """' + "a\n" * CLASS + '    """\n'
    assert too_long("m", f"def f():\n{text}{body}") == []
    assert too_long("m", f"def f():\n{body}    y = 2\n") == ["m: f has 81 lines of code, above 80"]
    assert too_long("m", "class A:\n" + "    x = 1\n" * CLASS) == [
        "m: A has 351 lines of code, above 350"
    ]
    assert too_long("m", "x = 1\n" * (MODULE + 1)) == ["m has 601 lines, above 600"]
