"""The command that reproduces the paper's experiments."""

from __future__ import annotations

import contextlib
import importlib
import sys
import time
from pathlib import Path

import click

from hamsym.cli.command import Report, command

_EXPERIMENTS = ("oscillator", "oscillator-long", "henon-heiles", "henon-heiles-long", "accuracy")


@command(
    "Reproduce the experiments of the paper.",
    "hamsym reproduce --quick",
    "hamsym reproduce oscillator --seeds 5 --out results",
)
@click.argument(
    "experiments", nargs=-1, type=click.Choice([*_EXPERIMENTS, "all"]), metavar="[EXPERIMENTS]..."
)
@click.option("--quick", is_flag=True, help="Few epochs: the same rows in minutes.")
@click.option("--claims", is_flag=True, help="Test further claims of the paper.")
@click.option("--seed", default=0, show_default=True, help="The first seed.")
@click.option("--seeds", type=int, help="Number of seeds  [3, or 1 with --quick]")
@click.option("--workers", type=int, help="Number of processes  [number of cores]")
@click.option(
    "--out", type=click.Path(), default="output/paper", show_default=True, help="Output directory."
)
def reproduce(
    experiments: tuple[str, ...],
    quick: bool,
    claims: bool,
    seed: int,
    seeds: int | None,
    workers: int | None,
    out: str,
) -> Report:
    """Reproduce the paper's experiments, with further methods and integrators.

    Each experiment writes its table, figures and results; page.md summarises them. Existing runs
    are reused. With --quick the output directory is its subdirectory "quick". EXPERIMENTS are
    oscillator, oscillator-long, henon-heiles, henon-heiles-long, accuracy (error against CPU time
    of every way to train) or all, the default.
    """
    from hamsym.support.locking import exclusive
    from hamsym.support.validation import require_whole

    require_whole("--seed", seed, 0)
    if seeds is None:
        seeds = 1 if quick else 3
    require_whole("--seeds", seeds, 1)
    if workers is not None:
        require_whole("--workers", workers, 1)
    chosen = [name for name in _EXPERIMENTS if not experiments or {name, "all"} & {*experiments}]
    if claims:
        chosen.append("claims")
    directory = Path(out) / "quick" if quick else Path(out)
    directory.mkdir(parents=True, exist_ok=True)
    options = [f"--seed={seed}", f"--seeds={seeds}", f"--out={directory}"] + ["--quick"] * quick
    if workers is not None:
        options.append(f"--workers={workers}")
    began = time.monotonic()
    # Tables are progress: with --json standard output has the object alone.
    as_json = click.get_current_context().meta.get("hamsym.json", False)
    shown = contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()
    with exclusive(directory), shown:
        for name in chosen:
            script = importlib.import_module(f"hamsym.paper.{name.replace('-', '_')}")
            script.main(options)
        importlib.import_module("hamsym.paper.page").main([f"--out={directory}"])
    minutes = (time.monotonic() - began) / 60
    return Report(
        f"{minutes:.1f} minutes",
        {"experiments": chosen, "folder": str(directory), "minutes": minutes},
    )
