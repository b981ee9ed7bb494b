"""Tests of the page's logic, without a browser or a web library."""

from __future__ import annotations

import asyncio
import builtins
import csv
import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym.cli.commands import main
from hamsym.errors import HamsymError, InputError, ParseError
from hamsym.workbench.explore import session, tasks
from hamsym.workbench.explore.messages import Setting, usual_state
from hamsym.workbench.explore.session import (
    FIRST,
    MOST_TABS,
    Latest,
    Session,
    Sessions,
    excerpt,
)
from hamsym.workbench.mathml import mathml


class _InProcess:
    """A worker without a process."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def start(self) -> None:
        pass

    def run(self, task: Callable[..., Any], seconds: float, *arguments: Any) -> Any:
        self.calls.append(task.__name__)
        return task(*arguments)

    def cancel(self) -> None:
        pass

    close = cancel


@pytest.fixture
def tab(monkeypatch) -> Session:
    monkeypatch.setattr(session, "Worker", _InProcess)
    return Session()


# -- the formula ----------------------------------------------------------------------------------


def test_derivation_has_names_equations_and_facts():
    found = tasks.derive(Setting("p**2/(2*m) + k*x**2/2", forces="p = -c*p"))
    assert found.names == ("x", "p")
    assert found.parameter_names == ("c", "k", "m")
    assert found.facts.endswith("energy not conserved: forces act.")
    assert found.equations.count('class="line"') == 4  # H, the force and two equations


def test_hessian_of_many_variables_is_a_list():
    small = tasks.derive(Setting("p**2/2 + x**2/2"))
    assert "<mtable>" in small.hessian
    many = tasks.derive(Setting("sum(i,1,6,p[i]**2/2 + x[i]**4)"))
    assert "<mtable>" not in many.hessian
    assert many.hessian.count("<math") == 12


def test_mathml_is_well_formed_and_short():
    from xml.etree import ElementTree

    H = hamsym.Hamiltonian("p_x**2/(2*9.109e-31) - exp(-x)*sin(x**2)")
    text = mathml(H.expr)
    plain = text.replace("&InvisibleTimes;", "").replace("&ExponentialE;", "e")
    ElementTree.fromstring(f"<math>{plain}</math>")
    assert "0" * 8 not in text  # 9.109e-31 is not written out


@pytest.mark.parametrize(
    ("forces", "message"),
    [("p -c*p", "is not a force"), ("= -c*p", "is not a force"), ("y = 1", "no momentum|momentum")],
)
def test_unusable_forces_are_refused(forces, message):
    with pytest.raises(InputError, match=message):
        tasks.derive(Setting("p**2/2 + x**2/2", forces=forces))


HOSTILE = [
    "__import__('os').system('true')",
    "p**2/2 + 9**9**9**9",
    "(" * 200,
    "x" * 60_000,
    "lambda: 0",
    "p**2/2 + \u202ex",
    "",
    "sum(i, 1, 99999999, p[i]**2)",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_formulas_get_one_sentence(tab, text):
    with pytest.raises(HamsymError) as caught:
        asyncio.run(tab.set_formula(text))
    assert "\n" not in str(caught.value)
    assert "the computation failed" not in str(caught.value)
    assert "<script" not in excerpt(text, caught.value)
    assert tab.setting == FIRST  # as before


def test_excerpt_marks_the_token_and_escapes():
    with pytest.raises(ParseError) as caught:
        hamsym.Hamiltonian("p**2/2 + <b>x</b>")
    shown = excerpt("p**2/2 + <b>x</b>", caught.value)
    assert "<mark>&lt;</mark>b&gt;" in shown
    assert "<b>" not in shown


def test_excerpt_of_a_long_formula_is_short():
    text = "x + " * 500 + "^" + " + x" * 500
    shown = excerpt(text, ParseError("^", 2001, "is not a power", "write **"))
    assert "<mark>^</mark>" in shown
    assert shown.startswith("…")
    assert len(shown) < 150


@pytest.mark.parametrize("name", ["henon_heiles", "paul_trap", "driven_duffing", "toda_chain"])
def test_examples_of_the_catalogue_are_complete(name):
    setting = tasks.example(name)
    found = tasks.derive(setting)
    problem = getattr(hamsym.systems, name)()
    assert found.names == problem.H.names
    assert tuple(setting.z0.values()) == tuple(problem.z0)
    assert set(setting.parameters) == set(found.parameter_names)


# -- values ---------------------------------------------------------------------------------------


def test_values_of_names_that_stay_are_kept(tab):
    asyncio.run(tab.set_formula("p**2/2 + k*x**2/2"))
    assert tab.set_values({"k": 3.0, "time span": 5})
    asyncio.run(tab.set_formula("p**2/(2*m) + k*x**2/2"))
    assert tab.setting.z0 == {"x": 1.3, "p": 1.0}
    assert tab.setting.parameters == {"k": 3.0, "m": 1.0}
    assert tab.setting.span == (0, 5)


def test_start_that_the_reader_chose_is_kept_even_if_it_escapes(tab):
    asyncio.run(tab.set_formula("p**2/2 + x**2/2 - x**3"))
    assert tab.setting.z0["x"] < 0.4
    assert tab.set_values({"x": 3.0})
    asyncio.run(tab.set_formula("p**2/2 + x**2/2 - 2*x**3"))
    assert tab.setting.z0["x"] == 3.0


def test_unusable_values_are_left_out(tab):
    asyncio.run(tab.set_formula("p**2/2 + x**2/2"))
    before = tab.setting
    for values in ({"y": 1.0}, {"x": math.nan}, {"x": "1"}, {"x": None}, {"time span": 0}):
        assert not tab.set_values(values)
    assert tab.setting == before


def test_typed_numbers_may_be_formulas(tab):
    assert asyncio.run(tab.number("4*pi")) == 4 * math.pi
    assert asyncio.run(tab.number("1e-24")) == 1e-24
    for text in ("nan", "inf", "x", "", "1,3"):
        with pytest.raises(HamsymError):
            asyncio.run(tab.number(text))


def test_usual_state_has_distinct_coordinates():
    names = [f"x{k}" for k in range(30)] + [f"p{k}" for k in range(30)]
    state = usual_state(names)
    assert list(state) == names
    assert len({state[f"x{k}"] for k in range(6)}) == 6


# -- motions --------------------------------------------------------------------------------------


def test_motion_is_the_solution_and_its_problem():
    found = tasks.motion(FIRST)
    solution = hamsym.solve(FIRST.formula, FIRST.z0, FIRST.span)
    assert found.verdict.success
    assert found.verdict.headline == solution.facts.headline
    assert found.verdict.energy_error < 1e-9
    assert "export function vector_field" in found.code
    problem = json.loads(found.problem)
    assert problem["z0"] == [1.3, 1.0]
    assert problem["scene"] == {"kind": "potential"}
    assert problem["reference"] is not None


@pytest.mark.slow
def test_motion_of_a_failure_says_so():
    setting = Setting("p**2/2 - 1/x", z0={"x": 1.0, "p": 0.0}, span=(0.0, 5.0))
    found = tasks.motion(setting)
    assert not found.verdict.success
    assert found.verdict.message
    assert json.loads(found.problem)["reference"] is None


def test_parameters_have_sliders_around_their_values():
    setting = Setting("p**2/2 + k*x**2/2", z0={"x": 1.0, "p": 0.0}, parameters={"k": 2.0})
    (k,) = json.loads(tasks.motion(setting).problem)["parameters"]
    assert (k["value"], k["range"]) == (2.0, [0.2, 4.0])


def test_system_without_javascript_is_judged():
    found = tasks.motion(Setting("p**2/2 + x*erf(x)", z0={"x": 1.0, "p": 0.0}, span=(0.0, 5.0)))
    assert found.verdict.success
    assert found.code == ""
    assert "'erf' cannot be generated for javascript" in found.refusal


def test_lesson_is_one_of_the_files():
    assert b"Content-Security-Policy" in tasks.exported(FIRST, ".html")


@pytest.mark.slow
def test_typed_henon_heiles_does_not_escape(tab):
    typed = "(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y - y**3/3"
    for formula in (typed[: typed.index(" + x**2*y")], typed):  # as it is typed
        asyncio.run(tab.set_formula(formula))
    setting = tab.setting
    solution = hamsym.solve(typed, setting.z0, setting.span)
    assert solution.success
    assert solution.scale.max() < 1


# -- requests and buttons -------------------------------------------------------------------------


def test_only_the_latest_request_counts():
    seen: list[int] = []
    state = {"value": 0}

    async def action() -> None:
        value = state["value"]
        await asyncio.sleep(0.01)
        seen.append(value)

    async def moves() -> None:
        latest = Latest(action)
        running = []
        for k in range(20):
            state["value"] = k
            running.append(asyncio.create_task(latest.request()))
            await asyncio.sleep(0)
        await asyncio.gather(*running)

    asyncio.run(moves())
    assert seen[-1] == 19
    assert len(seen) <= 3


def test_failed_request_does_not_block_later_ones():
    outcomes = iter([ValueError, None])
    calls: list[int] = []

    async def action() -> None:
        calls.append(1)
        error = next(outcomes)
        if error:
            raise error

    async def requests() -> None:
        latest = Latest(action)
        with pytest.raises(ValueError):  # noqa: PT011
            await latest.request()
        await latest.request()

    asyncio.run(requests())
    assert len(calls) == 2


def test_second_button_waits_for_none(tab, monkeypatch):
    async def press_both() -> None:
        first = asyncio.create_task(tab.job("certify", 30.0, 30.0))
        await asyncio.sleep(0)
        with pytest.raises(HamsymError, match="another computation"):
            await tab.job("exponents", 30.0, 5.0)
        await first

    from hamsym.workbench.explore.messages import JobResult

    monkeypatch.setattr(tasks, "certify", lambda *_: JobResult("proven"))
    asyncio.run(press_both())


def test_comparison_lists_the_methods():
    setting = replace(FIRST, span=(0.0, 2.0))
    found = tasks.comparison(setting, ("yoshida4",))
    assert found.header[0] == "method"
    assert {row[0] for row in found.rows} >= {"network"}
    with pytest.raises(InputError, match="yoshida"):
        tasks.comparison(setting, ("yoshida99",))


def test_proof_of_a_failure_is_refused():
    setting = Setting("p**2/2 - 1/x", z0={"x": 1.0, "p": 0.0}, span=(0.0, 5.0))
    found = tasks.certify(setting, 10.0)
    assert not found.success
    assert found.statement.startswith("Nothing to prove")


# -- files ----------------------------------------------------------------------------------------


def test_table_has_states_energy_and_errors():
    rows = list(csv.reader(io.StringIO(tasks.table(FIRST).decode())))
    assert rows[0] == ["t", "x", "p", "H", "error of x", "error of p"]
    values = np.array(rows[1:], dtype=float)
    assert np.allclose(values[:, 3], values[0, 3], atol=1e-9)


def test_file_of_the_solution_can_be_loaded(tmp_path):
    path = tmp_path / "orbit.hamsym"
    path.write_bytes(tasks.solution_file(FIRST))
    assert hamsym.load(path).success


@pytest.mark.parametrize("backend", ["torch", "numpy", "numba", "c", "julia", "javascript"])
def test_code_is_that_of_the_hamiltonian(backend):
    text = tasks.code(FIRST, backend)
    assert text == hamsym.Hamiltonian(FIRST.formula).source(backend).rstrip("\n") + "\n"


@pytest.mark.parametrize("ending", [".py", ".json", ".h"])
def test_exported_code_is_that_of_the_solution(ending, tmp_path):
    path = tmp_path / f"orbit{ending}"
    hamsym.solve(FIRST.formula, FIRST.z0, FIRST.span).export(path)
    assert len(tasks.exported(FIRST, ending)) == pytest.approx(path.stat().st_size, rel=0.05)


def test_report_has_the_proof_of_the_present_solution(tab, monkeypatch):
    def outcome(setting: Setting, seconds: float) -> tasks.JobResult:
        return tasks.JobResult("", success=seconds > 1)

    monkeypatch.setattr(tasks, "certify", outcome)
    monkeypatch.setattr(tasks, "report", lambda setting, proven: proven)
    for seconds in (0.5, 2.0):
        asyncio.run(tab.job("certify", seconds, seconds))
        assert asyncio.run(tab.file("report")) is (seconds > 1)
    tab.setting = replace(tab.setting, z0={"x": 1.4, "p": 1.0})
    assert asyncio.run(tab.file("report")) is False


@pytest.mark.slow
def test_report_is_written_with_a_proof():
    assert "Proven" in tasks.report(FIRST, True).decode()


# -- the command ----------------------------------------------------------------------------------


def test_missing_package_is_one_sentence(monkeypatch, capsys):
    real = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name.partition(".")[0] == "nicegui":
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main(["explore", "--no-browser"]) == 2
    message = capsys.readouterr().err
    assert message == 'hamsym: the page needs nicegui; run pip install "hamsym[explore]"\n'


@pytest.mark.parametrize("port", ["-1", "70000"])
def test_unusable_ports_are_refused(port, capsys):
    pytest.importorskip("nicegui")
    assert main(["explore", "--no-browser", "--port", port]) == 2
    assert "give one from 1024 to 65535, or 0" in capsys.readouterr().err


def test_closed_tab_is_told_nothing(monkeypatch):
    ui = pytest.importorskip("nicegui").ui
    from hamsym.workbench.explore.tab_panels import _notify

    said = []
    monkeypatch.setattr(ui, "notify", lambda text, **_: said.append(text))
    session = Session()
    _notify(session, HamsymError("no file"))
    session.close()
    _notify(session, HamsymError("cancelled"))
    assert said == ["no file"]


def test_number_of_tabs_is_limited(monkeypatch):
    monkeypatch.setattr(Session, "start", lambda self: None)
    sessions = Sessions()
    tabs = [sessions.open() for _ in range(MOST_TABS)]
    with pytest.raises(InputError, match=f"{MOST_TABS} tabs of this page are open"):
        sessions.open()
    sessions.close(tabs[0])
    sessions.open()
    sessions.close_all()
