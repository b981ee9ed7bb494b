"""Evaluation of expansions z^ = z_a + (t - t_a) N(t, y) over a box, with numpy or torch.

``xp`` is the module numpy or torch; queries are along the first axis. The inputs are what varies in
the box, and y are the inputs scaled to [-1, 1]; T_nu(y) = prod_k T_{nu_k}(y_k) are products of
Chebyshev polynomials with multi-indices nu, the rows of ``degrees``.

Leg, Chain and Split have two methods. ``evaluate(t, inputs, xp)`` returns z^ at times of shape (n,)
for inputs of shape (n, d); ``derivatives(t, inputs)`` returns z^, dz^/dt and dz^/d(inputs), of
shapes (n, dim), (n, dim) and (n, dim, d), with numpy.
"""

import numpy as np

CHUNK = 8_192  # queries at once


class Piece:
    """N over a part of the time, of low rank: sum_r W_r(y) phi_r(t).

    The readouts are W_r(y) = sum_nu readouts[nu, r] T_nu(y). The columns phi_r have the Chebyshev
    series ``columns[r, n, i]`` in time, for component i of the state.
    """

    def __init__(self, degrees, readouts, columns):
        self.degrees, self.readouts, self.columns = degrees, readouts, columns

    def states(self, time, y, xp):
        """Return N at scaled times and inputs."""
        values = products(self.degrees, tables(self.degrees, y, xp))
        series = chebyshev_table(time, self.columns.shape[1], xp)
        readouts = array_of(self.readouts, y, xp).T @ values
        columns = array_of(self.columns, y, xp)
        parts = [(readouts * (columns[:, :, i] @ series)).sum(0) for i in range(columns.shape[2])]
        return xp.stack(parts).T


class Leg:
    """A trial solution over a box, exact at its start: z^ = z_a + (t - t_a) N(t, y).

    The scaled inputs are y = scaling @ inputs + shift. The start is
    z_a = selection @ inputs + offset + sum_nu start[nu] T_nu(y), with the multi-indices
    ``start_degrees``. ``edges`` are the ends of the pieces, counted from t_a = ``begin``.
    """

    def __init__(
        self, begin, edges, scaling, shift, selection, offset, start_degrees, start, pieces
    ):
        self.begin, self.edges, self.pieces = begin, edges, pieces
        self.scaling, self.shift = scaling, shift
        self.selection, self.offset = selection, offset
        self.start_degrees, self.start = start_degrees, start

    def evaluate(self, t, inputs, xp=np):
        y = affine(inputs, self.scaling, self.shift, xp)
        states = starts(self, inputs, y, xp)
        times = t - self.begin
        found = xp.zeros_like(states)
        for number, chosen in self.parts(times):
            time = self.scaled_time(number, times[chosen])
            found[chosen] = self.pieces[number].states(time, y[chosen], xp)
        return states + times[:, None] * found

    def derivatives(self, t, inputs):
        y = affine(inputs, self.scaling, self.shift)
        states, jacobian = starts_and_slopes(self, inputs, y)
        times, rates = t - self.begin, np.zeros_like(states)
        for number, chosen in self.parts(times):
            time = times[chosen]
            value, rate, slopes = self.pieces[number].derivatives(
                self.scaled_time(number, time), y[chosen]
            )
            rate *= 2 / (self.edges[number + 1] - self.edges[number])
            states[chosen] += time[:, None] * value
            rates[chosen] = value + time[:, None] * rate
            jacobian[chosen] += time[:, None, None] * (slopes @ self.scaling)
        return states, rates, jacobian

    def parts(self, times):
        """Yield the number of a piece and queries in it, in chunks."""
        yield from grouped(interval_numbers(self.edges, times), len(self.pieces))

    def scaled_time(self, number, times):
        """Return times of a piece, counted from t_a, scaled to [-1, 1]."""
        low, high = self.edges[number], self.edges[number + 1]
        return (2 * times - (low + high)) / (high - low)


class Chain:
    """Maps one after the other: each starts at the end of the one before.

    The inputs of the second and later ones are the state at its start and the parameters, which are
    the columns ``kept`` of the inputs. ``joints`` are the ends of all maps but the last.
    """

    def __init__(self, maps, joints, kept):
        self.maps, self.joints, self.kept = maps, joints, kept
        self.begin = maps[0].begin

    def evaluate(self, t, inputs, xp=np):
        numbers = interval_numbers([self.begin, *self.joints, None], t)
        parts, order, left = [], [], np.arange(len(numbers))
        kept = inputs[:, self.kept]
        for k, part in enumerate(self.maps):
            here, beyond = numbers[left] == k, numbers[left] > k
            parts.append(part.evaluate(t[left[here]], inputs[here], xp))
            order.append(left[here])
            if not beyond.any():
                break
            left = left[beyond]
            ends = xp.zeros_like(t[left]) + self.joints[k]
            states = part.evaluate(ends, inputs[beyond], xp)
            inputs = xp.concatenate((states, kept[left]), 1)
        return xp.concatenate(parts)[np.argsort(np.concatenate(order))]

    def derivatives(self, t, inputs):
        numbers = interval_numbers([self.begin, *self.joints, None], t)
        parts, order, left = [], [], np.arange(len(numbers))
        kept, count = inputs[:, self.kept], inputs.shape[1]
        through = np.repeat(np.eye(count)[None], len(t), axis=0)
        of_kept = np.eye(count)[self.kept]
        for k, part in enumerate(self.maps):
            here, beyond = numbers[left] == k, numbers[left] > k
            states, rates, jacobian = part.derivatives(t[left[here]], inputs[here])
            parts.append((states, rates, jacobian @ through[here]))
            order.append(left[here])
            if not beyond.any():
                break
            left = left[beyond]
            ends = np.full(len(left), self.joints[k])
            states, _, jacobian = part.derivatives(ends, inputs[beyond])
            inputs = np.concatenate((states, kept[left]), axis=1)
            rows = np.repeat(of_kept[None], len(left), axis=0)
            through = np.concatenate((jacobian @ through[beyond], rows), axis=1)
        places = np.argsort(np.concatenate(order))
        return tuple(np.concatenate(found)[places] for found in zip(*parts, strict=True))


