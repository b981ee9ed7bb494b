"""Flow maps z^(t; z0, parameters): one closed form for all starts in a box."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

import hamsym
from hamsym.errors import InputError
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.compiled_piece import MAPS
from hamsym.flow_maps.judging import Judgement
from hamsym.flow_maps.time_order import require_inputs, require_order
from hamsym.hamiltonian import Hamiltonian
from hamsym.parallel.threads import Threads, slices
from hamsym.solution.times import is_tensor, times_in_span
from hamsym.support.record_fields import AnyFloat, Count, Size, floats
from hamsym.support.records import packed
from hamsym.support.shown import Drawn, Saved
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.validation import checked_numbers

_QUERIES = 10_000  # for each core, from which on several are used


@suggest_attributes
@dataclass(frozen=True, eq=False)
class FlowMap(Drawn, Saved):
    """All trajectories from a box of initial states and parameters, as one function.

    Call it with times, initial states and parameters to get states; see :meth:`__call__`.

    ``plot()`` draws the box in phase planes at six times if all components vary, otherwise the
    range of each component over time with eight trajectories; ``plot("x")`` the range of one
    component, ``plot("x", "p")`` the box in the plane of two.

    Attributes
    ----------
    region : Box
        What varies.
    span : (float, float)
        Times for which the map holds; it ends early where solutions fail.
    map : Leg, Chain or Split
        The closed form, in the inputs ``inputs``.
    tol : float
        The tolerance that was asked for.
    success : bool
        Whether the estimated error over the whole box and span is within the tolerance.
    message : str
        Outcome, with the worst place found.
    largest_error : numpy.ndarray
        Estimated largest error of each component over the box and the span, shape (dim,); see
        :mod:`hamsym.flow_maps.judging`.
    excess : float
        Largest ratio of the estimated to the allowed error.
    judgement : Judgement
        How the error was estimated: places, worst place, confidence, symplecticity.
    solutions : int
        Number of solutions from which the map was made.
    seconds : float
        Wall time of the construction, without the judgement.
    """

    region: Box
    span: tuple[float, float]
    map: Annotated[Any, MAPS]
    tol: float
    success: bool
    message: str
    largest_error: Annotated[np.ndarray, floats("dim", finite=False)]
    excess: AnyFloat
    judgement: Judgement
    solutions: Count
    seconds: Size

    def check(self) -> None:
        """Raise ValueError unless its parts follow each other, and success has an error."""
        require_order(self.map, self.span)
        require_inputs(self.map, self.H.dim, len(self.inputs))
        if self.success and not (self.excess <= 1 and np.isfinite(self.largest_error).all()):
            raise ValueError("its success is true, but its error is not within the tolerance")

    def __repr__(self) -> str:
        start, end = self.span
        intervals = ", ".join(
            f"{name} in [{low:.6g}, {high:.6g}]"
            for name, low, high in zip(self.inputs, self.region.low, self.region.high, strict=True)
        )
        return (
            f"FlowMap({self.H.formulas!r}, {intervals}, t from {start:.6g} to {end:.6g}: "
            f"{'success' if self.success else 'no success'}, {self.message})"
        )

    @property
    def H(self) -> Hamiltonian:
        """The Hamiltonian; parameters that vary have the centres of their intervals."""
        return self.region.H

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of what varies: components of z0, then parameters."""
        return self.region.names

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """Interval of each input, by name."""
        low, high = self.region.low.tolist(), self.region.high.tolist()
        return dict(zip(self.inputs, zip(low, high, strict=True), strict=True))

    @property
    def fixed(self) -> dict[str, float]:
        """Components of z0, and parameters, that do not vary."""
        varied = {*self.inputs}
        values = {k: v for k, v in self.H.parameters.items() if k not in varied}
        return {**self.region.fixed, **values}

    @property
    def symplecticity(self) -> float | None:
        """Largest entry of M^T J M - J, M = dz^/dz0; see :class:`Judgement`."""
        return self.judgement.symplecticity

    @property
    def nbytes(self) -> int:
        """Bytes of the numbers that define the map."""
        arrays, _ = packed(self)
        return sum(array.nbytes for name, array in arrays.items() if name.startswith("map."))

    # -- evaluation --------------------------------------------------------------------------

    def __call__(
        self,
        t: Any,
        z0: Any = None,
        parameters: Mapping[Any, Any] | None = None,
        *,
        extrapolate: bool = False,
    ) -> Any:
        """Return the states z^(t; z0, parameters).

        Parameters
        ----------
        t : float or array
            Times, shape (n,) or any other.
        z0 : array or mapping, optional
            Initial states, shape (n, dim) in the order of H.z, or a mapping of components to
            numbers and arrays. Components that do not vary may be left out of a mapping.
        parameters : mapping, optional
            A number or an array for each parameter that varies.
        extrapolate : bool
            Allow queries outside the box and the span, where nothing is known of the error.

        Returns
        -------
        numpy.ndarray or torch.Tensor
            Shape (n, dim): all arguments are broadcast to one shape (n,). A tensor if an argument
            is one; it is differentiable in t, z0 and the parameters.

        Raises
        ------
        InputError
            If an argument is missing, unknown, or outside the box or the span.

        Examples
        --------
        >>> flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 3), tol=1e-8)
        >>> flow([1.0, 2.0], {"x": 1.5, "p": 0.0}).shape
        (2, 2)
        >>> bool(abs(flow(3.0, [2.0, 0.0])[0] - 2 * np.cos(3)) < 1e-8)
        True
        """
        given = self.region.inputs_of(z0, parameters)
        if is_tensor(t) or any(map(is_tensor, given.values())):
            return self._tensors(t, given, extrapolate)
        return self._values(self.map.evaluate, t, given, extrapolate)

    def jacobian(
        self,
        t: Any,
        z0: Any = None,
        parameters: Mapping[Any, Any] | None = None,
        *,
        extrapolate: bool = False,
    ) -> np.ndarray:
        """Return the derivatives of the states in the inputs, shape (n, dim, len(inputs)).

        The columns are in the order of ``inputs``: components of z0, then parameters.

        Parameters
        ----------
        t, z0, parameters, extrapolate
            As of :meth:`__call__`.

        Examples
        --------
        >>> flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 3), tol=1e-8)
        >>> flow.jacobian(np.pi / 2, [1.5, 0.5]).round(6) + 0.0
        array([[ 0.,  1.],
               [-1.,  0.]])
        """
        given = self.region.inputs_of(z0, parameters)
        return self._values(lambda *part: self.map.derivatives(*part)[2], t, given, extrapolate)

    def rate(
        self,
        t: Any,
        z0: Any = None,
        parameters: Mapping[Any, Any] | None = None,
        *,
        extrapolate: bool = False,
    ) -> np.ndarray:
        """Return dz^/dt, shape (n, dim); arguments as of :meth:`__call__`."""
        given = self.region.inputs_of(z0, parameters)
        return self._values(lambda *part: self.map.derivatives(*part)[1], t, given, extrapolate)

    def _values(
        self,
        function: Callable[[np.ndarray, np.ndarray], np.ndarray],
        t: Any,
        given: Mapping[str, Any],
        extrapolate: bool,
    ) -> np.ndarray:
        """Return a function of times and inputs at queries; many are divided among all cores."""
        times, inputs, shape = self._queries(t, given, extrapolate)
        with Threads(len(times) // _QUERIES) as threads:
            parts = slices(len(times), threads.cores)
            results = threads.results(lambda part: function(times[part], inputs[part]), parts)
            found = np.concatenate([result for _, result in results])
        return found.reshape(*shape, *found.shape[1:])

    def _queries(
        self, t: Any, given: Mapping[str, Any], extrapolate: bool
    ) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
        """Return times, shape (n,), inputs, shape (n, d), and their shape as it was given."""
        arrays = [checked_numbers(f"'{name}'", value) for name, value in {"t": t, **given}.items()]
        try:
            times, *columns = np.broadcast_arrays(*arrays)
        except ValueError:
            shapes = ", ".join(
                f"{name} {array.shape}" for name, array in zip(("t", *given), arrays, strict=True)
            )
            raise InputError(
                f"shapes do not broadcast: {shapes}; give arrays of one shape"
            ) from None
        inputs = np.stack([column.ravel() for column in columns], axis=-1)
        self._check(times.ravel(), inputs, extrapolate)
        return times.ravel(), inputs, times.shape

    def _tensors(self, t: Any, given: Mapping[str, Any], extrapolate: bool) -> Any:
        import torch  # slow to import; the caller has a tensor

        tensors = [value for value in (t, *given.values()) if is_tensor(value)]
        like = {"dtype": torch.float64, "device": tensors[0].device}
        columns = torch.broadcast_tensors(
            *(torch.as_tensor(v, **like) for v in (t, *given.values()))
        )
        shape, flat = columns[0].shape, [column.reshape(-1) for column in columns]
        inputs = torch.stack(flat[1:], dim=-1)
        self._check(flat[0].detach().cpu().numpy(), inputs.detach().cpu().numpy(), extrapolate)
        return self.map.evaluate(flat[0], inputs, torch).reshape(*shape, self.H.dim)

    def _check(self, times: np.ndarray, inputs: np.ndarray, extrapolate: bool) -> None:
        """Raise InputError unless all queries are finite, and inside the box and the span."""
        if not (np.isfinite(times).all() and np.isfinite(inputs).all()):
            raise InputError("t, z0 or a parameter is not finite; give finite numbers")
        if extrapolate:
            return
        times_in_span(times, self.span)
        outside = self.region.outside(inputs)
        if outside.any():
            query, column = np.argwhere(outside)[0]
            raise InputError(
                f"{self.inputs[column]} = {inputs[query, column]:.16g} is outside the box, from "
                f"{self.region.low[column]:.16g} to {self.region.high[column]:.16g}; give a value "
                "inside it, or extrapolate=True"
            )

    # -- proofs ------------------------------------------------------------------------------

    def certify(
        self,
        box: Mapping[str, tuple[float, float]] | None = None,
        time_limit: float | None = None,
        max_parts: int = 4_096,
    ) -> hamsym.BoxCertificate:
        """Compute a rigorous bound on the error for all starts and parameters in a box.

        The defect of the map is enclosed over the whole box by Taylor models, and what becomes of
        it by the linear equation of the error with a bound on the second order
        (:mod:`hamsym.proof.boxes.box_proof`); every rounding is included. Maps of one leg, chains
        of legs and splits are proven alike. It reaches as far as the map is much more accurate than
        the distance over which H is nonlinear, with up to four or so inputs.

        Parameters
        ----------
        box : mapping, optional
            Intervals (low, high) of some inputs, within those of the map; by default all of it.
        time_limit : float, optional
            Seconds.
        max_parts : int
            Largest number of parts into which the box is cut.

        Returns
        -------
        BoxCertificate

        Raises
        ------
        CertificationError
            If there is no bound: errors grow too fast, H is not smooth somewhere in the box, or a
            limit is reached. The message gives the place and a remedy.

        Examples
        --------
        >>> flow = hamsym.flow_map("p**2/2 + x**2/2", {"x": (1, 2), "p": (-1, 1)}, (0, 3), tol=1e-8)
        >>> certificate = flow.certify()
        >>> len(certificate.bound), max(certificate.bound) < 1e-8
        (2, True)
        """
        return hamsym.certify(self, box=box, time_limit=time_limit, max_parts=max_parts)
