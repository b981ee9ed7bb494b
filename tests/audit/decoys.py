"""Decoys: systems with a feature far narrower than the windows of a march, and their true ends.

Each feature changes the end of the trajectory by much more than the tolerances, but leaves no
trace at most places of a window. ``decoys.json`` has the end states. Run
``python -m tests.audit.decoys [name ...]`` to make those that are missing: by Taylor series of high
precision whose steps resolve the known features, twice, with other orders and steps.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .taylor import Equations, Orbit, integrate

FILE = Path(__file__).with_name("decoys.json")

_OSCILLATOR = "p**2/2+x**2/2"
_BESIDE = (-6, -3, 0, 3, 6)  # widths
_PLANE = "(px**2+py**2)/2+(x**2+2*y**2)/2+x**2*y/5"


@dataclass(frozen=True)
class Decoy:
    """A smooth system with a narrow feature.

    Attributes
    ----------
    name : str
    text, hidden : str
        H is ``text + hidden``; the feature is ``hidden``, or in the forces.
    focus : tuple of (str, float)
        Expressions, and the distance from their zeros within which the feature lies, in units of
        which it is resolved.
    z0 : tuple of float
    span : (float, float)
    q, p : str
        Names, separated by blanks.
    parameters, forces : mapping
    tols : tuple of float
    """

    name: str
    text: str
    hidden: str
    focus: tuple[tuple[str, float], ...]
    z0: tuple[float, ...] = (1.0, 0.0)
    span: tuple[float, float] = (0.0, 10.0)
    q: str = "x"
    p: str = "p"
    parameters: Mapping[str, float] = field(default_factory=dict)
    forces: Mapping[str, str] = field(default_factory=dict)
    tols: tuple[float, ...] = (1e-4, 1e-6, 1e-9)

    @property
    def formula(self) -> str:
        return self.text + self.hidden

    @property
    def fingerprint(self) -> str:
        """Digest of everything that determines the truth."""
        parts = (self.formula, self.q, self.p, self.z0, self.span)
        parts = (*parts, dict(self.parameters), dict(self.forces))
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def _pulse(name: str, hidden: str, at: str, width: float, **more: object) -> Decoy:
    """Return an oscillator with a feature at a time."""
    given = {"text": _OSCILLATOR, "focus": ((f"t-{at}", width),), **more}
    return Decoy(name=name, hidden=hidden, **given)  # type: ignore[arg-type]


def _needle(name: str, hidden: str, at: str, width: float, **more: object) -> Decoy:
    """Return an oscillator with a feature at a place."""
    given = {"text": _OSCILLATOR, "focus": ((at, width),), **more}
    return Decoy(name=name, hidden=hidden, **given)  # type: ignore[arg-type]


def _plane(name: str, hidden: str, at: str, width: float, **more: object) -> Decoy:
    """Return two degrees of freedom with a feature on a curve."""
    given = {"text": _PLANE, "q": "x y", "p": "px py", "z0": (1.0, 0.3, 0.0, 0.4)}
    given |= {"focus": ((at, width),), **more}
    return Decoy(name=name, hidden=hidden, **given)  # type: ignore[arg-type]


_FERMI = "1/(1+1e-17*exp(1e6*(t-3.37)))-1/(1+2e-17*exp(1e6*(t-3.37)))"

DECOYS: tuple[Decoy, ...] = (
    # -- pulses in time --------------------------------------------------------------------------
    _pulse("gauss_1e-5", "-x*1e4*exp(-((t-3.37)/1e-5)**2)", "3.37", 1e-5),
    _pulse("gauss_1e-12", "-x*1e12*exp(-((t-3.37)/1e-12)**2)", "3.37", 1e-12),
    _pulse("gauss_quartic", "-x*1e7*exp(-((t-6.283)/1e-7)**4)", "6.283", 1e-7),
    _pulse("sech_1e-7", "-x*5e6*sech((t-4.123)/1e-7)", "4.123", 1e-7),
    _pulse("lorentz_1e-9", "-x*3e-10/((t-2.71)**2+1e-18)", "2.71", 1e-9),
    _pulse("algebraic", "-x*4e-12/((t-8.3)**2+4e-12)**(3/2)", "8.3", 2e-6),
    _pulse(
        "erf_pair",
        "-x*2e5*(erf((t-5.5)/1e-7)-erf((t-5.500002)/1e-7))",
        "5.5",
        1e-7,
        focus=(("t-5.5", 1e-7), ("t-5.500002", 1e-7)),
    ),
    _needle("high_power", "-x*1e5/(1+1e9*sin(t-1.1)**2)**30", "sin(t-1.1)", 6e-6),
    _needle("deep_cosine", "-x*1e5*exp(1e12*(cos(t/8-0.4)-1))", "sin(t/8-0.4)", 1e-6),
    _pulse("frequency_pulse", "+x**2*5e7*exp(-((t-6.1)/1e-8)**2)", "6.1", 1e-8),
    _pulse("displacement", "+p*5e5*exp(-((t-7.7)/1e-6)**2)", "7.7", 1e-6),
    _pulse("at_an_edge", "-x*6e9*exp(-((t-5)/1e-10)**2)", "5", 1e-10),
    _pulse("at_another_edge", "-x*6e9*exp(-((t-1.25)/1e-10)**2)", "1.25", 1e-10),
    _pulse("near_the_start", "-x*5e7*exp(-((t-3e-7)/1e-8)**2)", "3e-7", 1e-8),
    _pulse("near_the_end", "-x*5e5*exp(-((t-9.9999)/1e-6)**2)", "9.9999", 1e-6),
    _pulse("backwards", "-x*5e5*exp(-((t-3.37)/1e-6)**2)", "3.37", 1e-6, span=(9.0, -1.0)),
    _pulse("late", "-x*5e5*exp(-((t-1000003.3)/1e-6)**2)", "1000003.3", 1e-6, span=(1e6, 1e6 + 10)),
    _pulse(
        "opposite_pair",
        "-x*1e8*(exp(-((t-3.1)/1e-8)**2)-exp(-((t-3.6)/1e-8)**2))",
        "3.1",
        1e-8,
        focus=(("t-3.1", 1e-8), ("t-3.6", 1e-8)),
    ),
    _pulse("doublet", "-x*1e10*((t-2.6)/1e-5)*exp(-((t-2.6)/1e-5)**2)", "2.6", 1e-5),
    _pulse(
        "gaussian_of_sine", "-x*1e5*exp(-1e11*sin(t-4)**2)", "4", 3e-6, focus=(("sin(t-4)", 3e-6),)
    ),
    _pulse(
        "on_a_broad_one",
        "-x*(exp(-(t-5)**2)+1e6*exp(-((t-5.2)/5e-7)**2))",
        "5.2",
        5e-7,
    ),
    _pulse(
        "pendulum_pulse",
        "-sin(x)*1e6*exp(-((t-3.37)/1e-6)**2)",
        "3.37",
        1e-6,
        text="p**2/2-cos(x)",
    ),
    _pulse(
        "clock_runs_ahead",
        "+(p**2/2+x**2/2+x**4/4)*1e8*exp(-((t-3.3)/1e-8)**2)",
        "3.3",
        1e-8,
        text="p**2/2+x**2/2+x**4/4",
    ),
    # -- pulses away from the zeros of their argument --------------------------------------------
    _pulse("fugacity", f"-x*1e6*({_FERMI})", "3.370039", 1e-6),
    _pulse("gumbel", "-x*3e7*exp(1e7*(t-4.4)+20-exp(1e7*(t-4.4)+20))", "4.399998", 1e-7),
    _pulse(
        "gumbel_pair",
        "-x*1e7*(exp(-exp(1e7*(t-4.4)+5))-exp(-exp(1e7*(t-4.4)+6)))",
        "4.39999945",
        1e-7,
    ),
    _pulse("one_minus_tanh", "-x*5e5*(1-tanh(1e6*(t-2.3)-12)**2)", "2.300012", 1e-6),
    _pulse(
        "product_of_steps", "-x*1e6*(1+tanh(1e6*(t-7)+9))*(1-tanh(1e6*(t-7)+7))/2", "6.999992", 1e-6
    ),
    _pulse(
        "product_of_fermis",
        "-x*4e6/((1+1e-9*exp(1e6*(t-2.2)))*(1+1e9*exp(-1e6*(t-2.2))))",
        "2.200020723",
        1e-6,
    ),
    _pulse(
        "log_of_pulse", "-x*1e4*log(1+1e20*exp(-((t-3.9)/1e-6)**2))", "3.9", 7e-7, tols=(1e-4, 1e-6)
    ),
    _pulse(
        "arctangents",
        "-x*2e5*(atan(1e6*(t-5.7)+40)-atan(1e6*(t-5.7)+39))",
        "5.6999605",
        1e-6,
    ),
    _pulse(
        "second_difference",
        "-x*3e8*(sqrt((t-4.50001)**2+1e-10)+sqrt((t-4.49999)**2+1e-10)-2*sqrt((t-4.5)**2+1e-10))",
        "4.5",
        1e-5,
        tols=(1e-4, 1e-6),
    ),
    # -- one pulse of a train --------------------------------------------------------------------
    _pulse(
        "train",
        "-x*4e4*exp(-1e4*(1-cos(2000*pi*t))-((t-3.37)/3e-4)**2)",
        "3.37",
        1e-6,
        focus=tuple((f"t-3.3{k}", 2e-6) for k in (68, 69, 7, 71, 72)),
    ),
    _pulse(
        "train_of_tanh",
        "-x*1e6*exp(-1e6*(1-cos(200*pi*t)))*(1-tanh(1e3*(t-3.13))**2)",
        "3.13",
        1e-6,
        focus=tuple((f"t-3.{k}", 2e-6) for k in (12, 13, 14)),
    ),
    _pulse(
        "coincidence",
        "-x*3e4*exp(-1e6*(2-cos(20*pi*t)-cos(20*pi*(t-3.3)/1.013)))",
        "3.3",
        1e-5,
        focus=(("t-3.3", 1e-5),),
    ),
    # -- nested, and with parameters -------------------------------------------------------------
    _needle("nested", "-x*3e5*exp(-1e12*(exp(sin(t))-2)**2)", "exp(sin(t))-2", 1e-6),
    _pulse(
        "parameters",
        "-x*k*exp(-((t-a)/w)**2)",
        "3.37",
        1e-8,
        parameters={"k": 7e7, "a": 3.37, "w": 1e-8},
        focus=(("t-a", 1e-8),),
    ),
    _pulse(
        "parameters_nested",
        "-x*k*exp(-((sqrt(t+a)-b)/w)**2)",
        "0",
        1e-7,
        parameters={"k": 3e6, "a": 2.0, "b": 2.31, "w": 1e-7},
        focus=(("sqrt(t+a)-b", 1e-7),),
    ),
    # -- needles in space ------------------------------------------------------------------------
    _needle("barrier", "+3*exp(-((x-0.3)/1e-6)**2)", "x-0.3", 1e-6),
    _needle("lorentz_barrier", "+5/(1+((x-0.3)/1e-8)**2)", "x-0.3", 1e-8),
    _needle("step_of_potential", "+0.1*tanh(1e7*(x-0.3))", "x-0.3", 1e-7),
    _needle(
        "steps_that_cancel",
        "+0.15*(tanh(1e7*(x-0.3))-tanh(1e7*(x-0.1)))",
        "x-0.3",
        1e-7,
        focus=(("x-0.3", 1e-7), ("x-0.1", 1e-7)),
    ),
    _needle("barrier_in_momentum", "+4*exp(-((p+0.3)/1e-6)**2)", "p+0.3", 1e-6),
    _needle("moving_barrier", "+4*exp(-((x-t/10)/1e-7)**2)", "x-t/10", 1e-7),
    _needle(
        "barrier_of_a_lattice",
        "+4*exp(-1e10*(1-cos(x-1)))",
        "sin((x-1)/2)",
        1e-5,
        text="p**2/2-cos(x)",
        z0=(2.0, 0.3),
    ),
    _needle("barrier_quartic", "+3*exp(-((x+0.21)/1e-7)**4)", "x+0.21", 1e-7, text="p**2/2+x**4/4"),
    _needle("barrier_of_a_square", "+3*exp(-((x**2-0.17)/1e-7)**2)", "x**2-0.17", 1e-7),
    _plane("oblique_barrier", "+3*exp(-((x+1000*y-5)/1e-4)**2)", "x+1000*y-5", 1e-4),
    _plane("curved_barrier", "+3*exp(-((x**2-y-0.2)/1e-6)**2)", "x**2-y-0.2", 1e-6),
    _plane(
        "turn_of_the_plane",
        "+(x*py-y*px)*5e6*exp(-((t-3.3)/1e-7)**2)",
        "t-3.3",
        1e-7,
        text="(px**2+py**2)/2+(x**2+y**2)/2+(x**2+y**2)**2/10",
    ),
    _plane(
        "kepler_kick",
        "-(x+2*y)*2e5*exp(-((t-3.3)/1e-6)**2)",
        "t-3.3",
        1e-6,
        text="(px**2+py**2)/2-1/sqrt(x**2+y**2)",
        z0=(1.0, 0.0, 0.0, 1.1),
    ),
    # -- forces ----------------------------------------------------------------------------------
    _pulse("force", "", "3.37", 1e-6, forces={"p": "4e5*exp(-((t-3.37)/1e-6)**2)"}),
    _pulse("pulse_of_friction", "", "3.37", 1e-6, forces={"p": "-4e5*p*exp(-((t-3.37)/1e-6)**2)"}),
    _needle("sheet_of_friction", "", "x-0.3", 1e-7, forces={"p": "-1e6*p*exp(-((x-0.3)/1e-7)**2)"}),
    _plane("sheet_of_force", "", "x-0.3", 1e-7, forces={"py": "2e6*exp(-((x-0.3)/1e-7)**2)"}),
    _pulse(
        "fugacity_force",
        "",
        "3.370039",
        1e-6,
        forces={"p": f"1e6*({_FERMI})"},
    ),
)


# -- truth ---------------------------------------------------------------------------------------


def _end(decoy: Decoy, *, order: int, digits: float, width: float, hidden: bool = True) -> Orbit:
    """Integrate Taylor series, with steps of at most this many widths at the feature."""
    # Beside the middle too, so that no step ends inside a feature that its start does not show.
    focus = [(f"({one})+({k * size})", width * size) for one, size in decoy.focus for k in _BESIDE]
    equations = Equations(
        decoy.formula if hidden else decoy.text,
        decoy.q.split(),
        decoy.p.split(),
        decoy.parameters,
        focus=focus if hidden else (),
        forces=decoy.forces if hidden else {},
    )
    start, end = decoy.span
    return integrate(equations, decoy.z0, start, [end], order=order, bits=192, digits=digits)


def make(decoy: Decoy) -> dict:
    """Return the end, its accuracy relative to the sizes, and what the feature changes."""
    orbit = _end(decoy, order=24, digits=18, width=1.0)
    other = _end(decoy, order=30, digits=22, width=0.6)
    smooth = _end(decoy, order=24, digits=15, width=1.0, hidden=False)
    z, again, without = (
        np.array([float(value) for value in one.states[-1]]) for one in (orbit, other, smooth)
    )
    sizes = np.array(orbit.scales)
    return {
        "of": decoy.fingerprint,
        "z": z.tolist(),
        "sizes": orbit.scales,
        "accuracy": float((np.abs(again - z) / sizes).max()),
        "change": float((np.abs(without - z) / sizes).max()),
    }


def truths() -> dict[str, dict]:
    """Read the end states."""
    stored: dict[str, dict] = json.loads(FILE.read_text()) if FILE.exists() else {}
    return stored


def _main(names: list[str]) -> None:
    known = truths()
    for decoy in DECOYS:
        old = known.get(decoy.name, {}).get("of")
        if (names and decoy.name not in names) or (not names and old == decoy.fingerprint):
            continue
        began = time.time()
        known[decoy.name] = row = make(decoy)
        seconds = time.time() - began
        print(
            f"{decoy.name:24} {row['accuracy']:8.1e} {row['change']:8.1e} {seconds:6.1f} s",
            flush=True,
        )
        ordered = {one.name: known[one.name] for one in DECOYS if one.name in known}
        lines = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in ordered.items())
        FILE.write_text("{\n" + lines + "\n}\n")


if __name__ == "__main__":
    _main(sys.argv[1:])
