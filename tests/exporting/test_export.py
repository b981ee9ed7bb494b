"""Exports: values equal those of the solution in every language, statements, bad input."""

from __future__ import annotations

import ctypes
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import sympy
import torch

import hamsym
from hamsym import FileError, Hamiltonian, InputError, Solution, solve
from hamsym.cli.commands import main
from hamsym.exporting.export import FORMATS
from hamsym.exporting.formats import prefix_of

PAGE = Path(__file__).parents[2] / "examples" / "guide" / "exporting.md"
EPS = np.finfo(float).eps

_QUICK = hamsym.Adam(epochs=4, points=12)
_RINGS = "(p_x**2 + p_y**2)/2 + x**2/2 + cos(x)"
#: H, parameters, start, span and options of each kind of solution.
CASES: dict[str, tuple[Any, Any, tuple[float, float], dict[str, Any]]] = {
    "march": ("p**2/2 + x**4/4", [1, 0], (0, 5), {}),
    "many windows": (
        "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)",
        {"x": 1, "p_y": 1.1, "y": 0, "p_x": 0},
        (0, 300),
        {"tol": 1e-6},
    ),
    "backwards, with time": ("p**2/2 - cos(x)*(2 + sin(t))", [1, 0], (3, -20), {}),
    "origin away from zero": ("p**2/2 + x**2/2", [1, 0], (100_000, 100_010), {}),
    "cyclic and at rest": (f"{_RINGS} + p_w**2/2 + w**2", [0.3, 0, 0, 0.1, 0.7, 0], (0, 8), {}),
    "breakpoints, piecewise": (
        "p**2/2 + max(x, -1)**2 + abs(x)",
        [1, 0.2],
        (0, 0.5),
        {"breakpoints": [0.25]},
    ),
    "parameters, a force": (
        Hamiltonian(
            "p**2/(2*m) + k*x**2/2", forces={"p": "-c*p"}, parameters={"m": 2, "k": -0.3, "c": 0.1}
        ),
        [1, 0],
        (0, 4),
        {},
    ),
    "SI units": (
        Hamiltonian(
            "p**2/(2*m) + q_e*U*cos(omega*t)*x**2/r**2",
            parameters={"m": 9.1e-31, "q_e": 1.6e-19, "U": 50.0, "omega": 6e7, "r": 1e-3},
            units={"x": "m", "p": "kg*m/s", "t": "s", "m": "kg", "r": "m", "U": "V", "q_e": "C"}
            | {"omega": "1/s"},
        ),
        [1e-5, 2e-26],
        (0, 1e-7),
        {},
    ),
    "names of the languages": (
        Hamiltonian(
            "p_lambda**2/(2*state) + DIM*lambda**2/2 + erf(lambda)/np + sign(double)*lambda",
            q=["lambda"],
            p=["p_lambda"],
            parameters={"state": 2.0, "DIM": 1.5, "np": 3.0, "double": -1.0},
        ),
        [1, 0],
        (0, 3),
        {},
    ),
    "Greek": (
        Hamiltonian("p_θ**2/2 - ω**2*cos(θ)", parameters={"ω": 1.5}),
        [1, 0],
        (0, 3),
        {},
    ),
    "thirty degrees of freedom": (
        " + ".join(f"p{k}**2/2 + (x{k} - x{(k + 1) % 30})**4/4" for k in range(30)),
        [math.sin(k) for k in range(60)],
        (0, 2),
        {"tol": 1e-6},
    ),
    "failed": ("p**2/2 - x**4/4", [1, 1], (0, 5), {}),
    "chain": (
        "p**2/2 + x**4/4",
        [1, 0],
        (0, 6),
        {"method": hamsym.NetworkChain(windows=3, hidden=(8, 30))},
    ),
    "chain backwards": (
        "p**2/2 + x**4/4",
        [1, 0],
        (6, 0),
        {"method": hamsym.NetworkChain()},
    ),
    "network, sine": (f"{_RINGS}", [0.3, 0, 0, 0.1], (1, 2), {"method": _QUICK}),
    "networks, sigmoid, linear, float32": (
        "p**2/2 + x**4/4",
        [1.1, 0],
        (0, -1),
        {
            "method": replace(
                _QUICK,
                activation="sigmoid",
                envelope="linear",
                dtype="float32",
                shared_weights=False,
                hidden=(5, 4, 3),
            )
        },
    ),
    "network, tanh": (
        "p**2/2 + x**4/4",
        [1.1, 0],
        (0, 1),
        {"method": replace(_QUICK, activation="tanh", hidden=[7])},
    ),
    "networks, one held": (
        "p**2/2 + x**4/4",
        [0, 0],
        (0, 1),
        {"method": replace(_QUICK, shared_weights=False, hidden=[7])},
    ),
}


