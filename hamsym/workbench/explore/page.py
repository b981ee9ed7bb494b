"""The page of one tab, built with nicegui."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeAlias

from nicegui import events, ui

from hamsym.errors import HamsymError, InputError
from hamsym.systems.catalogue import CATALOGUE
from hamsym.workbench.explore import charts
from hamsym.workbench.explore.results import Picture
from hamsym.workbench.explore.session import Latest, Session, Sessions, excerpt
from hamsym.workbench.explore.setting import Setting
from hamsym.workbench.explore.tab_panels import (
    CodePanel,
    build_comparison,
    build_downloads,
    build_exponents,
    build_proof,
)
from hamsym.workbench.explore.values_panel import ValuesPanel

_Event: TypeAlias = events.ValueChangeEventArguments
_Handler: TypeAlias = Callable[[_Event], Awaitable[None]]

_STYLE = Path(__file__).with_name("page.css")
_SCRIPT = Path(__file__).with_name("page.js")
_TYPING = 250  # milliseconds without a key before a formula is read
_QUIET = 1.0  # seconds without a change before the loops of a section are compiled
_MOST_CURVES = 6


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
        self._section_drawing = Latest(self._draw_section)
        self._picture: Picture | None = None
        self._waiting: asyncio.TimerHandle | None = None
        self._example = ""
        self._filling = False  # fields are being filled by the program

    # -- elements ------------------------------------------------------------------------------

    def build(self) -> None:
        """Build all elements."""
        ui.add_css(_STYLE.read_text(encoding="utf-8"))
        ui.add_body_html(f"<script>{_SCRIPT.read_text(encoding='utf-8')}</script>")
        self._client = ui.context.client
        with ui.element("div").classes("explore"):
            with ui.element("section").classes("problem").props('aria-label="Problem"'):
                self._build_problem()
            with ui.element("section").classes("answers").props('aria-label="Results"'):
                self._build_verdict()
                self._build_charts()
                self._build_tabs()
        self._session.start()
        ui.timer(0.05, self._formula_read.request, once=True)

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
        self._formula = (
            ui.textarea(
                "Hamiltonian H", value=setting.formula, on_change=self._unless_filling(self._typed)
            )
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
            self._q = ui.input(
                "Coordinates, e.g. x, y", on_change=self._unless_filling(self._typed)
            ).props(dense)
            self._p = ui.input(
                "Their momenta, e.g. p_x, p_y", on_change=self._unless_filling(self._typed)
            ).props(dense)
            self._forces = ui.textarea(
                "Forces, one a line: p = -c*p", on_change=self._unless_filling(self._typed)
            ).props(f"{dense} autogrow")
        self._values = ValuesPanel(
            self._session, self._changed, lambda text: self._say(text, "failed")
        )

    def _build_verdict(self) -> None:
        with ui.element("div").classes("verdict").props("role=status aria-live=polite") as box:
            self._verdict_text = ui.label("Starting…")
            self._stop = ui.button("Stop", on_click=self._session.stop_drawing).props(
                "dense outline no-caps"
            )
        self._stop.set_visibility(False)
        self._verdict = box

    def _build_charts(self) -> None:
        with ui.element("div").classes("choices"):
            self._shown = ui.select([], label="Components", multiple=True, value=[]).props(
                "dense outlined options-dense use-chips"
            )
            self._shown.on_value_change(self._unless_filling(self._choice_changed))
            self._plane = ui.select([], label="Plane").props("dense outlined options-dense")
            self._plane.on_value_change(self._unless_filling(self._choice_changed))
            self._surface = ui.input("Section at").props("dense outlined spellcheck=false")
            self._surface.on("blur", self._surface_typed)
            self._surface.on("keydown.enter", self._surface_typed)
        with ui.element("div").classes("charts") as self._grid:
            self._charts = {
                name: ui.echart(charts.empty(title), renderer="svg").classes(f"chart {name}")
                for name, title in {
                    "coordinates": "Coordinates",
                    "momenta": "Momenta",
                    "plane": "Phase portrait",
                    "errors": "Energy error and estimated error",
                }.items()
            }
            with ui.element("div") as self._section_box:
                section = ui.echart(charts.empty("Section"), renderer="svg").classes(
                    "chart section"
                )
                self._section_note = ui.label("").classes("section-note")
            self._charts["section"] = section

    def _build_tabs(self) -> None:
        with ui.tabs().props("dense no-caps align=left mobile-arrows outside-arrows") as tabs:
            names = ("Equations", "Code", "Prove", "Exponents", "Compare", "Download")
            made = {name: ui.tab(name) for name in names}
        panels = ui.tab_panels(tabs, value=made["Equations"], animated=False).props("keep-alive")
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
        old = session.setting.z0.keys(), session.setting.parameters.keys()
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
        setting = session.setting
        if name:
            self._fill(setting)
        if name or self._values.is_empty or old != (setting.z0.keys(), setting.parameters.keys()):
            self._values.build()
        self._show_derivation()
        await self._code.show()
        await self._changed()

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
        self._grid.classes(add="stale")
        self._say("H cannot be read; the pictures are of the last one that could.", "failed")

    def _show_derivation(self) -> None:
        found = self._session.derivation
        if found is None:
            return
        self._equations.content, self._hessian.content = found.equations, found.hessian
        self._facts.text = found.facts
        dof, names = found.dof, found.names
        planes = {f"{k},{k + dof}": f"{names[k]}, {names[k + dof]}" for k in range(dof)}
        planes |= {f"{k},{k + 1}": f"{names[k]}, {names[k + 1]}" for k in range(dof - 1)}
        self._filling = True
        if self._plane.options != planes:
            self._plane.set_options(planes, value="0,1" if dof > 1 else next(iter(planes)))
        chosen = list(range(min(dof, _MOST_CURVES)))
        options = dict(enumerate(names[:dof]))
        if self._shown.options != options:
            self._shown.set_options(options, value=chosen)
        self._surface.value = self._session.surface
        self._surface.set_visibility(dof > 1)
        self._section_box.set_visibility(dof > 1)
        self._grid.classes(add="many") if dof > 1 else self._grid.classes(remove="many")
        self._shown.set_visibility(dof > 1)
        self._plane.set_visibility(dof > 1)
        self._filling = False

    async def _surface_typed(self) -> None:
        surface = (self._surface.value or "").strip()
        if surface != self._session.surface:
            self._session.surface = surface
            self._section_box.classes(add="earlier")
            await self._section_drawing.request()

    async def _choice_changed(self, _: _Event) -> None:
        if self._picture is not None:
            self._show_picture(self._picture)

    # -- pictures ------------------------------------------------------------------------------

    async def _changed(self) -> None:
        """Draw the present setting; the first section of an H, once nothing changes."""
        self._section_box.classes(add="earlier")
        await self._drawing.request()
        if self._session.is_compiled:
            await self._section_drawing.request()
            return
        if self._waiting is not None:
            self._waiting.cancel()
        loop = asyncio.get_running_loop()
        self._waiting = loop.call_later(
            _QUIET, lambda: asyncio.ensure_future(self._section_drawing.request())
        )

    async def _draw(self) -> None:
        try:
            with self._stoppable():
                found = await self._session.picture()
        except HamsymError as error:
            self._grid.classes(add="stale")
            self._say(f"No solution: {error}. The pictures are of earlier values.", "failed")
            return
        self._picture = found
        self._show_picture(found)

    def _show_picture(self, found: Picture) -> None:
        derivation = self._session.derivation
        if derivation is None or len(derivation.names) != found.z.shape[1]:
            return
        names, dof = derivation.names, derivation.dof
        chosen = [int(k) for k in self._shown.value or range(min(dof, _MOST_CURVES))]
        rest = f", {len(chosen)} of {dof}" if len(chosen) < dof else ""
        momenta = [k + dof for k in chosen]
        forced = not derivation.has_energy
        x, y = (int(k) for k in str(self._plane.value or f"0,{dof}").split(","))
        self._put(
            coordinates=charts.over_time(f"Coordinates{rest}", names, chosen, found),
            momenta=charts.over_time(f"Momenta{rest}", names, momenta, found),
            plane=charts.plane(names, x, y, found),
            errors=charts.errors_over_time(found, self._session.setting.tol, forced),
        )
        self._grid.classes(remove="stale")
        points = f" Drawn at {len(found.t):,} times, too few for its oscillations."
        coarse = points if found.coarse else ""
        if self._error.visible:
            coarse += " This is the last H that could be read."
        if found.success:
            energy = float(found.energy_error.max())
            self._say(
                f"Accepted: {found.headline}, energy error at most {energy:.1e} of the terms of H. "
                f"{_duration(found.seconds)}.{coarse}",
                "accepted",
            )
        else:
            self._say(f"Not accepted: {found.message}.{coarse}", "failed")

    def _put(self, **drawn: dict[str, Any]) -> None:
        by_id = {self._charts[name].id: options for name, options in drawn.items()}
        self._client.run_javascript(f"hamsymDraw({json.dumps(by_id, allow_nan=False)})")

    async def _draw_section(self) -> None:
        derivation = self._session.derivation
        if derivation is None or derivation.dof < 2 or not self._session.surface:
            return
        asked = self._session.setting, self._session.surface
        try:
            found = await self._session.section()
        except HamsymError as error:
            self._section_note.text = f"No section: {error}"
            return
        self._put(section=charts.section_plane(found, self._session.surface))
        self._section_note.text = found.message
        if asked == (self._session.setting, self._session.surface):
            self._section_box.classes(remove="earlier")

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
