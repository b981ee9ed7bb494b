"""Lessons: what the page consists of, its trajectories in node, and what is refused."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.cli.commands import main
from hamsym.errors import CodeGenerationError
from hamsym.workbench.lessons.problem import moving
from hamsym.workbench.lessons.start import proposed_start

SPRING = "p**2/2 + k*x**2/2"
KEPLER = "(p_x**2 + p_y**2)/2 - k/sqrt(x**2 + y**2)"
#: H, parameters, start and span of systems with trajectories of different kinds.
SYSTEMS: dict[str, tuple[Any, dict[str, float], list[float], tuple[float, float]]] = {
    "oscillator": (SPRING, {"k": 2.0}, [1, 0], (0, 20)),
    "Henon-Heiles": (
        "(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y - y**3/3",
        {},
        [0.3, 0.1, 0.2, 0.3],
        (0, 40),
    ),
    "eccentric Kepler": (KEPLER, {"k": 1.0}, [0.2, 0, 0, 3.0], (0, 10)),
    "double pendulum": ("double_pendulum", {}, [], (0, 0)),
    "driven, backwards": ("p**2/2 - cos(x)*(2 + sin(w*t))", {"w": 1.5}, [1, 0], (3, -12)),
    "damped": (
        Hamiltonian("p**2/2 + x**4/4", forces={"p": "-c*p + cos(t)"}),
        {"c": 0.1},
        [1, 0],
        (0, 20),
    ),
    "charge in a magnetic field": (
        "((p_x + B*y/2)**2 + (p_y - B*x/2)**2 + p_z**2)/2 + z**2/2",
        {"B": 1.3},
        [1, 0, 0.2, 0.1, 0.4, 0],
        (0, 15),
    ),
}


def solved(name: str) -> hamsym.Solution:
    H, parameters, z0, span = SYSTEMS[name]
    if name == "double pendulum":
        problem = hamsym.systems.double_pendulum()
        return hamsym.solve(problem.H, problem.z0, (0, 15))
    H = Hamiltonian.of(H, bound=False).with_parameters(**parameters)
    return hamsym.solve(H, z0, span)


def parts(page: str) -> tuple[str, str, dict[str, Any]]:
    """The script, the style sheet and the problem of a page."""
    scripts = re.findall(r"<script(.*?)>(.*?)</script>", page, flags=re.DOTALL)
    (kind, data), (module, script) = scripts
    assert kind == ' type="application/json" id="problem"'
    assert module == ' type="module"'
    (style,) = re.findall(r"<style>(.*?)</style>", page, flags=re.DOTALL)
    return script, style, json.loads(data)


def written(folder: Path, result: Any, **options: Any) -> str:
    hamsym.export(result, folder / "a.html", **options)
    return (folder / "a.html").read_text("utf-8")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("lesson")
    options: dict[str, Any] = {"z0": [1, 0.5], "parameters": {"k": (0.5, 2.5)}, "title": "A spring"}
    return written(folder, SPRING, **options, text="It swings.\n\nAnd swings.")


# -- the page --------------------------------------------------------------------------------------


def test_policy_allows_the_inline_script_and_style_alone(page: str) -> None:
    script, style, _ = parts(page)
    policy = re.search(r'http-equiv="Content-Security-Policy" content="(.*?)"', page)
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in html.unescape(policy[1]).split(";"))
    for rule, text in (("script-src", script), ("style-src", style)):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"
    assert rules["default-src"] == "'none'"
    assert " style=" not in page
    assert re.search(r"\son\w+=", page) is None
    assert re.search(r"(src|href)=\"(?!data:|#)", page) is None


def test_page_has_values_ranges_and_texts(page: str) -> None:
    problem = parts(page)[2]
    assert problem["z0"] == [1, 0.5]
    assert problem["span"] == [0, 20]
    (k,) = problem["parameters"]
    assert (k["name"], k["value"], k["range"]) == ("k", 1.5, [0.5, 2.5])
    assert "<h1>A spring</h1>\n<p>It swings.</p>\n<p>And swings.</p>" in page
    assert "<math" in page
    assert len(page.encode()) < 300_000


def test_markup_in_texts_is_text(tmp_path: Path) -> None:
    attack = '</script><img src=x onerror="alert(1)"><!--'
    page = written(tmp_path, SPRING, z0=[1, 0], parameters={"k": (1, 3)}, title=attack, text=attack)
    parts(page)
    assert attack not in page
    assert page.count(html.escape(attack, quote=False).replace('"', "&#34;")) == 3


def test_start_of_a_range_includes_the_motion(page: str) -> None:
    problem = parts(page)[2]
    largest = np.sqrt(1 + 0.5**2 / 1.5)
    low, high = problem["starts"][0]
    assert low < -largest < largest < high
    kepler = hamsym.solve("(p_r**2 + L**2/r**2)/2 - 1/r".replace("L", "1"), [1.2, 0], (0, 20))
    from hamsym.workbench.lessons.problem import problem as of

    assert of(kepler, {})["starts"][0][0] > 0


def test_thirty_degrees_of_freedom_fit(tmp_path: Path) -> None:
    n = 30
    H = "+".join(f"p{i}**2/2 + (x{i} - x{(i + 1) % n})**2/2" for i in range(n))
    page = written(tmp_path, H, z0=np.linspace(0, 1, 2 * n), span=(0, 0.5))
    assert len(page.encode()) < 300_000
    assert parts(page)[2]["scene"] == {
        "kind": "chain",
        "coordinates": list(range(n)),
        "axes": [{"base": "site"}, {"base": "x", "unit": ""}],
    }


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        (KEPLER, {"kind": "plane", "bodies": [[0, 1]]}),
        ("p_phi**2/2 - cos(phi)", {"kind": "pendulum", "angles": [0], "lengths": [1.0]}),
        ("(p_u**2 + p_v**2)/2 + u**2*v**2", {"kind": "plane", "bodies": [[0, 1]]}),
        ("p_u**2 + p_v**2 + p_w**2 + u*v*w", {"kind": "chain", "coordinates": [0, 1, 2]}),
        (
            "p_r**2/2 + p_theta**2/(2*r**2) - r*cos(theta)",
            {"kind": "polar", "pairs": [[0, 1]], "zero": -np.pi / 2, "rods": True},
        ),
    ],
)
def test_names_of_coordinates_say_what_moves(formula: str, expected: dict[str, Any]) -> None:
    assert moving(Hamiltonian(formula)) == expected


# -- trajectories ----------------------------------------------------------------------------------

_RUN = """
const problem = JSON.parse(process.argv[1]);
const parameters = Object.fromEntries(problem.parameters.map(({ key, value }) => [key, value]));
const field = (z, t, out) => vector_field(z, t, parameters, out);
const trajectory = new Trajectory(field, problem.z0, problem.span, problem.method, TOLERANCE);
trajectory.advance(1e9);
const [start, end] = problem.span, out = new Float64Array(problem.z0.length);
const states = Array.from({ length: 101 }, (_, k) =>
  Array.from(trajectory.state(start + (end - start) * k / 100, out)));