@cache
def solution_of(name: str) -> Solution:
    H, z0, span, options = CASES[name]
    return solve(H, z0, span, progress=False, **options)


@pytest.fixture(params=CASES)
def solution(request: pytest.FixtureRequest) -> Solution:
    return solution_of(request.param)


def times(solution: Solution) -> np.ndarray:
    """Random times, both ends, and edges of windows with their neighbours."""
    low, high = min(solution.span), max(solution.span)
    found = [np.random.default_rng(1).uniform(low, high, 100), solution.span]
    if solution.record.edges is not None:
        edges = solution.record.edges[:40] + solution.record.origin
        found += [edges, np.nextafter(edges, math.inf), np.nextafter(edges, -math.inf)]
    return np.clip(np.concatenate(found), low, high)


def sizes(solution: Solution, rates: bool = False) -> np.ndarray:
    """Size of each component, or of its rate, as far as round-off is concerned."""
    z, dz = map(np.abs, solution.evaluate(solution.scan_times))
    found = (dz if rates else z).max(axis=0)
    if solution.method != "features":  # sums of terms that cancel
        found = np.maximum(found, 10)
    return np.asarray(found)


def close(found: Any, solution: Solution, t: np.ndarray, ulps: float, rates: bool = False) -> None:
    expected = solution.derivative(t) if rates else solution(t)
    error = np.abs(np.asarray(found) - expected)
    assert (error <= ulps * EPS * sizes(solution, rates)).all(), (error / sizes(solution)).max()


# -- Python ----------------------------------------------------------------------------------------


def module(path: Path) -> ModuleType:
    found = ModuleType(path.stem)
    exec(compile(path.read_text("utf-8"), path.name, "exec"), found.__dict__)  # noqa: S102
    return found


@pytest.fixture
def exported(solution: Solution, tmp_path: Path) -> ModuleType:
    solution.export(tmp_path / "orbit.py", allow_failed=True)
    return module(tmp_path / "orbit.py")


@pytest.mark.slow_cases(
    "chain", "many windows", "network, tanh", "network, sine", "thirty degrees of freedom"
)
@pytest.mark.sampled(9)
def test_modules_have_the_values_of_the_solution(solution: Solution, exported: ModuleType) -> None:
    t = times(solution)
    close(exported.state(t), solution, t, 20)
    close(exported.derivative(t), solution, t, 200, rates=True)
    energy, half = solution.energy(t), solution.H.dim // 2
    # Terms of H may be much larger than their sum.
    terms = np.abs(exported.state(t) * np.roll(exported.derivative(t), half, axis=1)).sum(axis=1)
    allowed = 1e-12 * np.abs(energy) + 1e-13 * (np.abs(energy).max() + terms)
    assert (np.abs(exported.energy(t) - energy) <= allowed).all()
    assert solution.H.names == exported.NAMES
    assert solution.span == exported.SPAN
    assert dict(solution.H.parameters) == exported.PARAMETERS
    assert exported.SUCCESS is bool(solution.success)


