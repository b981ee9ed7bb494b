"""Pages of the reference: one for each public name, from its docstrings."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docstrings import prepared

import hamsym

if TYPE_CHECKING:
    from sphinx.application import Sphinx

# Public names by subject; names that are missing here come last, under "More".
GROUPS = {
    "Equations and code": ["Hamiltonian", "System", "Invariant", "Invariants", "systems"],
    "Trajectories": ["solve", "Solution", "integrate", "Trajectory"],
    "Methods of solve": ["Features", "NetworkChain", "LevenbergMarquardt", "SSBroyden", "LBFGS"],
    "Many trajectories": ["solve_many", "Solutions", "flow_map", "FlowMap", "sweep", "Sweep"],
    "Data": ["fit", "Fit"],
    "Proofs": ["certify", "verify", "Certificate", "enclose", "Enclosure", "Ball"],
    "Dynamics": ["lyapunov", "LyapunovExponents", "LyapunovMap", "section", "Section"],
    "Equilibria and periodic orbits": ["equilibria", "Equilibria", "Equilibrium"],
    "Comparison, figures and files": ["compare", "Comparison", "plot", "save", "load"],
    "Errors": ["HamsymError", "InputError", "FileError", "CertificationError"],
}
GROUPS["Equations and code"] += ["transform", "Transformation", "regularize", "Regularization"]
GROUPS["Comparison, figures and files"] += ["describe", "Facts"]
GROUPS["Methods of solve"] += ["Adam", "Regularizer"]
GROUPS["Proofs"] += ["BoxCertificate"]
GROUPS["Equilibria and periodic orbits"] += ["normal_form", "NormalForm"]
GROUPS["Dynamics"] += ["frequencies", "Frequencies", "time_average"]
GROUPS["Dynamics"] += ["chaos_indicators", "ChaosIndicators", "monodromy"]
GROUPS["Proofs"] += ["SectionCertificate"]
GROUPS["Equilibria and periodic orbits"] += ["manifolds", "Manifolds", "Manifold"]
GROUPS["Equilibria and periodic orbits"] += ["connections", "Connections", "Connection"]
GROUPS["Equilibria and periodic orbits"] += ["connection_family"]
GROUPS["Equilibria and periodic orbits"] += ["periodic_orbit", "PeriodicOrbit", "orbit_family"]
GROUPS["Equilibria and periodic orbits"] += ["OrbitFamily", "prove_orbit", "OrbitCertificate"]

# Classes that public functions return or take and that have no name of their own in hamsym.
RETURNED = [
    "hamsym.dynamics.monodromy.TangentMap",
    "hamsym.families.proofs.Proofs",
    "hamsym.networks.record.TrainingState",
    "hamsym.solution.analysis.Analysis",
    "hamsym.solution.events.Events",
]
_MEMBERS = """\
   :members:
   :inherited-members: Sequence, tuple
   :special-members: __call__, __getitem__
"""


def _heading(text: str, mark: str = "=") -> str:
    return f"{text}\n{mark * len(text)}\n\n"


def groups() -> dict[str, list[str]]:
    """Return all public names by subject."""
    named = [name for names in GROUPS.values() for name in names]
    more = [name for name in hamsym.__all__ if name not in named]
    found = {title: [n for n in names if n in hamsym.__all__] for title, names in GROUPS.items()}
    return found | ({"More": more} if more else {})


def found(path: str) -> Any:
    """Return what a dotted path names."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def _page(path: str) -> str:
    """Return the page of a class, a function or a module."""
    thing = found(path)
    if inspect.ismodule(thing):
        return _module_page(path, thing)
    kind = "autoclass" if inspect.isclass(thing) else "autofunction"
    if inspect.isclass(thing) and issubclass(thing, Exception):
        kind = "autoexception"
    title = path.rpartition(".")[2] if path in RETURNED else path
    members = _MEMBERS if kind == "autoclass" else ""
    return _heading(title) + f".. {kind}:: {path}\n{members}"


def _module_page(path: str, module: Any) -> str:
    text = _heading(path) + f".. automodule:: {path}\n\n"
    for name in module.__all__:
        if inspect.isclass(getattr(module, name)):
            text += f".. autoclass:: {path}.{name}\n{_MEMBERS}\n"
        elif inspect.isfunction(getattr(module, name)):
            text += f".. autofunction:: {path}.{name}\n\n"
    return text


def _first_sentence(thing: Any) -> str:
    paragraph = (inspect.getdoc(thing) or "").split("\n\n")[0]
    return prepared([paragraph.replace("\n", " ")])[0]


def _index(pages: dict[str, list[tuple[str, str]]]) -> str:
    text = _heading("Reference")
    text += (
        "Every public name of ``hamsym``, with all arguments, attributes, errors and an example.\n"
        "The same text is in the docstrings: ``help(hamsym.solve)``.\n\n"
    )
    for title, entries in pages.items():
        text += _heading(title, "-") + ".. toctree::\n   :hidden:\n\n"
        text += "".join(f"   {name}\n" for name, _ in entries) + "\n"
        text += ".. list-table::\n   :widths: 30 70\n\n"
        text += "".join(f"   * - :doc:`{name}`\n     - {line}\n" for name, line in entries) + "\n"
    return text


def pages() -> dict[str, str]:
    """Return the text of all pages of the reference by file name."""
    texts: dict[str, str] = {}
    index = {}
    for title, names in groups().items():
        index[title] = [(f"hamsym.{n}", _first_sentence(getattr(hamsym, n))) for n in names]
        texts |= {f"hamsym.{n}.rst": _page(f"hamsym.{n}") for n in names}
    index["Other objects"] = [(path, _first_sentence(found(path))) for path in RETURNED]
    texts |= {f"{path}.rst": _page(path) for path in RETURNED}
    index["Commands"] = [("commands", "The command line: every command with its options.")]
    command = ".. click:: hamsym.cli.commands:cli\n   :prog: hamsym\n   :nested: full\n"
    texts["commands.rst"] = _heading("Command line") + command
    return texts | {"index.rst": _index(index)}


def _write(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "generated" / "reference"
    folder.mkdir(parents=True, exist_ok=True)
    texts = pages()
    for path in folder.iterdir():
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("builder-inited", _write)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
