"""Loops of the integrators, appended to generated numba modules after the kernels of their H.

A module contains the sections that apply to its H, without the text above the first section.

``DOF`` and ``DIM`` are the numbers of coordinates and of components. Coordinates q and momenta p
have the types that ``read_q`` and ``read_p`` return. The other kernels are ``write``, ``shift``,
``shift_compensated``, ``velocity`` (dH/dp) and ``slope`` (dH/dq), with ``velocity_curvature``,
``slope_curvature``, ``shear_q`` and ``shear_p`` for tangent vectors, ``_velocity_jacobian`` and
``_slope_jacobian`` for implicit halves, and ``_gradient``, ``_vector_field``, ``_hessian`` and
``_rate_curvature`` at arrays of points. They take the parameters as the tuple that
``read_parameters`` returns. Functions here whose names begin with an underscore are called by
compiled code alone, so they have no wrappers, which take long to compile.
"""
# ruff: noqa: F821

import math

import numpy as np
from numba import njit

# -- integrators ---------------------------------------------------------------------------------
#
# Each loop advances states, shape (n, ...), by saves*save_every steps of length sizes[i]. The
# steps begin at time starts[i] + first*sizes[i]. After every save_every steps the states are
# written to out, shape (n, rows, DIM), from row offset on. low, shaped as the states, is the
# rounding error that compensated summation adds to the next step. columns, shape (n, ..., k),
# are tangent vectors, propagated by the derivative of the steps. done, shape (n, 2), counts
# steps, and evaluations where their number depends on iterations. parameters, shape (n, k), are
# the values of each trajectory.

# -- splitting -----------------------------------------------------------------------------------
#
# A stage is a row (drift, kick, time of the drift, time of the kick), in units of a step: q
# changes by drift*h*dH/dp, then p by -kick*h*dH/dq. A last kick of zero is skipped; a test of
# every coefficient would slow down short steps.


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def splitting(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    stages, parameters,
):  # fmt: skip
    """Splitting methods, one trajectory after the other; compensated where low is not None."""
    kicks = stages.shape[0] - (stages[-1, 1] == 0.0)
    rows = out.reshape(-1, DIM)
    for trajectory in range(states.shape[0]):
        h, start = sizes[trajectory], starts[trajectory]
        values = read_parameters(parameters, trajectory)
        q, p = read_q(states, trajectory), read_p(states, trajectory)
        if low is not None:
            q_low, p_low = read_q(low, trajectory), read_p(low, trajectory)
        for save in range(saves):
            for step in range(save_every):
                elapsed = first + save * save_every + step
                for stage in range(stages.shape[0]):
                    t = start + h * (elapsed + stages[stage, 2])
                    drift = h * stages[stage, 0]
                    change = velocity(q, p, t, values)
                    if low is None:
                        q = shift(q, drift, change)
                    else:
                        q, q_low = shift_compensated(q, q_low, drift, change)
                    if stage == kicks:
                        break
                    t = start + h * (elapsed + stages[stage, 3])
                    kick = -h * stages[stage, 1]
                    change = slope(q, p, t, values)
                    if low is None:
                        p = shift(p, kick, change)
                    else:
                        p, p_low = shift_compensated(p, p_low, kick, change)
            write(rows, trajectory * out.shape[1] + offset + save, q, p)
        write(states, trajectory, q, p)
        if low is not None:
            write(low, trajectory, q_low, p_low)
        done[trajectory, 0] += saves * save_every


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def splitting_ensemble(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    stages, parameters,
):  # fmt: skip
    """Splitting methods, 64 trajectories at a time; compensated where low is not None.

    Each flow is applied to all trajectories of a block: their arithmetic is independent, so the
    processor executes several at once.
    """
    lanes, low_lanes = np.empty((DIM, 64)).T, np.empty((DIM, 64)).T
    given = np.empty((parameters.shape[1], 64)).T
    rows = out.reshape(-1, DIM)
    for base in range(0, states.shape[0], 64):
        count = min(64, states.shape[0] - base)
        for lane in range(count):
            for component in range(DIM):
                lanes[lane, component] = states[base + lane, component]
                if low is not None:
                    low_lanes[lane, component] = low[base + lane, component]
            for parameter in range(parameters.shape[1]):
                given[lane, parameter] = parameters[base + lane, parameter]
        for save in range(saves):
            for step in range(save_every):
                elapsed = first + save * save_every + step
                for stage in range(stages.shape[0]):
                    drift, kick = stages[stage, 0], stages[stage, 1]
                    if drift != 0.0:
                        for lane in range(count):
                            h = sizes[base + lane]
                            t = starts[base + lane] + h * (elapsed + stages[stage, 2])
                            q, p = read_q(lanes, lane), read_p(lanes, lane)
                            values = read_parameters(given, lane)
                            change = velocity(q, p, t, values)
                            if low is None:
                                q = shift(q, h * drift, change)
                            else:
                                q_low = read_q(low_lanes, lane)
                                q, q_low = shift_compensated(q, q_low, h * drift, change)
                                write_q(low_lanes, lane, q_low)
                            write_q(lanes, lane, q)
                    if kick != 0.0:
                        for lane in range(count):
                            h = sizes[base + lane]
                            t = starts[base + lane] + h * (elapsed + stages[stage, 3])
                            q, p = read_q(lanes, lane), read_p(lanes, lane)
                            values = read_parameters(given, lane)
                            change = slope(q, p, t, values)
                            if low is None:
                                p = shift(p, -h * kick, change)
                            else:
                                p_low = read_p(low_lanes, lane)
                                p, p_low = shift_compensated(p, p_low, -h * kick, change)
                                write_p(low_lanes, lane, p_low)
                            write_p(lanes, lane, p)
            for lane in range(count):
                place = (base + lane) * out.shape[1] + offset + save
                for component in range(DIM):
                    rows[place, component] = lanes[lane, component]
        for lane in range(count):
            for component in range(DIM):
                states[base + lane, component] = lanes[lane, component]
                if low is not None:
                    low[base + lane, component] = low_lanes[lane, component]
            done[base + lane, 0] += saves * save_every


