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
from hamsym.workbench.explore import charts, session, tasks
from hamsym.workbench.explore.session import (
    FIRST,
    MOST_TABS,
    Latest,
    Session,
    Sessions,
    excerpt,
)
from hamsym.workbench.explore.setting import Setting, SliderRange, usual_state
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


# -- sliders --------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [1.3, -0.7, 1e-24, -3.2e-24, 6e30, 5e-300, 0.0, 42])
def test_slider_reaches_around_the_value(value):
    slider = SliderRange.around(value)
    assert slider.low < value < slider.high
    assert slider.high >= 2 * abs(value)
    step = (slider.high - slider.low) / slider.positions
    assert abs(slider.value(slider.position(value)) - value) <= 0.51 * step


def test_slider_positions_have_distinct_values():
    slider = SliderRange.around(3.2e-24)
    values = [slider.value(k) for k in range(slider.positions + 1)]
    assert np.all(np.diff(values) > 0)
    assert (values[0], values[-1]) == (slider.low, slider.high)


def test_positive_slider_never_reaches_zero():
    slider = SliderRange.around(20.0, positive=True)
    assert slider.value(0) > 0
    assert slider.value(slider.positions) == slider.high == 50.0


def test_slider_suits_values_that_it_can_move():
    slider = SliderRange.around(1.0)
    assert slider.suits(1.9)
    assert slider.suits(0.0)
    assert not slider.suits(2.1)
    assert not slider.suits(1e-6)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_slider_of_no_number_is_refused(value):
    with pytest.raises(InputError, match="is not a finite number"):
        SliderRange.around(value)


# -- the formula ----------------------------------------------------------------------------------


def test_derivation_has_names_equations_and_facts():
    found = tasks.derive("p**2/(2*m) + k*x**2/2", "", "", "p = -c*p")
    assert found.names == ("x", "p")
    assert found.parameter_names == ("c", "k", "m")
    assert not found.has_energy
    assert found.facts.endswith("energy not conserved: forces act.")
    assert found.equations.count('class="line"') == 4  # H, the force and two equations


def test_hessian_of_many_variables_is_a_list():
    small = tasks.derive("p**2/2 + x**2/2", "", "", "")
    assert "<mtable>" in small.hessian
    many = tasks.derive("sum(i,1,6,p[i]**2/2 + x[i]**4)", "", "", "")
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
        tasks.derive("p**2/2 + x**2/2", "", "", forces)


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
    found = tasks.derive(setting.formula, setting.q, setting.p, setting.forces)
    problem = getattr(hamsym.systems, name)()
    assert found.names == problem.H.names
    assert tuple(setting.z0.values()) == tuple(problem.z0)
    assert set(setting.parameters) == set(found.parameter_names)


# -- values ---------------------------------------------------------------------------------------


def test_values_of_names_that_stay_are_kept(tab):
    asyncio.run(tab.set_formula("p**2/2 + k*x**2/2"))
    tab.set_value("k", 3.0)
    asyncio.run(tab.set_formula("p**2/(2*m) + k*x**2/2"))
    assert tab.setting.z0 == {"x": 1.3, "p": 1.0}
    assert tab.setting.parameters == {"k": 3.0, "m": 1.0}


@pytest.mark.parametrize(("name", "value"), [("y", 1.0), ("x", math.nan)])
def test_unusable_values_are_refused(tab, name, value):
    with pytest.raises(InputError):
        tab.set_value(name, value)


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


# -- pictures -------------------------------------------------------------------------------------


def test_picture_is_the_solution():
    found = tasks.picture(FIRST)
    solution = hamsym.solve(FIRST.formula, FIRST.z0, FIRST.span)
    assert found.success
    assert np.array_equal(found.z, solution(found.t))
    assert found.z.shape == (len(found.t), 2)
    assert found.headline == solution.facts.headline
    assert found.energy_error.max() < 1e-9


