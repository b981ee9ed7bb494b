"""Evaluation of networks z^ = z_a + f(t) N(t, y) over a box, with numpy or torch.

The protocol of maps is described in :mod:`hamsym.flow_maps.expansion`.
"""

import numpy as np

from hamsym.flow_maps.expansion import affine, starts, starts_and_slopes

ENVELOPES = ("exponential", "linear")
QUERIES = 4_096  # through the network at once, to stay in the cache


class NetworkMap:
    """A network over a box, exact at its start: z^ = z_a + f(t) N(s, y).

    N has layers of sines. Its inputs are the time s = 2 (t - t_a) / length - 1 and the scaled
    inputs y = scaling @ inputs + shift. With the unit of time tau, f = (t - t_a) / tau for the
    envelope "linear" and f = 1 - exp(-(t - t_a) / tau) for "exponential". The start is
    z_a = selection @ inputs + offset + sum_nu start[nu] T_nu(y), with the multi-indices
    ``start_degrees``. ``layers`` are pairs (matrix, bias); the last layer is linear.
    """

    def __init__(
        self,
        begin,
        length,
        tau,
        envelope,
        scaling,
        shift,
        selection,
        offset,
        start_degrees,
        start,
        layers,
    ):
        self.begin, self.length, self.tau, self.envelope = begin, length, tau, envelope
        self.scaling, self.shift = scaling, shift
        self.selection, self.offset = selection, offset
        self.start_degrees, self.start = start_degrees, start
        self.layers = layers

    def describe(self):
        """Return what the arrays do not contain, as values of JSON."""
        return {
            "form": "network",
            "begin": float(self.begin),
            "length": float(self.length),
            "tau": float(self.tau),
            "envelope": self.envelope,
            "layers": len(self.layers),
        }

    def arrays(self):
        """Return all arrays that define the map, by name."""
        own = ("scaling", "shift", "selection", "offset", "start_degrees", "start")
        found = {name: getattr(self, name) for name in own}
        for number, (matrix, bias) in enumerate(self.layers):
            found |= {f"{number}.matrix": matrix, f"{number}.bias": bias}
        return found

    def evaluate(self, t, inputs, xp=np):
        parts = [
            self.states(t[first : first + QUERIES], inputs[first : first + QUERIES], xp)
            for first in range(0, max(len(t), 1), QUERIES)
        ]
        return parts[0] if len(parts) == 1 else xp.concatenate(parts)

    def states(self, t, inputs, xp):
        """Return z^ for a few queries."""
        y = affine(inputs, self.scaling, self.shift, xp)
        states = starts(self, inputs, y, xp)
        times = t - self.begin
        h = xp.concatenate((self.scaled_time(times)[:, None], y), 1)
        *hidden, (matrix, bias) = self.layers
        for weights, shift in hidden:
            h = xp.sin(affine(h, weights, shift, xp))
        return states + self.factor(times, xp)[0][:, None] * affine(h, matrix, bias, xp)

    def derivatives(self, t, inputs):
        parts = [
            self.slopes(t[first : first + QUERIES], inputs[first : first + QUERIES])
            for first in range(0, max(len(t), 1), QUERIES)
        ]
        return tuple(np.concatenate(found) for found in zip(*parts, strict=True))

    def slopes(self, t, inputs):
        """Return z^ and its derivatives for a few queries."""
        y = affine(inputs, self.scaling, self.shift)
        states, jacobian = starts_and_slopes(self, inputs, y)
        times = t - self.begin
        h = np.concatenate((self.scaled_time(times)[:, None], y), axis=1)
        # The derivatives in s and in y are along the first axis.
        along = np.repeat(np.eye(h.shape[1])[:, None], len(h), axis=1)
        *hidden, (matrix, bias) = self.layers
        for weights, shift in hidden:
            a = affine(h, weights, shift)
            h, along = np.sin(a), np.cos(a) * (along @ weights.T)
        value, along = affine(h, matrix, bias), along @ matrix.T
        f, rate = (part[:, None] for part in self.factor(times, np))
        jacobian += f[:, None] * (np.moveaxis(along[1:], 0, -1) @ self.scaling)
        return states + f * value, rate * value + f * (2 / self.length) * along[0], jacobian

    def scaled_time(self, times):
        """Return times, counted from t_a, scaled to [-1, 1]."""
        return 2 * times / self.length - 1

    def factor(self, times, xp):
        """Return f and its derivative."""
        if self.envelope == "linear":
            return times / self.tau, xp.ones_like(times) / self.tau
        f = -xp.expm1(-times / self.tau)
        return f, (1 - f) / self.tau
