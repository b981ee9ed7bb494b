"""Commands of the command line: grouped options, examples, and results as text or as JSON."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import click
from click.shell_completion import CompletionItem

from hamsym.facts.facts import strict
from hamsym.support.suggestions import did_you_mean, similar, unknown
from hamsym.support.text_tables import ROWS

_OF_SECTIONS = {
    "Problem": "q p param force lagrangian velocities z0 t-start t-end energy at box guess free "
    "bounds sigma near period symmetry invariant degree basis start",
    "Accuracy": "tol rtol atol steps dt prove bound confidence max-steps max-boxes "
    "time-limit compensated",
    "Output": "output export plot draw save-every saves full analysis latex certificate out json",
    "Help": "help list version",
}
_SECTIONS = {name: title for title, names in _OF_SECTIONS.items() for name in names.split()}
_ORDER = ("Problem", "Accuracy", "Method")  # other sections follow, then these:
_LAST = ("Output", "Help")


#: Settings of every context: the names of the option that prints the help.
HELP = {"help_option_names": ["-h", "--help"]}


# Names of other programs, and of arguments of Python, for options.
_MEANT = {
    **dict.fromkeys(("surface", "where", "section"), "at"),
    **dict.fromkeys(("tmax", "t-max", "tend", "tfinal", "time", "span", "t-span"), "t-end"),
    **dict.fromkeys(("y0", "x0", "start", "initial", "state"), "z0"),
    **dict.fromkeys(("parameter", "parameters", "params"), "param"),
}


@dataclass(frozen=True)
class Report:
    """What a command prints, and the exit status."""

    #: For a terminal.
    text: str
    #: The same as data, for ``--json``.
    values: Mapping[str, Any]
    #: Whether the exit status is 0.
    success: bool = True
    #: Files that were written.
    files: list[str] = field(default_factory=list)


def command(
    short_help: str, *examples: str, cls: type[Command] | None = None, epilog: str | None = None
) -> Callable[[Callable[..., Any]], click.Command]:
    """Return a decorator that makes a :class:`Command` of a function, whose docstring is its help.

    - short_help: For the list of commands.
    - examples: Command lines.
    """
    settings: dict[str, Any] = {"examples": examples, "epilog": epilog}
    return click.command(cls=cls or Command, short_help=short_help, **settings)


def report_of(result: Any, rows: int | None = ROWS, success: bool | None = None) -> Report:
    """Return the report of a result: its facts, as text and as data.

    - rows: Most rows of a table; None for all.
    - success: By default that of the result.
    """
    facts = result.facts
    good = facts.success is not False if success is None else success
    return Report(facts.text(rows), facts.values(), good)


def _echo(report: Report, as_json: bool) -> None:
    if as_json:
        values = {**report.values, "success": bool(report.success)}
        if report.files:
            values["files"] = report.files
        click.echo(json.dumps(strict(values), allow_nan=False, ensure_ascii=False))
        return
    if report.text:
        click.echo(report.text, nl=not report.text.endswith("\n"))
    for path in report.files:
        click.echo(f"wrote {path}")


class Command(click.Command):
    """A command that returns a :class:`Report`, with ``--json`` and examples in its help.

    - examples: Command lines.
    """

    def __init__(self, *arguments: Any, examples: Sequence[str] = (), **settings: Any) -> None:
        # click keeps the option of the first context, which need not be one of the group.
        super().__init__(*arguments, **{"context_settings": HELP, **settings})
        self.examples = tuple(examples)
        self.params.append(
            click.Option(["--json", "as_json"], is_flag=True, help="Print one JSON object.")
        )

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; a formula that begins with a minus sign is not taken for an option."""
        given = list(args)
        ctx.allow_extra_args = True  # answered here
        try:
            rest = super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            formula = next((a for a in given if a[:1] == "-" and set(a) & set("*/+(")), None)
            if formula is None or formula.startswith("--"):
                raise click.UsageError(self._meant(ctx, error.option_name), ctx) from None
            raise click.UsageError(
                f"{formula!r} begins as an option does; give the options first, then -- and the "
                "formula",
                ctx,
            ) from None
        if rest and not ctx.resilient_parsing:  # as for the completion of words
            names = [option for each in self.get_params(ctx) for option in each.opts]
            option = next((name for name in ("--certificate", "--z0") if name in names), None)
            remedy = f"give it as {option} {rest[0]}" if option else "quotes keep a formula in one"
            raise click.UsageError(f"{rest[0]!r} is one argument too many; {remedy}", ctx)
        return rest

    def _meant(self, ctx: click.Context, name: str) -> str:
        """Return the sentence about an option that does not exist."""
        names = [option for each in self.get_params(ctx) for option in each.opts]
        other = f"--{_MEANT.get(name.strip('-').replace('_', '-'))}"
        found = other if other in names else similar(name, names)
        remedy = f"give {found}" if found else f"'hamsym {ctx.info_name} --help' lists them"
        return f"{name} is not an option of {ctx.info_name}; {remedy}"

    def invoke(self, ctx: click.Context) -> int:
        as_json = ctx.params.pop("as_json", False)
        ctx.meta["hamsym.json"] = as_json
        report = super().invoke(ctx)
        if not isinstance(report, Report):
            return int(report or 0)
        if (note := ctx.meta.get("hamsym.note")) and not as_json:
            click.echo(note)
        _echo(report, as_json)
        return 0 if report.success else 1

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options in sections."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None and isinstance(parameter, click.Option):
                sections.setdefault(_section(parameter), []).append(record)
        middle = [title for title in sections if title not in (*_ORDER, *_LAST)]
        for title in (*_ORDER, *middle, *_LAST):
            if title in sections:
                with formatter.section(title):
                    formatter.write_dl(sections[title])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, then the epilog."""
        if self.examples:
            with formatter.section("Examples"):
                for example in self.examples:
                    for line in _continued(example, formatter.width - 4):
                        formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        super().format_epilog(ctx, formatter)


def _section(parameter: click.Parameter) -> str:
    titles = (_SECTIONS.get(option.lstrip("-")) for option in parameter.opts)
    return getattr(parameter, "section", None) or next(filter(None, titles), "Method")


def _continued(command: str, width: int) -> list[str]:
    """Return a command line in lines that end with a backslash, broken before options."""
    lines = [""]
    for part in command.replace(" --", "\0--").replace(" -P ", "\0-P ").split("\0"):
        if lines[-1] and len(lines[-1]) + len(part) + 3 > width:
            lines[-1] += " \\"
            lines.append(f"    {part}")
        else:
            lines[-1] += f" {part}" if lines[-1] else part
    return lines


class Group(click.Group):
    """A group that lists its commands by subject and suggests similar ones.

    - subjects: Commands of each part of the list, by its title.
    """

    def __init__(
        self, *arguments: Any, subjects: Mapping[str, Sequence[click.Command]], **settings: Any
    ) -> None:
        super().__init__(*arguments, **settings)
        self.subjects = subjects
        for each in itertools.chain.from_iterable(subjects.values()):
            self.add_command(each)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            hint = did_you_mean(args[0], self.list_commands(ctx))
            ctx.fail(f"No such command '{args[0]}'{hint}; 'hamsym --help' lists them")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands by subject."""
        for title, commands in self.subjects.items():
            with formatter.section(title):
                formatter.write_dl(
                    [(str(each.name), each.get_short_help_str(limit=62)) for each in commands]
                )


class Choice(click.Choice):
    """A choice among names, whose error suggests a similar one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        names = [str(name) for name in self.choices]
        if value not in names:
            self.fail(unknown(value, names, "one of them"), param, ctx)
        return value


def completing(
    names: Callable[[], Iterable[str]],
) -> Callable[[click.Context, click.Parameter, str], list[CompletionItem]]:
    """Return a completion of names, also of the last one in a list between commas."""

    def complete(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
        before, comma, last = incomplete.rpartition(",")
        return [
            CompletionItem(f"{before}{comma}{name}") for name in names() if name.startswith(last)
        ]

    return complete
