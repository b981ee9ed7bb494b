"""Steps of an enclosure of the true solution over one window of time, compiled.

The equation is dz/dx = w G(t, z, k) on -1 <= x <= 1, with the half length w of the window, time
t = t_m + w x and constants k (parameters that are not known exactly). y(x) is a polynomial near
the solution, V(x) one near its derivatives by the start and by k; both are guesses, found by
collocation at Chebyshev points without bounds. What follows is proven for any y and V.

*Lemma (window).* Let z(-1) = y(-1) + xi and k = k_0 + kappa, and write xi for both together. Let

    D(x) = y(x) - y(-1) - w int_-1^x G(t, y, k_0)         (the defect of y),
    A(x) = A_0(x) + B(x), an interval matrix that contains w DG(t, y + e, k_0 + kappa) for all
           |e_i| <= rho_i, A_0 polynomial,
    K(x) = V(x) - V(-1) - int_-1^x A_0 V                  (the defect of V), V(-1) = I + F.

Then z = y + (V - K) xi - D + d as long as |z_i - y_i| < rho_i, where

    d' = A d + (B V - A K) xi - A D,   d(-1) = -F xi.

Proof. e = z - y satisfies e = xi - D + int A e, because G(y + e) - G(y) is the mean of DG(y + s e)
over 0 <= s <= 1, times e. Put e = (V - K) xi - D + d and use (V - K) xi = xi + F xi + int A_0 V xi.

*Bound on d.* With units U = diag(u) and m >= the largest eigenvalue of the symmetric part of
U^-1 A U, m >= 0 (bounded by Gershgorin's circles),

    |U^-1 d| <= e^(2m) (|U^-1 F xi| + 2 |U^-1 (|B V - A K| |xi| + |A| |D|)|)   (Dahlquist 1959).

*Existence.* If |(V xi)_i| + sum_j |K_ij| |xi_j| + |D_i| + |d_i| < rho_i for every i, the solution
exists on the whole window and stays inside the tube: at the first time at which it left it, or up
to which it existed, the bound with "<" would hold (continuation of solutions).

The derivative of the flow is dz(x)/d(z(-1), k) = V(x) - K(x) + V_d(x), with column c of V_d bounded
like d with xi = e_c and without D, because it satisfies the linear equation with such an A.
"""

from __future__ import annotations

import math

import numpy as np

from hamsym.proof.ball_arithmetic import (
    MIDDLE,
    UNDERFLOW,
    UNIT,
    absolute,
    add,
    ball_of,
    compiled,
    exponential,
    fma,
    multiply,
    negative,
    scaled,
    two_sum,
)
from hamsym.proof.chebyshev_models import (
    ADD,
    ARCCOSINE,
    ARCOSH,
    ARCSINE,
    ARCTANGENT,
    ARSINH,
    ARTANH,
    EXPONENTIAL,
    LOGARITHM,
    MULTIPLY,
    NEGATE,
    RECIPROCAL,
    RECIPROCAL_ROOT,
    SINE_COSINE,
    SUBTRACT,
    apply_table,
    end_value,
    integrate_series,
    multiply_series,
    run_models,
    size_of,
    up,
)


@compiled
def run_values(program, rows):
    """Run a program on values at points, without bounds; rows (registers, points)."""
    for step in range(len(program)):
        operation, k, i, j = program[step]
        a, b, out = rows[i], rows[j], rows[k]
        if operation == ADD:
            for c in range(len(out)):
                out[c] = a[c] + b[c]
        elif operation == SUBTRACT:
            for c in range(len(out)):
                out[c] = a[c] - b[c]
        elif operation == NEGATE:
            for c in range(len(out)):
                out[c] = -a[c]
        elif operation == MULTIPLY:
            for c in range(len(out)):
                out[c] = a[c] * b[c]
        elif operation == RECIPROCAL:
            for c in range(len(out)):
                out[c] = 1 / a[c]
        elif operation == RECIPROCAL_ROOT:
            for c in range(len(out)):
                out[c] = 1 / math.sqrt(a[c]) if a[c] > 0 else math.nan
        elif operation == EXPONENTIAL:
            for c in range(len(out)):
                out[c] = math.exp(a[c])
        elif operation == SINE_COSINE:
            for c in range(len(out)):
                out[c] = math.sin(a[c])
            for c in range(len(out)):
                b[c] = math.cos(a[c])
        elif operation == LOGARITHM:
            for c in range(len(out)):
                out[c] = math.log(a[c]) if a[c] > 0 else math.nan
        elif operation == ARCTANGENT:
            for c in range(len(out)):
                out[c] = math.atan(a[c])
        elif operation == ARCSINE:
            for c in range(len(out)):
                out[c] = math.asin(a[c])
        elif operation == ARCCOSINE:
            for c in range(len(out)):
                out[c] = math.acos(a[c])
        elif operation == ARSINH:
            for c in range(len(out)):
                out[c] = math.asinh(a[c])
        elif operation == ARCOSH:
            for c in range(len(out)):
                out[c] = math.acosh(a[c])
        elif operation == ARTANH:
            for c in range(len(out)):
                out[c] = math.atanh(a[c])
        else:
            for c in range(len(out)):
                out[c] = math.erf(a[c])


