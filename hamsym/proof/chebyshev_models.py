"""Chebyshev models: polynomials of one variable with a radius, compiled.

A model of a function f on [-1, 1] is P = sum_k (h_k + l_k) T_k with float64 numbers h_k, l_k, and
a radius R with |f(x) - P(x)| <= R for all x in [-1, 1]. Without ``double`` all l_k are 0. Models
are rows of arrays ``high``, ``low`` (rows, terms), ``radius`` (rows,) and ``length`` (rows,), the
number of terms in use. ||P|| means sum_k |h_k| + |l_k|, which bounds |P|.

*Products.* T_i T_j = (T_i+j + T_|i-j|)/2. The terms of the first factor are taken from the last to
the first, so that small numbers are added first. With S_i = sum_{m>=i} |a_m| ||b||, the partial
sums of all coefficients have a size of at most S_i after term i, and each coefficient takes at most
three additions in each term. So the rounding errors sum up to at most

    2u ||a|| ||b|| + 3u sum_i S_i = u (2 ||a|| + 3 sum_i (i + 1) |a_i|) ||b||.

With ``double`` the sums of high parts are exact but for what goes to the low parts, whose size
after term i is at most 13u sum_{m>=i} S_m; its roundings, and products of low parts, which are left
out, sum up to at most 80 u^2 sum_i (i + 1)(i + 2)/2 |a_i| ||b||. A factor 1 + 2^-20 covers terms of
second order and the roundings of the bounds themselves, sums of fewer than 2^30 numbers >= 0. Terms
beyond the rows go to the radius.

*Integral* from -1: 10u ||c||, or 128 u^2 ||c||, bounds its roundings: c_k = (c_k-1 - c_k+1)/(2k)
takes two, and the value at -1 sums k |c_k| <= (|c_k-1| + |c_k+1|)/2.

*Functions.* A polynomial q that interpolates the function at Chebyshev points is a guess. It is
proven afterwards, by a residual:

- 1/f: with |1 - f q| <= e < 1, |1/f - q| <= ||q|| e/(1 - e).
- 1/sqrt(f): with |1 - f q^2| <= e < 1, f > 0 and q has no zero; if q(1) > 0, then
  |1/sqrt(f) - q| <= ||q|| ((1 - e)^-1/2 - 1) <= ||q|| e/(2 (1 - e)).
- g = exp(P): with s = q - q(-1) - integral(P' q) and d = g - q, v = d + s satisfies
  v' = P' (v - s), so |d| <= |s| + E (|d(-1)| + 2 ||P'|| |s|), E = exp(max P - min P). The radius
  of f = P + r adds |exp(r) - 1| |g|.
- sin(P), cos(P): the same for the pair, whose equation is a rotation, so that E = 1.
- functions with f' = g(P) P', such as log, atan or asin: integral(g P') + f(P(-1)), and r |g|.

*Angles* that depend on time alone are taken modulo 2 pi, once for a window (REDUCED_ANGLE).

Values at -1 are those of :mod:`hamsym.proof.ball_arithmetic`. (Brisebarre & Joldes 2010 introduced
such models; Brehard, Brisebarre & Joldes 2018 validate solutions of linear equations like exp.)
"""

from __future__ import annotations

import math

import numpy as np

from hamsym.proof.ball_arithmetic import (
    HALF_PI,
    MIDDLE,
    TINY,
    UNIT,
    absolute,
    add,
    arccosine,
    arcsine,
    arctangent,
    ball_of,
    compiled,
    error_function,
    exponential,
    fma,
    inlined,
    inverse_hyperbolic_cosine,
    inverse_hyperbolic_sine,
    inverse_hyperbolic_tangent,
    logarithm,
    multiply,
    negative,
    scaled,
    sine_cosine,
    two_sum,
)

HALVING = 1e-321  # error of halving the numbers of a series, which may be subnormal

ADD, SUBTRACT, NEGATE, MULTIPLY, RECIPROCAL, RECIPROCAL_ROOT, EXPONENTIAL, SINE_COSINE = range(8)
LOGARITHM, ARCTANGENT, ARCSINE, ARCCOSINE, ARSINH, ARCOSH, ARTANH, ERROR_FUNCTION = range(8, 16)
REDUCED_ANGLE = 16