@pytest.mark.slow_cases(
    "networks, one held", "thirty degrees of freedom", "networks, sigmoid, linear, float32"
)
def test_modules_start_exactly(solution: Solution, exported: ModuleType) -> None:
    np.testing.assert_array_equal(exported.state(solution.span[0]), solution(solution.span[0]))


def test_components_at_rest_stay_exactly() -> None:
    solution = solution_of("cyclic and at rest")
    assert (solution(times(solution))[:, solution.z0 == 0].max(axis=0) == 0).any()


def test_modules_take_numbers_and_arrays(tmp_path: Path) -> None:
    solution_of("march").export(tmp_path / "orbit.py")
    orbit = module(tmp_path / "orbit.py")
    assert orbit.state(1).shape == (2,)
    assert orbit.state([1, 2]).shape == orbit.derivative([1, 2]).shape == (2, 2)
    assert orbit.state(np.array([])).shape == (0, 2)
    assert orbit.state(np.zeros(10_000)).shape == (10_000, 2)
    assert isinstance(float(orbit.energy(1)), float)
    assert orbit.energy([1, 2]).shape == (2,)
    assert orbit.state(5 * (1 + EPS)).shape == (2,)  # a rounded end


@pytest.mark.parametrize(
    "t", [5.1, -1e-3, math.nan, math.inf, [1, math.nan], [[1.0]], [1, 6], None, "x"], ids=str
)
@pytest.mark.parametrize("function", ["state", "derivative", "energy"])
def test_modules_refuse_other_times(t: Any, function: str, tmp_path: Path) -> None:
    solution_of("march").export(tmp_path / "orbit.py")
    with pytest.raises(ValueError, match=r"outside the span|shape|convert"):
        getattr(module(tmp_path / "orbit.py"), function)(t)


