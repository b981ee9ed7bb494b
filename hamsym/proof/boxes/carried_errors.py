"""Errors of polynomials near solutions, and derivatives of solutions, from step to step.

With z^, M, S, A, r and D of :mod:`hamsym.proof.boxes.tube`, a column Y, which is the error
delta = z^ - z or a derivative of z, fulfils on a step

    (S Y)' = S f + e,    Y = M S Y + (1 - M S) Y,

- for delta f = r, and |e| <= sup |S' + S A| D + sup |S| sup |q|;
- for derivatives by the starts f = 0, for those by a parameter k f = dF/dk on the tube, and
  |e| <= (sup |S' + S A| + sup |S| G) sup |Y|, |DF(z) - A|_ij <= G_ij = sum_k sup |d2F_i| D_k.

So |Y| <= sup |M (S Y at the begin + integral of S f)| + l sup |M| |e| + sup |1 - M S| |Y|, and a
bound that this keeps below itself holds on the whole step, as in the tube. Between steps

    S Y in W(s) + {B r: |r_i| <= R_i},

with Taylor models W, in which the signs of the defect cancel. M goes on from step to step. In wide
sets S becomes C S after each step, with numbers C near M in the middle of a part: W and B are
multiplied by C, and the radii of W become columns of B, so that these sets do not wrap. Where
|M| |S| is large all the same, M becomes the identity for all s: W and B are multiplied by M, and
the radii of W go into B r. The new B, and that of too many columns, is about orthogonal in units of
the components, its first column along the longest edge of the set (Lohner 1992).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hamsym.proof.arithmetic.balls import ball, working
from hamsym.proof.arithmetic.directed import UNIT, sum_up
from hamsym.proof.arithmetic.generated import ParameterSlopes
from hamsym.proof.arithmetic.taylor_models import (
    BITS,
    MODELS,
    Model,
    Parts,
    float_with_radius,
    total,
)
from hamsym.proof.boxes.tube import Matrix, StepModels, Stepper, kept_bound, product, sizes

_TINY = 1e-250
_TRIES = 8
_ROOM = 1.05  # of a bound on derivatives
_LARGE = 1e7  # |M| |S| from which M becomes the identity
_MOST_EDGES = 1024  # columns of B


@dataclass
class ErrorStep:
    """Delta on a step.

    - change: Bounds on the change of S before the step, shape (dim, dim, parts).
    - w: W on the step.
    - bound, rest, curvature: D; bounds on the integral of |e|, and on the second derivatives of F.
    - added: Radii that the step adds to W, shape (dim, parts).
    """

    change: np.ndarray
    w: list[Model]
    bound: np.ndarray
    rest: np.ndarray
    curvature: np.ndarray
    added: np.ndarray
    #: What D would be without radii and second order, not a proven number.
    sharp: np.ndarray


@dataclass
class CarriedErrors:
    """Delta, and perhaps the derivatives by the starts and parameters, where a step begins.

    - columns: W of delta, of starts and of parameters; a model for each component.
    - frame, radii: B and R; shapes (dim, edges, parts) and (edges, columns, parts).
    - fundamental, adjoint: M and S where the last step ended.
    - present: Bounds on the columns there, shape (dim, columns, parts).
    """

    stepper: Stepper
    slopes: ParameterSlopes
    columns: list[list[Model]]
    frame: np.ndarray
    radii: np.ndarray
    fundamental: Matrix
    adjoint: Matrix
    present: np.ndarray

    @classmethod
    def of_start(
        cls, stepper: Stepper, slopes: ParameterSlopes, count: int, beside: np.ndarray
    ) -> CarriedErrors:
        """The columns at the start: delta within ``beside``, the identity, and ``count`` zeros."""
        dim, space = stepper.flow.dim, stepper.space
        start = np.hstack([np.zeros((dim, 1)), np.eye(dim), np.zeros((dim, count))])
        columns = [[space.constant(np.array([entry])) for entry in own] for own in start.T.tolist()]
        radii = np.zeros((dim, len(columns), 1))
        radii[:, 0, 0] = beside
        one = stepper.first(1)
        frame, present = np.eye(dim)[:, :, None], start[:, :, None] + radii
        return cls(stepper, slopes, columns, frame, radii, one, one, present)

    @classmethod
    def of_map(cls, stepper: Stepper, slopes: ParameterSlopes, start: list[Model]) -> CarriedErrors:
        """Delta alone, from its models at the start."""
        dim, cells = len(start), len(start[0].radius)
        frame = np.repeat(np.eye(dim)[:, :, None], cells, axis=2)
        present = np.array([model.largest() for model in start])[:, None]
        one, radii = stepper.first(cells), np.zeros((dim, 1, cells))
        return cls(stepper, slopes, [start], frame, radii, one, one, present)

    def split(self, parts: Parts) -> CarriedErrors:
        """The columns on parts of the parts."""
        space, own = self.stepper.space, parts.parents

        def halved(rows: list[list[Model]]) -> list[list[Model]]:
            return [[space.parts_of(model, parts) for model in row] for row in rows]

        fundamental = [[entry.polynomial() for entry in row] for row in halved(self.fundamental)]
        return CarriedErrors(
            self.stepper,
            self.slopes,
            halved(self.columns),
            self.frame[:, :, own],
            self.radii[:, :, own],
            fundamental,
            halved(self.adjoint),
            self.present[:, :, own],
        )

    def step(self, models: StepModels, jump: list[Model] | None) -> ErrorStep:
        """Delta on a step at whose begin the polynomials change by ``jump``."""
        space = self.stepper.space
        starts = [[space.at_end(entry, -1) for entry in row] for row in models.adjoint]
        pairs = zip(starts, self.adjoint, strict=True)
        change = sizes([[a - b for a, b in zip(*rows, strict=True)] for rows in pairs])
        shifts = None if jump is None else product(starts, jump)
        w = self._on_step(0, models, change, shifts, models.forced)
        main = product(models.fundamental, w)
        sharp = np.array([model.size() for model in main])
        linear = np.array([model.largest() for model in main])
        linear = sum_up(linear + self._spread(models)[:, 0])
        bound, rest, curvature = kept_bound(self.stepper.flow, models, linear)
        before = np.array([model.radius for model in self.columns[0]])
        added = np.array([space.at_end(model, 1).radius for model in w]) - before + rest
        return ErrorStep(change, w, bound, rest, curvature, added, sharp)

    def _on_step(
        self,
        number: int,
        models: StepModels,
        change: np.ndarray,
        shifts: list[Model] | None,
        forced: list[Model] | None,
    ) -> list[Model]:
        """W of a column on a step."""
        space = self.stepper.space
        wider = np.einsum("ijc,jc->ic", change, self.present[:, number])
        wider = sum_up(wider, len(change))
        found = [model.widened(r) for model, r in zip(self.columns[number], wider, strict=True)]
        if shifts is not None:
            found = [a + b for a, b in zip(found, shifts, strict=True)]
        if forced is not None:
            with working(BITS):
                half = float_with_radius(ball(models.step.half))
            pairs = zip(found, forced, strict=True)
            found = [model + space.integral(more).times(*half) for model, more in pairs]
        return found

    def _spread(self, models: StepModels) -> np.ndarray:
        """Bounds on |M B r| over a step, shape (dim, columns, parts)."""
        dim, _, parts = self.frame.shape
        one = np.broadcast_to(np.eye(dim)[:, :, None], (dim, dim, parts))
        return self._moved(one, models.fundamental)

    def _moved(self, left: np.ndarray, matrix: Matrix) -> np.ndarray:
        """Bounds on |left matrix B r|, shape (dim, columns, parts)."""
        dim, edges, parts = self.frame.shape
        if not self.radii.any():
            return np.zeros((dim, self.radii.shape[1], parts))
        entries = np.array([[model.coefficients for model in row] for row in matrix])
        radius = np.array([[model.radius for model in row] for row in matrix])
        amounts = np.array([[model.amount() for model in row] for row in matrix])
        found = np.empty((dim, edges, parts))
        for part in range(parts):
            product = np.tensordot(left[..., part], entries[..., part], 1)
            product = np.swapaxes(product, 1, 2) @ self.frame[..., part]
            found[..., part] = np.abs(product).sum(axis=1)
        rounding = radius + 2 * (2 * dim + 6) * UNIT * amounts
        sides = np.abs(left), rounding, np.abs(self.frame)
        found += np.einsum("ijc,jkc,klc->ilc", *sides, optimize=True)
        found = np.einsum("ilc,lkc->ikc", found, self.radii)
        return np.asarray(sum_up(found, entries.shape[2] + 6 * dim + edges))

    def after(
        self, models: StepModels, step: ErrorStep, *, is_last: bool = False
    ) -> tuple[CarriedErrors, list[np.ndarray], list[np.ndarray]]:
        """The columns after a step; and V and V_error of each of the derivatives on it.

        - is_last: Whether M must be the identity after it, as at the end of a leg.
        """
        dim, space = self.stepper.flow.dim, self.stepper.space
        with np.errstate(all="ignore"):  # infinite where there is no bound
            M, S = sizes(models.fundamental), sizes(models.adjoint)
            near = sum_up(np.einsum("ijkc,kc->ijc", step.curvature, step.bound), dim)
            grown = sum_up(models.mismatch + np.einsum("ijc,jkc->ikc", S, near), 2 * dim)
            grown = sum_up(models.length * grown)
            spread = self._spread(models)
            every, bounds, rests = [step.w], [step.bound], [step.rest]
            V, V_error = [], []
            for number, forced in enumerate(self._forced(models, step), start=1):
                w = self._on_step(number, models, step.change, None, forced)
                main = product(models.fundamental, w)
                linear = np.array([model.largest() for model in main]) + spread[:, number]
                bound, rest = _kept_below(sum_up(linear), M, grown, models.rest)
                middle, beside = _without_inputs(main)
                beside = beside + spread[:, number] + np.einsum("ijc,jc->ic", M, rest)
                beside = beside + np.einsum("ijc,jc->ic", models.rest, bound)
                every.append(w)
                bounds.append(bound)
                rests.append(rest)
                V.append(middle)
                V_error.append(sum_up(beside, 3 * dim))
            columns = [
                [space.at_end(model, 1).widened(r) for model, r in zip(own, rest, strict=True)]
                for own, rest in zip(every, rests, strict=True)
            ]
            found = CarriedErrors(
                self.stepper,
                self.slopes,
                columns,
                self.frame,
                self.radii,
                models.fundamental_at_end(),
                [[space.at_end(entry, 1) for entry in row] for row in models.adjoint],
                np.stack(bounds, axis=1),
            )
            reach = np.einsum("ijc,jkc,kc->ic", M, S, step.bound) / step.bound
            if is_last or not reach.max() <= _LARGE:
                found = found._reframed(models)
        return found, V, V_error

    def _forced(self, models: StepModels, step: ErrorStep) -> list[list[Model] | None]:
        """S f of the derivatives; None where it vanishes."""
        flow = self.stepper.flow
        found: list[list[Model] | None] = [None] * (len(self.columns) - 1)
        if not self.slopes.places:
            return found
        widened = [s.widened(r) for s, r in zip(models.states, step.bound, strict=True)]
        clock, *parameters = models.arguments[flow.dim :]
        with working(BITS):
            values = self.slopes(MODELS, widened, parameters, clock)
        for (i, k), value in zip(self.slopes.places, values, strict=True):
            rate = flow.as_model(value, models.arguments)
            more = [row[i] * rate for row in models.adjoint]
            own = found[flow.dim + k]
            pairs = zip(own or [], more, strict=True)
            found[flow.dim + k] = [a + b for a, b in pairs] if own else more
        return found

    def turned(self) -> CarriedErrors:
        """The same columns with C S for S, so that M is about the identity in the middle of a part.

        What later steps add then has the size of errors of Y, not |M| |S| times that.
        """
        space, (dim, _, parts) = self.stepper.space, self.frame.shape
        ends = np.array([[entry.coefficients for entry in row] for row in self.fundamental])
        C = ends[:, :, 0]
        try:
            inverse = np.moveaxis(np.linalg.inv(np.moveaxis(C, 2, 0)), 0, 2)
        except np.linalg.LinAlgError:
            return self
        fundamental = np.einsum("ijtc,jkc->iktc", ends, inverse)

        def moved(column: list[Model]) -> list[Model]:
            return [total([m.times(c) for m, c in zip(column, row, strict=True)]) for row in C]

        lost = 2 * (dim + 4) * UNIT * np.einsum("ijc,jkc->ikc", np.abs(C), np.abs(self.frame))
        rounding = np.einsum("ijc,jkc->kic", lost, self.radii)
        rounding = sum_up(rounding, 2 * dim + len(self.radii))
        columns = []
        for column, more in zip(self.columns, rounding, strict=True):
            turned = moved([model.polynomial() for model in column])
            columns.append([m.widened(r) for m, r in zip(turned, more, strict=True)])
        added = np.array([[model.radius for model in column] for column in self.columns])
        frame = np.concatenate([np.einsum("ijc,jkc->ikc", C, self.frame), C], axis=1)
        radii = np.concatenate([self.radii, np.swapaxes(added, 0, 1)])
        adjoint = np.array(self.adjoint, dtype=object).T.tolist()
        found = replace(
            self,
            columns=columns,
            frame=frame,
            radii=radii,
            fundamental=[[Model(space, m, np.zeros(parts)) for m in row] for row in fundamental],
            adjoint=[list(row) for row in zip(*map(moved, adjoint), strict=True)],
        )
        return found._shortened() if frame.shape[1] > _MOST_EDGES else found

    def _shortened(self) -> CarriedErrors:
        """The same columns with as many edges as components."""
        edges = self.frame * self.radii[None, :, 0]
        frame, inverse, share = _orthogonal(edges, np.zeros_like(edges[:, 0]))
        radii = self._moved(inverse, self.stepper.first(edges.shape[2]))
        return replace(self, frame=frame, radii=sum_up(radii + share * radii.max(axis=0)))

    def _reframed(self, models: StepModels) -> CarriedErrors:
        """The same columns with M the identity."""
        space, dim = self.stepper.space, len(self.frame)
        ends = [[space.at_end(entry, 1) for entry in row] for row in models.fundamental]
        main = [product(ends, own) for own in self.columns]
        added = np.stack([[model.radius for model in own] for own in main], axis=1)
        added = added + np.einsum("ijc,jkc->ikc", models.rest, self.present)
        added = sum_up(added, 2 * dim)
        middle = np.array([[entry.coefficients[0] for entry in row] for row in ends])
        frame, inverse, share = _orthogonal(
            np.einsum("ijc,jkc,kc->ikc", middle, self.frame, self.radii[:, 0]), added[:, 0]
        )
        radii = self._moved(inverse, ends)
        radii = sum_up(radii + np.einsum("ijc,jkc->ikc", np.abs(inverse), added), 2 * dim)
        radii = sum_up(radii + share * radii.max(axis=0))
        columns = [[model.polynomial() for model in own] for own in main]
        one = self.stepper.first(len(share))
        present = self.present
        return CarriedErrors(
            self.stepper, self.slopes, columns, frame, np.asarray(radii), one, one, present
        )


def _orthogonal(edges: np.ndarray, beside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A frame B along the edges of a set, X, and c: |B^-1 v|_i <= |X v|_i + c max_j |X v|_j."""
    dim = len(edges)
    units = np.abs(edges).sum(axis=1) + beside
    units = np.where((units > _TINY) & np.isfinite(units), units, 1.0)
    edges = np.moveaxis(edges / units[:, None], 2, 0)
    edges = np.where(np.isfinite(edges), edges, 0.0)
    order = np.argsort(-np.linalg.norm(edges, axis=1), axis=1, kind="stable")
    Q, _ = np.linalg.qr(np.take_along_axis(edges, order[:, None], axis=2))
    Q = np.moveaxis(Q, 0, 2)
    frame, inverse = Q * units[:, None], Q.transpose(1, 0, 2) / units[None]
    product = np.einsum("ijc,jkc->ikc", inverse, frame) - np.eye(dim)[:, :, None]
    large = np.einsum("ijc,jkc->ikc", np.abs(inverse), np.abs(frame))
    off = np.abs(product) + 2 * (dim + 4) * UNIT * (large + 1)
    norm = sum_up(off.sum(axis=1).max(axis=0), 2 * dim)  # of 1 - X B
    return frame, inverse, np.where(norm < 0.5, sum_up(norm / (1 - norm)), np.inf)


