"""A tube around a flow map that contains the exact trajectories of all starts in a cell.

Lemma 28 of examples/guide/how_proofs_work.md: with z^(t, y) the map on a step of its time, z(t, y)
the exact solution, delta = z^ - z, F the vector field, A = DF(z^), r = dz^/dt - F(z^) the defect,
M is about the fundamental matrix of delta' = A delta, found in float64, S = -J M^T J about its
inverse, and w = S delta. W, the integral of S r, is a Taylor model: a polynomial in the time and in
y, in which the signs of the defect cancel. No error is enclosed in boxes that turn with the flow,
so that the bounds do not grow by wrapping.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import tangent_scales
from hamsym.proof.arithmetic.balls import ball, working
from hamsym.proof.arithmetic.directed import sum_up
from hamsym.proof.arithmetic.functions import SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.proof.arithmetic.taylor_models import (
    BITS,
    MODELS,
    Model,
    Space,
    float_with_radius,
    total,
)
from hamsym.proof.boxes.map_models import Step
from hamsym.proof.boxes.nodes import Nodes

_TIMES = 10  # nodes of a step for the fundamental matrix, without its start
_ROOM = 1.02  # of a tube
_WIDER = 4.0  # tube over which second derivatives are bounded
_TRIES = 12
_SMALLEST = 1e-250


Matrix = list[list[Model]]


class Flow:
    """H with its derivatives as models, of models of z, t and the parameters that vary."""

    def __init__(self, H: Hamiltonian, varied: Sequence[str]) -> None:
        if H.real_equations.has(sympy.atan2):
            raise CertificationError(
                "H contains 'atan2', of which there are no Taylor models; a proof over a box needs "
                "H without it"
            )
        self.dim, self.dof, self.forced = H.dim, H.dof, bool(H.forces)
        self.parameters = list(varied)
        self._functions = GeneratedFunctions(H, MODELS, self.parameters)
        self.keywords = self._functions.keywords

    def energy(self, arguments: list[Model]) -> Model:
        return self.as_model(self._evaluated("energy", arguments), arguments)

    def field(self, arguments: list[Model]) -> list[Model]:
        """F."""
        values = self._evaluated("vector_field", arguments)
        return [self.as_model(value, arguments) for value in values]

    def _tensor(self, name: str, arguments: list[Model]) -> dict[tuple[int, ...], Model]:
        entries = self._evaluated(name, arguments)
        return {index: self.as_model(value, arguments) for index, value in entries.items()}

    def _evaluated(self, name: str, arguments: list[Model]) -> Any:
        state, t, varied = arguments[: self.dim], arguments[self.dim], arguments[self.dim + 1 :]
        keywords = dict(zip(self._functions.keywords, varied, strict=True))
        with working(BITS):
            return self._functions(name, state, t, **keywords)

    @staticmethod
    def as_model(value: Any, arguments: list[Model]) -> Model:
        """A value that may be a ball as a model."""
        if isinstance(value, Model):
            return value
        number, radius = float_with_radius(value)
        return arguments[0].space.constant(np.full(len(arguments[0].radius), number), radius)

    def jacobian(self, arguments: list[Model]) -> list[list[Model | None]]:
        """DF; None for entries that vanish."""
        found: list[list[Model | None]] = [[None] * self.dim for _ in range(self.dim)]
        for (i, j), entry in self._tensor("jacobian", arguments).items():
            found[i][j] = entry
        return found

    def _target(self, row: int) -> int:
        """The component whose rate is, up to the sign, the slope of H in another one."""
        return (row + self.dof) % self.dim

    def curvature(self, arguments: list[Model]) -> np.ndarray:
        """Bounds on |d2F_i/dz_j dz_k|, shape (dim, dim, dim, cells)."""
        cells = len(arguments[0].radius)
        found = np.zeros((self.dim, self.dim, self.dim, cells))
        # H finite as a model is analytic there, which its derivatives alone do not show.
        energy = self.energy(arguments).largest()
        found[:, :, :, ~np.isfinite(energy)] = np.inf
        if self.forced:
            for rate in self.field(arguments):
                found[:, :, :, ~np.isfinite(rate.largest())] = np.inf
            for (i, j, k), entry in self._tensor("third_derivatives", arguments).items():
                found[self._target(i), j, k] = found[self._target(i), k, j] = entry.largest()
            return found
        for index, entry in self._tensor("third_derivatives", arguments).items():
            size = entry.largest()
            for row, *columns in set(itertools.permutations(index)):
                place = self._target(row), *columns
                found[place] = np.maximum(found[place], size)
        return found


@dataclass
class StepModels:
    """What a step of the proof needs, without the bounds on the error so far."""

    step: Step
    arguments: list[Model]
    #: states, defect: z^ and r.
    states: list[Model]
    defect: list[Model]
    #: fundamental, adjoint: M and S.
    fundamental: Matrix
    adjoint: Matrix
    #: Bounds on the entries of S' + S A, shape (dim, dim, cells).
    mismatch: np.ndarray
    #: Bounds on the entries of 1 - M S.
    rest: np.ndarray

    def fundamental_at_end(self) -> Matrix:
        """M where the step ends, a polynomial."""
        space = self.states[0].space
        return [[space.at_end(entry, 1).polynomial() for entry in row] for row in self.fundamental]

    @cached_property
    def forced(self) -> list[Model]:
        """S r."""
        return product(self.adjoint, self.defect)

    @cached_property
    def length(self) -> float:
        with working(BITS):
            value, radius = float_with_radius(ball(2 * abs(self.step.half)))
        return float(sum_up(value + radius))


def product(matrix: Matrix, column: list[Model]) -> list[Model]:
    return [
        total([entry * model for entry, model in zip(row, column, strict=True)]) for row in matrix
    ]


def steepest_inputs(models: Sequence[Model]) -> np.ndarray:
    """The input of each cell in which models vary most beyond their middle degree."""
    found: Any = 0.0
    for model in models:
        exponents = model.space.exponents[:, 1:]
        high = exponents.sum(axis=1) * 2 >= model.space.degree
        size = np.abs(model.coefficients[high])
        found = found + exponents[high].T @ size / (model.amount() + _SMALLEST)
    return np.asarray(np.argmax(np.nan_to_num(found), axis=0))


def sizes(matrix: Matrix) -> np.ndarray:
    return np.array([[entry.largest() for entry in row] for row in matrix])


class Stepper:
    """Models on steps of the time.

    - space: Of all models but those from which the defect is made, which may have higher degrees.
    - degree: Largest degree of M in the inputs.
    """

    def __init__(self, flow: Flow, space: Space, degree: int) -> None:
        self.flow, self.space = flow, space
        self.nodes = Nodes(space, min(_TIMES, space.time_degree), degree)

    def lowered(self, models: Sequence[Model]) -> list[Model]:
        return [model.space.lowered(model, self.space) for model in models]

    def first(self, cells: int) -> Matrix:
        """M at the start of the map."""
        return [
            [self.space.constant(np.full(cells, entry)) for entry in row]
            for row in np.eye(self.flow.dim).tolist()
        ]

    def models(
        self,
        step: Step,
        states: list[Model],
        rates: list[Model],
        clock: Model,
        parameters: list[Model],
        before: Matrix,
    ) -> StepModels:
        """The models of a step from z^ and dz^/dtau, and from M where the step begins.

        Raise SingularityError if H is not smooth on a part of the step in every cell.
        """
        flow, space = self.flow, self.space
        arguments = [*states, clock, *parameters]
        with working(BITS):
            half, _ = float_with_radius(ball(step.half))
            inverse, inverse_spread = float_with_radius(1 / ball(step.half))
        field = flow.field(arguments)
        defect = self.lowered(
            [
                rate.times(inverse, inverse_spread) - value
                for rate, value in zip(rates, field, strict=True)
            ]
        )
        arguments = self.lowered(arguments)
        states = arguments[: flow.dim]
        jacobian = flow.jacobian(arguments)
        found = self._fundamental(jacobian, half, before)
        dim = flow.dim
        fundamental = [
            [space.moved(entry, start) for entry, start in zip(row, starts, strict=True)]
            for row, starts in zip(self._fitted(found), before, strict=True)
        ]
        if flow.forced:
            try:
                inverses = np.linalg.inv(found)
            except np.linalg.LinAlgError:
                inverses = np.full(found.shape, np.nan)  # the mismatch then refuses the step
            adjoint = self._fitted(inverses)
        else:
            adjoint = self._adjoint(fundamental, space)
        mismatch = np.zeros((dim, dim, len(found)))
        rest = np.zeros((dim, dim, len(found)))
        for i in range(dim):
            for j in range(dim):
                terms = [space.rate(adjoint[i][j]).times(inverse, inverse_spread)]
                for k in range(dim):
                    entry = jacobian[k][j]
                    if entry is not None:
                        terms.append(adjoint[i][k] * entry)
                mismatch[i, j] = total(terms).largest()
                product = total([fundamental[i][k] * adjoint[k][j] for k in range(dim)])
                rest[i, j] = product.plus(-1.0 if i == j else 0.0).largest()
        return StepModels(step, arguments, states, defect, fundamental, adjoint, mismatch, rest)

    def _fitted(self, values: np.ndarray) -> list[list[Model]]:
        """Models of matrices at the nodes."""
        count, dim = len(values), values.shape[-1]
        return [
            [
                Model(self.space, self.nodes.polynomial(values[..., i, j]), np.zeros(count))
                for j in range(dim)
            ]
            for i in range(dim)
        ]

    def _adjoint(self, fundamental: list[list[Model]], space: Space) -> list[list[Model]]:
        """-J M^T J, the inverse of a symplectic matrix M."""
        dim, dof = self.flow.dim, self.flow.dof
        signs = np.array([1.0] * dof + [-1.0] * dof)
        swap = [*range(dof, dim), *range(dof)]
        return [
            [
                Model(space, signs[i] * signs[j] * entry.coefficients, entry.radius)
                for j, entry in enumerate([fundamental[swap[j]][swap[i]] for j in range(dim)])
            ]
            for i in range(dim)
        ]

    def _fundamental(
        self, jacobian: list[list[Model | None]], half: float, before: Matrix
    ) -> np.ndarray:
        """M at the nodes, by collocation, shape (cells, inputs, times, dim, dim)."""
        dim, nodes = self.flow.dim, self.nodes
        times = len(nodes.times) - 1
        starts = [[nodes.start_values(entry.coefficients) for entry in row] for row in before]
        matrices = np.moveaxis(np.array(starts), (0, 1), (2, 3))
        cells = len(matrices)
        A = np.zeros((cells, nodes.count, times + 1, dim, dim))
        for i, row in enumerate(jacobian):
            for j, entry in enumerate(row):
                if entry is not None:
                    A[..., i, j] = nodes.values(entry.coefficients)
        A = np.where(np.isfinite(A), A, 0.0)
        units = tangent_scales(A)[:, None]
        A, matrices = A * (units.T / units), matrices / units
        D = nodes.rates
        system = np.broadcast_to(
            np.kron(D[1:, 1:], np.eye(dim)), (cells, nodes.count, times * dim, times * dim)
        ).copy()
        for k in range(times):
            part = slice(k * dim, (k + 1) * dim)
            system[..., part, part] -= half * A[:, :, k + 1]
        right = -np.einsum("k,cnij->cnkij", D[1:, 0], matrices).reshape(
            cells, nodes.count, times * dim, dim
        )
        found = np.linalg.solve(system, right).reshape(cells, nodes.count, times, dim, dim)
        return np.concatenate((matrices[:, :, None], found), axis=2) * units


def kept_bound(
    flow: Flow, models: StepModels, linear: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """D with the right-hand side below D, the bound on the rest of w, and second derivatives.

    Infinite where there is none.

    - linear: Bounds on \\|M (w_0 + W)\\|, shape (dim, cells).
    """
    M, S = sizes(models.fundamental), sizes(models.adjoint)
    dim = flow.dim
    D = _ROOM * linear + _SMALLEST
    bound, rest = np.full_like(linear, np.inf), np.full_like(linear, np.inf)
    limit = np.zeros_like(D)
    curvature = np.zeros((dim, dim, dim, linear.shape[1]))
    for _ in range(_TRIES):
        wider = ~(limit >= D).all(axis=0)
        if wider.any():
            limit = np.where(wider, _WIDER * D, limit)
            widened = [s.widened(r) for s, r in zip(models.states, limit, strict=True)]
            try:
                curvature = flow.curvature([*widened, *models.arguments[dim:]])
            except SingularityError:
                break
        q = sum_up(np.einsum("ijkc,jc,kc->ic", curvature, D, D) / 2, dim * dim)
        inside = np.einsum("ijc,jc->ic", models.mismatch, D) + np.einsum("ijc,jc->ic", S, q)
        x = sum_up(models.length * sum_up(inside, 2 * dim))
        found = sum_up(
            linear + np.einsum("ijc,jc->ic", M, x) + np.einsum("ijc,jc->ic", models.rest, D),
            2 * dim,
        )
        done = (found < D).all(axis=0) & (limit >= D).all(axis=0)
        bound, rest = np.where(done, found, bound), np.where(done, x, rest)
        D = np.where(done, D, np.maximum(_ROOM * found + _SMALLEST, D))
        if np.isfinite(bound).all():
            break
    return bound, rest, curvature
