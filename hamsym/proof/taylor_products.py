"""Products of the coefficients of Taylor models, compiled."""

from __future__ import annotations

from hamsym.proof.ball_arithmetic import compiled


@compiled
def add_products(found, first, second, rows, others, targets):
    """Add the products of coefficients to their places.

    Parameters
    ----------
    found, first, second : numpy.ndarray
        Coefficients, shape (terms, cells).
    rows, others, targets : numpy.ndarray
        Places in ``first``, ``second`` and ``found`` of each product.
    """
    cells = found.shape[1]
    for place in range(len(rows)):
        i, j, k = rows[place], others[place], targets[place]
        for cell in range(cells):
            found[k, cell] += first[i, cell] * second[j, cell]
