"""Make ``references.json``: states of the systems of the audit, to 25 digits.

Run it from the repository: ``python -m tests.audit.make_references [name ...]``; without names it
makes the missing references. Every trajectory is computed twice, at two precisions and orders, and
the largest difference is stored as ``agreement``. If there is an exact solution it is stored, and
the Taylor series are compared with it.
"""

from __future__ import annotations

import json
import math
import random
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import mpmath
import sympy
from flint import arb, ctx

from .systems import BY_NAME, System
from .taylor import Equations, formula, integrate

FILE = Path(__file__).with_name("references.json")
_TIMES, _BUSY = 20, 6
_DIGITS = 25
_NUDGE = 1e-18  # relative perturbation of the start, to measure the growth of errors
_AGREEMENT = 1e-14

mpmath.mp.dps = 50


def times_of(system: System, equations: Equations) -> list[float]:
    """Irregular times, some of them at the fastest motion, and the end."""
    start, end = system.span
    end = system.until if system.until is not None else end
    generator = random.Random(zlib.crc32(system.name.encode()))
    times = {start + (end - start) * generator.random() for _ in range(_TIMES - 1)}
    rough = integrate(equations, system.z0, start, [end], order=20, bits=96, digits=15)
    edges = [*rough.starts, rough.reached]
    # Short steps mark fast motion: an encounter or a kick.
    busy: list[float] = []
    for k in sorted(range(1, rough.steps), key=lambda k: abs(edges[k + 1] - edges[k])):
        if all(abs(edges[k] - t) > 0.03 * abs(end - start) for t in busy):
            busy.append(edges[k])
    times.update(busy[:_BUSY])
    return [*sorted(times - {end}, reverse=end < start), end]


def equations_of(system: System) -> Equations:
    return Equations(
        system.smooth or system.text,
        system.q.split(),
        system.p.split(),
        system.parameters,
        [one for one in system.switches.split(";") if one],
        system.focus,
    )


# -- exact solutions -----------------------------------------------------------------------------


def linear(system: System, times: list[float]) -> list[list[mpmath.mpf]]:
    """Solution exp(A t) z0 of a linear system."""
    names = system.names
    symbols = [sympy.Symbol(name, real=True) for name in names]
    exact = {
        sympy.Symbol(name, real=True): sympy.Rational(*float(value).as_integer_ratio())
        for name, value in system.parameters.items()
    }
    H = formula(system.text, [*names, *system.parameters]).subs(exact)
    half = len(names) // 2
    hessian = sympy.hessian(H, symbols)
    assert not hessian.free_symbols
    rows = [hessian.row(half + k) for k in range(half)] + [-hessian.row(k) for k in range(half)]
    with mpmath.workdps(60):
        matrix = mpmath.matrix([[mpmath.mpf(int(v.p)) / int(v.q) for v in row] for row in rows])
        # In units of the start's sizes the norm is that of the frequencies.
        z0 = mpmath.matrix(list(system.z0))
        found = []
        for t in times:
            found.append(list(mpmath.expm(matrix * (mpmath.mpf(t) - system.span[0])) * z0))
        return found


def kepler(system: System, times: list[float]) -> list[list[mpmath.mpf]]:
    """Kepler orbit, mu = 1, from an apsis on the x axis."""
    x, _, _, v = (mpmath.mpf(value) for value in system.z0)
    a = 1 / (2 / x - v * v)
    e = 1 - x / a  # negative from the aphelion, where the eccentric anomaly counts from
    n, b = a ** mpmath.mpf(-1.5), a * mpmath.sqrt(1 - e * e)
    found = []
    for t in times:
        M = n * (mpmath.mpf(t) - system.span[0])
        low, high = M - 1, M + 1
        for _ in range(20):
            middle = (low + high) / 2
            if middle - e * mpmath.sin(middle) < M:
                low = middle
            else:
                high = middle
        E = (low + high) / 2
        for _ in range(60):
            step = (E - e * mpmath.sin(E) - M) / (1 - e * mpmath.cos(E))
            E -= step
            if abs(step) < mpmath.mpf(10) ** -45:
                break
        rate = n / (1 - e * mpmath.cos(E))
        found.append(
            [
                a * (mpmath.cos(E) - e),
                b * mpmath.sin(E),
                -a * mpmath.sin(E) * rate,
                b * mpmath.cos(E) * rate,
            ]
        )
    return found


def pendulum(system: System, times: list[float]) -> list[list[mpmath.mpf]]:
    """Pendulum from rest at x0: sin(x/2) = k sn(K - t), k = sin(x0/2)."""
    k = mpmath.sin(mpmath.mpf(system.z0[0]) / 2)
    K = mpmath.ellipk(k * k)
    found = []
    for t in times:
        u = K - (mpmath.mpf(t) - system.span[0])
        sn, cn = (mpmath.ellipfun(kind, u, m=k * k) for kind in ("sn", "cn"))
        found.append([2 * mpmath.asin(k * sn), -2 * k * cn])
    return found


def parabolas(system: System, times: list[float]) -> list[list[mpmath.mpf]]:
    """Motion in |x - 1| from rest at distance d from the kink; quarter periods sqrt(2 d)."""
    d = mpmath.mpf(system.z0[0]) - 1
    quarter = mpmath.sqrt(2 * d)
    found = []
    for t in times:
        # From the last passage of the kink, at speed -quarter first.
        elapsed = mpmath.mpf(t) - system.span[0] + quarter
        side = (-1) ** int(mpmath.floor(elapsed / (2 * quarter)))
        s = elapsed - 2 * quarter * mpmath.floor(elapsed / (2 * quarter))
        found.append([1 + side * (quarter * s - s * s / 2), side * (quarter - s)])
    return found