# -- tangents ------------------------------------------------------------------------------------


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def splitting_tangent(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    stages, parameters,
):  # fmt: skip
    """Splitting methods with the derivative of each flow."""
    kicks = stages.shape[0] - (stages[-1, 1] == 0.0)
    rows = out.reshape(-1, DIM)
    for trajectory in range(states.shape[0]):
        h, start = sizes[trajectory], starts[trajectory]
        values = read_parameters(parameters, trajectory)
        tangents = columns[trajectory]
        q, p = read_q(states, trajectory), read_p(states, trajectory)
        for save in range(saves):
            for step in range(save_every):
                elapsed = first + save * save_every + step
                for stage in range(stages.shape[0]):
                    t = start + h * (elapsed + stages[stage, 2])
                    drift = h * stages[stage, 0]
                    change, curvature = velocity_curvature(q, p, t, values)
                    q = shift(q, drift, change)
                    for column in range(tangents.shape[1]):
                        shear_q(tangents, column, drift, curvature)
                    if stage == kicks:
                        break
                    t = start + h * (elapsed + stages[stage, 3])
                    kick = -h * stages[stage, 1]
                    change, curvature = slope_curvature(q, p, t, values)
                    p = shift(p, kick, change)
                    for column in range(tangents.shape[1]):
                        shear_p(tangents, column, kick, curvature)
            write(rows, trajectory * out.shape[1] + offset + save, q, p)
        write(states, trajectory, q, p)
        done[trajectory, 0] += saves * save_every


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def splitting_tangent_ensemble(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    stages, parameters,
):  # fmt: skip
    """Splitting methods with one tangent vector each, 64 trajectories at a time."""
    lanes, vectors = np.empty((DIM, 64)).T, np.empty((DIM, 64))
    given = np.empty((parameters.shape[1], 64)).T
    rows = out.reshape(-1, DIM)
    for base in range(0, states.shape[0], 64):
        count = min(64, states.shape[0] - base)
        for lane in range(count):
            for component in range(DIM):
                lanes[lane, component] = states[base + lane, component]
                vectors[component, lane] = columns[base + lane, component, 0]
            for parameter in range(parameters.shape[1]):
                given[lane, parameter] = parameters[base + lane, parameter]
        for save in range(saves):
            for step in range(save_every):
                elapsed = first + save * save_every + step
                for stage in range(stages.shape[0]):
                    drift, kick = stages[stage, 0], stages[stage, 1]
                    if drift != 0.0:
                        for lane in range(count):
                            h = sizes[base + lane]
                            t = starts[base + lane] + h * (elapsed + stages[stage, 2])
                            q, p = read_q(lanes, lane), read_p(lanes, lane)
                            values = read_parameters(given, lane)
                            change, curvature = velocity_curvature(q, p, t, values)
                            write_q(lanes, lane, shift(q, h * drift, change))
                            shear_q(vectors, lane, h * drift, curvature)
                    if kick != 0.0:
                        for lane in range(count):
                            h = sizes[base + lane]
                            t = starts[base + lane] + h * (elapsed + stages[stage, 3])
                            q, p = read_q(lanes, lane), read_p(lanes, lane)
                            values = read_parameters(given, lane)
                            change, curvature = slope_curvature(q, p, t, values)
                            write_p(lanes, lane, shift(p, -h * kick, change))
                            shear_p(vectors, lane, -h * kick, curvature)
            for lane in range(count):
                for component in range(DIM):
                    at = (base + lane) * out.shape[1] + offset + save
                    rows[at, component] = lanes[lane, component]
        for lane in range(count):
            for component in range(DIM):
                states[base + lane, component] = lanes[lane, component]
                columns[base + lane, component, 0] = vectors[component, lane]
            done[base + lane, 0] += saves * save_every


