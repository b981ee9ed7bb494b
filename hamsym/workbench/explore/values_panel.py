"""The sliders of a page: initial state, parameters, time span and tolerance."""

from __future__ import annotations

import html
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeAlias

from nicegui import events, ui

from hamsym.errors import HamsymError
from hamsym.workbench.explore.session import Session
from hamsym.workbench.explore.setting import SliderRange

_Event: TypeAlias = events.ValueChangeEventArguments

_DURATION = "time span"  # no name of a formula
_TOLERANCES = {1e-6: "1e-6", 1e-9: "1e-9", 1e-12: "1e-12"}


@dataclass
class _Row:
    """A slider with the field beside it."""

    name: str
    slider: ui.slider
    entry: ui.input
    range: SliderRange

    def show(self, value: float) -> None:
        """Write a value into the field."""
        self.entry.value = f"{value:.9g}"


class ValuesPanel:
    """Sliders with fields beside them.

    - changed: Awaited after a change of a value.
    - complain: Takes a sentence on a value that cannot be used.
    """

    def __init__(
        self,
        session: Session,
        changed: Callable[[], Awaitable[None]],
        complain: Callable[[str], None],
    ) -> None:
        self._session, self._changed, self._complain = session, changed, complain
        self._rows: dict[str, _Row] = {}
        self._filling = False  # a slider is being set by the program
        self._box = ui.element("div").classes("values")

    @property
    def is_empty(self) -> bool:
        """Whether there are no sliders yet."""
        return not self._rows

    def build(self) -> None:
        """Build the sliders of the present names."""
        setting = self._session.setting
        self._box.clear()
        self._rows = {}
        with self._box:
            ui.html("<h2>Initial state</h2>", sanitize=False)
            with ui.element("div").classes("rows"):
                size = max(map(abs, setting.z0.values()), default=1.0)
                for name, value in setting.z0.items():
                    self._add_row(name, value, SliderRange.around(value, size))
            if setting.parameters:
                ui.html("<h2>Parameters</h2>", sanitize=False)
                with ui.element("div").classes("rows"):
                    for name, value in setting.parameters.items():
                        self._add_row(name, value, SliderRange.around(value, positive=True))
            ui.html("<h2>Time and tolerance</h2>", sanitize=False)
            start, end = setting.span
            with ui.element("div").classes("rows"):
                length = SliderRange.around(end - start, positive=True)
                self._add_row(_DURATION, end - start, length)
            with ui.element("div").classes("pair"):
                self._start = ui.input("from t =", value=f"{start:.10g}").props("outlined dense")
                self._start.on("blur", self._start_typed).on("keydown.enter", self._start_typed)
                ui.select(
                    {**_TOLERANCES, setting.tol: f"{setting.tol:g}"},
                    label="tolerance",
                    value=setting.tol,
                    on_change=self._tolerance_chosen,
                ).props("outlined dense options-dense")

    def _add_row(self, name: str, value: float, slider_range: SliderRange) -> None:
        with ui.element("div").classes("row-of-slider"):
            ui.label(name).classes("name").tooltip(name)
            slider = ui.slider(
                min=0,
                max=slider_range.positions,
                step=1,
                value=slider_range.position(value),
                on_change=lambda event: None if self._filling else self._moved(name, event),
            ).props(f'aria-label="{html.escape(name)}" dense')
            entry = ui.input(value=f"{value:.9g}").props(
                f'dense outlined aria-label="value of {html.escape(name)}" spellcheck=false'
            )
            entry.on("blur", lambda: self._entered(name))
            entry.on("keydown.enter", lambda: self._entered(name))
        self._rows[name] = _Row(name, slider, entry, slider_range)

    async def _moved(self, name: str, event: _Event) -> None:
        if event.value is None:
            return
        row = self._rows[name]
        value = row.range.value(float(event.value))
        row.show(value)
        self._set(name, value)
        await self._changed()

    async def _entered(self, name: str) -> None:
        row = self._rows[name]
        try:
            value = await self._session.number(row.entry.value or "")
        except HamsymError as error:
            row.entry.props("error")
            self._complain(f"{name}: {error}")
            return
        row.entry.props(remove="error")
        if value == self._value(name):
            return
        if name == _DURATION and value == 0:
            self._complain("time span: 0 is none; give another number")
            return
        self._set(name, value)
        if not row.range.suits(value):
            positive = name not in self._session.setting.z0
            row.range = SliderRange.around(value, positive=positive)
            row.slider._props["max"] = row.range.positions
        self._filling = True
        row.slider.value = row.range.position(value)
        self._filling = False
        await self._changed()

    def _value(self, name: str) -> float:
        setting = self._session.setting
        if name == _DURATION:
            return setting.span[1] - setting.span[0]
        return {**setting.z0, **setting.parameters}[name]

    def _set(self, name: str, value: float) -> None:
        setting = self._session.setting
        if name == _DURATION:
            self._session.set_span(setting.span[0], setting.span[0] + value)
        else:
            self._session.set_value(name, value)

    async def _start_typed(self) -> None:
        try:
            start = await self._session.number(self._start.value or "")
        except HamsymError as error:
            self._complain(f"start: {error}")
            return
        old, end = self._session.setting.span
        if start != old:
            self._session.set_span(start, start + (end - old))
            await self._changed()

    async def _tolerance_chosen(self, event: _Event) -> None:
        self._session.set_tolerance(float(event.value))
        await self._changed()
