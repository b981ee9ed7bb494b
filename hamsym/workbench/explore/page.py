"""The page of one tab, built with nicegui; what moves in it is templates/player."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from nicegui import events, ui

from hamsym.errors import HamsymError, InputError
from hamsym.systems.catalogue import CATALOGUE
from hamsym.workbench.explore.messages import Motion, Setting, Verdict
from hamsym.workbench.explore.session import SPAN, Latest, Session, Sessions, excerpt
from hamsym.workbench.explore.tab_panels import (
    CodePanel,
    build_comparison,
    build_downloads,
    build_exponents,
    build_proof,
)
from hamsym.workbench.lessons.lesson import player_elements, player_script, player_style

_Event: TypeAlias = events.ValueChangeEventArguments
_Handler: TypeAlias = Callable[[_Event], Awaitable[None]]

_STYLE = Path(__file__).with_name("page.css")
_SCRIPT = Path(__file__).with_name("page.js")
_TYPING = 250  # milliseconds without a key before a formula is read
_TABS = ("Equations", "Code", "Prove", "Exponents", "Compare", "Download")
_TOLERANCES = {1e-6: "1e-6", 1e-9: "1e-9", 1e-12: "1e-12"}


def build(sessions: Sessions) -> None:
    """Build the page of a new tab, or say that too many are open."""
    try:
        session = sessions.open()
    except InputError as error:
        ui.label(str(error)).props("role=alert")
        return
    ui.context.client.on_delete(lambda: sessions.close(session))
    Page(session).build()


class Page:
    """The elements of a page and what they do."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._formula_read = Latest(self._read_formula)
        self._drawing = Latest(self._draw)
        self._example = ""
        self._filling = False  # fields are being filled by the program
        self._given: dict[str, float] = {}  # values of the address, for the first system
        self._is_new = True  # whether the player must get the system before its values

    # -- elements ------------------------------------------------------------------------------

    def build(self) -> None:
        """Build all elements."""
        ui.dark_mode().auto()
        ui.add_css(_STYLE.read_text(encoding="utf-8") + player_style())
        script = f"{player_script()}\n{_SCRIPT.read_text(encoding='utf-8')}"
        ui.add_body_html(f'<script type="module">{script}</script>')
        self._client = ui.context.client
        with ui.element("div").classes("explore"):
            with ui.element("section").classes("problem").props('aria-label="Problem"'):
                self._build_problem()
            with ui.element("section").classes("answers").props('aria-label="Results"'):
                self._build_verdict()
                self._player = ui.html(player_elements(), sanitize=False)
                self._build_tabs()
        ui.on("moved", self._moved)
        self._session.start()
        ui.timer(0.05, self._begin, once=True)

    async def _begin(self) -> None:
        """Take the values of the address, and show the first system."""
        await self._client.connected()
        texts = await self._client.run_javascript("hamsymAddress()", timeout=30)
        self._take_address({str(name): str(text) for name, text in texts.items()})
        await self._formula_read.request()

    def _take_address(self, texts: Mapping[str, str]) -> None:
        if texts.get(".H"):
            q, p, forces = (texts.get(f".{name}", "") for name in ("q", "p", "forces"))
            self._fill(Setting(texts[".H"], q, p, forces))
        for name, text in texts.items():
            with contextlib.suppress(ValueError):
                self._given[name] = float(text)
        if self._given.get(".tol") in _TOLERANCES:
            self._tolerance.value = self._given[".tol"]
        if texts.get(".tab") in _TABS:
            self._tabs.value = texts[".tab"]

    def _build_problem(self) -> None:
        setting = self._session.setting
        ui.html("<h1>hamsym explore</h1>", sanitize=False)
        self._examples = ui.select(
            sorted(CATALOGUE),
            label="Example from the catalogue",
            with_input=True,
            clearable=True,
            on_change=self._unless_filling(self._choose_example),
        ).props("dense outlined options-dense")
        typed = self._unless_filling(self._typed)
        self._formula = (
            ui.textarea("Hamiltonian H", value=setting.formula, on_change=typed)
            .props(f"outlined dense autogrow debounce={_TYPING} spellcheck=false")
            .classes("formula")
        )
        self._error = ui.element("div").classes("error").props("role=alert")
        with self._error:
            self._excerpt = ui.html("", sanitize=False)
            self._reason = ui.label("")
        self._error.set_visibility(False)
        self._names = ui.expansion("Names and forces").props("dense").classes("names")
        with self._names:
            dense = f"outlined dense debounce={_TYPING} spellcheck=false"
            self._q = ui.input("Coordinates, e.g. x, y", on_change=typed).props(dense)
            self._p = ui.input("Their momenta, e.g. p_x, p_y", on_change=typed).props(dense)
            forces = ui.textarea("Forces, one a line: p = -c*p", on_change=typed)
            self._forces = forces.props(f"{dense} autogrow")
        with ui.element("div").classes("fields"):
            self._start = ui.input("from t =", value=f"{setting.span[0]:.10g}")
            self._start.props("outlined dense").on("blur", self._start_typed)
            self._start.on("keydown.enter", self._start_typed)
            self._tolerance = ui.select(
                {**_TOLERANCES, setting.tol: f"{setting.tol:g}"},
                label="tolerance",
                value=setting.tol,
                on_change=self._tolerance_chosen,
            ).props("outlined dense options-dense")

    def _build_verdict(self) -> None:
        with ui.element("div").classes("verdict").props("role=status aria-live=polite") as box:
            self._verdict_text = ui.label("Starting…")
            self._stop = ui.button("Stop", on_click=self._session.stop_drawing).props(
                "dense outline no-caps"
            )
        self._stop.set_visibility(False)
        self._verdict = box

    def _build_tabs(self) -> None:
        with ui.tabs(
            value=_TABS[0], on_change=lambda event: self._keep({".tab": event.value})
        ) as self._tabs:
            made = {name: ui.tab(name) for name in _TABS}
        self._tabs.props("dense no-caps align=left mobile-arrows outside-arrows")
        panels = ui.tab_panels(self._tabs, value=_TABS[0], animated=False).props("keep-alive")
        with panels.classes("panels"):
            with ui.tab_panel(made["Equations"]):
                self._facts = ui.label("")
                self._equations = ui.html("", sanitize=False).classes("mathematics")
                ui.html("<h2>Hessian</h2>", sanitize=False)
                self._hessian = ui.html("", sanitize=False).classes("mathematics")
            with ui.tab_panel(made["Code"]):
                self._code = CodePanel(self._session)
            for name, build_panel in (
                ("Prove", build_proof),
                ("Exponents", build_exponents),
                ("Compare", build_comparison),
                ("Download", build_downloads),
            ):
                with ui.tab_panel(made[name]):
                    build_panel(self._session)

    def _unless_filling(self, handler: _Handler) -> Callable[[_Event], Awaitable[None] | None]:
        """Return a handler that does nothing while the program fills in the fields.

        Handlers run after the change, when it would be too late for them to ask.
        """
        return lambda event: None if self._filling else handler(event)

    # -- the formula ---------------------------------------------------------------------------

    async def _typed(self, _: _Event) -> None:
        self._example = ""
        await self._formula_read.request()

    async def _choose_example(self, event: _Event) -> None:
        if event.value:
            self._example = event.value
            await self._formula_read.request()

    async def _read_formula(self) -> None:
        session = self._session
        text = self._formula.value or ""
        name, self._example = self._example, ""
        try:
            with self._stoppable():
                if name:
                    await session.set_example(name)
                else:
                    extra = self._q.value or "", self._p.value or "", self._forces.value or ""
                    await session.set_formula(text, *extra)
        except HamsymError as error:
            self._show_error(text, error)
            return
        self._error.set_visibility(False)
        self._formula.props(remove="error")
        if name:
            self._fill(session.setting)
        session.set_values(self._given)
        self._given = {}
        self._show_derivation()
        self._keep_formula()
        await self._code.show()
        self._is_new = True
        await self._drawing.request()

    def _keep_formula(self) -> None:
        setting = self._session.setting
        texts = {"H": setting.formula, "q": setting.q, "p": setting.p, "forces": setting.forces}
        self._keep({f".{name}": text for name, text in texts.items()})

    def _keep(self, values: Mapping[str, str]) -> None:
        """Keep what belongs to the page in the address."""
        self._client.run_javascript(f"window.hamsymKeep?.({json.dumps(values)})")

    def _fill(self, setting: Setting) -> None:
        self._filling = True
        self._formula.value, self._forces.value = setting.formula, setting.forces
        self._q.value, self._p.value = setting.q, setting.p
        self._filling = False

    def _show_error(self, text: str, error: HamsymError) -> None:
        self._error.set_visibility(True)
        self._formula.props("error no-error-icon hide-bottom-space")
        self._excerpt.content = excerpt(text, error)
        hint = ""
        if "q=[...]" in str(error):
            hint = " On this page they are under Names and forces."
            self._names.value = True
        self._reason.text = f"{error}.{hint}"
        self._player.classes(add="stale")
        self._say("H cannot be read; the pictures are of the last one that could.", "failed")

    def _show_derivation(self) -> None:
        found = self._session.derivation
        if found is None:
            return
        self._equations.content, self._hessian.content = found.equations, found.hessian
        self._facts.text = found.facts

    # -- values --------------------------------------------------------------------------------

    async def _moved(self, event: events.GenericEventArguments) -> None:
        """Take the values of the player's sliders."""
        if isinstance(event.args, dict) and self._session.set_values(event.args):
            await self._drawing.request()

    async def _start_typed(self) -> None:
        try:
            start = await self._session.number(self._start.value or "")
        except HamsymError as error:
            self._say(f"start: {error}", "failed")
            return
        if start != self._session.setting.span[0]:
            self._session.set_start(start)
            self._is_new = True
            await self._drawing.request()

    async def _tolerance_chosen(self, event: _Event) -> None:
        self._session.set_tolerance(float(event.value))
        self._keep({".tol": f"{event.value:g}"})
        await self._drawing.request()

    async def _draw(self) -> None:
        """Solve the present setting, for the verdict and, if the system is new, for the player."""
        session = self._session
        if session.derivation is None:
            return
        refusal = ""
        try:
            with self._stoppable():
                if self._is_new:
                    motion = await session.motion()
                    found, refusal = motion.verdict, motion.refusal
                else:
                    found = await session.verdict()
        except HamsymError as error:
            self._player.classes(add="stale")
            self._say(f"No solution: {error}. The pictures are of earlier values.", "failed")
            return
        if self._is_new and not refusal:
            self._is_new = False
            self._show(motion)
        if refusal:
            self._player.classes(add="stale")
        else:
            self._player.classes(remove="stale")
        self._judge(found, f" Nothing of it is drawn: {refusal}." if refusal else "")

    def _show(self, motion: Motion) -> None:
        """Hand a system and its present values to the player."""
        setting = self._session.setting
        length = setting.span[1] - setting.span[0]
        values = json.dumps({**setting.z0, **setting.parameters, SPAN: length})
        code = json.dumps(motion.code)
        self._client.run_javascript(f"hamsymShow({code}, {motion.problem}, {values})")

    def _judge(self, found: Verdict, more: str) -> None:
        earlier = " This is the last H that could be read." if self._error.visible else more
        if found.success:
            self._say(
                f"Accepted: {found.headline}, energy error at most {found.energy_error:.1e} of the "
                f"terms of H. {_duration(found.seconds)}.{earlier}",
                "accepted",
            )
        else:
            self._say(f"Not accepted: {found.message}.{earlier}", "failed")

    def _say(self, text: str, kind: str) -> None:
        self._verdict_text.text = text
        self._verdict.classes(remove="accepted failed", add=kind)

    @contextlib.contextmanager
    def _stoppable(self) -> Any:
        """If it takes long, say so, and show the button that ends what is live."""

        def show() -> None:
            self._say("Computing… The verdict and the pictures follow.", "")  # the old one is stale
            self._stop.set_visibility(True)

        shown = asyncio.get_running_loop().call_later(0.7, show)
        try:
            yield
        finally:
            shown.cancel()
            self._stop.set_visibility(False)


def _duration(seconds: float) -> str:
    if seconds >= 0.9995:
        return f"{seconds:.1f} s"
    return f"{1e3 * seconds:.1f} ms" if seconds < 0.00995 else f"{1e3 * seconds:.0f} ms"
