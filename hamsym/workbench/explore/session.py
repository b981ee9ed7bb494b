"""Session: the state of one tab, and what it asks of its workers; without any web library."""

from __future__ import annotations

import asyncio
import html
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any

from hamsym.errors import HamsymError, InputError
from hamsym.parallel.processes import Worker
from hamsym.workbench.explore import tasks
from hamsym.workbench.explore.messages import Derivation, JobResult, Motion, Setting, Verdict

FIRST = Setting("p**2/2 + x**2/2 + x**4/4", z0={"x": 1.3, "p": 1.0}, span=(0.0, 20.0))
_LIVE_LIMIT = 15.0  # seconds of what is drawn while a slider moves
_FILE_LIMIT = 240.0  # the comparison of a report alone may take a minute
_FIRST_LIMIT = 90.0  # with the start of a process and the import of hamsym on a busy machine
_CONTEXT = 40  # characters around an invalid token


class Latest:
    """An action of which only the latest request counts.

    A request that comes while the action runs makes it run once more at its end; those in between
    are dropped, as the positions that a slider passes.

    - action: () -> awaitable.
    """

    def __init__(self, action: Callable[[], Awaitable[None]]) -> None:
        self._action = action
        self._running = self._again = False

    async def request(self) -> None:
        """Run the action, now or at the end of the present run."""
        self._again = True
        if self._running:
            return
        self._running = True
        try:
            while self._again:
                self._again = False
                await self._action()
        finally:
            self._running = False


#: What the player calls the length of the time span, which is no name of a formula.
SPAN = "time span"
#: Tabs at once.
MOST_TABS = 8


class Session:
    """The setting of one tab, with three processes: what is live, the background, and the buttons.

    - derivation: Of the formula; None before the first one.
    - closed: Whether the tab was closed, which ended its processes.
    """

    def __init__(self, setting: Setting = FIRST) -> None:
        self.setting = setting
        self.derivation: Derivation | None = None
        self._moved = False  # whether the start is one that the reader chose
        self._live, self._background, self._button = (Worker() for _ in range(3))
        self._proven: Setting | None = None
        self._busy = False
        self._started = False
        self.closed = False

    def start(self) -> None:
        """Start the process of what is live."""
        self._live.start()

    def close(self) -> None:
        """End all processes."""
        self.closed = True
        for worker in (self._live, self._background, self._button):
            worker.close()

    async def _call(self, worker: Worker, task: str, seconds: float, *arguments: Any) -> Any:
        return await asyncio.to_thread(worker.run, getattr(tasks, task), seconds, *arguments)

    async def _call_live(self, task: str, *arguments: Any) -> Any:
        seconds = _LIVE_LIMIT if self._started else _FIRST_LIMIT
        found = await self._call(self._live, task, seconds, *arguments)
        self._started = True
        return found

    def stop_drawing(self) -> None:
        """End what is live; the next request starts a new process."""
        self._started = False
        self._live.cancel()

    # -- formula and values --------------------------------------------------------------------

    async def set_formula(self, formula: str, q: str = "", p: str = "", forces: str = "") -> None:
        """Take a new formula; values of names that stay are kept, if the reader chose them.

        Raise HamsymError if it cannot be used; the setting stays as it is.
        """
        setting = replace(self.setting, formula=formula, q=q, p=p, forces=forces)
        derivation = await self._call_live("derive", setting)
        known = all(name in setting.z0 for name in derivation.names)
        setting = setting.with_names(derivation.names, derivation.parameter_names)
        if not (known and self._moved):
            self._moved = False
            setting = replace(setting, z0=await self._call_live("start", setting, known))
        self.setting, self.derivation = setting, derivation

    async def set_example(self, name: str) -> None:
        """Take a system of the catalogue with its values."""
        setting = await self._call_live("example", name)
        derivation = await self._call_live("derive", setting)
        setting = setting.with_names(derivation.names, derivation.parameter_names)
        self.setting, self.derivation, self._moved = setting, derivation, True

    def set_values(self, values: Mapping[str, float]) -> bool:
        """Set components of the start, parameters and the length of the span; whether any is new.

        Names of other formulas, and what is no finite number, are left out.
        """
        setting = self.setting
        known = {
            name: float(value)
            for name, value in values.items()
            if isinstance(value, int | float) and math.isfinite(value)
        }
        start, end = setting.span
        length = known.get(SPAN, end - start) or end - start
        self.setting = replace(
            setting,
            z0={name: known.get(name, value) for name, value in setting.z0.items()},
            parameters={name: known.get(name, value) for name, value in setting.parameters.items()},
            span=(start, start + length),
        )
        self._moved = self._moved or self.setting.z0 != setting.z0
        return self.setting != setting

    def set_start(self, start: float) -> None:
        """Move the time span."""
        old, end = self.setting.span
        self.setting = replace(self.setting, span=(start, start + (end - old)))

    def set_tolerance(self, tol: float) -> None:
        """Set the tolerance."""
        self.setting = replace(self.setting, tol=tol)

    async def number(self, text: str) -> float:
        """Return the value of a typed number, which may be a formula such as ``4*pi``.

        Raise HamsymError if it is none.
        """
        return await self._call_live("number", text)

    # -- what is drawn -------------------------------------------------------------------------

    async def motion(self) -> Motion:
        """Solve the present setting for the player of the page."""
        return await self._call_live("motion", self.setting)

    async def verdict(self) -> Verdict:
        """Solve the present setting."""
        return await self._call_live("verdict", self.setting)

    async def code(self, backend: str) -> str:
        """Return the generated code of a backend."""
        return await self._call_live("code", self.setting, backend)

    # -- buttons and files ---------------------------------------------------------------------

    async def job(self, task: str, seconds: float, *arguments: Any) -> JobResult:
        """Carry out what a button asks for; :meth:`cancel` ends it.

        Raise HamsymError if it fails, or another one is running.
        """
        if self._busy:
            raise HamsymError("another computation of this tab is running; cancel it first")
        self._busy = True
        setting = self.setting
        try:
            found: JobResult = await self._call(self._button, task, seconds, setting, *arguments)
        finally:
            self._busy = False
        if task == "certify" and found.success:
            self._proven = setting
        return found

    def cancel(self) -> None:
        """End what a button asked for."""
        self._button.cancel()

    async def file(self, task: str, *arguments: Any) -> bytes:
        """Return the content of a file; a report has the proof of the present solution, if any."""
        if task == "report":
            arguments = (self._proven == self.setting,)
        return await self._call(self._background, task, _FILE_LIMIT, self.setting, *arguments)