def _kept_below(
    linear: np.ndarray, M: np.ndarray, grown: np.ndarray, rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds on a column Y and on the integral of |e|, (dim, parts); infinite where without."""
    dim = len(linear)
    bound, added = np.full_like(linear, np.inf), np.full_like(linear, np.inf)
    guess = _ROOM * linear + _TINY
    for _ in range(_TRIES):
        x = sum_up(np.einsum("ijc,jc->ic", grown, guess), dim)
        found = linear + np.einsum("ijc,jc->ic", M, x) + np.einsum("ijc,jc->ic", rest, guess)
        found = sum_up(found, 2 * dim)
        below = (found < guess).all(axis=0)
        bound, added = np.where(below, found, bound), np.where(below, x, added)
        if below.all():
            break
        guess = np.where(below, guess, np.maximum(guess, _ROOM * found + _TINY))
    return bound, added


def _without_inputs(column: list[Model]) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the powers of the time alone, and bounds on everything else of models."""
    space = column[0].space
    alone = space.exponents[:, 1:].sum(axis=1) == 0
    values = np.array([model.coefficients[alone] for model in column])
    rest = [np.abs(model.coefficients[~alone]).sum(axis=0) + model.radius for model in column]
    return values, np.asarray(sum_up(np.array(rest), space.count))