@inlined
def up(value):
    return value * (1 + 2.0**-20) + TINY


@compiled
def size_of(high, low, count):
    """||P||, rounded up."""
    total = 0.0
    for k in range(count):
        total += abs(high[k]) + abs(low[k])
    return total * (1 + 2 * (count + 8) * UNIT)


@compiled
def finished(oh, ol, count, error):
    """A bound on errors, infinite beside coefficients that are not finite."""
    total = 0.0
    for k in range(count):
        total += abs(oh[k]) + abs(ol[k])
    return up(error) if total < math.inf else math.inf


@compiled
def multiply_series(ah, al, na, bh, bl, nb, oh, ol, double):
    """The product of two series in oh, ol; a bound on its rounding errors."""
    count = na + nb - 1
    for k in range(count):
        oh[k] = 0.0
        ol[k] = 0.0
    other = 0.0
    for k in range(nb):
        other += abs(bh[k]) + abs(bl[k])
    size = 0.0
    if not double:
        for i in range(na - 1, -1, -1):
            x = 0.5 * ah[i]
            size += (2 + 3 * (i + 1)) * abs(ah[i])
            if x == 0:
                continue
            for j in range(nb):
                oh[i + j] += x * bh[j]
            for j in range(min(i + 1, nb)):
                oh[i - j] += x * bh[j]
            for j in range(i + 1, nb):
                oh[j - i] += x * bh[j]
        return finished(oh, ol, count, UNIT * size * other + HALVING * other)
    for i in range(na - 1, -1, -1):
        x, y = 0.5 * ah[i], 0.5 * al[i]
        size += (i + 1) * (i + 2) / 2 * (abs(ah[i]) + abs(al[i]))
        if x == 0 and y == 0:
            continue
        for j in range(nb):
            p = x * bh[j]
            e = fma(x, bh[j], -p) + (x * bl[j] + y * bh[j])
            s = oh[i + j] + p
            t = s - oh[i + j]
            ol[i + j] += ((oh[i + j] - (s - t)) + (p - t)) + e
            oh[i + j] = s
        for j in range(min(i + 1, nb)):
            p = x * bh[j]
            e = fma(x, bh[j], -p) + (x * bl[j] + y * bh[j])
            s = oh[i - j] + p
            t = s - oh[i - j]
            ol[i - j] += ((oh[i - j] - (s - t)) + (p - t)) + e
            oh[i - j] = s
        for j in range(i + 1, nb):
            p = x * bh[j]
            e = fma(x, bh[j], -p) + (x * bl[j] + y * bh[j])
            s = oh[j - i] + p
            t = s - oh[j - i]
            ol[j - i] += ((oh[j - i] - (s - t)) + (p - t)) + e
            oh[j - i] = s
    for k in range(count):
        oh[k], ol[k] = two_sum(oh[k], ol[k])
    return finished(oh, ol, count, 80 * UNIT * UNIT * size * other + HALVING * other)


@compiled
def cut(oh, ol, count, terms):
    """The size of the terms beyond the rows."""
    rest = 0.0
    for k in range(terms, count):
        rest += abs(oh[k]) + abs(ol[k])
    return rest


@compiled
def integrate_series(ch, cl, count, oh, ol, double):
    """The integral from -1 in count + 1 terms; a bound on its rounding errors."""
    for k in range(count, 0, -1):
        h, m = ch[k - 1], cl[k - 1]
        if k == 1:
            h, m = 2 * h, 2 * m
        if k + 1 < count:
            s, e = two_sum(h, -ch[k + 1])
            h, m = two_sum(s, e + (m - cl[k + 1]))
        q = h / (2 * k)
        oh[k] = q
        ol[k] = (fma(-q, 2.0 * k, h) + m) / (2 * k) if double else 0.0
    value, rest = 0.0, 0.0
    for k in range(count, 0, -1):
        sign = 1.0 if k % 2 == 1 else -1.0
        s, e = two_sum(value, sign * oh[k])
        value = s
        rest += e + sign * ol[k]
    value, rest = two_sum(value, rest)
    oh[0] = value
    ol[0] = rest if double else 0.0
    size = size_of(ch, cl, count)
    return up((128 * UNIT * UNIT if double else 10 * UNIT) * size)