class Sessions:
    """The sessions of all tabs.

    - setting: With which each begins.
    """

    def __init__(self, setting: Setting = FIRST) -> None:
        self._setting = setting
        self._open: set[Session] = set()
        self._ready: Session | None = Session(setting)
        self._ready.start()  # imports while the server starts

    def open(self) -> Session:
        """Return a new session; the first one has started its process already.

        Raise InputError if too many tabs are open: each has three processes.
        """
        if len(self._open) >= MOST_TABS:
            raise InputError(
                f"{MOST_TABS} tabs of this page are open, each with processes of its own; close "
                "one, and load this page again"
            )
        session, self._ready = self._ready or Session(self._setting), None
        self._open.add(session)
        return session

    def close(self, session: Session) -> None:
        """End the processes of a session."""
        self._open.discard(session)
        session.close()

    def close_all(self) -> None:
        """End all processes, so that no thread waits for one."""
        for session in [*self._open, *([self._ready] if self._ready else [])]:
            session.close()


def excerpt(text: str, error: HamsymError) -> str:
    """Return the place of an error in a formula as HTML, with the token marked.

    Examples
    --------
    >>> from hamsym.errors import ParseError
    >>> excerpt("x^2 < y", ParseError("^", 2, "is not a power", "write ** for powers"))
    'x<mark>^</mark>2 &lt; y'
    """
    column, token = getattr(error, "column", 0), getattr(error, "token", "")
    if not column:
        return ""
    first = column - 1
    # A long token is shortened in messages, and one of a control character is spelled out.
    last = first + max(len(token), 1) if text[first : first + len(token)] == token else first + 1
    start, end = max(first - _CONTEXT, 0), min(last + _CONTEXT, len(text))
    before = ("…" if start else "") + html.escape(text[start:first])
    marked = html.escape(text[first : min(last, first + _CONTEXT)]) or "&nbsp;"
    after = html.escape(text[last:end]) + ("…" if end < len(text) else "")
    return f"{before}<mark>{marked}</mark>{after}"
