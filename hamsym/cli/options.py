"""Options that commands share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Report, completing
from hamsym.cli.output import FIGURES, TABLES, check_file, save_figure, write_table
from hamsym.cli.texts import NAMES, STATE, TIME, assignments, formulas, joined
from hamsym.errors import InputError
from hamsym.support.suggestions import similar
from hamsym.support.text_tables import ROWS
from hamsym.support.text_tables import wrapped as wrapped_text

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian
    from hamsym.systems import Problem

Command = Callable[..., Any]


def _with(command: Command, *options: Command) -> Command:
    """Add options to a command in this order."""
    for add in reversed(options):
        command = add(command)
    return command


def formula_options(command: Command) -> Command:
    """Add the formula with its names and parameters; the command takes them as keywords."""
    return _with(
        command,
        click.argument("expression", metavar="H"),
        click.option("--q", type=NAMES, help="Coordinates, e.g. x,y."),
        click.option("--p", type=NAMES, help="Their momenta, in the same order."),
        click.option(
            *("--param", "-P", "parameters"),
            multiple=True,
            callback=joined(assignments),
            metavar="NAME=VALUE",
            help="A parameter.",
        ),
        click.option(
            *("--force", "forces"),
            multiple=True,
            callback=joined(formulas),
            metavar="MOMENTUM=FORMULA",
            help="A force beyond those of H, e.g. p=-c*p.",
        ),
    )


def hamiltonian_options(command: Command) -> Command:
    """Add the formula with its names and parameters; the command takes a Hamiltonian."""

    @formula_options
    @functools.wraps(command)
    def wrapped(
        expression: str, q: Any, p: Any, parameters: Any, forces: Any, **options: Any
    ) -> Any:
        from hamsym.hamiltonian import Hamiltonian  # sympy is slow to import

        problem = None if q or p or forces else _listed_problem(expression)
        if problem is not None:
            H = problem.H.with_parameters(**(parameters or {}))
        else:
            H = Hamiltonian(expression, q=q, p=p, parameters=parameters, forces=forces)
        return command(H, **options)

    return wrapped


def _listed_problem(name: str) -> Problem | None:
    """Return the system of the catalogue with this name, for the options that are not given."""
    if not name.isidentifier():
        return None
    from hamsym.systems import CATALOGUE

    if name not in CATALOGUE:
        return None
    problem = CATALOGUE[name]()
    context = click.get_current_context()
    context.meta["hamsym.problem"] = problem
    start = ",".join(f"{n}={v:.6g}" for n, v in zip(problem.H.names, problem.z0, strict=True))
    context.meta["hamsym.note"] = "\n".join(
        (
            wrapped_text(
                f"system of the catalogue; usual are --z0 {start} and --t-end {problem.span[1]:g}",
                f"{name}: ",
            ),
            wrapped_text(problem.H.notation.text(problem.H.expr), "H = "),
        )
    )
    return problem


def _usual() -> Problem | None:
    """Return the system of the catalogue that was named in place of H."""
    found: Problem | None = click.get_current_context().meta.get("hamsym.problem")
    return found


def _given_start(H: Hamiltonian, start: Any) -> Any:
    """Return the state of --z0, that of the catalogue if it is not given."""
    if start is not None:
        return start
    if (problem := _usual()) is not None:
        return problem.z0
    example = ",".join(f"{name}={int(k < H.dof)}" for k, name in enumerate(H.names))
    raise InputError(f"--z0 is missing; give a value of each component, e.g. --z0 {example}")


def start_options(*, several: bool) -> Callable[[Command], Command]:
    """Add the start and the times; the command takes a state, or an array of several, and a span.

    States that lack a component get it from the option ``energy`` of the command, if it has one.
    """
    more = "; repeat it for further trajectories" if several else " or 1.3,1"

    def decorate(command: Command) -> Command:
        @click.option(
            *("--z0", "start"),
            type=STATE,
            multiple=several,
            help=f"For example x=1.3,p=1{more}.  [required]",
        )
        @click.option("--t-start", type=TIME, default="0", show_default=True)
        @click.option("--t-end", type=TIME, help='For example 20 or "4*pi".  [required]')
        @functools.wraps(command)
        def wrapped(
            H: Hamiltonian, start: Any, t_start: float, t_end: float | None, **options: Any
        ) -> Any:
            if t_end is None and (problem := _usual()) is not None:
                t_end = problem.span[1]
            if t_end is None:
                raise InputError("--t-end is missing; give the last time, e.g. --t-end 20")
            span = t_start, t_end
            if not several:
                return command(H, _given_start(H, start), span, **options)
            states = [_given_start(H, given) for given in start or (None,)]
            if (energy := options.pop("energy", None)) is not None:
                if not all(isinstance(given, dict) for given in states):
                    raise InputError(
                        "--energy needs states by name; write e.g. --z0 x=0,y=0.1,p_y=0"
                    )
                states = [H.state_at_energy(energy, given, t_start) for given in states]
            import numpy as np

            arrays = [H.state_from(given) for given in states]
            return command(H, arrays[0] if len(arrays) == 1 else np.array(arrays), span, **options)

        return wrapped

    return decorate


def integrator_options(command: Command) -> Command:
    """Add the time-stepping method, and the number of steps or their size as a formula."""
    return _with(
        command,
        click.option(
            "--method",
            metavar="NAME",
            help="[blanes_moan6, or gauss6 if not separable]",
            shell_complete=completing(integrators),
        ),
        click.option("--steps", type=int, help="Number of equal steps."),
        click.option("--dt", type=TIME, help="Largest step, in place of --steps."),
    )


def integrators() -> list[str]:
    """Return the names of all integrators."""
    from hamsym.integrators.table import ALIASES, INTEGRATORS

    return [*INTEGRATORS, *ALIASES]


#: Adds --full; the command takes the number of rows of its tables.
rows_option = click.option(
    *("--full", "rows"),
    is_flag=True,
    callback=lambda _, __, full: None if full else ROWS,
    help="Print all rows of tables.",
)


def figure_options(command: Command) -> Command:
    """Add --plot and --draw; the command takes ``draw``, which writes a figure of its result.

    The file and formulas in the names of H, the first argument, are checked before the command.
    """

    @click.option("--plot", "figure", type=click.Path(), metavar="FILE", help="Draw a figure.")
    @click.option(
        *("--draw", "names"),
        type=NAMES,
        default="",
        help='What --plot draws: components, formulas or a panel, e.g. "x, p_x**2/2".',
    )
    @functools.wraps(command)
    def wrapped(*arguments: Any, figure: str | None, names: list[str], **options: Any) -> Any:
        if names and figure is None:
            raise InputError("--draw says what a figure shows; give its file too, --plot FILE")
        check_file(figure, FIGURES)
        for name in names:
            if not name.isidentifier() or similar(name, arguments[0].names):
                arguments[0].observable(name)

        def draw(result: Any, report: Report) -> None:
            if figure is not None:
                save_figure(result.plot(*names), figure)
                report.files.append(figure)

        return command(*arguments, draw=draw, **options)

    return wrapped


#: A result that has ``plot``, its report, columns of a .csv file, and arrays of a .npz file.
Output = tuple[Any, Report, list[tuple[str, Any]], dict[str, Any]]

#: Writes the figure of a result, if one was asked for, and adds it to the files of a report.
Draw = Callable[[Any, Report], None]


def output_options(table_help: str) -> Callable[[Command], Command]:
    """Add -o for a table and --plot, which are checked before the command runs.

    The command returns an :data:`Output`; its table is written, and the report is returned.
    """

    def decorate(command: Command) -> Command:
        @click.option("-o", "--output", type=click.Path(), metavar="FILE", help=table_help)
        @figure_options
        @functools.wraps(command)
        def wrapped(*arguments: Any, output: str | None, draw: Draw, **options: Any) -> Report:
            check_file(output, TABLES)
            result, report, columns, arrays = command(*arguments, **options)
            if output is not None:
                write_table(output, columns, arrays)
                report.files.append(output)
            draw(result, report)
            return report

        return wrapped

    return decorate


def show_methods(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    """Print the table of integrators and exit."""
    if wanted:
        from hamsym.integrators.table import listing

        click.echo(listing())
        context.exit()