# -- linear equations ----------------------------------------------------------------------------


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _factor(matrix, pivots):
    """Compute LU factors with partial pivoting, in place."""
    size = matrix.shape[0]
    for column in range(size):
        pivot = column
        for row in range(column + 1, size):
            if abs(matrix[row, column]) > abs(matrix[pivot, column]):
                pivot = row
        pivots[column] = pivot
        if pivot != column:
            for entry in range(size):
                value = matrix[column, entry]
                matrix[column, entry] = matrix[pivot, entry]
                matrix[pivot, entry] = value
        for row in range(column + 1, size):
            matrix[row, column] /= matrix[column, column]
            for entry in range(column + 1, size):
                matrix[row, entry] -= matrix[row, column] * matrix[column, entry]


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _substitute(matrix, pivots, right):
    """Solve a linear system with the LU factors of its matrix, in place."""
    size = matrix.shape[0]
    for row in range(size):
        pivot = pivots[row]
        right[row], right[pivot] = right[pivot], right[row]
    for row in range(size):
        for column in range(row):
            right[row] -= matrix[row, column] * right[column]
    for row in range(size - 1, -1, -1):
        for column in range(row + 1, size):
            right[row] -= matrix[row, column] * right[column]
        right[row] /= matrix[row, row]


# -- symplectic Euler ----------------------------------------------------------------------------


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _largest(values):
    """Return the largest magnitude, infinite if a value is not finite."""
    largest = 0.0
    for value in values:
        if not abs(value) <= largest:
            largest = abs(value) if math.isfinite(value) else math.inf
    return largest


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _newton(z, time, h, q_first, parameters, slopes, mixed, matrix, pivots, units):
    """Solve the implicit half of a step for q (for p unless q_first), in place.

    Pivots and the convergence are those in units of the components. Returns whether the
    iteration converged, and the number of evaluations.
    """
    at, h = (0, h) if q_first else (DOF, -h)
    unknown, units = z[0, at : at + DOF], units[at : at + DOF]
    old = unknown.copy()
    correction = np.empty(DOF)
    previous = math.inf
    for attempt in range(50):
        if q_first:
            _velocity_jacobian(z, time, parameters, slopes, mixed)
        else:
            _slope_jacobian(z, time, parameters, slopes, mixed)
        for row in range(DOF):
            correction[row] = (unknown[row] - old[row] - h * slopes[row]) / units[row]
            for entry in range(DOF):
                derivative = mixed[row, entry] if q_first else mixed[entry, row]
                derivative *= units[entry] / units[row]
                matrix[row, entry] = (row == entry) - h * derivative
        # Slopes may be small differences of large terms; this is the size of these terms.
        terms = 0.0
        for row in range(DOF):
            value = 0.0
            for entry in range(DOF):
                value += abs((matrix[row, entry] - (row == entry)) * old[entry] / units[entry])
            terms = max(terms, value)
        _factor(matrix, pivots)
        _substitute(matrix, pivots, correction)
        for row in range(DOF):
            unknown[row] -= correction[row] * units[row]
        change = _largest(correction)
        scale = terms + _largest(old / units) + _largest(unknown / units)
        # Converged when the corrections are round-off: negligible, or small and no longer
        # shrinking.
        if not math.isfinite(change):
            return False, attempt + 1
        if change <= 2e-16 * scale or (change >= previous and change <= 1e-11 * scale):
            return True, attempt + 1
        previous = change
    return False, 50


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _euler_tangents(tangents, second, h, q_first, matrix, pivots, units):
    """Propagate tangent vectors by the derivative of a step (implicit function theorem)."""
    unknown, given, h = (0, DOF, h) if q_first else (DOF, 0, -h)
    right = np.empty(DOF)
    for row in range(DOF):
        for entry in range(DOF):
            curvature = h * second[given + row, unknown + entry]
            curvature *= units[unknown + entry] / units[unknown + row]
            matrix[row, entry] = (row == entry) - curvature
    _factor(matrix, pivots)
    for column in range(tangents.shape[1]):
        for row in range(DOF):
            right[row] = tangents[unknown + row, column]
            for entry in range(DOF):
                curvature = h * second[given + row, given + entry]
                right[row] += curvature * tangents[given + entry, column]
            right[row] /= units[unknown + row]
        _substitute(matrix, pivots, right)
        for row in range(DOF):
            tangents[unknown + row, column] = right[row] * units[unknown + row]
        for row in range(DOF):
            right[row] = tangents[given + row, column]
            for entry in range(DIM):
                curvature = h * second[unknown + row, entry]
                right[row] -= curvature * tangents[entry, column]
        for row in range(DOF):
            tangents[given + row, column] = right[row]


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def euler(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    q_first, units, parameters,
):  # fmt: skip
    """Symplectic Euler: both slopes at (q_n+1, p_n, t_n+1), or else at (q_n, p_n+1, t_n).

    For a non-separable H the first half is implicit. If it has no solution the rest of out is
    unchanged.
    """
    slopes = np.empty(DOF)
    mixed = np.zeros((DOF, DOF))
    matrix = np.empty((DOF, DOF))
    pivots = np.empty(DOF, np.int64)
    second = np.zeros((1, DIM, DIM))
    time = np.empty(1)
    for trajectory in range(states.shape[0]):
        h = sizes[trajectory]
        values = read_parameters(parameters, trajectory)
        z = states[trajectory : trajectory + 1]
        tangents = columns[trajectory]
        converged = True
        for save in range(saves):
            for step in range(save_every):
                time[0] = starts[trajectory] + h * (first + save * save_every + step + q_first)
                converged, attempts = _newton(
                    z, time, h, q_first, values, slopes, mixed, matrix, pivots, units
                )
                done[trajectory, 1] += attempts
                if not converged:
                    break
                if tangents.shape[1]:
                    _hessian(z, time, values, second)
                    _euler_tangents(tangents, second[0], h, q_first, matrix, pivots, units)
                q, p = read_q(z, 0), read_p(z, 0)
                if q_first:
                    write_p(z, 0, shift(p, -h, slope(q, p, time[0], values)))
                else:
                    write_q(z, 0, shift(q, h, velocity(q, p, time[0], values)))
                done[trajectory, 0] += 1
            if not converged:
                break
            for component in range(DIM):
                out[trajectory, offset + save, component] = z[0, component]


