"""The command that prints the completion of a shell."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from hamsym.cli.command import Choice, Command, Report


@click.command(
    cls=Command,
    short_help="Print the completion script of a shell.",
    examples=[
        "hamsym completion bash > ~/.hamsym-complete.bash",
        "hamsym completion fish > ~/.config/fish/completions/hamsym.fish",
    ],
)
@click.argument("shell", type=Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> Report:
    """Print the script that completes commands, options, names and files.

    bash: add ". ~/.hamsym-complete.bash" to ~/.bashrc; zsh: write the script to a file and source
    it in ~/.zshrc; fish reads the file of the example by itself.
    """
    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(context.find_root().command, {}, "hamsym", "_HAMSYM_COMPLETE")
    text = script.source_template % script.source_vars()
    return Report(text, {"shell": shell, "script": text})