@compiled
def collocate(program, results, rows, integral, start, half, most):
    """Fixed-point iteration for y at the points; rows[:dim] begin with a guess.

    Returns the number of iterations, or 0 where y is not finite.
    """
    dim, points = len(start), rows.shape[1]
    found = np.empty(points)
    before, slow = math.inf, 0
    for count in range(1, most + 1):
        run_values(program, rows)
        change = 0.0
        news = np.empty((dim, points))
        for i in range(dim):
            apply_table(integral, rows[results[i]], points, found)
            size, moved = abs(start[i]), 0.0
            for c in range(points):
                value = start[i] + half * found[c]
                moved = max(moved, abs(value - rows[i, c]))
                size = max(size, abs(value))
                news[i, c] = value
            if size > 0:
                change = max(change, moved / size)
            if not moved < math.inf:
                return 0
        for i in range(dim):
            for c in range(points):
                rows[i, c] = news[i, c]
        if change < 4e-16:
            return count
        if change < 1e-13 and change >= 0.5 * before:
            return count
        slow = slow + 1 if change >= before else 0
        if slow > 12:
            break
        before = change
    return most  # round-off, or a guess that the tail or the defect of y will refuse


@compiled
def tangents(rows, entries, signs, dim, columns, integral, half, units, most):
    """Fixed-point iteration for V at the points, shape (dim, columns, points), without bounds.

    It ends when each column has converged in units of the components, because columns are of
    different dimensions, and their entries, too.
    """
    points = rows.shape[1]
    found = np.zeros((dim, columns, points))
    for i in range(dim):
        found[i, i, :] = 1.0
    rates = np.empty((dim, columns, points))
    done = np.empty(points)
    before = math.inf
    for _ in range(most):
        rates[:] = 0.0
        for e in range(len(entries)):
            i, j, place = entries[e]
            a = rows[place]
            for c in range(columns):
                if j < dim:
                    b = found[j, c]
                    out = rates[i, c]
                    for x in range(points):
                        out[x] += signs[e] * a[x] * b[x]
                elif j == c:
                    out = rates[i, c]
                    for x in range(points):
                        out[x] += signs[e] * a[x]
        change = 0.0
        for c in range(columns):
            shift, size = 0.0, 0.0
            for i in range(dim):
                apply_table(integral, rates[i, c], points, done)
                moved, large = 0.0, 0.0
                first = 1.0 if i == c else 0.0
                for x in range(points):
                    value = first + half * done[x]
                    moved = max(moved, abs(value - found[i, c, x]))
                    large = max(large, abs(value))
                    found[i, c, x] = value
                shift, size = max(shift, moved / units[i]), max(size, large / units[i])
            if shift != 0:
                ratio = shift / size
                change = max(change, ratio) if ratio < math.inf else math.inf
        if not change < math.inf or change <= 4e-16:
            break
        if change <= 1e-12 and change >= 0.5 * before:
            break
        before = change
    return found