@compiled
def differentiate_series(ch, cl, count, oh, ol, double):
    """The derivative in count - 1 terms (at least one); a bound on its rounding errors."""
    oh[0] = 0.0
    ol[0] = 0.0
    weight = 0.0
    for k in range(count - 2, -1, -1):
        factor = 2.0 * (k + 1)
        p = factor * ch[k + 1]
        e = fma(factor, ch[k + 1], -p) + factor * cl[k + 1]
        h, m = p, e
        if k + 2 < count - 1:
            s, d = two_sum(h, oh[k + 2])
            h, m = two_sum(s, d + (m + ol[k + 2]))
        weight += (k / 2 + 1) * (abs(h) + abs(p))
        oh[k] = h
        ol[k] = m if double else 0.0
    oh[0] *= 0.5
    ol[0] *= 0.5
    return up((64 * UNIT * UNIT if double else 4 * UNIT) * weight)


@compiled
def end_value(high, low, count, end):
    """The value at -1 or 1 as a ball."""
    value, rest, weight, small = 0.0, 0.0, 0.0, 0.0
    for k in range(count - 1, -1, -1):
        sign = 1.0 if end > 0 or k % 2 == 0 else -1.0
        s, e = two_sum(value, sign * high[k])
        value = s
        rest += e + sign * low[k]
        weight += (k + 1) * abs(high[k])
        small += (k + 1) * abs(low[k])
    value, rest = two_sum(value, rest)
    return value, rest, up((count + 2) * UNIT * (UNIT * weight + small))


@inlined
def apply_table(table, vector, count, out):
    """out = table^T vector; table has a row for each entry of the vector."""
    for k in range(len(out)):
        out[k] = 0.0
    for j in range(count):
        x = vector[j]
        for k in range(len(out)):
            out[k] += x * table[j, k]


@compiled
def trim(vector):
    """Remove the round-off behind the last significant term, so that it can be corrected."""
    largest = 0.0
    for c in range(len(vector)):
        largest = max(largest, abs(vector[c]))
    for c in range(len(vector) - 1, 0, -1):
        if not abs(vector[c]) <= 4e-15 * largest:
            break
        vector[c] = 0.0


@compiled
def sum_models(high, low, radius, length, k, i, j, sign, double):
    """Row k becomes the sum of rows i and j, or their difference."""
    n = length[i]
    m = length[j]
    count = max(n, m)
    total = 0.0
    for c in range(count):
        a, b = (high[i, c] if c < n else 0.0), (sign * high[j, c] if c < m else 0.0)
        s, e = two_sum(a, b)
        if double:
            x, y = (low[i, c] if c < n else 0.0), (sign * low[j, c] if c < m else 0.0)
            total += (abs(a) + abs(b)) * MIDDLE
            s, e = two_sum(s, e + (x + y))
        else:
            total += abs(e)
            e = 0.0
        high[k, c], low[k, c] = s, e
    length[k] = count
    radius[k] = up(radius[i] + radius[j] + total)


@compiled
def negate_model(high, low, radius, length, k, i):
    """Row k becomes minus row i."""
    n = length[i]
    for c in range(n):
        high[k, c], low[k, c] = -high[i, c], -low[i, c]
    length[k], radius[k] = n, radius[i]


@compiled
def reduce_angle_model(high, low, radius, length, k, i):
    """Row k becomes row i minus the multiple of 2 pi that brings its middle near zero."""
    negate_model(high, low, radius, length, k, i)
    negate_model(high, low, radius, length, k, k)
    turn = scaled(HALF_PI, 4.0)
    turns = high[k, 0] / turn[0]
    if not abs(turns) <= 2.0**50:
        radius[k] = math.inf
        return
    count = float(math.floor(turns + 0.5))
    if count != 0:
        middle = (high[k, 0], low[k, 0], radius[k])
        middle = add(middle, negative(multiply(ball_of(count), turn)))
        high[k, 0], low[k, 0], radius[k] = middle


