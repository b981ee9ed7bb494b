"""Help texts: sections, width and examples."""

from __future__ import annotations

import shlex

import click
import pytest

from hamsym.cli.commands import cli, main

Captured = pytest.CaptureFixture[str]

EXAMPLES = [
    (name, example)
    for name, command in cli.commands.items()
    for example in getattr(command, "examples", ())
]


@pytest.mark.parametrize("name", cli.commands)
def test_every_help_has_two_examples(name: str, capsys: Captured) -> None:
    assert main([name, "-h"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    assert out.index("Examples:") > out.index("Help:")
    shown = out[out.index("Examples:") :].replace("\\\n", " ")
    assert shown.count(f"  hamsym {name}") >= 2
    for _, example in (pair for pair in EXAMPLES if pair[0] == name):
        assert " ".join(example.split()) in " ".join(shown.split())


@pytest.mark.parametrize(("name", "example"), EXAMPLES, ids=[pair[1][:60] for pair in EXAMPLES])
def test_examples_parse(name: str, example: str) -> None:
    program, command, *arguments = shlex.split(example.partition(" > ~")[0])
    assert (program, command) == ("hamsym", name)
    context = cli.commands[name].make_context(name, arguments)
    assert isinstance(context, click.Context)


def test_options_of_solve_are_in_sections(capsys: Captured) -> None:
    main(["solve", "--help"])
    out = capsys.readouterr().out
    titles = ["Problem:", "Accuracy:", "Method:", "Network (methods that train):", "Output:"]
    places = [out.index(f"\n{title}\n") for title in titles]
    assert places == sorted(places)
    for title, option in zip(
        titles, ["--z0", "--tol", "--seed", "--hidden", "--json"], strict=True
    ):
        assert out.index(f"  {option}", out.index(title)) < out.index("\n\n", out.index(title))


def test_commands_are_listed_by_subject(capsys: Captured) -> None:
    main(["--help"])
    out = capsys.readouterr().out
    assert "...\n" not in out[out.index("Options:") :]
    assert "Exit status:" in out
    for name in cli.commands:
        assert f"\n  {name} " in out
    assert out.index("Derive:") < out.index("  derive ") < out.index("Solve:")


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        (["slove"], "No such command 'slove' (did you mean 'solve'?)"),
        (["xyz"], "No such command 'xyz'; 'hamsym --help' lists them"),
        (["source", "p**2/2 + x**2/2", "--backend", "nunpy"], "(did you mean 'numpy'?)"),
        (
            ["solve", "p**2/2 + x**2/2", "--z0", "1,0", "--t-end", "1", "--methd", "adam"],
            "--method",
        ),
        (
            ["integrate", "p**2/2 + x**2/2", "--z0", "1,0", "--t-end", "1", "--method", "ruth_3"],
            "(did you mean 'ruth3'?)",
        ),
    ],
)
def test_similar_names_are_suggested(arguments: list[str], answer: str, capsys: Captured) -> None:
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert answer in err
    assert err.count("\n") == 1