@compiled
def correct(rows, entries, signs, dim, integral, half, wanted, units, most):
    """c with c = -D + w int A c at the points; wanted holds -D, shape (dim, points).

    The iteration ends when c has converged in units of the components.
    """
    points = rows.shape[1]
    found = wanted.copy()
    rates = np.empty((dim, points))
    done = np.empty(points)
    for _ in range(most):
        rates[:] = 0.0
        for e in range(len(entries)):
            i, j, place = entries[e]
            if j < dim:
                for x in range(points):
                    rates[i, x] += signs[e] * rows[place, x] * found[j, x]
        change, size = 0.0, 0.0
        for i in range(dim):
            apply_table(integral, rates[i], points, done)
            moved, large = 0.0, 0.0
            for x in range(points):
                value = wanted[i, x] + half * done[x]
                moved = max(moved, abs(value - found[i, x]))
                large = max(large, abs(value))
                found[i, x] = value
            change, size = max(change, moved / units[i]), max(size, large / units[i])
        if not change < math.inf or change <= 1e-14 * size:
            break
    return found


@compiled
def defects(program, results, values, series, high, low, radius, length, dim, half):
    """Coefficients of D for each component, and bounds on |D|; the models hold y and constants.

    ``half`` is a ball (high, low, radius).
    """
    terms = high.shape[1]
    double = terms > 0  # numba would compile once more for the constant True
    run_models(program, values, series, high, low, radius, length, double)
    found = np.zeros((dim, terms + 1))
    sizes = np.zeros(dim)
    inner, inner_low = np.zeros(terms + 1), np.zeros(terms + 1)
    wide, rest = np.zeros(terms + 2), np.zeros(terms + 2)
    factor, factor_low = np.array([half[0]]), np.array([half[1]])
    for i in range(dim):
        r = results[i]
        n = length[r]
        error = multiply_series(factor, factor_low, 1, high[r], low[r], n, inner, inner_low, True)
        error += half[2] * size_of(high[r], low[r], n) + radius[r] * (abs(half[0]) * (1 + 4 * UNIT))
        error = 2 * error + integrate_series(inner, inner_low, n, wide, rest, True)
        begin = end_value(high[i], low[i], length[i], -1)
        total = 0.0
        count = max(n + 1, length[i])
        for c in range(count):
            a, x = (high[i, c], low[i, c]) if c < length[i] else (0.0, 0.0)
            b, y = (-wide[c], -rest[c]) if c < n + 1 else (0.0, 0.0)
            s, e = two_sum(a, b)
            total += MIDDLE * (abs(a) + abs(b))
            if c == 0:
                s, d = two_sum(s, -begin[0])
                e = (e + d) - begin[1]
                total += begin[2] + MIDDLE * abs(begin[0]) * 2
            s, e = two_sum(s, e + (x + y))
            found[i, c] = s
            total += abs(s) + abs(e)
        sizes[i] = up(error + total)
    return found, sizes


@compiled
def length_in(vector, units):
    """The 2-norm of a vector of numbers >= 0 in units, rounded up."""
    total = 0.0
    for i in range(len(vector)):
        value = up(vector[i]) / units[i]
        total += value * value
    return up(math.sqrt(up(total)))