def test_modules_need_numpy_alone(tmp_path: Path) -> None:
    solution = solution_of("names of the languages")
    solution.export(tmp_path / "orbit.py")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import orbit\n"
        "assert not {'hamsym', 'scipy', 'sympy', 'torch'} & sys.modules.keys()\n"
        "print(orbit.state(1.5).tolist(), float(orbit.energy(1.5)))"
    )
    command = [sys.executable, "-I", "-W", "error", "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert out.strip() == f"{solution(1.5).tolist()} {float(solution.energy(1.5))}"


@pytest.mark.slow_cases("thirty degrees of freedom", "networks, sigmoid, linear, float32")
def test_docstrings_say_what_they_are(solution: Solution, exported: ModuleType) -> None:
    text = " ".join((exported.__doc__ or "").split())
    H = solution.H
    assert f"H = {' '.join(H.notation.text(H.expr).split())}" in text
    for name, value in [*zip(H.names, solution.z0.tolist(), strict=True), *H.parameters.items()]:
        assert f"{name} = {value!r}" in text
    for name, force in H.force_texts.items():
        assert f"force of {name} = {force}" in text
    for name, unit in H.units.items():
        assert f"{name} in {unit}" in text
    assert f"Span: t from {solution.span[0]!r} to {solution.span[1]!r}" in text
    assert " ".join(solution.message.split()) in text
    assert f"Made by hamsym {hamsym.__version__}, seed 0" in text
    assert "not proven. SHA-256 of the solution: " in text
    assert "hamsym.solve(" in text
    assert ("FAILED (success=False)" in text) == (not solution.success)
    for name, error in zip(H.names, solution.largest_error, strict=True):
        assert f"{name} = {f'{error:.1e}' if math.isfinite(error) else 'unknown'}" in text


def test_lines_in_docstrings_make_the_solution_again(tmp_path: Path) -> None:
    solution = solution_of("parameters, a force")
    solution.export(tmp_path / "orbit.py")
    text = module(tmp_path / "orbit.py").__doc__ or ""
    lines = re.search(r"again:\n\n((?:    .*\n|\n)*)", text)
    assert lines is not None
    names: dict[str, Any] = {}
    exec(re.sub("^    ", "", lines[1], flags=re.MULTILINE), names)  # noqa: S102
    t = times(solution)
    np.testing.assert_array_equal(names["solution"](t), solution(t))


def test_certificates_are_in_the_docstring(tmp_path: Path) -> None:
    solution = solution_of("march")
    certificate = solution.certify(bound=1e-9)
    solution.export(tmp_path / "orbit.py", certificate=certificate)
    text = " ".join((module(tmp_path / "orbit.py").__doc__ or "").split())
    assert certificate.digest in text
    bound = re.search(r"the state at most (\S+) \(2-norm\)", text)
    assert bound is not None
    assert certificate.bound <= float(bound[1]) <= 1e-9
    solution.export(tmp_path / "orbit.json", certificate=certificate)
    about = json.loads((tmp_path / "orbit.json").read_text())["about"]
    assert about["proven"] == certificate.bound
    assert about["sha256"] == certificate.digest
    proved = solve("p**2/2 + x**2/2", [1, 0], (0, 1), prove=True)
    proved.export(tmp_path / "own.py")
    assert "Proven: the error of" in (module(tmp_path / "own.py").__doc__ or "").replace("\n", " ")


def test_proofs_are_said_not_to_be_repeated(tmp_path: Path) -> None:
    solution = solution_of("march")
    solution.export(tmp_path / "orbit.py", certificate=solution.certify())
    text = " ".join((module(tmp_path / "orbit.py").__doc__ or "").split())
    assert "its proof was not repeated for this file" in text


def test_own_certificate_of_an_altered_solution_is_refused(tmp_path: Path) -> None:
    proved = solve("p**2/2 + x**2/2", [1, 0], (0, 1), prove=True)
    other = solve("p**2/2 + x**2/2", [1, 0.1], (0, 1))
    carried = replace(other, certificate=proved.certificate)
    with pytest.raises(InputError, match="another solution"):
        carried.export(tmp_path / "orbit.py")


@pytest.mark.parametrize("bound", [math.nan, 0.0])
@pytest.mark.parametrize("ending", ["py", "json", "h"])
def test_certificates_with_bounds_that_nothing_proves_are_refused(
    bound: float, ending: str, tmp_path: Path
) -> None:
    solution = solution_of("march")
    forged = replace(solution.certify(), bound=bound)
    with pytest.raises(InputError, match="the certificate is not valid: its bounds"):
        solution.export(tmp_path / f"orbit.{ending}", certificate=forged)


# -- JavaScript ------------------------------------------------------------------------------------


@pytest.fixture
def in_javascript(tmp_path: Path) -> Callable[[Solution, np.ndarray], np.ndarray]:
    """States by the function that the page gives."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    code = re.findall(r"```javascript\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)[0]

    def states(solution: Solution, t: np.ndarray) -> np.ndarray:
        solution.export(tmp_path / "orbit.json", allow_failed=True)
        (tmp_path / "t.json").write_text(json.dumps(t.tolist()))
        read = 'JSON.parse(require("fs").readFileSync(process.argv[{}]))'
        end = f"const orbit = {read.format(2)}, t = {read.format(3)};"
        end += "console.log(JSON.stringify(t.map((t) => state(orbit, t))));"
        (tmp_path / "run.js").write_text(code + end)
        command = [node, *(str(tmp_path / name) for name in ("run.js", "orbit.json", "t.json"))]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        return np.array(json.loads(result.stdout))

    return states


@pytest.mark.sampled(6)
def test_javascript_has_the_values_of_the_solution(solution: Solution, in_javascript: Any) -> None:
    t = times(solution)
    close(in_javascript(solution, t), solution, t, 100)


def test_javascript_refuses_other_times(in_javascript: Any) -> None:
    with pytest.raises(AssertionError, match="is outside the span"):
        in_javascript(solution_of("march"), np.array([5.1]))


def test_json_documents_are_strict(solution: Solution, tmp_path: Path) -> None:
    solution.export(tmp_path / "orbit.json", allow_failed=True)

    def refused(text: str) -> None:
        raise ValueError(text)

    text = (tmp_path / "orbit.json").read_text()
    values = json.loads(text, parse_constant=refused)
    assert values["names"] == list(solution.H.names)
    assert values["about"]["success"] is bool(solution.success)
    assert values["about"]["H"] == solution.H.formula
    if values["kind"] == "features":
        trial: Any = solution.trial
        np.testing.assert_array_equal(values["readouts"], trial.readouts)


# -- C ---------------------------------------------------------------------------------------------

_C = """
#include "my orbit.h"
void states(int n, const double *t, double *z, double *dz, double *h);
void states(int n, const double *t, double *z, double *dz, double *h)
{
    for (int k = 0; k < n; k++) {
        const int first = my_orbit_state(t[k], z + k*my_orbit_DIM);
        const int second = my_orbit_derivative(t[k], dz + k*my_orbit_DIM);
        h[k] = my_orbit_energy(t[k]);
        if (first != second || (my_orbit_component(0) == NULL))
            h[k] = 1e99;
    }
}
"""


@pytest.fixture
def in_c(tmp_path: Path) -> Callable[[Solution, np.ndarray], tuple[np.ndarray, ...]]:
    """States, derivatives and H by a compiled header."""
    cc = shutil.which("cc")
    if cc is None:
        pytest.skip("needs a C compiler, cc")

    def states(solution: Solution, t: np.ndarray) -> tuple[np.ndarray, ...]:
        solution.export(tmp_path / "my orbit.h", allow_failed=True)
        (tmp_path / "main.c").write_text(_C)
        library = tmp_path / "main.so"
        command = [cc, "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow", "-O1"]
        command += ["-shared", "-fPIC", str(tmp_path / "main.c"), "-o", str(library), "-lm"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr[-1000:]
        z, dz = np.full((2, len(t), solution.H.dim), 7.0)
        energy = np.full(len(t), 7.0)
        given = [np.ascontiguousarray(t, dtype=float), z, dz, energy]
        pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for a in given]
        ctypes.CDLL(str(library)).states(len(t), *pointers)
        return z, dz, energy

    return states


def test_headers_have_the_values_of_the_solution(solution: Solution, in_c: Any) -> None:
    t = times(solution)
    z, dz, energy = in_c(solution, t)
    close(z, solution, t, 100)
    close(dz, solution, t, 1000, rates=True)
    near = np.abs(solution(t)).max(axis=1) < 30  # terms of H cancel where a solution diverges
    expected = solution.energy(t)[near]
    atol = 1e-12 * np.abs(expected).max()
    np.testing.assert_allclose(energy[near], expected, rtol=1e-11, atol=atol)


def test_headers_give_nan_outside_the_span(in_c: Any) -> None:
    t = np.array([-0.1, 5.1, math.nan, math.inf, -math.inf])
    assert all(np.isnan(values).all() for values in in_c(solution_of("march"), t))


@pytest.mark.parametrize(
    ("stem", "prefix"),
    [
        ("orbit", "orbit"),
        ("my orbit", "my_orbit"),
        ("2body", "orbit_2body"),
        ("Ökör", "k_r"),
        ("a-b.c", "a_b_c"),
        ("???", "orbit"),
        ("__x__", "x"),
        ("int", "int"),
    ],
)
def test_prefixes_are_identifiers(stem: str, prefix: str) -> None:
    assert prefix_of(stem) == prefix


@pytest.mark.slow
def test_headers_are_cpp_too(tmp_path: Path) -> None:
    cc = shutil.which("c++")
    if cc is None:
        pytest.skip("needs a C++ compiler, c++")
    for name in ("march", "network, tanh", "names of the languages"):
        solution_of(name).export(tmp_path / "orbit.h", allow_failed=True)
        command = [cc, "-x", "c++", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only"]
        subprocess.run([*command, str(tmp_path / "orbit.h")], check=True)


# -- statements and bad input ----------------------------------------------------------------------


def test_networks_of_the_caller_are_refused(tmp_path: Path) -> None:
    network = torch.nn.Sequential(torch.nn.Linear(1, 6), torch.nn.Tanh(), torch.nn.Linear(6, 2))
    method = replace(_QUICK, trial=network)
    solution = solve("p**2/2 + x**2/2", [1, 0], (0, 1), method=method, progress=False)
    with pytest.raises(InputError, match=r"has no closed form; save .* with torch\.save"):
        solution.export(tmp_path / "orbit.py", allow_failed=True)


def test_failed_solutions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the solution failed .*allow_failed=True"):
        solution_of("failed").export(tmp_path / "orbit.py")
    assert not list(tmp_path.iterdir())


def test_texts_of_the_user_cannot_end_a_docstring_or_comment(tmp_path: Path, in_c: Any) -> None:
    message = 'x"""\nimport os\\N{DIGIT ONE}\\ */ int main; /* ??/ \x00\x1b tail\\'
    solution = solution_of("march").judged(False, message)
    solution.export(tmp_path / "orbit.py", allow_failed=True)
    text = module(tmp_path / "orbit.py").__doc__ or ""
    assert 'x""" import os\\N{DIGIT ONE}\\ */ int main; /* ??/' in " ".join(text.split())
    z, _, _ = in_c(solution, np.array([0.0]))
    assert z.tolist() == [[1.0, 0.0]]
    assert b"\x00" not in (tmp_path / "my orbit.h").read_bytes()


@pytest.mark.parametrize("name", ["orbit", "orbit.txt", "orbit.hamsym", "orbit.pyc", ".py", ""])
def test_unknown_endings_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no ending of a format; give one of \.py \(a module"):
        solution_of("march").export(tmp_path / name)


@pytest.mark.parametrize("path", [3, None, [], b"orbit.txt"], ids=str)
def test_names_that_are_no_files_are_refused(path: Any) -> None:
    with pytest.raises(InputError, match=r"is not the name of a file|no ending"):
        solution_of("march").export(path)


def test_unwritable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written: No such file"):
        solution_of("march").export(tmp_path / "missing" / "orbit.py")
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(FileError, match="cannot be written"):
        solution_of("march").export(tmp_path / "folder.py")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.py"]


def test_files_are_replaced_in_one_step(tmp_path: Path) -> None:
    (tmp_path / "ORBIT.PY").write_text("old")
    hamsym.export(solution_of("march"), tmp_path / "ORBIT.PY")
    assert module(tmp_path / "ORBIT.PY").NAMES == ("x", "p")
    assert len(list(tmp_path.iterdir())) == 1


def test_certificates_of_other_solutions_are_refused(tmp_path: Path) -> None:
    other = solve("p**2/2 + x**4/4", [1, 0], (0, 1)).certify(bound=1e-9)
    with pytest.raises(InputError, match="certificate is that of another solution"):
        solution_of("march").export(tmp_path / "orbit.py", certificate=other)
    given: Any = "proof"
    with pytest.raises(InputError, match="certificate='proof' is not a Certificate"):
        solution_of("march").export(tmp_path / "orbit.py", certificate=given)


def test_other_results_are_refused(tmp_path: Path) -> None:
    trajectory: Any = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 1), steps=10)
    with pytest.raises(InputError, match="a Trajectory cannot be exported; give the result of"):
        hamsym.export(trajectory, tmp_path / "orbit.py")


@pytest.mark.parametrize("ending", FORMATS)
def test_too_large_solutions_are_refused(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = FORMATS[ending]
    monkeypatch.setitem(FORMATS, ending, type(row)(row.summary, row.content, 100))
    with pytest.raises(
        InputError, match=r"numbers in 8 windows, more than the 100 .* shorter span"
    ):
        solution_of("march").export(tmp_path / f"orbit{ending}")


def test_binary_fractions_of_a_formula_are_told(tmp_path: Path) -> None:
    x, p = sympy.symbols("x p")
    H = Hamiltonian(p**2 / 2 + sympy.Float(0.1) * x**2, q=[x], p=[p])
    solve(H, [1, 0], (0, 1)).export(tmp_path / "orbit.py")
    assert "H has binary fractions" in (module(tmp_path / "orbit.py").__doc__ or "")
    solution_of("march").export(tmp_path / "orbit.py")
    assert "H has binary fractions" not in (module(tmp_path / "orbit.py").__doc__ or "")


@pytest.mark.slow
def test_members_are_exported(tmp_path: Path) -> None:
    many = hamsym.solve_many("p**2/2 + x**2/2", [[1, 0], [2, 0]], (0, 3))
    hamsym.export(many[1], tmp_path / "member.py")
    t = np.linspace(0, 3, 50)
    np.testing.assert_allclose(module(tmp_path / "member.py").state(t), many[1](t), atol=1e-14)
    with pytest.raises(InputError, match=r"a Solutions cannot be exported; .* many\[0\]"):
        hamsym.export(many, tmp_path / "many.py")


# -- command line ----------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    solution_of("march").save("a.hamsym")
    solution_of("failed").save("failed.hamsym")
    return tmp_path


@pytest.mark.usefixtures("saved")
def test_command_exports_with_the_certificate_beside(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "a.hamsym", "-o", "a.py"]) == 0
    assert re.fullmatch(r"wrote a\.py \(2\d(\.\d)? kB\)\n", capsys.readouterr().out)
    assert "not proven" in (module(Path("a.py")).__doc__ or "")
    assert main(["certify", "a.hamsym", "--bound", "1e-9"]) == 0
    assert main(["export", "a.hamsym", "-o", "a.h"]) == 0
    assert "Proven: the error of" in Path("a.h").read_text()


@pytest.mark.usefixtures("saved")
@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        ("a.hamsym -o a.txt", 2, "'a.txt' has no ending of a format"),
        ("a.hamsym", 2, "Missing option '-o'"),
        ("missing.hamsym -o a.py", 2, "missing.hamsym"),
        ("a.hamsym -o missing/a.py", 2, "directory of 'missing/a.py' does not exist"),
        ("a.hamsym -o a.py --certificate missing", 2, "'missing' cannot be read: No such file"),
        ("a.hamsym -o a.py --certificate a.hamsym", 2, "is not a certificate"),
        ("a.hamsym -o a.py --certificate other", 2, "'other' is the certificate of another solu"),
        ("failed.hamsym -o a.py", 2, "the solution failed"),
        ("failed.hamsym -o a.py --allow-failed", 0, ""),
    ],
)
def test_command_names_what_is_wrong(
    arguments: str, status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    other = solve("p**2/2 + x**4/4", [1, 0], (0, 1)).certify(bound=1e-9)
    Path("other").write_text(other.to_json())
    assert main(["export", *arguments.split()]) == status
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == bool(status)
    assert Path("a.py").exists() == (status == 0)


@pytest.mark.slow
@pytest.mark.usefixtures("saved")
def test_solve_exports(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["solve", "p**2/2 + x**4/4", "--z0", "1,0", "--t-end", "5", "--export"]
    assert main([*command, "b.json"]) == 0
    assert "wrote b.json" in capsys.readouterr().out
    assert main([*command, "b.xyz"]) == 2
    command[1] = "p**2/2 - x**4/4"
    assert main([*command, "c.json"]) == 1
    assert "c.json is not written: the solution failed" in capsys.readouterr().out
    assert not Path("c.json").exists()
