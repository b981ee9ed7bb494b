"""Equations of motion as programs, with their derivatives and H, for proofs on windows."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_straight_line
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.generated import GeneratedFunctions, evaluated
from hamsym.proof.arithmetic.programs import BITS, Program, Recorder
from hamsym.symbolic.exact import rational


class Equation:
    """dz/dt = G(t, z, k), its derivatives and H as programs.

    - H: With a value for every parameter.
    - unknown: Names of parameters that are arguments k of the programs.
    - dim, columns: 2 dof, and dim plus the number of unknown parameters.
    - slopes: Derivatives of H with forces; without them ``rates``, which are those up to order and
      sign.
    - entries, signs: Rows (i, j, place): DG_ij is a sign times the result ``place`` of
      ``jacobian``.
    """

    def __init__(self, H: Hamiltonian, unknown: Sequence[str] = ()) -> None:
        H.require_parameters()
        self.dim, self.columns = H.dim, H.dim + len(unknown)
        self.conserved = H.conserves_energy
        self._H, self._unknown = H, list(unknown)
        self.rates, _ = self._recorded("vector_field")
        self.energy, _ = self._recorded("energy")
        self.slopes = self._recorded("gradient")[0] if H.forces else self.rates
        self.jacobian, indices = self._recorded("jacobian" if H.forces else "hessian")
        dof = H.dof
        rows: list[tuple[int, int, int, int]] = []
        for place, (i, j) in enumerate(indices):
            if j >= H.dim or H.forces:  # a rate by a parameter, or by the state itself
                rows.append((i, j, place, 1))
                continue
            for row, column in {(i, j), (j, i)}:
                target, sign = (row - dof, 1) if row >= dof else (row + dof, -1)
                rows.append((target, column, place, sign))
        self.entries = np.array([row[:3] for row in rows], dtype=np.int64).reshape(-1, 3)
        self.signs = np.array([float(row[3]) for row in rows])
        #: The same with registers in place of results.
        self.placed = self.entries.copy()
        self.placed[:, 2] = self.jacobian.results[self.entries[:, 2]]

    def resting(self, zero: Iterable[int]) -> set[int]:
        """Components that stay exactly zero, of those that are zero at the start."""
        own, found = self._H.real_equations, set(zero)
        while found:
            values = {own.z[i]: sympy.Integer(0) for i in found}
            # With a symbol for each float: a rounded sum of them may vanish where it is not zero.
            rates = [rate.xreplace(values) for rate in own.exact.vector_field]
            moving = {i for i in found if rates[i] != 0}
            if not moving:
                break
            found -= moving
        return found

    def _recorded(self, name: str) -> tuple[Program, list[tuple[int, ...]]]:
        """A generated function as a program, and the indices of its results."""
        recorder = Recorder(self.columns + 1, self.dim)
        functions = GeneratedFunctions(self._H, recorder.arithmetic, self._unknown)
        *state, time = recorder.variables
        varied = dict(zip(functions.keywords, state[self.dim :], strict=True))
        with working(BITS):
            found = functions(name, state[: self.dim], time, **varied)
            indices: list[tuple[int, ...]] = []
            if isinstance(found, dict):
                indices, results = list(found), list(found.values())
                for index, value in self._by_parameters(recorder).items():
                    indices.append(index)
                    results.append(value)
            else:
                results = found if isinstance(found, list) else [found]
            return Program(recorder, results), indices

    def _by_parameters(self, recorder: Recorder) -> dict[tuple[int, ...], Any]:
        """The derivatives of the rates by the unknown parameters."""
        own = self._H.real_equations
        values = {s: value for n, (s, value) in own.parameters.items() if n not in self._unknown}
        known = {s: value for s, value in values.items() if value is not None}
        rates = [own.exact.with_fractions(entry, known) for entry in own.exact.vector_field]
        found = {
            (i, self.dim + k): slope
            for k, name in enumerate(self._unknown)
            for i, rate in enumerate(rates)
            if (slope := sympy.diff(rate, own.parameters[name][0])) != 0
        }
        if not found:
            return {}
        exact = {s: rational(v) for s, v in known.items()}
        symbols = [
            *own.z,
            *(own.parameters[name][0] for name in self._unknown),
            own.time or sympy.Dummy("t"),
        ]
        function = compile_straight_line([e.xreplace(exact) for e in found.values()], symbols)
        results = evaluated(function, recorder.arithmetic, *recorder.variables)
        return dict(zip(found, results, strict=True))


@functools.lru_cache(maxsize=64)
def equation_of(H: Hamiltonian, unknown: tuple[str, ...] = ()) -> Equation:
    """The equation of a Hamiltonian, kept for other solutions of it."""
    return Equation(H, unknown)