@compiled
def multiply_models(high, low, radius, length, k, i, j, double):
    """Row k becomes the product of rows i and j."""
    terms = high.shape[1]
    n = length[i]
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    m = length[j]
    error = multiply_series(high[i], low[i], n, high[j], low[j], m, wide, rest, double)
    error += cut(wide, rest, n + m - 1, terms)
    size, more_size = size_of(high[i], low[i], n), size_of(high[j], low[j], m)
    error += radius[i] * (more_size + radius[j]) + size * radius[j]
    count = min(n + m - 1, terms)
    for c in range(count):
        high[k, c], low[k, c] = wide[c], rest[c]
    length[k], radius[k] = count, up(error)


@compiled
def invert_model(values, series, high, low, radius, length, k, i, double):
    """Row k becomes 1/f of row i."""
    terms = high.shape[1]
    n = length[i]
    rounds = 3 if double else 1
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    other, other_low = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    points, more = np.zeros(terms), np.zeros(terms)
    nothing = np.zeros(terms)
    apply_table(values, high[i], n, points)
    for c in range(terms):
        points[c] = 1 / points[c]
    apply_table(series, points, terms, high[k])
    if double:
        trim(high[k])
    count = 1 if n == 1 else terms
    for c in range(terms):
        low[k, c] = 0.0
    for attempt in range(rounds):
        error = multiply_series(high[i], low[i], n, high[k], low[k], count, wide, rest, double)
        wide[0] -= 1
        if attempt < rounds - 1:
            for c in range(terms):
                more[c] = wide[c] + rest[c] if c < n + count - 1 else 0.0
            multiply_series(high[k], nothing, count, more, nothing, terms, other, other_low, False)
            for c in range(count):
                s, e = two_sum(high[k, c], -other[c])
                high[k, c], low[k, c] = two_sum(s, e + low[k, c])
    error += cut(wide, rest, n + count - 1, 0)
    size = size_of(high[k], low[k], count)
    error = up(error + radius[i] * size)
    if error < 0.5:
        radius[k] = up(size * error / (1 - error))
    else:
        radius[k] = math.inf
    length[k] = count


@compiled
def invert_root_model(values, series, high, low, radius, length, k, i, double):
    """Row k becomes 1/sqrt(f) of row i."""
    terms = high.shape[1]
    n = length[i]
    rounds = 3 if double else 1
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    other, other_low = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    points, more = np.zeros(terms), np.zeros(terms)
    nothing = np.zeros(terms)
    apply_table(values, high[i], n, points)
    for c in range(terms):
        points[c] = 1 / math.sqrt(points[c]) if points[c] > 0 else math.nan
    apply_table(series, points, terms, high[k])
    if double:
        trim(high[k])
    count = 1 if n == 1 else terms
    for c in range(terms):
        low[k, c] = 0.0
    for attempt in range(rounds):
        # f q first, with its own rounding and without a radius; then q (f q)
        error = multiply_series(high[i], low[i], n, high[k], low[k], count, wide, rest, double)
        error += cut(wide, rest, n + count - 1, terms)
        width = min(n + count - 1, terms)
        for c in range(width):
            other[c], other_low[c] = wide[c], rest[c]
        size = size_of(high[k], low[k], count)
        error = error * size + multiply_series(
            high[k], low[k], count, other, other_low, width, wide, rest, double
        )
        wide[0] -= 1
        if attempt < rounds - 1:
            for c in range(terms):
                more[c] = 0.5 * (wide[c] + rest[c]) if c < width + count - 1 else 0.0
            multiply_series(high[k], nothing, count, more, nothing, terms, other, other_low, False)
            for c in range(count):
                s, e = two_sum(high[k, c], -other[c])
                high[k, c], low[k, c] = two_sum(s, e + low[k, c])
    error += cut(wide, rest, width + count - 1, 0)
    size = size_of(high[k], low[k], count)
    error = up(error + radius[i] * size * size)
    end = end_value(high[k], low[k], count, 1)
    if error < 0.5 and end[0] - abs(end[1]) - end[2] > 0:
        radius[k] = up(size * error / (2 * (1 - error)))
    else:
        radius[k] = math.inf
    length[k] = count