@compiled
def transport(
    jacobian,
    jacobian_radius,
    jacobian_length,
    entries,
    signs,
    start,
    hull,
    V,
    D,
    half,
    units,
    dim,
):
    """Bounds of the lemma: on |z - y|, |d - K xi|, |V_d - K|; and m.

    Parameters
    ----------
    jacobian, jacobian_radius, jacobian_length
        Models of the entries of DG by their place in ``entries``, over the tube.
    entries, signs : numpy.ndarray
        Rows (i, j, place); signs.
    start : numpy.ndarray
        Bounds on |xi|, shape (columns,).
    hull : numpy.ndarray
        Bounds on |V xi| over the window, shape (dim,).
    V : numpy.ndarray
        Coefficients, shape (dim, columns, terms).
    D : numpy.ndarray
        Bounds on |D|, shape (dim,).
    half : float
        An upper bound on w.
    units : numpy.ndarray
        Shape (dim,), any numbers > 0: roundings of their ratios are among those of the products.
    """
    columns, terms = V.shape[1], V.shape[2]
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    none = np.zeros(2 * terms + 2)
    sizes = np.zeros((dim, columns))
    for i in range(dim):
        for c in range(columns):
            sizes[i, c] = size_of(V[i, c], none, terms)
    large = np.zeros(len(entries))  # |A_ij|
    loosely = np.zeros(len(entries))  # |B_ij|
    for e in range(len(entries)):
        large[e] = (
            half
            * (size_of(jacobian[e], none, jacobian_length[e]) + jacobian_radius[e])
            * (1 + 8 * UNIT)
            + UNDERFLOW
        )
        loosely[e] = half * jacobian_radius[e] * (1 + 8 * UNIT) + UNDERFLOW
    # K and the part of S from the radii of A, entry by entry
    sums = np.zeros((dim, columns, 2 * terms + 1))
    errors = np.zeros((dim, columns))
    loose = np.zeros((dim, columns))
    for e in range(len(entries)):
        i, j, _ = entries[e]
        n = jacobian_length[e]
        for c in range(columns):
            if j >= dim:
                if j == c:
                    for k in range(n):
                        p = signs[e] * half * jacobian[e, k]
                        sums[i, c, k] += p
                        errors[i, c] += UNIT * (abs(p) + abs(sums[i, c, k]))
                    loose[i, c] += loosely[e]
                continue
            errors[i, c] += (
                (1 + 8 * UNIT)
                * half
                * multiply_series(jacobian[e], none, n, V[j, c], none, terms, wide, rest, False)
            )
            loose[i, c] += loosely[e] * sizes[j, c]
            for k in range(n + terms - 1):
                p = signs[e] * half * wide[k]
                sums[i, c, k] += p
                errors[i, c] += UNIT * (abs(p) + abs(sums[i, c, k]))
    defect = np.zeros((dim, columns))
    start_error = np.zeros((dim, columns))
    inner, inner_low = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    for i in range(dim):
        for c in range(columns):
            begin = end_value(V[i, c], none, terms, -1)
            first = 1.0 if i == c else 0.0
            start_error[i, c] = up(abs(begin[0] - first) + abs(begin[1]) + begin[2])
            error = 2 * errors[i, c] + begin[2] + abs(begin[1])
            error += integrate_series(sums[i, c], none, 2 * terms + 1, inner, inner_low, False)
            for k in range(2 * terms + 2):
                value = (V[i, c, k] if k < terms else 0.0) - inner[k]
                error += UNIT * abs(value)
                if k == 0:
                    value -= begin[0]
                    error += UNIT * abs(value)
                error += abs(value)
            defect[i, c] = up(error)
    residuals = np.zeros((dim, columns))
    for i in range(dim):
        for c in range(columns):
            residuals[i, c] = loose[i, c]
    for e in range(len(entries)):
        i, j, _ = entries[e]
        if j < dim:
            for c in range(columns):
                residuals[i, c] += large[e] * defect[j, c]
    for i in range(dim):
        for c in range(columns):
            residuals[i, c] = up(residuals[i, c])
    # Gershgorin's circles of the symmetric part of U^-1 A U
    scaled = np.zeros((dim, dim, terms))
    apart = np.zeros((dim, dim))
    for e in range(len(entries)):
        i, j, _ = entries[e]
        if j < dim:
            ratio = units[j] / units[i]
            for k in range(jacobian_length[e]):
                scaled[i, j, k] += signs[e] * jacobian[e, k] * ratio
            size = size_of(jacobian[e], none, jacobian_length[e])
            apart[i, j] += jacobian_radius[e] * (ratio + UNDERFLOW) + UNDERFLOW * (1 + size)
    norm = 0.0
    for i in range(dim):
        circle = scaled[i, i, 0] + apart[i, i]
        for k in range(1, terms):
            circle += abs(scaled[i, i, k])
        spread = abs(scaled[i, i, 0])
        for j in range(dim):
            if j != i:
                total = apart[i, j] + apart[j, i]
                for k in range(terms):
                    total += abs(scaled[i, j, k] + scaled[j, i, k])
                    spread += abs(scaled[i, j, k]) + abs(scaled[j, i, k])
                circle += 0.5 * total
        circle = circle + (64 + 2 * (terms + dim)) * UNIT * (spread + abs(circle))
        if not circle < math.inf:  # max() would drop NaN
            circle = math.inf
        norm = max(norm, circle)
    growth = absolute(exponential(ball_of(up(2 * half * norm))))
    # d
    begun, reach, hidden = np.zeros(dim), np.zeros(dim), np.full(dim, UNDERFLOW)
    for i in range(dim):
        for c in range(columns):
            begun[i] += start_error[i, c] * start[c]
            hidden[i] += defect[i, c] * start[c]
    for e in range(len(entries)):
        i, j, _ = entries[e]
        if j < dim:
            reach[i] += large[e] * (D[j] + hidden[j]) + loosely[e] * (hull[j] + UNDERFLOW)
        else:
            reach[i] += loosely[e] * start[j]
    bound = up(growth * (length_in(begun, units) + 2 * length_in(reach, units)))
    d = units * bound
    derivative = np.zeros((dim, columns))
    for c in range(columns):
        first = np.ascontiguousarray(start_error[:, c])
        rate = np.ascontiguousarray(residuals[:, c])
        bound = up(growth * (length_in(first, units) + 2 * length_in(rate, units)))
        for i in range(dim):
            derivative[i, c] = up(units[i] * bound + defect[i, c])
    tube = np.zeros(dim)
    for i in range(dim):
        d[i] = up(d[i] + hidden[i])
        tube[i] = up(hull[i] + D[i] + d[i])
    return tube, d, derivative, norm