def test_level_sets_are_curves_of_equal_energy():
    found = tasks.picture(FIRST)
    energy = hamsym.Hamiltonian(FIRST.formula).observable(FIRST.formula)
    assert len(found.levels) >= 5
    for line in found.levels:
        values = energy(line)
        assert np.ptp(values) < 0.05 * max(abs(values).max(), 0.1)


@pytest.mark.slow
def test_picture_of_a_failure_says_so():
    setting = Setting("p**2/2 - 1/x", z0={"x": 1.0, "p": 0.0}, span=(0.0, 5.0))
    found = tasks.picture(setting)
    assert not found.success
    assert found.message
    options = charts.plane(("x", "p"), 0, 1, found)
    assert "not accepted" in options["title"]["text"]


@pytest.mark.slow
def test_fast_motion_gets_more_points():
    setting = replace(FIRST, span=(0.0, 400.0))
    assert len(tasks.picture(setting).t) > len(tasks.picture(FIRST).t)


def test_section_lies_on_the_surface():
    setting = replace(tasks.example("henon_heiles"), span=(0.0, 5.0))
    found = tasks.section(setting, "y = 0, p_y > 0")
    assert found.axes == ("x", "p_x")
    assert found.points.shape[1] == 2
    assert len(found.points) > 5


@pytest.mark.parametrize("scale", [1.0, 1e-24, 1e12])
def test_charts_are_json_with_readable_numbers(scale):
    found = tasks.picture(FIRST)
    found = replace(found, z=found.z * scale)
    drawn = [
        charts.over_time("Coordinates", ("x", "p"), [0], found),
        charts.plane(("x", "p"), 0, 1, replace(found, box=None)),
        charts.errors_over_time(found, 1e-9, False),
    ]
    json.dumps(drawn, allow_nan=False)
    values = np.array(drawn[0]["series"][0]["data"])[:, 1]
    assert 1e-3 <= np.abs(values).max() < 1e5
    unit = 1.0 if scale == 1 else float(drawn[0]["title"]["text"].split(" / ")[1])
    assert np.allclose(values * unit, found.z[:, 0], rtol=1e-4, atol=1e-4 * scale)


def test_axis_of_a_constant_hides_round_off():
    found = tasks.picture(FIRST)
    rng = np.random.default_rng(0)
    z = np.column_stack([1 + 1e-15 * rng.standard_normal(len(found.t)), found.z[:, 1]])
    axis = charts.over_time("Coordinates", ("x", "p"), [0], replace(found, z=z))["yAxis"]
    assert axis["max"] - axis["min"] > 0.1


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


def test_compiled_loops_belong_to_one_formula(tab, monkeypatch):
    drawn: list[str] = []

    def section(setting: Setting, surface: str) -> None:
        drawn.append(setting.formula)
        if "bad" in surface:
            raise InputError("no surface")

    monkeypatch.setattr(tasks, "section", section)
    asyncio.run(tab.set_formula("p**2/2 + x**2/2"))
    assert not tab.is_compiled
    tab.surface = "bad"
    with pytest.raises(HamsymError, match="no surface"):
        asyncio.run(tab.section())
    assert not tab.is_compiled
    tab.surface = "x = 0"
    asyncio.run(tab.section())
    assert tab.is_compiled
    asyncio.run(tab.set_formula("p**2/2 + x**2/3"))
    assert not tab.is_compiled
    assert drawn == ["p**2/2 + x**2/2"] * 2


def test_second_button_waits_for_none(tab, monkeypatch):
    async def press_both() -> None:
        first = asyncio.create_task(tab.job("certify", 30.0, 30.0))
        await asyncio.sleep(0)
        with pytest.raises(HamsymError, match="another computation"):
            await tab.job("exponents", 30.0, 5.0)
        await first

    from hamsym.workbench.explore.results import JobResult

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
    text = tasks.code(FIRST.formula, "", "", "", backend)
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
