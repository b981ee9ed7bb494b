"""Modules, classes and functions stay short enough to be read at once."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import hamsym

ROOT = Path(hamsym.__file__).parents[1]
FOLDERS = sorted({str(p.parent.relative_to(ROOT)) for p in (ROOT / "hamsym").rglob("*.py")})
#: Most lines of a module, and most lines without docstrings of a class and of a function.
MODULE, CLASS, FUNCTION = 600, 350, 80
#: Longer modules that are to be divided.
LONGER = {"hamsym/solution/solution.py"}


def is_text(statement: ast.stmt) -> bool:
    """Whether a statement is a docstring."""
    value = getattr(statement, "value", None)
    return isinstance(statement, ast.Expr) and isinstance(getattr(value, "value", None), str)


def own_lines(node: ast.stmt, found: list[tuple[ast.stmt, int]]) -> int:
    """Lines of a statement without docstrings; those of classes and functions in it go to found."""
    lines = (node.end_lineno or 0) - node.lineno + 1
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.stmt):
            whole = (inner.end_lineno or 0) - inner.lineno + 1
            lines -= whole if is_text(inner) else whole - own_lines(inner, found)
    if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        found.append((node, lines))
    return lines


def too_long(name: str, source: str) -> list[str]:
    """Descriptions of what exceeds the limits in a module."""
    length = len(source.splitlines())
    texts = [f"{name} has {length} lines, above {MODULE}"] if length > MODULE else []
    found: list[tuple[ast.stmt, int]] = []
    for statement in ast.parse(source).body:
        own_lines(statement, found)
    for node, lines in found:
        most = CLASS if isinstance(node, ast.ClassDef) else FUNCTION
        if lines > most:
            texts.append(f"{name}: {node.name} has {lines} lines of code, above {most}")
    return texts


@pytest.mark.parametrize("folder", FOLDERS)
def test_nothing_exceeds_the_limits(folder: str) -> None:
    paths = {f"{folder}/{path.name}": path for path in sorted((ROOT / folder).glob("*.py"))}
    found = {name: too_long(name, path.read_text("utf-8")) for name, path in paths.items()}
    assert [text for name in found if name not in LONGER for text in found[name]] == []
    assert all(found[name] for name in LONGER if name in found)


def test_long_code_is_named_and_docstrings_are_free() -> None:
    body = "    x = 1\n" * (FUNCTION - 1)
    text = '    """' + "a\n" * CLASS + '    """\n'
    assert too_long("m", f"def f():\n{text}{body}") == []
    assert too_long("m", f"def f():\n{body}    y = 2\n") == ["m: f has 81 lines of code, above 80"]
    assert too_long("m", "class A:\n" + "    x = 1\n" * CLASS) == [
        "m: A has 351 lines of code, above 350"
    ]
    assert too_long("m", "x = 1\n" * (MODULE + 1)) == ["m has 601 lines, above 600"]
