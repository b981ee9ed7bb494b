"""Systems of the audit: formulas, starts and spans, each with one kind of difficulty.

References are in ``references.json``, made by ``make_references.py``.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

EVERY = (1e-4, 1e-8, 1e-11)

_CHAOS = r"round-off|chao|grow|lost|carried|needs"
_END = r"singular|domain|blow|escape|infinit|finite|too short|jump|steep"


@dataclass(frozen=True)
class System:
    """One row of the audit.

    Attributes
    ----------
    name, kind : str
        ``kind`` is the class of difficulty.
    text : str
    q, p : str
        Names of coordinates and momenta, separated by blanks.
    z0 : tuple of float
        In the order of q, then p.
    span : (float, float)
    parameters : mapping
    tols : tuple of float
        Tolerances of the solves.
    fast : tuple of float
        Tolerances of the tests that are not marked slow.
    must_succeed, must_refuse : tuple of float
        Tolerances at which success is required, and at which it is impossible.
    word : str
        Regular expression that matches the message of a refusal.
    reference : str
        "taylor", the name of an exact solution in ``make_references.py``, or "none".
    until : float, optional
        End of the reference, if it is before the end of the span.
    smooth, switches : str
        For the reference: H with signs s1, s2, ... instead of non-smooth functions, and the
        expressions that have these signs, separated by semicolons.
    focus : tuple of (str, float)
        For the reference: expressions, and the width around their zeros within which H changes.
    zero : tuple of str
        Components that are zero or round-off on the trajectory, judged by the floor of 1e-8 of
        the largest of their half instead of by their own scale.
    """

    name: str
    kind: str
    text: str
    q: str
    p: str
    z0: tuple[float, ...]
    span: tuple[float, float]
    parameters: Mapping[str, float] = field(default_factory=dict)
    tols: tuple[float, ...] = EVERY
    fast: tuple[float, ...] = ()
    must_succeed: tuple[float, ...] = ()
    must_refuse: tuple[float, ...] = ()
    word: str = ""
    reference: str = "taylor"
    until: float | None = None
    smooth: str = ""
    switches: str = ""
    focus: tuple[tuple[str, float], ...] = ()
    zero: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.q.split(), *self.p.split())

    @property
    def fingerprint(self) -> str:
        """Digest of everything that determines the reference."""
        parts = (self.smooth or self.text, self.q, self.p, self.z0, self.span, self.until)
        more = (dict(self.parameters), self.switches, self.reference)
        return hashlib.sha256(repr((parts, more)).encode()).hexdigest()[:16]

    @property
    def start(self) -> dict[str, float]:
        return dict(zip(self.names, self.z0, strict=True))


_HENON = "(px**2+py**2)/2+(x**2+y**2)/2+x**2*y-y**3/3"
_DOUBLE = "(p1**2+2*p2**2-2*p1*p2*cos(q1-q2))/(2*(1+sin(q1-q2)**2))-2*cos(q1)-cos(q2)"
_RESTRICTED = "(px**2+py**2)/2+y*px-x*py-(1-mu)/sqrt((x+mu)**2+y**2)-mu/sqrt((x-1+mu)**2+y**2)"
_KEPLER = "(px**2+py**2)/2-1/sqrt(x**2+y**2)"
_SUN = {"G": 6.674e-11, "M": 1.989e30, "m": 5.972e24}


def _bodies(masses: tuple[str, ...], gravity: str = "1") -> str:
    """H of gravitating bodies in a plane, with coordinates x1, y1, x2, ..."""
    count = len(masses)
    kinetic = [f"(px{k + 1}**2+py{k + 1}**2)/(2*({masses[k]}))" for k in range(count)]
    potential = [
        f"({gravity})*({masses[i]})*({masses[k]})"
        f"/sqrt((x{i + 1}-x{k + 1})**2+(y{i + 1}-y{k + 1})**2)"
        for i in range(count)
        for k in range(i)
    ]
    return "+".join(kinetic) + "-" + "-".join(potential)


def _planar(count: int) -> tuple[str, str]:
    q = " ".join(f"x{k + 1} y{k + 1}" for k in range(count))
    return q, " ".join(f"p{name}" for name in q.split())


def _numbered(letter: str, count: int) -> str:
    return " ".join(f"{letter}{k + 1}" for k in range(count))


def _chain(count: int, bond: str) -> str:
    """H of a chain with fixed ends; ``bond`` is a function of the stretch d."""
    sites = ["0", *(f"q{k + 1}" for k in range(count)), "0"]
    kinetic = "+".join(f"p{k + 1}**2/2" for k in range(count))
    bonds = (bond.replace("d", f"({b}-{a})") for a, b in pairwise(sites))
    return kinetic + "+" + "+".join(bonds)


def _ring(count: int) -> str:
    kinetic = "+".join(f"p{k + 1}**2/2" for k in range(count))
    bonds = (f"exp(q{k + 1}-q{(k + 1) % count + 1})" for k in range(count))
    return kinetic + "+" + "+".join(bonds)


def _network(count: int) -> str:
    """H of linear oscillators with all-to-all coupling."""
    own = "+".join(f"p{k + 1}**2/2+{k + 2}*q{k + 1}**2/2" for k in range(count))
    coupling = "+".join(
        f"(q{i + 1}-q{k + 1})**2/{4 + i + 2 * k}" for i in range(count) for k in range(i)
    )
    return own + "+" + coupling


def _waves(count: int, size: float) -> tuple[float, ...]:
    """Start at rest with two modes of a chain."""
    q = (
        size * (math.sin(math.pi * (k + 1) / (count + 1)) + math.cos(1.7 * k) / 3)
        for k in range(count)
    )
    return (*q, *(0.0,) * count)


_PLANETS = ("1", "9.5e-4", "2.9e-4")

SYSTEMS: tuple[System, ...] = (
    # -- chaos -----------------------------------------------------------------------------------
    System(
        name="henon_heiles_8000",
        kind="chaos",
        text=_HENON,
        q="x y",
        p="px py",
        z0=(0.0, -0.15, 0.5555, 0.0),
        span=(0.0, 8000.0),
        tols=(1e-4, 1e-6, 1e-8, 1e-11),
        must_refuse=(1e-4, 1e-6, 1e-8, 1e-11),
        word=_CHAOS,
        until=250.0,
    ),
    System(
        name="henon_heiles_regular",
        kind="chaos",
        text=_HENON,
        q="x y",
        p="px py",
        z0=(0.0, 0.1, 0.35, 0.1),
        span=(0.0, 100.0),
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="henon_heiles_300",
        kind="chaos",
        text=_HENON,
        q="x y",
        p="px py",
        z0=(0.0, -0.15, 0.5555, 0.0),
        span=(0.0, 300.0),
        tols=(1e-4, 1e-11),
        fast=(1e-11,),
        must_refuse=(1e-4, 1e-11),
        word=_CHAOS,
        until=250.0,
    ),
    System(
        name="double_pendulum_short",
        kind="chaos",
        text=_DOUBLE,
        q="q1 q2",
        p="p1 p2",
        z0=(2.0, 2.0, 0.0, 0.0),
        span=(0.0, 8.0),
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="double_pendulum_long",
        kind="chaos",
        text=_DOUBLE,
        q="q1 q2",
        p="p1 p2",
        z0=(2.0, 2.5, 0.0, 0.0),
        span=(0.0, 1000.0),
        must_refuse=EVERY,
        word=_CHAOS,
        until=40.0,
    ),
    System(
        name="arenstorf",
        kind="chaos",
        text=_RESTRICTED,
        q="x y",
        p="px py",
        z0=(0.994, 0.0, 0.0, -1.0075851063790825),
        span=(0.0, 17.0652165601579625),
        parameters={"mu": 0.012277471},
        fast=(1e-4,),
    ),
    System(
        name="restricted_bodies_chaotic",
        kind="chaos",
        text=_RESTRICTED,
        q="x y",
        p="px py",
        z0=(0.35, 0.0, 0.0, 1.45),
        span=(0.0, 60.0),
        parameters={"mu": 0.2},
        tols=(1e-4, 1e-8, 1e-11),
    ),
    System(
        name="driven_pendulum_chaotic",
        kind="chaos",
        text="p**2/2-cos(x)-6*x*cos(2*t/3)/5",
        q="x",
        p="p",
        z0=(0.2, 0.0),
        span=(0.0, 400.0),
        tols=(1e-8, 1e-11),
        must_refuse=(1e-11,),
        word=_CHAOS,
        until=120.0,
    ),
    System(
        name="yang_mills",
        kind="chaos",
        text="(px**2+py**2)/2+x**2*y**2/2",
        q="x y",
        p="px py",
        z0=(1.0, 0.4, 0.3, 0.9),
        span=(0.0, 60.0),
        fast=(1e-8,),
    ),
    # -- SI units in mixed coordinates -----------------------------------------------------------
    System(
        name="kepler_si_polar",
        kind="units",
        text="p_r**2/(2*m)+p_phi**2/(2*m*r**2)-G*M*m/r",
        q="r phi",
        p="p_r p_phi",
        z0=(1.471e11, 0.0, 0.0, 5.972e24 * 1.471e11 * 3.029e4),
        span=(0.0, 3.15576e9),
        fast=(1e-6,),
        parameters=_SUN,
        tols=(1e-4, 1e-6, 1e-8, 1e-11),
        must_succeed=(1e-4, 1e-6, 1e-8),
    ),
    System(
        name="kepler_si_polar_eccentric",
        kind="units",
        text="p_r**2/(2*m)+p_phi**2/(2*m*r**2)-G*M*m/r",
        q="r phi",
        p="p_r p_phi",
        z0=(1.471e11, 0.0, 0.0, 5.972e24 * 1.471e11 * 3.6e4),
        span=(0.0, 3.15576e9),
        parameters=_SUN,
        tols=(1e-4, 1e-6, 1e-8, 1e-9, 1e-11),
        fast=(1e-9,),
        must_succeed=(1e-4, 1e-6, 1e-8),
    ),
    System(
        name="kepler_si_polar_year",
        kind="units",
        text="p_r**2/(2*m)+p_phi**2/(2*m*r**2)-G*M*m/r",
        q="r phi",
        p="p_r p_phi",
        z0=(1.471e11, 0.0, 0.0, 5.972e24 * 1.471e11 * 3.029e4),
        span=(0.0, 3.2e7),
        parameters=_SUN,
        fast=(1e-4, 1e-8),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="kepler_si_cartesian",
        kind="units",
        text="(p_x**2+p_y**2)/(2*m)-G*M*m/sqrt(x**2+y**2)",
        q="x y",
        p="p_x p_y",
        z0=(1.471e11, 0.0, 0.0, 5.972e24 * 3.029e4),
        span=(0.0, 3.15576e8),
        parameters=_SUN,
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="satellite_si_spherical",
        kind="units",
        text="(p_r**2+p_theta**2/r**2+p_phi**2/(r**2*sin(theta)**2))/(2*m)-G*M*m/r",
        q="r theta phi",
        p="p_r p_theta p_phi",
        z0=(7e6, 1.2, 0.0, 1e3, -2e13, 4.9e13),
        span=(0.0, 86400.0),
        parameters={"G": 6.674e-11, "M": 5.972e24, "m": 1000.0},
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="earth_moon_si",
        kind="units",
        text=_bodies(("m1", "m2"), "G"),
        q=_planar(2)[0],
        p=_planar(2)[1],
        z0=(-4.67e6, 0.0, 3.797e8, 0.0, 0.0, -7.348e22 * 1022.0, 0.0, 7.348e22 * 1022.0),
        span=(0.0, 7.1e6),
        fast=(1e-8,),
        parameters={"G": 6.674e-11, "m1": 5.972e24, "m2": 7.348e22},
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="molecule_pendulum_si",
        kind="units",
        text="p_theta**2/(2*I)-D*cos(theta)",
        q="theta",
        p="p_theta",
        z0=(2.9, 0.0),
        span=(0.0, 3e-9),
        parameters={"I": 1e-40, "D": 1e-20},
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="diatomic_molecule_si",
        kind="units",
        text="p_r**2/(2*mu)+p_phi**2/(2*mu*r**2)+D*(1-exp(-a*(r-b)))**2",
        q="r phi",
        p="p_r p_phi",
        z0=(1.2e-10, 0.0, 0.0, 2.1e-33),
        span=(0.0, 1e-12),
        fast=(1e-8,),
        parameters={"mu": 1.14e-26, "D": 1.8e-18, "a": 2.3e10, "b": 1.128e-10},
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="paul_trap_si",
        kind="units",
        text="(p_x**2+p_y**2)/(2*m)+e*(U+V*cos(w*t))*(x**2-y**2)/(2*d**2)",
        q="x y",
        p="p_x p_y",
        z0=(1e-5, 2e-5, 0.0, 1e-25),
        span=(0.0, 1e-5),
        parameters={"m": 6.64e-26, "e": 1.602e-19, "d": 1e-3, "U": 1.0, "V": 200.0, "w": 6.28e7},
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="cyclotron_si",
        kind="units",
        text="((p_x+e*B*y/2)**2+(p_y-e*B*x/2)**2)/(2*m)",
        q="x y",
        p="p_x p_y",
        z0=(1e-5, 0.0, 0.0, 9.109e-25),
        span=(0.0, 1e-9),
        fast=(1e-8,),
        parameters={"m": 9.109e-31, "e": 1.602e-19, "B": 1.0},
        reference="linear",
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="circuit_si",
        kind="units",
        text="q**2/(2*C)+p**2/(2*L)+b*q**4",
        q="q",
        p="p",
        z0=(1e-6, 0.0),
        span=(0.0, 2e-4),
        parameters={"C": 1e-9, "L": 1e-3, "b": 2e20},
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="twenty_powers_of_ten",
        kind="units",
        text="(px**2+py**2)/2+x**2/2+y**2/2+1e20*y**4/4",
        q="x y",
        p="px py",
        z0=(1e10, 1e-10, 0.0, 0.0),
        span=(0.0, 20.0),
        fast=(1e-4, 1e-8),
    ),
    System(
        name="angle_and_length_far_apart",
        kind="units",
        text="px**2/2+5e17*(1-cos(phi))+p_phi**2/2e17+x**2/2+1e4*x*sin(phi)",
        q="x phi",
        p="px p_phi",
        z0=(1e9, 0.3, 0.0, 0.0),
        span=(0.0, 30.0),
    ),
    # -- narrow features in t and q --------------------------------------------------------------
    System(
        name="tanh_step",
        kind="narrow",
        text="p**2/2+x**2/2+tanh(1000*(x-1/3))/20",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 20.0),
        focus=(("x-1/3", 1e-3),),
        fast=(1e-4,),
    ),
    System(
        name="erf_step",
        kind="narrow",
        text="p**2/2+erf(2000*(x-0.77))/10",
        q="x",
        p="p",
        z0=(-10.0, 1.0),
        span=(0.0, 20.0),
        fast=(1e-8,),
        focus=(("x-0.77", 5e-4),),
    ),
    System(
        name="scatterer_after_flight",
        kind="narrow",
        text="(px**2+py**2)/2+exp(-(x-5000)**2-y**2)*3/10",
        q="x y",
        p="px py",
        z0=(0.0, 0.3, 1.0, 0.0),
        span=(0.0, 5010.0),
        fast=(1e-6,),
        tols=(1e-4, 1e-6, 1e-8, 1e-11),
        focus=(("x-5000", 1.0),),
    ),
    System(
        name="scatterer_after_flight_1e-3",
        kind="narrow",
        text="(px**2+py**2)/2+exp(-1e6*((x-5)**2+y**2))*3/10",
        q="x y",
        p="px py",
        z0=(0.0, 3e-4, 1.0, 0.0),
        span=(0.0, 9.0),
        focus=(("x-5", 1e-3),),
    ),
    System(
        name="scatterer_after_flight_0.1",
        kind="narrow",
        text="(px**2+py**2)/2+exp(-100*((x-5000)**2+y**2))/2",
        q="x y",
        p="px py",
        z0=(0.0, 0.05, 1.0, 0.0),
        span=(0.0, 5010.0),
        tols=(1e-4, 1e-6, 1e-8, 1e-11),
        fast=(1e-6,),
        focus=(("x-5000", 0.1),),
    ),
    System(
        name="gaussian_kick",
        kind="narrow",
        text="p**2/2+x*exp(-1e6*(t-3.37)**2)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        reference="gaussian_kick",
        focus=(("t-3.37", 1e-3),),
        fast=(1e-4, 1e-8),
    ),
    System(
        name="gaussian_kick_1e10",
        kind="narrow",
        text="p**2/2+x**2/2+20*x*exp(-1e10*(t-6.789)**2)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        focus=(("t-6.789", 1e-5),),
        fast=(1e-4,),
    ),
    System(
        name="two_kicks",
        kind="narrow",
        text="p**2/2-cos(x)+x*exp(-1e4*(t-2.1)**2)-x*exp(-1e6*(t-8.03)**2)/2",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 12.0),
        fast=(1e-8,),
        focus=(("t-2.1", 1e-2), ("t-8.03", 1e-3)),
    ),
    System(
        name="erf_in_time",
        kind="narrow",
        text="p**2/2+x**2/2+x*erf(500*(t-4.1))/10",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 20.0),
        focus=(("t-4.1", 1e-3),),
    ),
    System(
        name="tanh_in_time",
        kind="narrow",
        text="p**2/2+x**2*(3+tanh(1e4*(t-7.77)))/4",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 20.0),
        focus=(("t-7.77", 1e-4),),
        fast=(1e-8,),
    ),
    System(
        name="sech_pulse",
        kind="narrow",
        text="p**2/2+x**2/2+x*sech(800*(t-2.345))",
        q="x",
        p="p",
        z0=(1.0, 0.5),
        span=(0.0, 12.0),
        fast=(1e-8,),
        focus=(("t-2.345", 1e-3),),
    ),
    System(
        name="lorentzian_in_x",
        kind="narrow",
        text="p**2/2+x**2/2+5e-8/((x-0.5)**2+1e-6)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 20.0),
        focus=(("x-0.5", 1e-3),),
    ),
    System(
        name="pulse_train",
        kind="narrow",
        text="p**2/2+x**2/2+x*exp(-1e4*sin(t)**2)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.5, 20.0),
        focus=(("sin(t)", 1e-2),),
    ),
    System(
        name="moving_bump",
        kind="narrow",
        text="p**2/2+exp(-400*(x+5*t-100)**2)/20",
        q="x",
        p="p",
        z0=(0.0, 0.5),
        span=(0.0, 40.0),
        fast=(1e-8,),
        focus=(("x+5*t-100", 5e-2),),
    ),
    System(
        name="gaussian_well_bound",
        kind="narrow",
        text="(px**2+py**2)/2+(x**2+2*y**2)/2-exp(-1e4*((x-0.31)**2+(y-0.05)**2))/50",
        q="x y",
        p="px py",
        z0=(1.0, 0.1, 0.0, 0.2),
        span=(0.0, 25.0),
        focus=(("(x-0.31)**2+(y-0.05)**2", 1e-4),),
    ),
    # -- hidden kinks ----------------------------------------------------------------------------
    System(
        name="kink_quartic_root",
        kind="kink",
        text="p**2/2+sqrt(x**4-2*x**2+1)",
        q="x",
        p="p",
        z0=(2.0, 0.0),
        span=(0.0, 10.0),
        smooth="p**2/2+s1*(x**2-1)",
        switches="x**2-1",
        fast=(1e-4, 1e-8),
    ),
    System(
        name="kink_quartic_root_met",
        kind="kink",
        text="p**2/2+sqrt(x**4-2*x**2+1)",
        q="x",
        p="p",
        z0=(1.5, 0.0),
        span=(0.0, 20.0),
        tols=(1e-3, 1e-5),
        fast=(1e-3,),
        smooth="p**2/2+s1*(x**2-1)",
        switches="x**2-1",
    ),
    System(
        name="kink_quartic_root_quartic",
        kind="kink",
        text="(px**2+py**2)/2+sqrt(x**4-2*x**2+1)+x*y/2+y**4/4",
        q="x y",
        p="px py",
        z0=(1.5, 0.0, 0.0, 0.0),
        span=(0.0, 10.0),
        tols=(1e-2, 1e-4),
        fast=(1e-2,),
        smooth="(px**2+py**2)/2+s1*(x**2-1)+x*y/2+y**4/4",
        switches="x**2-1",
    ),
    System(
        name="kink_quartic_root_plane",
        kind="kink",
        text="(px**2+py**2)/2+sqrt(x**4-2*x**2+1)+y**2/2+x*y/10",
        q="x y",
        p="px py",
        z0=(2.0, 0.3, 0.0, 0.1),
        span=(0.0, 10.0),
        fast=(1e-4,),
        smooth="(px**2+py**2)/2+s1*(x**2-1)+y**2/2+x*y/10",
        switches="x**2-1",
    ),
    System(
        name="kink_root_of_square",
        kind="kink",
        text="p**2/2+sqrt((x-1)**2)",
        q="x",
        p="p",
        z0=(3.0, 0.0),
        span=(0.0, 10.0),
        smooth="p**2/2+s1*(x-1)",
        switches="x-1",
        reference="parabolas",
    ),
    System(
        name="kink_expanded_square",
        kind="kink",
        text="p**2/2+sqrt(x**2-2*x+1)",
        q="x",
        p="p",
        z0=(3.0, 0.0),
        span=(0.0, 10.0),
        smooth="p**2/2+s1*(x-1)",
        switches="x-1",
        reference="parabolas",
        fast=(1e-8,),
    ),
    System(
        name="kink_abs",
        kind="kink",
        text="p**2/2+abs(x-1)",
        q="x",
        p="p",
        z0=(3.0, 0.0),
        span=(0.0, 10.0),
        smooth="p**2/2+s1*(x-1)",
        switches="x-1",
        reference="parabolas",
    ),
    System(
        name="kink_two_planes",
        kind="kink",
        text="(px**2+py**2)/2+sqrt((x-y)**2)+sqrt(x**2+2*x*y+y**2+0)/3+x/7",
        q="x y",
        p="px py",
        z0=(1.0, 0.25, 0.1, 0.3),
        span=(0.0, 6.0),
        smooth="(px**2+py**2)/2+s1*(x-y)+s2*(x+y)/3+x/7",
        switches="x-y;x+y",
    ),
    System(
        name="kink_half_oscillators",
        kind="kink",
        text="p**2/2+max(x,0)**2+x**2/2",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 20.0),
        smooth="p**2/2+(1+s1)/2*x**2+x**2/2",
        switches="x",
    ),
    System(
        name="kink_in_time",
        kind="kink",
        text="p**2/2+x**2/2+x*sqrt(t**2-6.6*t+10.89)/10",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        smooth="p**2/2+x**2/2+x*s1*(t-3.3)/10",
        switches="t-3.3",
    ),
    System(
        name="cone_passed_closely",
        kind="kink",
        text="(px**2+py**2)/2+sqrt(x**2+y**2)",
        q="x y",
        p="px py",
        z0=(1.0, 0.0, 0.0, 1e-4),
        span=(0.0, 8.0),
        fast=(1e-4,),
    ),
    System(
        name="cone_through_apex",
        kind="kink",
        text="(px**2+py**2)/2+sqrt(x**2+y**2)",
        q="x y",
        p="px py",
        z0=(1.0, 0.0, 0.0, 0.0),
        span=(0.0, 8.0),
        fast=(1e-8,),
        smooth="(px**2+py**2)/2+s1*x",
        switches="x",
        zero=("y", "py"),
    ),
    System(
        name="rounded_abs_1e-10",
        kind="kink",
        text="p**2/2+sqrt(x**2+1e-20)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        fast=(1e-8,),
        focus=(("x", 1e-10),),
    ),
    System(
        name="rounded_abs_1e-3",
        kind="kink",
        text="p**2/2+sqrt(x**2+1e-6)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        focus=(("x", 1e-3),),
        must_succeed=(1e-4, 1e-8),
    ),
    # -- near a separatrix -----------------------------------------------------------------------
    System(
        name="pendulum_almost_up",
        kind="separatrix",
        text="p**2/2-cos(x)",
        q="x",
        p="p",
        z0=(math.pi - 1e-6, 0.0),
        span=(0.0, 60.0),
        fast=(1e-4,),
    ),
    System(
        name="pendulum_nearly_up",
        kind="separatrix",
        text="p**2/2-cos(x)",
        q="x",
        p="p",
        z0=(math.pi - 1e-3, 0.0),
        span=(0.0, 30.0),
        fast=(1e-4,),
        reference="pendulum",
        must_succeed=(1e-4,),
    ),
    System(
        name="pendulum_stands",
        kind="separatrix",
        text="p**2/2-cos(x)",
        q="x",
        p="p",
        z0=(math.pi, 0.0),
        span=(0.0, 20.0),
    ),
    System(
        name="pendulum_on_separatrix",
        kind="separatrix",
        text="p**2/2-cos(x)",
        q="x",
        p="p",
        z0=(0.0, 2.0),
        span=(0.0, 20.0),
        fast=(1e-8,),
    ),
    System(
        name="duffing_saddle",
        kind="separatrix",
        text="p**2/2-x**2/2+x**4/4",
        q="x",
        p="p",
        z0=(1e-6, 0.0),
        span=(0.0, 40.0),
        must_succeed=(1e-4,),
    ),
    System(
        name="double_well_over_barrier",
        kind="separatrix",
        text="p**2/2+(x**2-1)**2/4",
        q="x",
        p="p",
        z0=(0.0, 1e-5),
        span=(0.0, 50.0),
        fast=(1e-4,),
        must_succeed=(1e-4,),
    ),
    System(
        name="saddle_plane",
        kind="separatrix",
        text="(px**2+py**2)/2+(x**2-1)**2/4+y**2*(1+x)/2",
        q="x y",
        p="px py",
        z0=(1e-7, 0.2, 0.0, 0.0),
        span=(0.0, 30.0),
    ),
    # -- close encounters ------------------------------------------------------------------------
    System(
        name="kepler_0.9",
        kind="encounter",
        text=_KEPLER,
        q="x y",
        p="px py",
        z0=(0.1, 0.0, 0.0, math.sqrt(19.0)),
        span=(0.0, 20.0),
        reference="kepler",
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="kepler_0.99",
        kind="encounter",
        text=_KEPLER,
        q="x y",
        p="px py",
        z0=(1.99, 0.0, 0.0, math.sqrt(0.01 / 1.99)),
        span=(0.0, 20.0),
        reference="kepler",
        must_succeed=(1e-4,),
    ),
    System(
        name="kepler_0.99_once",
        kind="encounter",
        text=_KEPLER,
        q="x y",
        p="px py",
        z0=(1.99, 0.0, 0.0, math.sqrt(0.01 / 1.99)),
        span=(0.0, 7.0),
        reference="kepler",
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="kepler_0.999",
        kind="encounter",
        text=_KEPLER,
        q="x y",
        p="px py",
        z0=(1.999, 0.0, 0.0, math.sqrt(0.001 / 1.999)),
        span=(0.0, 10.0),
        fast=(1e-4,),
        reference="kepler",
        must_succeed=(1e-4,),
    ),
    System(
        name="kepler_polar_0.95",
        kind="encounter",
        text="(p_r**2+p_phi**2/r**2)/2-1/r",
        q="r phi",
        p="p_r p_phi",
        z0=(1.95, 0.0, 0.0, 0.31),
        span=(0.0, 30.0),
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="pythagorean_10",
        kind="encounter",
        text=_bodies(("3", "4", "5")),
        q=_planar(3)[0],
        p=_planar(3)[1],
        z0=(1.0, 3.0, -2.0, -1.0, 1.0, -1.0, *(0.0,) * 6),
        span=(0.0, 10.0),
        fast=(1e-4,),
        must_succeed=(1e-4,),
    ),
    System(
        name="pythagorean_30",
        kind="encounter",
        text=_bodies(("3", "4", "5")),
        q=_planar(3)[0],
        p=_planar(3)[1],
        z0=(1.0, 3.0, -2.0, -1.0, 1.0, -1.0, *(0.0,) * 6),
        span=(0.0, 30.0),
        tols=(1e-4, 1e-8),
    ),
    System(
        name="figure_eight",
        kind="encounter",
        text=_bodies(("1", "1", "1")),
        q=_planar(3)[0],
        p=_planar(3)[1],
        z0=(
            *(0.97000436, -0.24308753, -0.97000436, 0.24308753, 0.0, 0.0),
            *(0.466203685, 0.43236573, 0.466203685, 0.43236573, -0.93240737, -0.86473146),
        ),
        span=(0.0, 19.0),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="two_centres",
        kind="encounter",
        text="(px**2+py**2)/2-1/sqrt((x-1)**2+y**2)-1/sqrt((x+1)**2+y**2)",
        q="x y",
        p="px py",
        z0=(0.1, 1.0, 0.3, -0.2),
        span=(0.0, 12.0),
        fast=(1e-8,),
    ),
    System(
        name="repelled_head_on",
        kind="encounter",
        text="(px**2+py**2)/2+1/sqrt(x**2+y**2)",
        q="x y",
        p="px py",
        z0=(500.0, 1e-3, -10.0, 0.0),
        span=(0.0, 100.0),
    ),
    # -- stiff -----------------------------------------------------------------------------------
    System(
        name="oscillator_1e4_rad",
        kind="stiff",
        text="p**2/2+x**2/2",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 1e4),
        reference="linear",
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="stiff_linear_pair",
        kind="stiff",
        text="(p1**2+p2**2)/2+q1**2/2+1e8*q2**2/2+q1*q2",
        q="q1 q2",
        p="p1 p2",
        z0=(1.0, 1e-4, 0.0, 0.5),
        span=(0.0, 1.0),
        reference="linear",
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="stiff_pair_coupled",
        kind="stiff",
        text="(p1**2+p2**2)/2+q1**2/2+1e8*q2**2/2+100*q1**2*q2",
        q="q1 q2",
        p="p1 p2",
        z0=(1.0, 1e-4, 0.0, 0.5),
        span=(0.0, 0.3),
        must_succeed=(1e-4,),
    ),
    System(
        name="stiff_spring_pendulum",
        kind="stiff",
        text="(p_r**2+p_phi**2/r**2)/2+1e6*(r-1)**2/2-r*cos(phi)",
        q="r phi",
        p="p_r p_phi",
        z0=(1.001, 1.0, 0.0, 0.0),
        span=(0.0, 1.0),
        fast=(1e-4,),
    ),
    System(
        name="linear_pair_5e3_rad",
        kind="stiff",
        text="(p1**2+p2**2)/2+q1**2/2+3*q2**2/2+q1*q2/3",
        q="q1 q2",
        p="p1 p2",
        z0=(1.0, 0.5, 0.0, 0.2),
        span=(0.0, 3000.0),
        reference="linear",
        must_succeed=(1e-4, 1e-8),
    ),
    # -- explicit time ---------------------------------------------------------------------------
    System(
        name="driven_in_resonance",
        kind="time",
        text="p**2/2+x**2/2-x*cos(t)",
        q="x",
        p="p",
        z0=(0.3, 0.0),
        span=(0.0, 60.0),
        fast=(1e-11,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="mathieu_unstable",
        kind="time",
        text="p**2/2+(1+0.4*cos(2*t))*x**2/2",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 60.0),
        fast=(1e-11,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="kapitza",
        kind="time",
        text="p**2/2-(1+100*cos(40*t))*cos(x)",
        q="x",
        p="p",
        z0=(3.0, 0.0),
        span=(0.0, 20.0),
        fast=(1e-8,),
    ),
    System(
        name="growing_frequency",
        kind="time",
        text="p**2/2+(1+t)**2*x**2/2",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 20.0),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="chirp",
        kind="time",
        text="p**2/2+x*cos(t**2)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 30.0),
        fast=(1e-8,),
        reference="chirp",
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="late_start",
        kind="time",
        text="p**2/2+x**2/2+x**4/4",
        q="x",
        p="p",
        z0=(1.0, 0.5),
        span=(1e7, 1e7 + 20.0),
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="late_start_driven",
        kind="time",
        text="p**2/2+x**2/2+x*cos(3*t)/10",
        q="x",
        p="p",
        z0=(1.0, 0.5),
        span=(1e7, 1e7 + 20.0),
        must_succeed=(1e-4,),
        fast=(1e-8,),
    ),
    System(
        name="late_start_kepler_1e12",
        kind="time",
        text=_KEPLER,
        q="x y",
        p="px py",
        z0=(0.5, 0.0, 0.0, 1.7),
        span=(1e12, 1e12 + 16.0),
        fast=(1e-4,),
    ),
    # -- 1 to 24 degrees of freedom --------------------------------------------------------------
    System(
        name="toda_ring_12",
        kind="many",
        text=_ring(12),
        q=_numbered("q", 12),
        p=_numbered("p", 12),
        z0=_waves(12, 0.5),
        span=(0.0, 10.0),
        fast=(1e-8,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="fput_24",
        kind="many",
        text=_chain(24, "d**2/2+d**3/12+d**4/20"),
        q=_numbered("q", 24),
        p=_numbered("p", 24),
        z0=_waves(24, 1.0),
        span=(0.0, 20.0),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="network_8",
        kind="many",
        text=_network(8),
        q=_numbered("q", 8),
        p=_numbered("p", 8),
        z0=_waves(8, 1.0),
        span=(0.0, 20.0),
        reference="linear",
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="sun_and_two_planets",
        kind="many",
        text=_bodies(_PLANETS, "39.478"),
        q=_planar(3)[0],
        p=_planar(3)[1],
        z0=(
            *(0.0, 0.0, 4.95, 0.0, 0.0, 9.0),
            *(5.93e-4, -2.6e-3, 0.0, 9.5e-4 * 2.76, -2.9e-4 * 2.05, 0.0),
        ),
        span=(0.0, 40.0),
    ),
    System(
        name="phi_four_6",
        kind="many",
        text=_chain(6, "d**2/2") + "".join(f"+(q{k + 1}**2-1)**2/4" for k in range(6)),
        q=_numbered("q", 6),
        p=_numbered("p", 6),
        z0=_waves(6, 1.2),
        span=(0.0, 30.0),
        fast=(1e-4,),
    ),
    # -- backwards -------------------------------------------------------------------------------
    System(
        name="pendulum_backwards",
        kind="backwards",
        text="p**2/2-cos(x)",
        q="x",
        p="p",
        z0=(2.5, 0.1),
        span=(0.0, -20.0),
        fast=(1e-11,),
        must_succeed=(1e-4, 1e-8),
    ),
    System(
        name="driven_backwards",
        kind="backwards",
        text="p**2/2+x**4/4-x*cos(2*t)",
        q="x",
        p="p",
        z0=(0.5, 0.0),
        span=(30.0, 12.5),
    ),
    System(
        name="kick_backwards",
        kind="backwards",
        text="p**2/2+x**2/2+x*exp(-1e6*(t-3.37)**2)",
        q="x",
        p="p",
        z0=(0.5, 0.0),
        span=(9.0, -1.0),
        fast=(1e-4,),
        focus=(("t-3.37", 1e-3),),
    ),
    # -- components at rest ----------------------------------------------------------------------
    System(
        name="free_particle",
        kind="rest",
        text="p**2/2",
        q="x",
        p="p",
        z0=(1.0, 0.7),
        span=(0.0, 1e6),
        fast=(1e-11,),
        must_succeed=EVERY,
    ),
    System(
        name="particle_at_rest",
        kind="rest",
        text="p**2/2",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 100.0),
        must_succeed=EVERY,
        fast=(1e-11,),
    ),
    System(
        name="equilibrium",
        kind="rest",
        text="(px**2+py**2)/2+x**2*(1+y)/2-y**2/2+y**4",
        q="x y",
        p="px py",
        z0=(0.0, 0.0, 0.0, 0.0),
        span=(0.0, 50.0),
        fast=(1e-11,),
        must_succeed=EVERY,
    ),
    System(
        name="radial_fall_no_spin",
        kind="rest",
        text="(p_r**2+p_phi**2/r**2)/2+r**2/2+r**4/4",
        q="r phi",
        p="p_r p_phi",
        z0=(1.0, 0.4, 0.0, 0.0),
        span=(0.0, 20.0),
        must_succeed=(1e-4, 1e-8),
        zero=("p_phi",),
        fast=(1e-8,),
    ),
    System(
        name="orbit_in_a_plane",
        kind="rest",
        text="(px**2+py**2+pz**2)/2-1/sqrt(x**2+y**2+z**2)",
        q="x y z",
        p="px py pz",
        z0=(1.0, 0.0, 0.0, 0.0, 1.1, 0.0),
        span=(0.0, 20.0),
        must_succeed=(1e-4, 1e-8),
        zero=("z", "pz"),
    ),
    System(
        name="on_a_singular_axis",
        kind="rest",
        text="(px**2+py**2+pz**2)/2+(x**2+y**2)**(3/2)+z**2/2",
        q="x y z",
        p="px py pz",
        z0=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        span=(0.0, 10.0),
        smooth="(px**2+py**2+pz**2)/2+z**2/2",
        zero=("x", "y", "px", "py"),
        fast=(1e-8,),
    ),
    System(
        name="dilation",
        kind="rest",
        text="x*p",
        q="x",
        p="p",
        z0=(1.0, 1.0),
        span=(0.0, 20.0),
        fast=(1e-8,),
        must_succeed=(1e-4,),
    ),
    System(
        name="stable_equilibrium",
        kind="rest",
        text="(px**2+py**2)/2+x**2/2+(y**2-1)**2/4",
        q="x y",
        p="px py",
        z0=(1.0, 1.0, 0.0, 0.0),
        span=(0.0, 20.0),
        smooth="(px**2+py**2)/2+x**2/2",
        must_succeed=EVERY,
        fast=EVERY,
    ),
    System(
        name="short_switched_pulse",
        kind="time",
        text="p**2/2+x**2/2+1e6*x*Heaviside(t-3)*Heaviside(3.00000001-t)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        tols=(1e-4,),
        smooth="p**2/2+x**2/2+1e6*x*(1+s1)*(1+s2)/4",
        switches="t-3;3.00000001-t",
        focus=(("t-3", 1e-8),),
        must_succeed=(1e-4,),
        fast=(1e-4,),
    ),
    System(
        name="angle_across_its_cut",
        kind="kink",
        text="(px**2+py**2)/2+(x**2+y**2)/2+atan2(y,x)/10",
        q="x y",
        p="px py",
        z0=(-1.0, 0.5, 0.0, -1.0),
        span=(0.0, 3.0),
        smooth="(px**2+py**2)/2+(x**2+y**2)/2-atan(y/(sqrt(x**2+y**2)-x))/5",
        must_succeed=EVERY,
        fast=(1e-8,),
    ),
    # -- singular ends and impossible accuracy ---------------------------------------------------
    System(
        name="blow_up_quartic",
        kind="end",
        text="p**2/2-x**4",
        q="x",
        p="p",
        z0=(1.0, 1.0),
        span=(0.0, 10.0),
        fast=(1e-8,),
        must_refuse=EVERY,
        word=_END,
        until=0.4,
    ),
    System(
        name="blow_up_plane",
        kind="end",
        text=_HENON,
        q="x y",
        p="px py",
        z0=(0.3, 1.2, 0.0, 0.3),
        span=(0.0, 50.0),
        fast=(1e-4,),
        must_refuse=EVERY,
        word=_END,
        until=1.0,
    ),
    System(
        name="fall_into_centre",
        kind="end",
        text="p**2/2-1/x",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 5.0),
        fast=(1e-8,),
        must_refuse=EVERY,
        word=_END,
        until=1.0,
    ),
    System(
        name="end_of_a_root",
        kind="end",
        text="p**2/2+sqrt(x)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        fast=(1e-4,),
        must_refuse=EVERY,
        word=_END,
        until=1.5,
    ),
    System(
        name="end_of_a_logarithm",
        kind="end",
        text="p**2/2+log(x)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        must_refuse=EVERY,
        word=_END,
        until=1.0,
    ),
    System(
        name="end_in_time",
        kind="end",
        text="p**2/2+x*sqrt(5-t)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        fast=(1e-8,),
        must_refuse=EVERY,
        word=_END,
        until=4.5,
    ),
    System(
        name="pole_in_time",
        kind="end",
        text="p**2/2+x/(t-3)",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.0, 10.0),
        must_refuse=EVERY,
        word=_END,
        until=2.5,
    ),
    System(
        name="square_wave",
        kind="end",
        text="p**2/2+x*sign(sin(3*t))",
        q="x",
        p="p",
        z0=(1.0, 0.0),
        span=(0.5, 10.0),
        fast=(1e-8,),
        word="breakpoints",
        smooth="p**2/2+x*s1",
        switches="sin(3*t)",
    ),
)

BY_NAME = {system.name: system for system in SYSTEMS}
assert len(BY_NAME) == len(SYSTEMS)
