"""The panels below the charts: code, what buttons compute, and files."""

from __future__ import annotations

import html
import time
from collections.abc import Callable
from typing import Any

from nicegui import ui

from hamsym.codegen.backends import BACKENDS
from hamsym.errors import HamsymError
from hamsym.integrators.table import INTEGRATORS
from hamsym.workbench.explore.messages import JobResult
from hamsym.workbench.explore.session import Session

_HIDDEN = "balls"  # a backend for proofs, which no program of the reader runs


class CodePanel:
    """The generated code of the present H."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with ui.element("div").classes("choices"):
            self._backend = ui.select(
                [name for name in BACKENDS if name != _HIDDEN],
                label="Backend",
                value="numpy",
                on_change=self.show,
            ).props("dense outlined options-dense")
            ui.button("Download code", on_click=self._download).props("no-caps")
        self._code = ui.html("", sanitize=False).classes("code")

    async def show(self) -> None:
        """Show the code of the chosen backend."""
        try:
            text = await self._session.code(str(self._backend.value))
        except HamsymError as error:
            text = str(error)
        self._code.content = f"<pre tabindex=0>{html.escape(text)}</pre>"

    async def _download(self) -> None:
        backend = str(self._backend.value)
        try:
            text = await self._session.code(backend)
        except HamsymError as error:
            _notify(self._session, error)
            return
        ui.download(text.encode(), f"hamiltonian_{backend}.{BACKENDS[backend].extension}")


def _notify(session: Session, error: HamsymError) -> None:
    """Say why there is no file, unless its tab was closed, which ended its computation."""
    if not session.closed:
        ui.notify(str(error), type="negative", multi_line=True)


def build_proof(session: Session) -> None:
    """Build the panel that certifies."""
    ui.label("Prove bounds on the error of this solution, from both sides.")
    _JobPanel(session, "certify", "Certify", lambda seconds: (seconds,))


def build_exponents(session: Session) -> None:
    """Build the panel of the Lyapunov exponents."""
    ui.label("Lyapunov exponents: how fast do trajectories from nearby starts part?")
    spans = ui.number("Time, in time spans", value=50, min=1, max=1e6).props("dense outlined")
    _JobPanel(session, "exponents", "Compute exponents", lambda _: (float(spans.value or 50),))


def build_comparison(session: Session) -> None:
    """Build the panel that compares with integrators."""
    ui.label("Compare this solution with integrators at equal and at finer steps.")
    methods = ui.select(
        list(INTEGRATORS), label="Integrators (none: the usual ones)", multiple=True, value=[]
    ).props("dense outlined options-dense use-chips")
    _JobPanel(session, "comparison", "Compare", lambda _: (tuple(methods.value or ()),))


def build_downloads(session: Session) -> None:
    """Build the buttons that download files of the present solution."""

    async def download(
        button: ui.button, filename: str, task: str, arguments: tuple[Any, ...]
    ) -> None:
        button.props("loading")  # no second click meanwhile
        state.text = f"Making {filename}."
        if task == "report":
            state.text += " Its comparison with integrators takes up to a minute."
        try:
            content = await session.file(task, *arguments)
        except HamsymError as error:
            if not session.closed:  # a closed tab ends its computations
                state.text = f"{filename} was not made: {error}."
            return
        finally:
            if not session.closed:
                button.props(remove="loading")
        state.text = f"{filename} is made."
        ui.download(content, filename)

    ui.label("Files of the present solution; they need no network.")
    files = (
        ("Data (CSV)", "data.csv", "table", ()),
        ("Solution, for hamsym.load", "orbit.hamsym", "solution_file", ()),
        ("Report (HTML)", "report.html", "report", ()),
        ("Lesson (HTML)", "lesson.html", "exported", (".html",)),
        ("Python module, needs numpy only", "orbit.py", "exported", (".py",)),
        ("JSON, for JavaScript", "orbit.json", "exported", (".json",)),
        ("C header", "orbit.h", "exported", (".h",)),
    )
    with ui.element("div").classes("downloads"):
        for title, filename, task, arguments in files:
            ui.button(
                title,
                on_click=lambda event, f=filename, k=task, a=arguments: download(
                    event.sender, f, k, a
                ),
            ).props("no-caps outline")
    state = ui.label("").props("role=status")


class _JobPanel:
    """A button whose answer takes time, with its limit, progress and cancellation."""

    def __init__(
        self, session: Session, task: str, title: str, arguments: Callable[[float], tuple[Any, ...]]
    ) -> None:
        self._session, self._task, self._arguments = session, task, arguments
        with ui.element("div").classes("choices"):
            self._limit = ui.number("Time limit in s", value=120, min=1, max=86_400).props(
                "dense outlined"
            )
            self._button = ui.button(title, on_click=self._run).props("no-caps")
            self._cancel = ui.button("Cancel", on_click=self._session.cancel).props(
                "no-caps outline"
            )
        self._bar = ui.linear_progress(0.0, show_value=False).props('aria-label="time used"')
        self._state = ui.label("").props("role=status")
        self._result = ui.element("div").classes("result")
        self._show_running(False)

    def _show_running(self, running: bool) -> None:
        self._button.set_enabled(not running)
        self._cancel.set_visibility(running)
        self._bar.set_visibility(running)

    async def _run(self) -> None:
        seconds = float(self._limit.value or 120)
        setting = self._session.setting
        began = time.monotonic()
        self._result.clear()
        self._show_running(True)

        def show_time() -> None:
            used = time.monotonic() - began
            self._bar.value = min(used / seconds, 1.0)
            self._state.text = f"Running for {used:.0f} s of at most {seconds:g} s."

        show_time()
        with self._result:
            timer = ui.timer(0.5, show_time)
        try:
            found = await self._session.job(self._task, seconds, *self._arguments(seconds))
        except HamsymError as error:
            self._state.text = f"{error}."[:1].upper() + f"{error}."[1:]
            return
        finally:
            timer.deactivate()
            self._show_running(False)
        self._state.text = f"Done in {time.monotonic() - began:.1f} s, for {setting.summary()}."
        self._show(found)

    def _show(self, found: JobResult) -> None:
        rows = "".join(
            f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>"
            for row in found.rows
        )
        head = "".join(f"<th scope=col>{html.escape(name)}</th>" for name in found.header)
        table = (
            f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>" if rows else ""
        )
        kind = "" if found.success else " class=failed"
        with self._result:
            ui.html(f"<p{kind}>{html.escape(found.statement)}</p>{table}", sanitize=False)
