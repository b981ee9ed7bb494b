"""No room of hamsym imports itself, by whatever detour; nor does a module while it loads.

Between rooms all imports count. Two modules of one room may know each other for types, or import
each other inside of functions.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

import hamsym

PACKAGE = Path(hamsym.__file__).parent


def module_files(root: Path) -> dict[str, Path]:
    """The modules of a package by name; a package by the name of its folder."""
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@functools.cache
def parsed(source: str) -> ast.Module:
    return ast.parse(source)


def imports_in(source: str) -> Iterator[ast.AST]:
    """All statements, also those in functions; expressions, which are most nodes, have none."""
    waiting: list[ast.AST] = [parsed(source)]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += (
            inner
            for inner in ast.iter_child_nodes(node)
            if isinstance(inner, ast.stmt | ast.excepthandler | ast.match_case)
        )


def imported_modules(
    source: str, module: str, is_package: bool, known: set[str], loading: bool = False
) -> Iterator[str]:
    """Modules among the known ones that a source imports: anywhere in it, or while it loads."""
    for node in parsed(source).body if loading else imports_in(source):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = node.level - is_package
                folder = module.rsplit(".", above)[0] if above else module
                base = f"{folder}.{base}".rstrip(".")
            # from a import b: b is a module of a, or a name in it.
            names = [f"{base}.{alias.name}" for alias in node.names]
            names = [name if name in known else base for name in names]
        else:
            continue
        # import a.b.c makes a.b.c, of which only what is known counts.
        yield from (name for name in names if name in known and name != module)


def import_graph(files: Mapping[str, Path], loading: bool = False) -> dict[str, set[str]]:
    return {
        name: {
            *imported_modules(
                *(path.read_text(encoding="utf-8"), name, path.name == "__init__.py", set(files)),
                loading,
            )
        }
        for name, path in files.items()
    }


def of_rooms(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The imports between folders of the package and loose modules; the package itself is none."""

    def room(name: str) -> str:
        return ".".join(name.split(".")[:2])

    found: dict[str, set[str]] = {}
    for name, others in graph.items():
        found.setdefault(room(name), set()).update(map(room, others))
    root = PACKAGE.name
    return {name: others - {name, root} for name, others in found.items() if name != root}


def circles(graph: Mapping[str, set[str]]) -> list[set[str]]:
    """Sets of modules each of which reaches every other one (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in graph[name]:
            if other not in index:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], index[other])
        if low[name] == index[name]:
            place = stack.index(name)
            component = set(stack[place:])
            del stack[place:]
            if len(component) > 1:
                found.append(component)

    for name in graph:
        if name not in index:
            visit(name)
    return found


def test_no_import_circles() -> None:
    files = module_files(PACKAGE)
    assert len(files) > 50
    assert circles(import_graph(files, loading=True)) == []
    assert circles(of_rooms(import_graph(files))) == []


@pytest.mark.parametrize(
    ("source", "module", "is_package", "expected"),
    [
        ("import a.b", "a.c", False, {"a.b"}),
        ("import a.b as c, os", "a.c", False, {"a.b"}),
        ("from a.b import f, g", "a.c", False, {"a.b"}),
        ("from a import b, c", "a.d", False, {"a.b", "a.c"}),
        ("from . import b", "a.c", False, {"a.b"}),
        ("from .b import f", "a.c", False, {"a.b"}),
        ("from .b import f", "a", True, {"a.b"}),
        ("from ..b import f", "a.d.e", False, {"a.b"}),
        ("def f():\n    import a.b", "a.c", False, {"a.b"}),
        ("if TYPE_CHECKING:\n    from a.b import f", "a.c", False, {"a.b"}),
        ("from a.c import f", "a.c", False, set()),
        ("import sympy\nfrom numpy import linalg", "a.c", False, set()),
    ],
)
def test_every_import_is_counted(
    source: str, module: str, is_package: bool, expected: set[str]
) -> None:
    known = {"a", "a.b", "a.c", "a.d", "a.d.e"}
    assert set(imported_modules(source, module, is_package, known)) == expected


def test_circles_are_found() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": {"d"}, "f": {"a"}}
    assert sorted(map(sorted, circles(graph))) == [["a", "b", "c"], ["d", "e"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
