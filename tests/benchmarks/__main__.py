"""Run benchmarks, print their tables and write their results: ``python -m tests.benchmarks``."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # CPU times count all threads

import argparse
from collections.abc import Sequence
from pathlib import Path

from .registry import BENCHMARKS
from .results import FILE, replace_section


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks",
        description="Run benchmarks, print their tables and write their results.",
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help=f"all by default, or some of: {', '.join(BENCHMARKS)}",
    )
    parser.add_argument("--quick", action="store_true", help="seconds: shows that they run")
    parser.add_argument("--results", type=Path, help=f"file to write; {FILE.name}, none if quick")
    chosen = parser.parse_args(arguments)
    for name in chosen.names:
        if name not in BENCHMARKS:
            parser.error(f"{name!r} is not a benchmark; choose from {', '.join(BENCHMARKS)}")
    file = chosen.results or (None if chosen.quick else FILE)
    for name in chosen.names or BENCHMARKS:
        benchmark = BENCHMARKS[name]
        print(f"\n{name}: {(benchmark.__doc__ or '').splitlines()[0]}\n", flush=True)
        section = benchmark.measure(chosen.quick)
        print(benchmark.table(section), flush=True)
        if file:
            replace_section(name, section, chosen.quick, file)


if __name__ == "__main__":
    main()
