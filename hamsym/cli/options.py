"""Options that commands share, and the values that their texts mean."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.output import check_figure, check_table
from hamsym.errors import InputError

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian

__all__ = [
    "hamiltonian_options",
    "listed",
    "output_options",
    "show_methods",
    "solver_options",
    "span_options",
    "starts_options",
    "step_options",
]


def hamiltonian_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The formula with its names and parameters; the command gets a Hamiltonian."""

    @click.argument("formula", metavar="H")
    @click.option("--q", "coordinates", metavar="NAMES", help="Coordinates, such as x,y.")
    @click.option("--p", "momenta", metavar="NAMES", help="Their momenta, in the same order.")
    @click.option(
        "--param", "-P", "parameters", multiple=True, metavar="NAME=VALUE", help="A parameter."
    )
    @functools.wraps(command)
    def wrapped(
        formula: str,
        coordinates: str | None,
        momenta: str | None,
        parameters: tuple[str, ...],
        **options: Any,
    ) -> Any:
        from hamsym.hamiltonian import Hamiltonian  # sympy is slow to import

        H = Hamiltonian(
            formula,
            q=None if coordinates is None else listed(coordinates),
            p=None if momenta is None else listed(momenta),
            parameters=_assignments(",".join(parameters), "--param") if parameters else None,
        )
        return command(H, **options)

    return wrapped


def span_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """One start and the times; the command gets a state and a span."""

    @click.option(
        "--z0", "start", required=True, metavar="STATE", help="Such as x=1.3,p=1, or 1.3,1."
    )
    @click.option("--t-start", default="0", metavar="TIME", show_default=True)
    @click.option("--t-end", required=True, metavar="TIME", help='Such as 20 or "4*pi".')
    @functools.wraps(command)
    def wrapped(H: Hamiltonian, start: str, t_start: str, t_end: str, **options: Any) -> Any:
        span = (_parsed(t_start), _parsed(t_end))
        return command(H, _state(start), span, **options)

    return wrapped


def starts_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """As :func:`span_options`, with any number of starts."""

    @click.option(
        "--z0",
        "starts",
        required=True,
        multiple=True,
        metavar="STATE",
        help="Such as x=1.3,p=1; again for each further trajectory.",
    )
    @click.option("--t-start", default="0", metavar="TIME", show_default=True)
    @click.option("--t-end", required=True, metavar="TIME", help='Such as 20 or "4*pi".')
    @functools.wraps(command)
    def wrapped(
        H: Hamiltonian, starts: tuple[str, ...], t_start: str, t_end: str, **options: Any
    ) -> Any:
        span = (_parsed(t_start), _parsed(t_end))
        energy = options.pop("energy", None)
        states: list[Any] = [_state(start) for start in starts]
        if energy is not None:
            states = [
                H.state_at_energy(_parsed(energy), _by_name(state), span[0]) for state in states
            ]
        import numpy as np

        arrays = [H.state_from(state) for state in states]
        return command(H, arrays[0] if len(arrays) == 1 else np.array(arrays), span, **options)

    return wrapped


def _by_name(state: Any) -> dict[str, float]:
    if not isinstance(state, dict):
        raise InputError("with --energy a start is given by name, such as x=0,y=0.1,p_y=0")
    return state


def step_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The number of steps, or their size as a formula."""

    @click.option("--steps", type=int, help="Number of equal steps.")
    @click.option("--dt", metavar="TIME", help="In place of it, the largest step.")
    @functools.wraps(command)
    def wrapped(*arguments: Any, dt: str | None, **options: Any) -> Any:
        return command(*arguments, dt=None if dt is None else _parsed(dt), **options)

    return wrapped


_figure_option = click.option(
    "--plot", "figure", type=click.Path(), metavar="FILE", help="Draw a figure."
)


def output_options(what: str) -> Callable[..., Any]:
    """-o for a table and --plot, both refused before the work if they could not be written."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @click.option("-o", "--output", type=click.Path(), metavar="FILE", help=what)
        @_figure_option
        @functools.wraps(command)
        def wrapped(*arguments: Any, output: str | None, figure: str | None, **options: Any) -> Any:
            check_table(output)
            check_figure(figure)
            return command(*arguments, output=output, figure=figure, **options)

        return wrapped

    return decorate