@compiled
def exponential_model(values, series, high, low, radius, length, k, i, double):
    """Row k becomes exp(f) of row i."""
    terms = high.shape[1]
    n = length[i]
    rounds = 3 if double else 1
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    slope, slope_low = np.zeros(terms + 1), np.zeros(terms + 1)
    other, other_low = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    points, more = np.zeros(terms), np.zeros(terms)
    flat = n == 1
    count = 1 if flat else terms
    slope_error = differentiate_series(high[i], low[i], n, slope, slope_low, double)
    steep = size_of(slope, slope_low, max(n - 1, 1)) + slope_error
    width = max(n - 1, 1)
    start = end_value(high[i], low[i], n, -1)
    apply_table(values, high[i], n, points)
    for c in range(terms):
        points[c] = math.exp(points[c])
    apply_table(series, points, terms, high[k])
    if double:
        trim(high[k])
    for c in range(terms):
        low[k, c] = 0.0
    head = exponential(start)
    spread = up(2 * (size_of(high[i], low[i], n) - abs(high[i, 0]) * (1 - 8 * UNIT)))
    growth = exponential(ball_of(min(spread, 1e6)))
    grown = absolute(growth)
    defect = 0.0
    for attempt in range(rounds):
        error = multiply_series(slope, slope_low, width, high[k], low[k], count, wide, rest, double)
        error += slope_error * size_of(high[k], low[k], count)
        product = width + count - 1
        if flat:
            wide[0], rest[0] = 0.0, 0.0
        error = 2 * error + integrate_series(wide, rest, product, other, other_low, double)
        # s = q - q(-1) - integral, then without its value at -1
        for c in range(product + 1):
            if c < count:
                s, e = two_sum(high[k, c], -other[c])
                error += UNIT * (abs(e) + abs(low[k, c]) + abs(other_low[c])) * 3
                other[c], other_low[c] = two_sum(s, e + (low[k, c] - other_low[c]))
            else:
                other[c], other_low[c] = -other[c], -other_low[c]
        behind = end_value(other, other_low, product + 1, -1)
        other[0], other_low[0] = two_sum(other[0] - behind[0], other_low[0] - behind[1])
        error += behind[2] + UNIT * (abs(other[0]) + abs(behind[0])) * (8 * UNIT if double else 2)
        defect = error + size_of(other, other_low, product + 1)
        begin = end_value(high[k], low[k], count, -1)
        apart = add(head, negative(begin))
        if attempt < rounds - 1:
            # d = -s + q (d(-1)/q(-1) - integral(P' s / q)) at the points
            apply_table(values, other, min(product + 1, terms), points)
            apply_table(values, slope, width, more)
            corrected = np.empty(terms)
            apply_table(values, high[k], count, corrected)
            for c in range(terms):
                more[c] = more[c] * points[c] / corrected[c]
            inner, inner_low = np.zeros(terms), np.zeros(terms)
            apply_table(series, more, terms, inner)
            integrate_series(inner, inner_low, terms - 1, wide, rest, False)
            apply_table(values, wide, terms, more)
            first = (apart[0] + apart[1]) / begin[0]
            for c in range(terms):
                points[c] = corrected[c] * (first - more[c]) - points[c]
            apply_table(series, points, terms, inner)
            for c in range(count):
                s, e = two_sum(high[k, c], inner[c])
                high[k, c], low[k, c] = two_sum(s, e + low[k, c])
    defect = up(defect)
    error = up(defect + grown * (absolute(apart) + 2 * steep * defect))
    size = size_of(high[k], low[k], count) + error
    if radius[i] <= 1:
        error += size * radius[i] * 2
    else:
        error = math.inf
    radius[k], length[k] = up(error), count