const { reason, t, taken } = trajectory;
const { reference } = problem;
const difference = reference && largestDifference(trajectory, reference);
console.log(JSON.stringify({ states, reason, t, taken, difference }));
"""


@pytest.fixture(scope="module")
def node() -> str:
    path = shutil.which("node") or shutil.which("nodejs")
    if path is None:
        pytest.skip("needs node, the system's package nodejs")
    return path


def run(node: str, page: str, **values: Any) -> dict[str, Any]:
    """What the script of a page computes without the page."""
    script, _, problem = parts(page)
    script = script[: script.index("const problem = JSON.parse(document")] + _RUN
    command = [node, "--input-type=module", "-e", script, json.dumps(problem | values)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("name", SYSTEMS)
def test_trajectory_of_the_page_is_that_of_solve(name: str, node: str, tmp_path: Path) -> None:
    solution = solved(name)
    found = run(node, written(tmp_path, solution))
    assert (found["reason"], found["t"]) == ("", solution.span[1])
    expected = solution(np.linspace(*solution.span, 101))
    errors = np.abs(np.array(found["states"]) - expected).max(axis=0) / solution.scale
    assert errors.max() < 1e-8
    assert found["difference"] < 1e-8


def test_difference_sees_another_trajectory(node: str, page: str) -> None:
    found = run(node, page, z0=[1.001, 0.5])
    assert 1e-4 < found["difference"] < 1e-2
    assert run(node, page, span=[0, 20.01])["difference"] > 1e-3


@pytest.mark.parametrize(
    ("formula", "z0", "end"),
    # Collision of a radial fall, at pi/(2 sqrt(2)); escape in finite time, at pi/4.
    [("p**2/2 - 1/x", [1.0, 0.0], np.pi / np.sqrt(8)), ("p*(1 + x**2)", [0.0, 1.0], np.pi / 2)],
)
def test_collisions_and_escapes_end_with_a_reason(
    formula: str, z0: list[float], end: float, node: str, tmp_path: Path
) -> None:
    page = written(tmp_path, formula, z0=z0, span=(0, 1.0))
    found = run(node, page, span=[0, 20])
    assert found["reason"] == "it collides or escapes"
    assert found["t"] == pytest.approx(end, rel=1e-6)


# -- starts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "formula",
    [
        "(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y - y**3/3",
        "p**2/2 + (x - 3)**2/2 - (x - 3)**3",
        "p**2/2 - cos(x) + x**2/10",
        KEPLER.replace("k", "1"),
        "(p_r**2 + p_phi**2/r**2)/2 - 1/r",
    ],
)
def test_proposed_starts_are_accepted_and_stay(formula: str) -> None:
    span = (0.0, 20.0)
    start = proposed_start(Hamiltonian(formula), span)
    solution = hamsym.solve(formula, start, span)
    assert solution.success
    assert np.abs(solution(np.linspace(*span, 500))[:, : solution.H.dof]).max() < 50
    assert any(start.values())


def test_given_start_is_kept_if_it_is_accepted() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x**3/3")
    assert proposed_start(H, (0, 20), [0.3, 0.1]) == {"x": 0.3, "p": 0.1}
    assert proposed_start(H, (0, 20), [3.0, 0.0])["x"] < 1


def test_lesson_without_a_start_gets_one(tmp_path: Path) -> None:
    page = written(tmp_path, "p**2/2 + x**2/2 - x**3", title="A well")
    assert parts(page)[2]["reference"] is not None


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"z0": [1, 0], "parameters": {"k": (1, 2), "m": (1, 2)}}, "'m' is not a parameter of H"),
        ({"z0": [1, 0], "parameters": {"k": (2, 1)}}, r"k=\(2, 1\) is no range"),
        ({"z0": [1, 0], "parameters": {"k": (1, float("nan"))}}, "k=.* is no range"),
        ({"z0": [1, 0], "parameters": {"k": 1.0}}, "k=1.0 is no range"),
        ({"z0": [1, 0], "parameters": {"k": (1, 10**400)}}, "k=.* is no range"),
        ({"z0": [1, 0], "parameters": 3}, "parameters=3 is not a mapping"),
        ({"z0": [1, 0], "parameters": {"k": (1, 2)}, "title": 3}, "are texts"),
        ({"z0": [1, 0], "parameters": {"k": (-2, -1)}, "span": (0, 500)}, "the solution failed"),
    ],
)
def test_unusable_options_are_refused(
    options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        hamsym.export(SPRING, tmp_path / "a.html", **options)
    assert not (tmp_path / "a.html").exists()


def test_ranges_contain_the_values(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian(SPRING, parameters={"k": 4.0}), [1, 0], (0, 5))
    with pytest.raises(InputError, match="k = 4 is not between 1 and 2"):
        solution.export(tmp_path / "a.html", parameters={"k": (1, 2)})
    with pytest.raises(InputError, match="z0 and span are those of the solution"):
        hamsym.export(solution, tmp_path / "a.html", z0=[1, 0])
    with pytest.raises(InputError, match="has no certificate"):
        solution.export(tmp_path / "a.html", certificate=solution.certify())
    with pytest.raises(InputError, match="title is an option of lessons"):
        solution.export(tmp_path / "a.py", title="A spring")
    with pytest.raises(InputError, match="a Hamiltonian cannot be exported"):
        hamsym.export(solution.H, tmp_path / "a.py")


def test_functions_that_javascript_lacks_are_named(tmp_path: Path) -> None:
    with pytest.raises(CodeGenerationError, match="'erf' cannot be generated for javascript"):
        hamsym.export("p**2/2 + x*erf(x)", tmp_path / "a.html", z0=[1, 0])


def test_command_writes_a_lesson(tmp_path: Path) -> None:
    file, page = tmp_path / "a.hamsym", tmp_path / "a.html"
    solution = hamsym.solve(Hamiltonian(SPRING, parameters={"k": 1.0}), [1, 0], (0, 5))
    solution.save(file)
    options = ["--slider", "k=0.5:2", "--title", "A spring", "--text", "It swings."]
    assert main(["export", str(file), "-o", str(page), *options]) == 0
    problem = parts(page.read_text("utf-8"))[2]
    assert problem["parameters"][0]["range"] == [0.5, 2]
    assert "<p>It swings.</p>" in page.read_text("utf-8")