def show_methods(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    """Print the integrators, each with its line, and end."""
    if wanted:
        from hamsym.integrators.table import listing

        click.echo(listing())
        context.exit()


def solver_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of the methods; what is not given is left to the method's own default."""
    choice = click.Choice
    methods = ["features", "levenberg-marquardt", "lbfgs", "adam"]
    options = (
        click.option("--method", type=choice(methods), default="features", show_default=True),
        click.option("--tol", metavar="NUMBER", help="Wanted accuracy (features)  [1e-9]"),
        click.option("--atol", metavar="NUMBER", help="Absolute part of it  [0]"),
        click.option("--breakpoints", metavar="TIMES", help="Where windows end (features)."),
        click.option("--max-window", metavar="TIME", help="Longest window (features)."),
        click.option("--iterations", type=int, help="At most  [1000, or 5000 with lbfgs]"),
        click.option("--epochs", type=int, help="Epochs of training (adam)  [50000]"),
        click.option("--learning-rate", type=float, help="Of Adam  [0.008]"),
        click.option("--betas", nargs=2, type=float, help="Of Adam  [0.9 0.999]"),
        click.option("--schedule", type=choice(["cosine", "constant"]), help="[cosine]"),
        click.option("--hidden", metavar="WIDTHS", help="Hidden layers  [50,50]"),
        click.option("--activation", type=choice(["sin", "sigmoid", "tanh"]), help="[sin]"),
        click.option("--envelope", type=choice(["exponential", "linear"]), help="[exponential]"),
        click.option("--tau", metavar="TIME", help="Of the input  [1 (adam), span/(4 pi)]"),
        click.option("--stages", type=int, help="Spans of sequential training  [1 (adam), 12]"),
        click.option("--points", type=int, help="Collocation points K  [200]"),
        click.option("--noise", metavar="TIME", help="Of the points  [3 spacings]"),
        click.option("--energy-weight", type=float, help="Of the energy penalty  [0]"),
        click.option("--target-loss", type=float, help="Stop when the loss is at most this."),
        click.option("--target-ell-max", type=float, help="Or the largest residual."),
        click.option("--target-error", type=float, help="Or the estimated error of the motion."),
        click.option("--accuracy", type=float, help="Or ell_max / sigma_min."),
        click.option("--patience", type=int, help="Or nothing improved for so many iterations."),
        click.option("--time-limit", type=float, metavar="SECONDS", help="Or so much time."),
        click.option("--checkpoint", type=click.Path(), metavar="FILE", help="Go on from there."),
        click.option("--initial", type=click.Path(), metavar="FILE", help="Its weights first."),
        click.option("--dtype", type=choice(["float64", "float32"]), help="[float64]"),
        click.option("--seed", default=0, show_default=True),
        _figure_option,
    )

    @functools.wraps(command)
    def wrapped(*arguments: Any, **given: Any) -> Any:
        values = {name: value for name, value in given.items() if value is not None}
        for name in ("tol", "atol", "max_window", "tau", "noise"):
            if name in values:
                values[name] = _parsed(values[name])
        if "breakpoints" in values:
            values["breakpoints"] = [_parsed(t) for t in listed(values["breakpoints"])]
        if "hidden" in values:
            values["hidden"] = tuple(_whole(w, "--hidden") for w in listed(values["hidden"]))
        if "initial" in values:
            from hamsym.archive import load

            values["initial"] = load(values["initial"])
        return command(*arguments, **values)

    for option in reversed(options):
        wrapped = option(wrapped)
    return wrapped


# -- what their texts mean -----------------------------------------------------------------------


def listed(text: str) -> list[str]:
    """What stands between the commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def _parsed(text: str) -> float:
    from hamsym.formula.parser import parse_number  # sympy is slow to import

    return parse_number(text)


def _assignments(text: str, option: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for part in listed(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not name or not value:
            raise InputError(f"'{part}' in {option} is not NAME=VALUE; write such as m=1.0")
        if name in values:
            raise InputError(f"'{name}' occurs twice in {option}; give it once")
        values[name] = _parsed(value)
    return values


def _state(text: str) -> dict[str, float] | list[float]:
    if "=" in text:
        return _assignments(text, "--z0")
    return [_parsed(part) for part in listed(text)]


def _whole(text: str, option: str) -> int:
    if not text.isdigit():
        raise InputError(f"'{text}' in {option} is not a whole number; write such as 50,50")
    return int(text)