@compiled
def matrix_product(a, b):
    """a b and a bound on its rounding errors, entry by entry."""
    n, m, k = a.shape[0], b.shape[1], a.shape[1]
    found, error = np.zeros((n, m)), np.zeros((n, m))
    for i in range(n):
        for h in range(k):
            x = a[i, h]
            y = abs(x)
            for j in range(m):
                found[i, j] += x * b[h, j]
                error[i, j] += y * abs(b[h, j])
    for i in range(n):
        for j in range(m):
            error[i, j] = up((k + 2) * UNIT * error[i, j])
    return found, error


@compiled
def moved_set(J, J_error, C, r0):
    """J C rounded, and bounds on the rest of (J +- J_error) C r with |r| <= r0, (columns, k)."""
    found, error = matrix_product(J, C)
    columns, kinds = r0.shape
    rest = np.zeros((len(J), kinds))
    for i in range(len(J)):
        for c in range(columns):
            total = error[i, c]
            for k in range(len(C)):
                total += J_error[i, k] * abs(C[k, c])
            for kind in range(kinds):
                rest[i, kind] += total * r0[c, kind]
    for i in range(len(J)):
        for kind in range(kinds):
            rest[i, kind] = up(rest[i, kind])
    return found, rest


@compiled
def orthogonal(matrix):
    """Columns made orthogonal one after the other, twice; unit vectors where nothing is left."""
    n = len(matrix)
    found = matrix.copy()
    for c in range(n):
        for attempt in range(n + 1):
            before = 0.0
            for i in range(n):
                before += found[i, c] * found[i, c]
            for _ in range(2):
                for d in range(c):
                    share = 0.0
                    for i in range(n):
                        share += found[i, d] * found[i, c]
                    for i in range(n):
                        found[i, c] -= share * found[i, d]
            length = 0.0
            for i in range(n):
                length += found[i, c] * found[i, c]
            if length > 1e-26 * before and length > 0:
                break
            for i in range(n):
                found[i, c] = 1.0 if i == attempt else 0.0
        length = math.sqrt(length)
        for i in range(n):
            found[i, c] /= length
    return found