# -- implicit Runge-Kutta ------------------------------------------------------------------------


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _stage_matrix(matrix, shares, weights, second, h, units):
    """Newton's matrix 1 - h a_ij J C_j, where C_j = second[j] is the Hessian at stage j
    or, with forces, the derivative of -J dz/dt. Both are left in units of the components."""
    stages = weights.shape[0]
    for stage in range(stages):
        for row in range(DIM):
            for column in range(DIM):
                second[stage, row, column] *= units[column] / units[(row + DOF) % DIM]
    for stage in range(stages):
        for other in range(stages):
            factor = shares[stage, other] * h * weights[other]
            block = matrix[stage * DIM : (stage + 1) * DIM, other * DIM : (other + 1) * DIM]
            for row in range(DOF):
                for column in range(DIM):
                    block[row, column] = -factor * second[other, DOF + row, column]
                    block[DOF + row, column] = factor * second[other, row, column]
    for row in range(stages * DIM):
        matrix[row, row] += 1.0


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def implicit(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    shares, weights, nodes, continued, units, parameters,
):  # fmt: skip
    """Implicit Runge-Kutta methods: stages by iteration, where it is slow by Newton's method.

    Each row of states contains the state and the rates at the last step's stages, which are
    extrapolated to the initial guess. Iteration goes on while corrections shrink to a third,
    and the factors of Newton's matrix are kept while they shrink tenfold. Corrections and
    pivots are compared in units of the components. The sum over steps is compensated. The
    coefficients a_ij are shares[i, j] times b_j; shares[i, j] and shares[j, i] add up to 1
    exactly, so that the rounded method is symplectic (Antonana, Makazaga & Murua 2017).
    """
    stages = weights.shape[0]
    increments = np.empty((stages, DIM))
    points = np.empty((stages, DIM))
    slopes = np.empty((stages, DIM))
    impulses = np.empty((stages, DIM))  # h b_i times the slopes
    times = np.empty(stages)
    second = np.zeros((stages, DIM, DIM))
    matrix = np.empty((stages * DIM, stages * DIM))
    pivots = np.empty(stages * DIM, np.int64)
    right = np.empty(stages * DIM)
    terms = np.empty(2)
    for trajectory in range(states.shape[0]):
        h = sizes[trajectory]
        values = read_parameters(parameters, trajectory)
        state = states[trajectory]
        tangents = columns[trajectory]
        converged = True
        for save in range(saves):
            for step in range(save_every):
                for stage in range(stages):
                    elapsed = first + save * save_every + step + nodes[stage]
                    times[stage] = starts[trajectory] + h * elapsed
                    for component in range(DIM):
                        value = 0.0
                        for other in range(stages):
                            rate = state[DIM * (1 + other) + component]
                            value += continued[stage, other] * rate
                        impulses[stage, component] = h * weights[stage] * value
                for stage in range(stages):
                    for component in range(DIM):
                        value = 0.0
                        for other in range(stages):
                            value += shares[stage, other] * impulses[other, component]
                        increments[stage, component] = value
                previous = math.inf
                converged = False
                newton = False
                stale = True
                terms[:] = 0.0
                for _attempt in range(50):
                    for stage in range(stages):
                        for component in range(DIM):
                            points[stage, component] = (
                                state[component] + increments[stage, component]
                            )
                    _vector_field(points, times, values, slopes)
                    for stage in range(stages):
                        for component in range(DIM):
                            slope = slopes[stage, component]
                            impulses[stage, component] = h * weights[stage] * slope
                    done[trajectory, 1] += stages
                    if newton and stale:
                        _rate_curvature(points, times, values, second)
                        _stage_matrix(matrix, shares, weights, second, h, units)
                        _factor(matrix, pivots)
                        # Slopes may be small differences of large terms; these are their sizes.
                        terms[:] = 0.0
                        for stage in range(stages):
                            for row in range(DIM):
                                value = 0.0
                                for column in range(DIM):
                                    term = second[stage, row, column] * points[stage, column]
                                    value += abs(term / units[column])
                                half = 1 - row // DOF
                                terms[half] = max(terms[half], abs(h) * value)
                    for stage in range(stages):
                        for component in range(DIM):
                            value = increments[stage, component]
                            for other in range(stages):
                                value -= shares[stage, other] * impulses[other, component]
                            right[stage * DIM + component] = value / units[component]
                    if newton:
                        _substitute(matrix, pivots, right)
                    # Corrections relative to the state, coordinates and momenta by themselves.
                    change = 0.0
                    for half in range(2):
                        largest = 0.0
                        scale = max(1e-300, terms[half])
                        for component in range(half * DOF, (half + 1) * DOF):
                            for stage in range(stages):
                                unit = units[component]
                                correction = right[stage * DIM + component]
                                increments[stage, component] -= correction * unit
                                largest = max(largest, abs(correction))
                                size = max(abs(points[stage, component]), abs(state[component]))
                                scale = max(scale, size / unit)
                                if not math.isfinite(correction):
                                    largest = math.inf
                        change = max(change, largest / scale)
                    # Converged when corrections are round-off: small and no longer shrinking,
                    # or, of Newton's method, negligible. The rest of an iteration has one
                    # direction, in which the energy would drift.
                    negligible = change <= 1e-16 and (newton or change == 0.0)
                    if negligible or (change >= previous and change <= 1e-11):
                        converged = True
                        break
                    if newton:
                        if not math.isfinite(change):
                            break
                        stale = change > 0.1 * previous
                    elif not (change <= 0.3 * previous or change <= 1e-13):
                        newton = True
                        change = math.inf
                        for stage in range(stages):
                            for component in range(DIM):
                                if not math.isfinite(increments[stage, component]):
                                    increments[stage, component] = 0.0
                    previous = change
                if not converged:
                    break
                if tangents.shape[1]:
                    # The derivative of the step, by the implicit function theorem.
                    _rate_curvature(points, times, values, second)
                    _stage_matrix(matrix, shares, weights, second, h, units)
                    _factor(matrix, pivots)
                    for column in range(tangents.shape[1]):
                        for stage in range(stages):
                            for component in range(DIM):
                                part = tangents[component, column] / units[component]
                                right[stage * DIM + component] = part
                        _substitute(matrix, pivots, right)
                        for other in range(stages):
                            moved = right[other * DIM : (other + 1) * DIM]
                            for row in range(DOF):
                                factor = h * weights[other] * units[row]
                                for entry in range(DIM):
                                    curvature = factor * second[other, DOF + row, entry]
                                    tangents[row, column] += curvature * moved[entry]
                                factor = h * weights[other] * units[DOF + row]
                                for entry in range(DIM):
                                    curvature = factor * second[other, row, entry]
                                    tangents[DOF + row, column] -= curvature * moved[entry]
                for component in range(DIM):
                    change = low[trajectory, component]
                    for stage in range(stages):
                        change += impulses[stage, component]
                        state[DIM * (1 + stage) + component] = slopes[stage, component]
                    total = state[component] + change
                    low[trajectory, component] = change - (total - state[component])
                    state[component] = total
                done[trajectory, 0] += 1
            if not converged:
                break
            for component in range(DIM):
                out[trajectory, offset + save, component] = state[component]


