"""Round-off over long spans, and Sun, Jupiter and Saturn over 100,000 years beside heyoka.

Kepler orbits of small eccentricity from random starts, against the exact motion: root mean squares
of the relative change of the energy and of the distance in the plane. Random round-off grows as
T^0.5 in the energy and as T^1.5 in the phase (Brouwer 1937), biased round-off as T and T^2.

Sun, Jupiter and Saturn start on 5 September 1994 (Hairer, Lubich & Wanner 2006, section I.2.4); the
error is the root mean square over 100 times of the distance of all positions, in astronomical
units, from heyoka's in extended precision.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import mpmath
import numpy as np

import hamsym
from hamsym import Hamiltonian
from hamsym.integrators.stepper import Stepper

from . import markdown
from .measuring import cpu, exponent
from .opponents import optional
from .results import Section

_KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
_STARTS = 8
#: Method, steps in a period, compensated, starts, periods.
_RUNS = (
    ("sofroniou_spaletta10", 60, True, _STARTS, (100, 1_000, 10_000, 100_000, 1_000_000)),
    ("sofroniou_spaletta10", 60, True, 4, (10_000_000,)),
    ("sofroniou_spaletta10", 60, False, _STARTS, (100, 1_000, 10_000, 100_000)),
    ("gauss12", 20, True, _STARTS, (100, 1_000, 10_000, 100_000)),
)
_QUICK = (("sofroniou_spaletta10", 60, True, 2, (10, 100)), ("gauss12", 20, True, 2, (10,)))

_GRAVITY = 2.95912208286e-4  # astronomical units, days, masses of the sun
_MASSES = (1.00000597682, 0.000954786104043, 0.000285583733151)
_PLACES = ((0, 0, 0), (-3.5023653, -3.8169847, -1.5507963), (9.0755314, -3.0458353, -1.6483708))
_SPEEDS = ((0, 0, 0), (0.00565429, -0.0041249, -0.00190589), (0.00168318, 0.00483525, 0.00192462))
_YEAR, _SAVES = 365.25, 100
#: Method and days in a step.
_PLANETS = (("sofroniou_spaletta10", 150), ("sofroniou_spaletta10", 130), ("gauss12", 200))


def measure(quick: bool) -> Section:
    skipped: list[str] = []
    laws = [row for run in (_QUICK if quick else _RUNS) for row in _law(*run)]
    heyoka = optional("heyoka", skipped)
    planets = _planets(heyoka, 100 if quick else 100_000) if heyoka else []
    return {"laws": laws, "planets": planets, "skipped": skipped}


# -- one orbit -------------------------------------------------------------------------------------


def _law(
    method: str, steps: int, compensated: bool, starts: int, counts: Sequence[int]
) -> list[dict[str, Any]]:
    """Errors after numbers of periods."""
    H, states = Hamiltonian(_KEPLER), _starts(starts)
    energy, size = H.compile("numpy").energy, 2 * np.pi / steps
    given = H, method, states, np.zeros(starts), np.full(starts, size)
    Stepper(*given, compensated=compensated).step(1)  # compiles
    stepper = Stepper(*given, compensated=compensated)
    rows, done, seconds = [], 0, 0.0
    before = energy(states)
    for count in counts:
        while done < count:
            some = min(count - done, 100_000)
            spent, z = cpu(functools.partial(stepper.step, steps * some))
            done, seconds = done + some, seconds + spent
        change = (energy(z) - before) / before
        exact = np.array([_exact(start, size * steps * count) for start in states])
        rows.append(
            {
                "method": method,
                "steps": steps,
                "compensated": compensated,
                "periods": count,
                "energy": float(np.sqrt((change**2).mean())),
                "mean": float(change.mean()),
                "phase": float(np.sqrt(((z[:, :2] - exact) ** 2).sum(axis=1).mean())),
                "seconds": seconds / starts,
            }
        )
    return rows


def _starts(count: int) -> np.ndarray:
    """Pericentres, shape (count, 4)."""
    random = np.random.default_rng(1)
    e, a = random.uniform(0.02, 0.12, count), random.uniform(0.9, 1.1, count)
    return np.stack((a * (1 - e), 0 * e, 0 * e, np.sqrt((1 + e) / (1 - e) / a)), axis=-1)


def _exact(start: np.ndarray, t: float) -> list[float]:
    """The place of Kepler's motion from a pericentre."""
    with mpmath.workdps(40):
        x, _, _, speed = map(mpmath.mpf, start.tolist())
        a = 1 / (2 / x - speed**2)
        e = 1 - x / a
        mean = mpmath.fmod(a ** mpmath.mpf(-1.5) * t, 2 * mpmath.pi)
        u = mpmath.findroot(lambda u: u - e * mpmath.sin(u) - mean, mean)
        return [
            float(a * (mpmath.cos(u) - e)),
            float(a * mpmath.sqrt(1 - e**2) * mpmath.sin(u)),
        ]


# -- planets ---------------------------------------------------------------------------------------