@compiled
def boxed_set(G, R, units):
    """Sets {G r} with |r| <= R as P r' in as many columns as rows: (P, R').

    *Lemma.* Let Q be any matrix and I - Q^T Q = F with |F| <= f < 1 (row sums). Then Q is regular
    and Q^-1 v is within f/(1 - f) max |Q^T v| of Q^T v, component by component: Q^-1 =
    (Q^T Q)^-1 Q^T, and (I - F)^-1 - I has row sums of at most f/(1 - f).

    Q = U^-1 P is the orthogonal factor of the columns of U^-1 G ordered by the lengths of their
    parts of the set (Lohner 1992), with units U = diag(u), powers of two, because lengths and
    angles mean nothing between components of different dimensions. Kinds of sets may have different
    dimensions, too, and are compared with the largest component of each.
    """
    columns, count = G.shape
    kinds = R.shape[1]
    own = np.empty((columns, count))  # U^-1 G; what underflows is below TINY in a product
    for i in range(columns):
        for c in range(count):
            own[i, c] = G[i, c] / units[i]
    largest_of = np.zeros(kinds)  # component of each kind of set, in these units
    for kind in range(kinds):
        for i in range(columns):
            size = 0.0
            for c in range(count):
                size += abs(own[i, c]) * R[c, kind]
            largest_of[kind] = max(largest_of[kind], size)
    lengths = np.zeros(count)
    for c in range(count):
        longest = 0.0
        for kind in range(kinds):
            if R[c, kind] > 0:
                longest = max(longest, R[c, kind] / largest_of[kind])
        for i in range(columns):
            lengths[c] += (own[i, c] * longest) ** 2
    arranged = np.zeros((columns, columns))
    for c in range(columns):  # the longest of those that are left
        longest = 0
        for d in range(1, count):
            if lengths[d] > lengths[longest]:
                longest = d
        lengths[longest] = -1.0
        largest = 0.0
        for i in range(columns):
            largest = max(largest, abs(own[i, longest]))
        for i in range(columns):  # a tiny column keeps its direction
            arranged[i, c] = own[i, longest] / largest if largest > 0 else 0.0
    Q = orthogonal(arranged)
    P = np.empty((columns, columns))
    inverse = np.empty((columns, columns))
    for i in range(columns):
        for c in range(columns):
            P[i, c] = Q[i, c] * units[i]
            Q[i, c] = P[i, c] / units[i]  # so that P = U Q exactly, even if it underflowed
            inverse[c, i] = Q[i, c]
    unit, error = matrix_product(inverse, Q)
    f = 0.0
    for i in range(columns):
        row = 0.0
        for c in range(columns):
            row += abs(unit[i, c] - (1.0 if i == c else 0.0)) + error[i, c]
        f = max(f, up(row) if row < math.inf else math.inf)  # max() would drop NaN
    if not f < 0.5:
        return P, np.full((columns, kinds), np.inf)
    product, error = matrix_product(inverse, own)
    found = np.zeros((columns, kinds))
    for kind in range(kinds):
        largest = 0.0
        for i in range(columns):
            total = 0.0
            for c in range(count):
                total += (abs(product[i, c]) + error[i, c]) * R[c, kind]
            found[i, kind] = up(total)
            largest = max(largest, found[i, kind])
        for i in range(columns):
            found[i, kind] = up(found[i, kind] + f / (1 - f) * largest)
    return P, found


@compiled
def chebyshev_balls(x, terms):
    """Balls of T_0(x) .. T_terms-1(x) for a ball x, shape (terms, 3)."""
    found = np.zeros((terms, 3))
    before, last = ball_of(1.0), x
    found[0, 0] = 1.0
    for k in range(1, terms):
        found[k, 0], found[k, 1], found[k, 2] = last
        following = add(scaled(multiply(x, last), 2.0), negative(before))
        before, last = last, following
    return found


@compiled
def matrix_value(series, basis):
    """Values of series with shape (n, m, terms) and bounds on their errors."""
    n, m, terms = series.shape
    found, error = np.zeros((n, m)), np.zeros((n, m))
    for k in range(terms - 1, -1, -1):
        t = basis[k, 0]
        gap = abs(basis[k, 1]) + basis[k, 2]
        for i in range(n):
            for j in range(m):
                p = series[i, j, k] * t
                found[i, j] += p
                error[i, j] += UNIT * (abs(p) + abs(found[i, j])) + abs(series[i, j, k]) * gap
    for i in range(n):
        for j in range(m):
            error[i, j] = up(error[i, j])
    return found, error


@compiled
def vector_value(high, low, basis):
    """Values of series with shape (n, terms) as balls, shape (n, 3)."""
    n, terms = high.shape
    found = np.zeros((n, 3))
    for i in range(n):
        total = ball_of(0.0)
        for k in range(terms - 1, -1, -1):
            t = (basis[k, 0], basis[k, 1], basis[k, 2])
            total = add(total, multiply((high[i, k], low[i, k], 0.0), t))
        found[i, 0], found[i, 1], found[i, 2] = total
    return found


@compiled
def set_radius(value, error, G, R):
    """Bounds on (value +- error) G r with |r| <= R, component by component, shape (n, kinds)."""
    product, found = moved_set(value, error, G, R)
    for i in range(len(product)):
        for kind in range(R.shape[1]):
            total = found[i, kind]
            for c in range(len(R)):
                total += abs(product[i, c]) * R[c, kind]
            found[i, kind] = up(total)
    return found