@compiled
def sine_cosine_models(values, series, high, low, radius, length, k, i, j, double):
    """Rows k and j become sin(f) and cos(f) of row i."""
    terms = high.shape[1]
    n = length[i]
    rounds = 3 if double else 1
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    slope, slope_low = np.zeros(terms + 1), np.zeros(terms + 1)
    other, other_low = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    points, more = np.zeros(terms), np.zeros(terms)
    flat = n == 1
    count = 1 if flat else terms
    slope_error = differentiate_series(high[i], low[i], n, slope, slope_low, double)
    steep = size_of(slope, slope_low, max(n - 1, 1)) + slope_error
    width = max(n - 1, 1)
    start = end_value(high[i], low[i], n, -1)
    apply_table(values, high[i], n, points)
    for c in range(terms):
        more[c] = math.cos(points[c])
        points[c] = math.sin(points[c])
    apply_table(series, points, terms, high[k])
    apply_table(series, more, terms, high[j])
    if double:
        trim(high[k])
        trim(high[j])
    for c in range(terms):
        low[k, c] = 0.0
        low[j, c] = 0.0
    head, beside = sine_cosine(start)
    defects = np.zeros(2)
    aparts = np.zeros((2, 2))
    distance = 0.0
    kept = np.zeros((2, terms))
    for attempt in range(rounds):
        for part in range(2):
            one, two = (k, j) if part == 0 else (j, k)
            sign = 1.0 if part == 0 else -1.0
            error = multiply_series(
                slope, slope_low, width, high[two], low[two], count, wide, rest, double
            )
            error += slope_error * size_of(high[two], low[two], count)
            product = width + count - 1
            if flat:
                wide[0], rest[0] = 0.0, 0.0
            error = 2 * error + integrate_series(wide, rest, product, other, other_low, double)
            for c in range(product + 1):
                o, p = sign * other[c], sign * other_low[c]
                if c < count:
                    s, e = two_sum(high[one, c], -o)
                    error += UNIT * (abs(e) + abs(low[one, c]) + abs(p)) * 3
                    other[c], other_low[c] = two_sum(s, e + (low[one, c] - p))
                else:
                    other[c], other_low[c] = -o, -p
            behind = end_value(other, other_low, product + 1, -1)
            other[0], other_low[0] = two_sum(other[0] - behind[0], other_low[0] - behind[1])
            error += behind[2] + UNIT * (abs(other[0]) + abs(behind[0])) * (
                8 * UNIT if double else 2
            )
            defects[part] = error + size_of(other, other_low, product + 1)
            for c in range(terms):
                kept[part, c] = other[c] if c < product + 1 else 0.0
            begin = end_value(high[one], low[one], count, -1)
            apart = add(head if part == 0 else beside, negative(begin))
            aparts[part, 0] = apart[0] + apart[1]
            aparts[part, 1] = absolute(apart)
        if attempt < rounds - 1:
            # In the rotating frame: (d + s) = M k, M = [[c, s], [-s, c]],
            # k' = -P' M^T (s_c, -s_s)
            fs, fc = np.empty(terms), np.empty(terms)
            ds, dc = np.empty(terms), np.empty(terms)
            apply_table(values, high[k], count, fs)
            apply_table(values, high[j], count, fc)
            apply_table(values, kept[0], terms, ds)
            apply_table(values, kept[1], terms, dc)
            apply_table(values, slope, width, more)
            g1, g2 = np.empty(terms), np.empty(terms)
            for c in range(terms):
                # v_s' = P' (v_c - s_c), v_c' = -P' (v_s - s_s)
                a, b = -more[c] * dc[c], more[c] * ds[c]
                g1[c] = fc[c] * a - fs[c] * b
                g2[c] = fs[c] * a + fc[c] * b
            inner, inner_low = np.zeros(terms), np.zeros(terms)
            apply_table(series, g1, terms, inner)
            integrate_series(inner, inner_low, terms - 1, wide, rest, False)
            apply_table(values, wide, terms, g1)
            apply_table(series, g2, terms, inner)
            integrate_series(inner, inner_low, terms - 1, wide, rest, False)
            apply_table(values, wide, terms, g2)
            s0, c0 = head[0], beside[0]
            a0 = c0 * aparts[0, 0] - s0 * aparts[1, 0]
            b0 = s0 * aparts[0, 0] + c0 * aparts[1, 0]
            for c in range(terms):
                a, b = g1[c] + a0, g2[c] + b0
                points[c] = fc[c] * a + fs[c] * b - ds[c]
                more[c] = -fs[c] * a + fc[c] * b - dc[c]
            apply_table(series, points, terms, inner)
            for c in range(count):
                s, e = two_sum(high[k, c], inner[c])
                high[k, c], low[k, c] = two_sum(s, e + low[k, c])
            apply_table(series, more, terms, inner)
            for c in range(count):
                s, e = two_sum(high[j, c], inner[c])
                high[j, c], low[j, c] = two_sum(s, e + low[j, c])
    distance = up(aparts[0, 1] + aparts[1, 1])
    defect = up(defects[0] + defects[1])
    error = up(defect + distance + 2 * steep * defect + radius[i])
    radius[k], length[k] = error, count
    radius[j], length[j] = error, count