def gaussian_kick(system: System, times: list[float]) -> list[list[mpmath.mpf]]:
    """Solution of p' = -exp(-(c (t - b))**2), x' = p, by error functions."""
    b, c = mpmath.mpf(337) / 100, mpmath.mpf(1000)
    x0, p0 = (mpmath.mpf(value) for value in system.z0)

    def first(u: mpmath.mpf) -> mpmath.mpf:
        return mpmath.sqrt(mpmath.pi) / 2 * mpmath.erf(u)

    def second(u: mpmath.mpf) -> mpmath.mpf:
        return u * first(u) + mpmath.exp(-u * u) / 2

    start = mpmath.mpf(system.span[0])
    low = c * (start - b)
    found = []
    for t in times:
        u, elapsed = c * (mpmath.mpf(t) - b), mpmath.mpf(t) - start
        kick = (first(u) - first(low)) / c
        path = (second(u) - second(low)) / c**2 - elapsed * first(low) / c
        found.append([x0 + p0 * elapsed - path, p0 - kick])
    return found


def chirp(system: System, times: list[float]) -> list[list[mpmath.mpf]]:
    """Solution of p' = -cos(t**2), x' = p, by Fresnel integrals."""
    x0, p0 = (mpmath.mpf(value) for value in system.z0)
    unit = mpmath.sqrt(mpmath.pi / 2)
    found = []
    for t in (mpmath.mpf(value) for value in times):
        C = unit * mpmath.fresnelc(t / unit)
        found.append([x0 + p0 * t - (t * C - mpmath.sin(t * t) / 2), p0 - C])
    return found


EXACT: dict[str, Callable[[System, list[float]], list[list[mpmath.mpf]]]] = {
    "linear": linear,
    "kepler": kepler,
    "pendulum": pendulum,
    "parabolas": parabolas,
    "gaussian_kick": gaussian_kick,
    "chirp": chirp,
}


# -- the file ------------------------------------------------------------------------------------


def reference(system: System) -> dict[str, object]:
    began = time.process_time()
    equations = equations_of(system)
    times = times_of(system, equations)
    first = integrate(equations, system.z0, system.span[0], times)
    scales = first.scales
    sizes = [scale if scale > 0 else 1.0 for scale in scales]
    second = integrate(equations, system.z0, system.span[0], times, order=28, bits=160, digits=27)
    generator = random.Random(1)
    before, ctx.prec = ctx.prec, 160
    nudged = [
        arb(value) + (0 if name in system.zero else size * _NUDGE * generator.choice((-1, 1)))
        for name, value, size in zip(system.names, system.z0, sizes, strict=True)
    ]
    moved = integrate(equations, nudged, system.span[0], times, order=28, bits=128, digits=27)
    growth = max(1.0, _largest(first.states, moved.states, sizes) / _NUDGE)
    agreement = _largest(first.states, second.states, sizes)
    states = [[_decimal(value) for value in row] for row in first.states]
    if system.reference != "taylor":
        exact = EXACT[system.reference](system, times)
        numbers = [[arb(mpmath.nstr(value, 45)) for value in row] for row in exact]
        agreement = max(agreement, _largest(numbers, first.states, sizes))
        states = [[mpmath.nstr(value, _DIGITS) for value in row] for row in exact]
    ctx.prec = before
    spent = time.process_time() - began
    print(
        f"{system.name:32s} {first.steps:6d} steps, agreement {agreement:.1e}, "
        f"growth {growth:.1e}, {len(first.events)} switches, {spent:.1f} s",
        flush=True,
    )
    if not agreement < _AGREEMENT:
        raise SystemExit(f"{system.name}: two computations differ by {agreement:.1e}")
    return {
        "of": system.fingerprint,
        "made": system.reference,
        "times": times,
        "states": states,
        "scales": scales,
        "growth": float(f"{growth:.3g}"),
        "agreement": float(f"{agreement:.2g}"),
    }


def _largest(one: list[list[arb]], other: list[list[arb]], sizes: list[float]) -> float:
    return max(
        abs(float(a - b)) / size
        for row, column in zip(one, other, strict=True)
        for a, b, size in zip(row, column, sizes, strict=True)
    )


def _decimal(value: arb) -> str:
    return mpmath.nstr(_mpf(value), _DIGITS)


def _mpf(value: arb) -> mpmath.mpf:
    mantissa, exponent = (int(part) for part in value.mid().man_exp())
    return mpmath.ldexp(mpmath.mpf(mantissa), exponent)


def main(names: list[str]) -> None:
    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    wanted = names or [name for name in BY_NAME if name not in known]
    for name in wanted:
        if BY_NAME[name].reference == "none":
            continue
        made = reference(BY_NAME[name])
        known = json.loads(FILE.read_text()) if FILE.exists() else {}
        known[name] = made
        rows = ",\n".join(f"{json.dumps(n)}: {json.dumps(known[n])}" for n in BY_NAME if n in known)
        FILE.write_text("{\n" + rows + "\n}\n")
    assert all(math.isfinite(row["growth"]) for row in known.values())


if __name__ == "__main__":
    main(sys.argv[1:])