@compiled
def dense(weights, bias, high, low, radius, length):
    """Models of weights @ f + bias, in twice float64: (high, low, radius, length)."""
    outputs, inputs = weights.shape
    terms = high.shape[1]
    count = 1
    for j in range(inputs):
        count = max(count, length[j])
    oh, ol = np.zeros((outputs, terms)), np.zeros((outputs, terms))
    error, lengths = np.zeros(outputs), np.full(outputs, count)
    for i in range(outputs):
        for j in range(inputs):
            w = weights[i, j]
            for k in range(length[j]):
                p = w * high[j, k]
                e = fma(w, high[j, k], -p) + w * low[j, k]
                s = oh[i, k] + p
                t = s - oh[i, k]
                ol[i, k] += ((oh[i, k] - (s - t)) + (p - t)) + e
                oh[i, k] = s
            size = 0.0
            for k in range(length[j]):
                size += abs(high[j, k]) + abs(low[j, k])
            # As in a product: each low part is a sum of at most `inputs` errors.
            error[i] += abs(w) * (radius[j] + (inputs + 8) * (inputs + 8) * 8 * UNIT * UNIT * size)
        s, e = two_sum(oh[i, 0], bias[i])
        oh[i, 0] = s
        ol[i, 0] += e
        error[i] += MIDDLE * (abs(bias[i]) + abs(s))
        for k in range(count):
            oh[i, k], ol[i, k] = two_sum(oh[i, k], ol[i, k])
        error[i] = up(error[i])
    return oh, ol, error, lengths


@compiled
def clenshaw(ch, cl, a, b, terms):
    """Models of sum_k c_k T_k(a + b x), |a| + |b| <= 1 up to rounding, for each column of c.

    a and b are balls. The error of one step of the recurrence reaches the result times at most its
    number, because |U_j| <= j + 1.
    """
    count, columns = ch.shape
    line, line_low = np.array([2 * a[0], 2 * b[0]]), np.array([2 * a[1], 2 * b[1]])
    loose = 2 * (a[2] + b[2])
    oh, ol = np.zeros((columns, terms)), np.zeros((columns, terms))
    error, lengths = np.zeros(columns), np.full(columns, min(count, terms))
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    for i in range(columns):
        one, one_low = np.zeros(terms + 1), np.zeros(terms + 1)
        two, two_low = np.zeros(terms + 1), np.zeros(terms + 1)
        total = 0.0
        used = 1
        for k in range(count - 1, -1, -1):
            # b_k = c_k + 2 (a + b x) b_k+1 - b_k+2; at the end c_0 + (a + b x) b_1 - b_2
            share = 1.0 if k > 0 else 0.5
            made = multiply_series(line, line_low, 2, one, one_low, used, wide, rest, True)
            made += loose * size_of(one, one_low, used)
            grown = used + 1
            if grown > terms:
                made += abs(wide[terms]) + abs(rest[terms])
                grown = terms
            size = 0.0
            for c in range(grown):
                s, e = two_sum(share * wide[c], -two[c])
                e = e + (share * rest[c] - two_low[c])
                size += abs(wide[c]) + abs(two[c])
                two[c], two_low[c] = one[c], one_low[c]
                one[c], one_low[c] = two_sum(s, e)
            s, e = two_sum(one[0], ch[k, i])
            one[0], one_low[0] = two_sum(s, e + (one_low[0] + cl[k, i]))
            made += MIDDLE * (size + abs(ch[k, i]) + abs(one[0]))
            total += (k + 1) * made
            used = min(grown, terms)
        for c in range(min(used, terms)):
            oh[i, c], ol[i, c] = one[c], one_low[c]
        lengths[i] = min(used, terms)
        error[i] = up(total)
    return oh, ol, error, lengths


@compiled
def exact_products(series, readout):
    """series @ readout in twice float64, and bounds on the error of each column's sum."""
    rows, inner = series.shape
    columns = readout.shape[1]
    high, low, error = np.zeros((rows, columns)), np.zeros((rows, columns)), np.zeros(columns)
    for row in range(rows):
        for i in range(columns):
            h, m, size = 0.0, 0.0, 0.0
            for j in range(inner):
                p = series[row, j] * readout[j, i]
                e = fma(series[row, j], readout[j, i], -p)
                h, d = two_sum(h, p)
                m += d + e
                size += abs(p)
            high[row, i], low[row, i] = two_sum(h, m)
            error[i] += (inner + 8) * (inner + 8) * 2 * UNIT * UNIT * size
    for i in range(columns):
        error[i] = up(error[i])
    return high, low, error