@compiled
def value_of(operation, start):
    """The value at a ball of a function with a known derivative."""
    if operation == LOGARITHM:
        return logarithm(start)
    if operation == ARCTANGENT:
        return arctangent(start)
    if operation == ARCSINE:
        return arcsine(start)
    if operation == ARCCOSINE:
        return arccosine(start)
    if operation == ARSINH:
        return inverse_hyperbolic_sine(start)
    if operation == ARCOSH:
        return inverse_hyperbolic_cosine(start)
    if operation == ARTANH:
        return inverse_hyperbolic_tangent(start)
    return error_function(start)


@compiled
def integrate_model(operation, high, low, radius, length, k, i, j, double):
    """Row k becomes a function of row i with f' = g(P) P', the model of g in row j."""
    terms = high.shape[1]
    n = length[i]
    wide, rest = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    slope, slope_low = np.zeros(terms + 1), np.zeros(terms + 1)
    other, other_low = np.zeros(2 * terms + 2), np.zeros(2 * terms + 2)
    m = length[j]
    slope_error = differentiate_series(high[i], low[i], n, slope, slope_low, double)
    width = max(n - 1, 1)
    error = multiply_series(high[j], low[j], m, slope, slope_low, width, wide, rest, double)
    size = size_of(high[j], low[j], m) + radius[j]
    error += slope_error * size + radius[j] * size_of(slope, slope_low, width)
    product = m + width - 1
    error = 2 * error + integrate_series(wide, rest, product, other, other_low, double)
    start = end_value(high[i], low[i], n, -1)
    head = value_of(operation, start)
    total = add((other[0], other_low[0], 0.0), head)
    other[0] = total[0]
    other_low[0] = total[1] if double else 0.0
    if not double:
        error += abs(total[1])
    error += total[2] + cut(other, other_low, product + 1, terms) + radius[i] * size
    count = min(product + 1, terms)
    for c in range(count):
        high[k, c], low[k, c] = other[c], other_low[c]
    radius[k], length[k] = up(error), count


@compiled
def run_models(program, values, series, high, low, radius, length, double):
    """Run a program on models, in place.

    Parameters
    ----------
    program : numpy.ndarray
        Rows (operation, target, first, second).
    values, series : numpy.ndarray
        Shape (terms, terms): values[k, j] = T_k at point j, series[j, k] the inverse.
    high, low : numpy.ndarray
        Shape (rows, terms).
    radius, length : numpy.ndarray
        Shape (rows,).
    double : bool
    """
    for step in range(len(program)):
        operation, k, i, j = program[step]
        if operation <= SUBTRACT:
            sign = 1.0 if operation == ADD else -1.0
            sum_models(high, low, radius, length, k, i, j, sign, double)
        elif operation == NEGATE:
            negate_model(high, low, radius, length, k, i)
        elif operation == MULTIPLY:
            multiply_models(high, low, radius, length, k, i, j, double)
        elif operation == REDUCED_ANGLE:
            reduce_angle_model(high, low, radius, length, k, i)
        elif operation == RECIPROCAL:
            invert_model(values, series, high, low, radius, length, k, i, double)
        elif operation == RECIPROCAL_ROOT:
            invert_root_model(values, series, high, low, radius, length, k, i, double)
        elif operation == EXPONENTIAL:
            exponential_model(values, series, high, low, radius, length, k, i, double)
        elif operation == SINE_COSINE:
            sine_cosine_models(values, series, high, low, radius, length, k, i, j, double)
            if not radius[j] < math.inf:
                radius[j] = math.inf
        else:
            integrate_model(operation, high, low, radius, length, k, i, j, double)
        if not radius[k] < math.inf:
            radius[k] = math.inf
