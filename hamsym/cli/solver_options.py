"""Options of the methods of solution, built from the fields of the methods' option dataclasses."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Mapping
from dataclasses import Field, fields
from typing import Any

import click

from hamsym.cli.command import Choice, Command
from hamsym.cli.texts import NUMBER, NUMBERS, Parsed, saved_solution, whole_numbers


class SolverCommand(Command):
    """A command that takes the options of all methods of solution.

    The options are built when they are first needed. Options that are not
    given are not passed on, so that the method's own defaults apply.
    """

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        return [*super().get_params(ctx), *_solver_parameters()]

    def invoke(self, ctx: click.Context) -> int:
        from hamsym.solving.methods import made_method

        options: dict[str, Any] = {}
        for parameter in _solver_parameters():
            name = str(parameter.name)
            value = ctx.params.pop(name, None)
            if value is not None:
                (options if isinstance(parameter, _MethodOption) else ctx.params)[name] = value
        ctx.params["method"] = made_method(ctx.params["method"], options)
        return super().invoke(ctx)


class _MethodOption(click.Option):
    """An option in a section of the help text."""

    def __init__(self, *arguments: Any, section: str, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.section = section


class _NamedChoice(Choice):
    """A choice among names of values."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__(values)
        self.values = values

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return self.values[super().convert(value, param, ctx)]


#: Sections of options by the name of their field.
_TOPICS = {
    name: topic
    for topic, names in {
        "Windows": "max_window windows train_hidden",
        "Network": "hidden activation envelope tau frequency shared_weights initial dtype device",
        "Loss": "points energy_weight invariant_weight",
        "Search for the weights": "stages iterations restarts",
        "Training": "epochs learning_rate betas schedule noise",
        "End of the training": "target_loss target_ell_max accuracy patience time_limit",
    }.items()
    for name in names.split()
}
_SHARED = ("Windows", "Search for the weights")
_OTHERS = "Other options"

#: Types of options by the annotation of their field, without "| None".
_TYPES: dict[str, Any] = {
    "int": click.INT,
    "bool": click.BOOL,
    "float": NUMBER,
    "tuple[float, float]": (click.FLOAT, click.FLOAT),
    "Sequence[int]": Parsed("numbers", whole_numbers),
    "Sequence[float]": NUMBERS,
    "float | Sequence[float]": NUMBERS,
    "str | torch.device": click.STRING,
    "Solution": Parsed("file", saved_solution),
}


@functools.cache
def _solver_parameters() -> tuple[click.Parameter, ...]:
    """Return the options of all methods, each once."""
    from hamsym.solving.methods import METHODS

    found: list[click.Parameter] = [
        click.Option(
            ["--tol"],
            type=NUMBER,
            metavar="NUMBER",
            help="Tolerance, relative to the largest value of each component; networks that are "
            "trained jointly stop when it is met.  [1e-09; 0.01 for networks trained jointly]",
        ),
        click.Option(
            ["--atol"],
            type=NUMBERS,
            metavar="NUMBERS",
            help="Absolute tolerance, one or one for each component.  [0]",
        ),
        click.Option(
            ["--breakpoints"],
            type=NUMBERS,
            metavar="TIMES",
            help="Times at which a window ends.",
        ),
        click.Option(
            ["--method"],
            type=Choice(METHODS),
            default=next(iter(METHODS)),
            show_default=True,
            help="Method of solution.",
        ),
        click.Option(
            ["--seed"], type=click.INT, default=0, show_default=True, help="Seed of random numbers."
        ),
    ]
    by_name: dict[str, dict[str, Field[Any]]] = {}
    for method, kind in METHODS.items():
        for field in fields(kind):
            if field.metadata["help"]:
                by_name.setdefault(field.name, {})[method] = field
    for topic in dict.fromkeys([*_TOPICS.values(), _OTHERS]):
        names = [name for name in by_name if _TOPICS.get(name, _OTHERS) == topic]
        if names:
            having = {method for name in names for method in by_name[name]}
            usual = tuple(m for m in METHODS if m in having and topic not in _SHARED)
            for name in names:
                found.append(_parameter(by_name[name], topic, usual))
    return tuple(found)


def _parameter(
    of_methods: Mapping[str, Field[Any]], topic: str, usual: tuple[str, ...]
) -> click.Parameter:
    """Return the option of a field; ``usual`` are the methods with options of its topic."""
    described = next(iter(of_methods.values()))
    metadata, name = described.metadata, described.name.replace("_", "-")
    choices = metadata["choices"]
    kind = _TYPES.get(str(described.type).removesuffix(" | None"))
    if choices is not None:
        kind = _NamedChoice(choices) if isinstance(choices, Mapping) else Choice(choices)
    only = "" if tuple(of_methods) == usual else f" ({', '.join(of_methods)})"
    defaults = _default_text({m: _text(f.default, f.metadata) for m, f in of_methods.items()})
    return _MethodOption(
        [f"--{name}/--no-{name}" if kind is click.BOOL else f"--{name}"],
        type=kind,
        metavar=metadata["unit"],
        default=None,
        help=f"{metadata['help']}{only}{defaults}",
        section=topic if topic in _SHARED else f"{topic} ({_listed(usual)})",
    )


def _listed(methods: tuple[str, ...]) -> str:
    from hamsym.solving.methods import METHODS

    words = {
        tuple(name for name, kind in METHODS.items() if not kind.marches): "methods that train",
        tuple(
            name for name, kind in METHODS.items() if kind.joint
        ): "methods that train one network",
    }
    return words.get(methods, ", ".join(methods))


def _text(default: Any, metadata: Mapping[str, Any]) -> str:
    """Return a default as text, empty if there is none."""
    if default is None or default == ():
        return metadata["default_text"] or ""
    if isinstance(default, tuple):
        return ",".join(map(str, default))
    if isinstance(default, bool):
        return "yes" if default else "no"
    return f"{default:g}" if isinstance(default, float) else str(default)


def _default_text(texts: Mapping[str, str]) -> str:
    """Return the default of most methods, and the methods with others, in brackets."""
    common, count = Counter(texts.values()).most_common(1)[0]
    parts = [common] if common and 2 * count > len(texts) else []
    parts += [f"{m}: {text}" for m, text in texts.items() if text and [text] != parts[:1]]
    return f"  [{'; '.join(parts)}]" if parts else ""
