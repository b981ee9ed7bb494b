"""An animation of the double pendulum.

Run `python examples/double_pendulum.py`; `--frames` and `--out` set their number and the folder.
"""

import argparse
from pathlib import Path

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--frames", type=int, default=100)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()
arguments.out.mkdir(parents=True, exist_ok=True)

problem = hamsym.systems.double_pendulum()
solution = hamsym.solve(problem.H, problem.z0, problem.span)
path = arguments.out / "double-pendulum.gif"
solution.animate(frames=arguments.frames, fps=12.5).save(path, dpi=90)
print(f"wrote {path}")