def _planets(heyoka: Any, years: int) -> list[dict[str, Any]]:
    """Seconds and errors, heyoka first."""
    masses = np.array(_MASSES)
    places, speeds = (
        np.array(a, dtype=float) - masses @ np.array(a, dtype=float) / masses.sum()
        for a in (_PLACES, _SPEEDS)
    )
    t = np.linspace(0, _YEAR * years, _SAVES + 1)
    start = np.concatenate((places, speeds), axis=1).ravel()
    long = np.longdouble
    exact = heyoka.taylor_adaptive(
        heyoka.model.nbody(3, masses=[long(m) for m in masses], Gconst=long(_GRAVITY)),
        start.astype(long),
        tol=long(1e-19),
        fp_type=long,
        high_accuracy=True,
    ).propagate_grid(t.astype(long))[-1]

    def error(found: np.ndarray) -> float:
        apart = (found - exact.reshape(-1, 3, 6)[:, :, :3]).astype(float)
        return float(np.sqrt((apart**2).sum(axis=(1, 2)).mean()))

    opponent = heyoka.taylor_adaptive(
        heyoka.model.nbody(3, masses=list(masses), Gconst=_GRAVITY),
        start,
        tol=1e-15,
        high_accuracy=True,
    )
    seconds, out = cpu(lambda: opponent.propagate_grid(t)[-1])
    rows = [_planet("heyoka, tol 1e-15", 0, seconds, error(out.reshape(-1, 3, 6)[:, :, :3]))]
    H = _newton(masses)
    q = dict(zip(map(str, H.q), places.ravel(), strict=True))
    p = dict(zip(map(str, H.p), (masses[:, None] * speeds).ravel(), strict=True))
    for method, days in _PLANETS:
        steps = max(1, round(t[-1] / days / _SAVES)) * _SAVES
        options: dict[str, Any] = {"steps": steps, "save_every": steps // _SAVES}
        if not method.startswith("gauss"):
            options["compensated"] = True

        def run(method: str = method, options: dict[str, Any] = options) -> hamsym.Trajectory:
            return hamsym.integrate(H, {**q, **p}, (0, t[-1]), method, **options)

        run()  # compiles
        seconds, found = cpu(run)
        rows.append(_planet(method, days, seconds, error(found.z[:, :9].reshape(-1, 3, 3))))
    return rows


def _newton(masses: np.ndarray) -> Hamiltonian:
    """Three bodies in space, in the order of their coordinates."""
    q = [[f"{axis}{body}" for axis in "xyz"] for body in range(3)]
    kinetic = [
        f"p_{name}**2/{2 * m!r}" for m, own in zip(masses.tolist(), q, strict=True) for name in own
    ]
    pairs = [
        f"{_GRAVITY * float(masses[i] * masses[j])!r}/sqrt("
        + " + ".join(f"({a} - {b})**2" for a, b in zip(q[i], q[j], strict=True))
        + ")"
        for i in range(3)
        for j in range(i)
    ]
    names = [name for own in q for name in own]
    return Hamiltonian(
        f"{' + '.join(kinetic)} - {' - '.join(pairs)}", q=names, p=[f"p_{name}" for name in names]
    )


def _planet(method: str, days: float, seconds: float, error: float) -> dict[str, Any]:
    return {"method": method, "days": days, "seconds": seconds, "error": error}


def table(section: Section) -> str:
    laws = section["laws"]
    rows = [
        [
            f"`{row['method']}`" + ("" if row["compensated"] else ", not compensated"),
            f"{row['periods']:,}",
            *(markdown.plain(abs(row[key])) for key in ("energy", "mean", "phase")),
            markdown.number(row["seconds"]),
        ]
        for row in laws
    ]
    head = ["method", "periods", "energy", "its mean", "distance", "s an orbit"]
    text = markdown.table(head, rows)
    for name in dict.fromkeys((row["method"], row["compensated"]) for row in laws):
        own = [r for r in laws if (r["method"], r["compensated"]) == name and r["periods"] >= 1_000]
        if len(own) > 1:
            periods = [row["periods"] for row in own]
            energy, phase = (
                exponent(periods, [row[k] for row in own]) for k in ("energy", "phase")
            )
            kept = "" if name[1] else ", not compensated"
            text += (
                f"\n\n`{name[0]}`{kept}: the energy grows as T^{energy:.2f}, the distance as "
                f"T^{phase:.2f} from 1,000 periods on."
            )
    first = section["planets"][0]["seconds"] if section["planets"] else 1.0
    planets = [
        [
            row["method"],
            f"{row['days']:g}" if row["days"] else "-",
            markdown.number(row["seconds"]),
            markdown.number(row["seconds"] / first),
            markdown.plain(row["error"]),
        ]
        for row in section["planets"]
    ]
    head = ["Sun, Jupiter, Saturn", "days in a step", "CPU s", "over heyoka", "error"]
    text += "\n\n" + markdown.table(head, planets) if planets else ""
    return text + markdown.skipped(section["skipped"])
