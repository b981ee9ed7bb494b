"""Bounds on the error of a march by windows that are its own, in float64.

On each window of a march the library guesses a polynomial y near z^ and proves how far it is from
the true solution. That takes a tenth of the time of the windows of
:mod:`hamsym.proof.windows.proven_windows`, but its bounds have the round-off of float64 in place of
that of twice float64, so that it decides about bounds that are asked for, and is no enclosure that
others use. Lemma 26 of examples/guide/how_proofs_work.md.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hamsym.kernel.enclosures import Models, enclosures
from hamsym.kernel.followed import MarchProof, Prepared
from hamsym.numerics.collocation import chebyshev_tables, chebyshev_values
from hamsym.numerics.scales import coupling_shares
from hamsym.proof.arithmetic.programs import ModelRows, Program
from hamsym.proof.windows.equation import Equation
from hamsym.proof.windows.guessed_windows import sizes_of_all
from hamsym.proof.windows.trial_models import feature_models
from hamsym.random_features.trial import FeatureTrial

# Coefficients of y, and of the models of DG and V.
_TERMS, _FEWER = 24, 16
# Windows that are proven together, between looks at the clock.
_TOGETHER = 64
# Columns of a set for each component.
_COLUMNS = 32


@dataclass(frozen=True, eq=False)
class Followed:
    """Windows that were proven."""

    #: Their number from the start of the march.
    end: int
    #: Coefficients of z^ - y, shape (windows, dim, terms).
    apart: np.ndarray
    #: Bounds on |z^ - z - (z^ - y)|, shape (windows, dim).
    radius: np.ndarray


def _prepared(program: Program, terms: int) -> Prepared:
    """A program with its models and values at points."""
    rows, points = ModelRows(program, terms), chebyshev_tables(_TERMS).points
    return Prepared(
        rows.models,
        np.ascontiguousarray(chebyshev_values(points, terms).T),
        np.repeat(rows.high[:, :1], _TERMS, axis=1),
        step=program.steps,
        still_step=program.still,
        constant=program.constants,
        place=program.still_places,
        result=program.results,
        number=program.numbers,
    )


def follow(equation: Equation, trial: FeatureTrial, count: int) -> Iterator[Followed]:
    """Prove the first windows of a march, part by part, up to one that is not proven.

    The exact solution begins at the first of the states.
    """
    proof = march_proof(equation, trial)
    for first in range(0, count, _TOGETHER):
        last = min(first + _TOGETHER, count)
        apart, radius = (
            np.empty((last - first, equation.dim, _TERMS)),
            np.empty((last - first, equation.dim)),
        )
        done = enclosures().follow(proof, first, last, apart, radius)
        if not (first or done or proof["sizes"].all()):
            half = abs(float(trial.edges[1] - trial.edges[0])) / 2
            couplings = proof["couplings"]
            shares = coupling_shares(couplings, half)
            proof["sizes"][:] = sizes_of_all(proof["sizes"], couplings, shares, half)
            done = enclosures().follow(proof, first, last, apart, radius)
        yield Followed(first + done, apart[:done], radius[:done])
        if done < last - first:
            return


def march_proof(equation: Equation, trial: FeatureTrial) -> MarchProof:
    """The proof of a march before its first window."""
    direction = 1.0 if trial.edges[-1] > trial.edges[0] else -1.0
    return MarchProof(
        rates=_prepared(equation.rates, _TERMS),
        jacobian=_prepared(equation.jacobian, _FEWER),
        energy=_prepared(equation.energy, _FEWER),
        entry=equation.entries,
        placed=equation.placed,
        signs=equation.signs * direction,
        integral=chebyshev_tables(_TERMS).integral,
        fewer_steps=chebyshev_tables(_FEWER).steps,
        fewer=_fewer(),
        features=_features(trial),
        readouts=np.ascontiguousarray(trial.readouts.transpose(0, 2, 1)),
        states=trial.states,
        edges=trial.edges,
        origin=float(trial.origin),
        most=_COLUMNS * equation.dim,
    )


def _features(trial: FeatureTrial) -> Models:
    found = feature_models(trial.series)[0]
    tables = chebyshev_tables(found.high.shape[1])
    rows = found.high, found.low, found.radius, found.length
    return Models(tables.values, tables.series, *rows)


@functools.cache
def _fewer() -> np.ndarray:
    """From values at the points of y to those at the points of V, shape (terms, fewer)."""
    tables, points = chebyshev_tables(_TERMS), chebyshev_tables(_FEWER).points
    return np.ascontiguousarray(tables.series @ chebyshev_values(points, _TERMS).T)