class Split:
    """Two maps over two parts of a box: ``low`` where normal @ inputs is at most a threshold."""

    def __init__(self, normal, threshold, low, high):
        self.normal, self.threshold, self.low, self.high = normal, threshold, low, high
        self.begin = low.begin

    def evaluate(self, t, inputs, xp=np):
        first, second, places = self.sides(inputs)
        low = self.low.evaluate(t[first], inputs[first], xp)
        high = self.high.evaluate(t[second], inputs[second], xp)
        return xp.concatenate((low, high))[places]

    def derivatives(self, t, inputs):
        first, second, places = self.sides(inputs)
        low = self.low.derivatives(t[first], inputs[first])
        high = self.high.derivatives(t[second], inputs[second])
        return tuple(np.concatenate(parts)[places] for parts in zip(low, high, strict=True))

    def sides(self, inputs):
        """Return the queries of the lower side and of the other one, and the way back."""
        is_low = plain(inputs) @ self.normal <= self.threshold
        first, second = np.flatnonzero(is_low), np.flatnonzero(~is_low)
        return first, second, np.argsort(np.concatenate((first, second)))


def affine(inputs, matrix, shift, xp=np):
    """Return matrix @ inputs + shift for each query."""
    return inputs @ array_of(matrix, inputs, xp).T + array_of(shift, inputs, xp)


def starts(map, inputs, y, xp=np):
    """Return z_a of a leg or a domain, for inputs and their scaled values y."""
    states = affine(inputs, map.selection, map.offset, xp)
    if len(map.start):
        values = products(map.start_degrees, tables(map.start_degrees, y, xp))
        states = states + values.T @ array_of(map.start, y, xp)
    return states


def starts_and_slopes(map, inputs, y):
    """Return z_a and its derivatives in the inputs, of shapes (n, dim) and (n, dim, d)."""
    states = affine(inputs, map.selection, map.offset)
    jacobian = np.repeat(map.selection[None], len(y), axis=0)
    if len(map.start):
        values, *slopes = products_and_slopes(map.start_degrees, y)
        states += values.T @ map.start
        jacobian += np.stack([slope.T @ map.start for slope in slopes], axis=-1) @ map.scaling
    return states, jacobian


def tables(degrees, y, xp=np):
    """Return the Chebyshev polynomials of each component of y, up to its degree."""
    most = degrees.max(axis=0).tolist()
    return [chebyshev_table(y[:, k], most[k] + 1, xp) for k in range(len(most))]


def products(degrees, factors):
    """Return prod_k factors[k][nu_k], shape (n, queries): T_nu(y), if they are the tables."""
    found = factors[0][degrees[:, 0]]
    for k in range(1, len(factors)):
        found = found * factors[k][degrees[:, k]]
    return found


def products_and_slopes(degrees, y):
    """Return T_nu(y) and its derivatives in the components of y, each of shape (n, queries)."""
    factors = tables(degrees, y)
    found = [products(degrees, factors)]
    for k, table in enumerate(factors):
        slope = chebyshev_slopes(y[:, k], table)
        found.append(products(degrees, [*factors[:k], slope, *factors[k + 1 :]]))
    return found


def chebyshev_table(x, count, xp=np):
    """Return T_0 to T_(count - 1) at x, shape (count, queries)."""
    found = xp.stack((xp.ones_like(x), x))
    while len(found) < count:
        # T_(k+j) = 2 T_k T_j - T_(k-j) doubles the table.
        k = len(found) - 1
        more = 2 * found[k] * found[1:] - found[np.arange(k - 1, -1, -1)]
        found = xp.concatenate((found, more))
    return found[:count]


def chebyshev_slopes(x, table):
    """Return the derivatives of a table of T_0, T_1, ... at x."""
    found = np.stack((np.zeros_like(x), np.ones_like(x)))
    while len(found) < len(table):
        k = len(found) - 1
        values = table[: k + 1]
        last = found[k] * values[1:] + values[k] * found[1:]
        found = np.concatenate((found, 2 * last - found[k - 1 :: -1]))[: len(table)]
    return found[: len(table)]


def interval_numbers(edges, t):
    """Return the interval in which each time is, shape (n,); outside, the first or the last one."""
    joints = np.array(edges[1:-1], dtype=float)
    sign = 1.0 if not len(joints) or joints[0] > edges[0] else -1.0
    return np.searchsorted(sign * joints, sign * plain(t))


def grouped(numbers, count):
    """Yield the number of a piece and the queries with it, in chunks."""
    order = np.argsort(numbers, kind="stable")
    ends = np.searchsorted(numbers[order], np.arange(count + 1)).tolist()
    for number in range(count):
        for first in range(ends[number], ends[number + 1], CHUNK):
            yield number, order[first : min(first + CHUNK, ends[number + 1])]


def plain(values):
    """Return an array of numpy with the values of an array or tensor."""
    return values.detach().cpu().numpy() if hasattr(values, "detach") else values


def array_of(values, like, xp):
    """Return a constant as an array or tensor, of the type of another one."""
    return values if xp is np else xp.as_tensor(values, dtype=like.dtype, device=like.device)