# -- doubled phase space -------------------------------------------------------------------------


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _flow(state, columns, at, h, slopes, second, times, fresh, parameters):
    """Apply the flow of H(q, y), at = 0, or of H(x, p), at = DIM, to a state (q, p, x, y).

    The arguments of H are constant, and the other two change by its slopes there, which are
    recomputed unless they are fresh.
    """
    over = DIM - at
    point = np.empty((1, DIM))
    for row in range(DOF):
        point[0, row] = state[at + row]
        point[0, DOF + row] = state[over + DOF + row]
    if not fresh:
        _gradient(point, times, parameters, slopes)
    for row in range(DOF):
        state[over + row] += h * slopes[0, DOF + row]
        state[at + DOF + row] -= h * slopes[0, row]
    if columns.shape[1]:
        _hessian(point, times, parameters, second)
    for column in range(columns.shape[1]):
        for row in range(DOF):
            for entry in range(DOF):
                left, right = columns[at + entry, column], columns[over + DOF + entry, column]
                change = second[0, DOF + row, entry] * left
                change += second[0, DOF + row, DOF + entry] * right
                columns[over + row, column] += h * change
                change = second[0, row, entry] * left
                change += second[0, row, DOF + entry] * right
                columns[at + DOF + row, column] -= h * change


@njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _couple(vectors, angle, units):
    """Rotate (q - x, p - y) by an angle, for the columns (q, p, x, y) of vectors.

    Coordinates are in the units of their momenta times those given.
    """
    cosine, sine = math.cos(angle), math.sin(angle)
    for column in range(vectors.shape[1]):
        for row in range(DOF):
            left = vectors[row, column] - vectors[DIM + row, column]
            right = vectors[DOF + row, column] - vectors[DIM + DOF + row, column]
            left /= units[row]
            change = (cosine * left + sine * right - left) / 2 * units[row]
            vectors[row, column] += change
            vectors[DIM + row, column] -= change
            change = (cosine * right - sine * left - right) / 2
            vectors[DOF + row, column] += change
            vectors[DIM + DOF + row, column] -= change


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def doubled(
    states, low, columns, out, offset, done, starts, sizes, first, saves, save_every,
    weights, coupling, units, parameters,
):  # fmt: skip
    """Explicit steps for any H in the phase space of (q, p, x, y); see Tao 2016."""
    slopes = np.empty((2, 1, DIM))
    second = np.zeros((1, DIM, DIM))
    time = np.empty(1)
    for trajectory in range(states.shape[0]):
        state = states[trajectory]
        vectors = state.reshape(2 * DIM, 1)
        tangents = columns[trajectory]
        fresh = False
        for save in range(saves):
            for step in range(save_every):
                values = read_parameters(parameters, trajectory)
                elapsed = 1.0 * (first + save * save_every + step)
                for weight in weights:
                    h = sizes[trajectory] * weight
                    half = h / 2
                    time[0] = starts[trajectory] + sizes[trajectory] * elapsed
                    # A loop, because numba compiles a function for each literal argument.
                    for flow in range(4):
                        if flow == 2:
                            _couple(vectors, 2 * coupling * h, units)
                            _couple(tangents, 2 * coupling * h, units)
                            elapsed += weight
                            time[0] = starts[trajectory] + sizes[trajectory] * elapsed
                        side = 1 if flow == 1 or flow == 2 else 0
                        known = fresh and flow == 0
                        at, rates = DIM * side, slopes[side]
                        _flow(state, tangents, at, half, rates, second, time, known, values)
                    fresh = True
                done[trajectory, 0] += 1
            for component in range(DIM):
                out[trajectory, offset + save, component] = state[component]
