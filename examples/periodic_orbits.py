"""Periodic orbits: figure eight, Lyapunov and halo families, bifurcations of Henon and Heiles.

Run `python examples/periodic_orbits.py`; `--out` sets the output folder.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import hamsym

BLUE, RED, GREEN = "#0072b2", "#d55e00", "#009e73"


def figure_eight():
    """Three equal masses on one curve (Chenciner & Montgomery 2000)."""
    q = [f"{c}{i}" for i in "123" for c in "xy"]
    kinetic = " + ".join(f"p_{name}**2/2" for name in q)
    pairs = ("12", "13", "23")
    potential = " - ".join(f"1/sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i, j in pairs)
    H = hamsym.Hamiltonian(f"{kinetic} - {potential}", q=q, p=[f"p_{name}" for name in q])
    start = {"x1": 0.97, "y1": -0.243, "x2": -0.97, "y2": 0.243, "x3": 0, "y3": 0}
    start |= {"p_x1": 0.466, "p_y1": 0.432, "p_x2": 0.466, "p_y2": 0.432}
    start |= {"p_x3": -0.932, "p_y3": -0.865}
    # Now the third body is in the middle; a twelfth of the period later the first one is on an
    # axis of symmetry.
    first, last = {}, {}
    for c, sign, turned in (("x", "", "-"), ("y", "-", "")):
        first |= {f"{c}1": f"-{c}2", f"{c}2": f"-{c}1", f"{c}3": f"-{c}3"}
        first |= {f"p_{c}1": f"p_{c}2", f"p_{c}2": f"p_{c}1"}
        last |= {f"{c}1": f"{sign}{c}1", f"{c}2": f"{sign}{c}3", f"{c}3": f"{sign}{c}2"}
        last |= {f"p_{c}1": f"{turned}p_{c}1", f"p_{c}2": f"{turned}p_{c}3"}
        last |= {f"p_{c}3": f"{turned}p_{c}2"}
    return hamsym.periodic_orbit(H, (start, 6.3), energy=-1.28714199, symmetry=(first, last))


def lyapunov_family():
    """Planar orbits around the libration point L1 of the Earth and the Moon."""
    H = hamsym.systems.halo_orbits().H
    guess = {"x": 0.8319, "y": 0, "z": 0, "p_x": 0, "p_y": 0.8738, "p_z": 0}
    mirror = {"y": "-y", "p_x": "-p_x", "p_z": "-p_z"}
    return hamsym.periodic_orbit(H, (guess, 2.7), symmetry=mirror).family(energy=-1.52)


def straight_family():
    """The orbit along the y axis of the Henon-Heiles system."""
    H = hamsym.systems.henon_heiles().H
    start = H.state_at_energy(0.12, {"x": 0, "y": 0, "p_x": 0})
    return hamsym.periodic_orbit(H, start, energy=0.12).family(energy=0.165)


def main(out):
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    eight = figure_eight()
    z = eight(np.linspace(0, eight.period, 1001))
    left.plot(z[:, 0], z[:, 1], color="0.5", linewidth=1)
    for body, color in enumerate((BLUE, RED, GREEN)):
        left.plot(*z[0, 2 * body : 2 * body + 2], "o", color=color, markersize=8)
    left.set(title=f"figure eight, period {eight.period:.7f}", xlabel="x", ylabel="y")
    left.set_aspect("equal", adjustable="datalim")
    family = lyapunov_family()
    for orbit in family[:: max(1, len(family) // 12)]:
        z = orbit(np.linspace(0, orbit.period, 501))
        middle.plot(z[:, 0], z[:, 1], color=BLUE, linewidth=0.8)
    mu = family[0].H.parameters["mu"]
    middle.plot([1 - mu], [0], "o", color="0.4", markersize=6)
    middle.annotate("Moon", (1 - mu, 0.012), ha="center")
    middle.set(title="Lyapunov orbits around L1", xlabel="x", ylabel="y")
    middle.set_aspect("equal", adjustable="datalim")
    halo = family.branch(0, energy=-1.51).plot("x", "y", "z")
    family = straight_family()
    places = [*family, *(found.orbit for found in family.bifurcations)]
    places.sort(key=lambda orbit: orbit.energy)
    sums = [float(np.sum(orbit.shift_multipliers).real) for orbit in places]
    right.plot([orbit.energy for orbit in places], sums, ".-", color=BLUE)
    for bound in (-2, 2):
        right.axhline(bound, color="0.6", linewidth=0.8)
    for found in family.bifurcations:
        doubling = found.kind == "period doubling"
        color = GREEN if doubling else RED
        right.plot(found.orbit.energy, -2 if doubling else 2, "o", color=color, markersize=8)
    right.set(
        title="Henon-Heiles: orbit along y",
        xlabel="energy",
        ylabel="sum of the two multipliers",
    )
    for axis in (left, middle, right):
        axis.grid(alpha=0.25)
    out.mkdir(parents=True, exist_ok=True)
    for name, drawn in (("periodic-orbits", figure), ("halo-orbits", halo)):
        drawn.savefig(out / f"{name}.png", dpi=110)
        print(f"wrote {out / name}.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("output"))
    main(parser.parse_args().out)
