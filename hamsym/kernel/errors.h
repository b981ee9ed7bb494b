/* The error of a march, carried from window to window.

   The linear equation of the error (the paper's eq. ell) is solved for the vectors that are needed: the
   error itself, driven by the residual, and perturbations of the size of round-off. The residual oscillates
   faster than the motion does: the error is V - D, with D the integral of the residual, and only A D is known
   at the many places of the residual. What is left is smooth, and few nodes resolve it. With rows for component
   and vector, a window is a fixed point V = V_a - h S A D + h S A V, with A = J Hess; it is iterated by halves,
   as the states were. Where the vectors are not resolved by the coarse nodes, the fine ones take their place.

   An error e obeys e' = F(z^ + e) - F(z^) - r, of which that equation is the linear part. Where e is not small,
   what it lacks, F(z^ + e) - F(z^) - A e, is computed at the last e and added to -r, until that changes e by
   little. */

#ifndef HAMSYM_ERRORS_H
#define HAMSYM_ERRORS_H

#include "march.h"

/* All windows estimated; errors as large as the motion, or not finite; a window without a solution. */
enum error_outcome { DONE, LOST, STUCK, NO_ROOM };
/* Marks of windows: the residual is large relative to the rates, or exceeds its limit; the error is so large
   that terms beyond the linear one do not settle; the residual is not bounded. */
enum mark { UNRESOLVED = 1, EXCESSIVE = 2, BENT = 4, UNBOUNDED = 8 };

/* Vectors of the error: itself, random ones that represent round-off, of which there are four or two, and one for
   roundings that are alike in all windows. */
#define EACH_MOST 6
#define EACH_FEWER 4
#define SLACK 10.0      /* times the residual that the march allows at its own places */

/* Nodes of the tangent equation: with `drift`, the integral of values at the places, without what it has beyond the
   degree of the nodes, and `beyond`, that at the places; `lift`, the interpolation to the places; `last`, the last two
   coefficients of a series in two of eight columns. */
typedef struct {
  int64_t nodes;
  const double *node, *at_nodes, *drift, *beyond, *integration, *twice, *lift, *end, *last;
} rule;

/* Tables of the estimate; see hamsym/random_features/error_estimate.py. */
typedef struct {
  int64_t columns, places, perturbations;
  double deviations; /* standard deviations that round-off may have, as the perturbations show them */
  double resolved; /* times the accuracy of the vectors: their last coefficients at the coarse nodes, at most */
  const double *place, *value, *value_low, *rate, *rate_low, *drift, *drift_end, *to_series, *dense;
  const rule *coarse, *fine;
} error_tables;

/* Terms of A V in the units of H: row += factor * second derivative * source row. Those of the coordinates'
   rates come first; terms of one row are consecutive. */
typedef struct { int64_t row, source, entry; double factor; } term;
typedef struct {
  int64_t velocities, terms;
  int64_t linear; /* whether the coordinates' rates are a constant matrix times the momenta, and not the others */
  const term *term;
} actions;

typedef struct {
  int64_t period, width;
  double tolerance;      /* local tolerance of the march */
  double accuracy;       /* of the vectors at the end of each window */
  double usual_length;   /* expected length of the window that contains a random time */
  const double *scale, *size, *sign, *kick, *parameters;
  const double *residual; /* windows x dim x places, in place of that in float64, or null */
  const double *late;     /* windows x dim: errors of the states since the start was rounded, or null */
} error_settings;

typedef struct {
  double *joint;         /* vectors at the start of a window, by component */
  double *history;       /* integral of the root of the error, and the error in the last window */
  double *series;        /* windows x places x dim, or null: Chebyshev series of the error */
  double *floor;         /* windows x dim, or null: accumulated round-off */
  double *largest;       /* dim: error and round-off so far */
  int64_t *mark;
} error_results;

typedef struct {
  long stride, each; /* vectors of each component */
  int shifted;       /* whether there are roundings that are alike in all windows */
  machine velocity, force, hessian;
  term *terms;           /* in units of the scale */
  vw *changes;
  double *readout, *times, *late, *z, *dz, *low, *rates, *disturbed, *pushed, *at_nodes, *node_times, *drift;
  double *smooth, *drift_inside, *found, *coefficients, *shown, *bent, *steady, *steady_pushed, *second, *curvature;
  double *base, *drifted, *vectors, *moved, *last, *before, *weight, *speeds, *tops;
} carrying;

void lay_out_errors(carrying *m, arena *arena, const equations *H, const error_tables *t, const actions *a);
int carry_errors(carrying *m, const equations *H, const error_tables *t, const actions *a, const error_settings *s,
                 const windows *w, const double *jumps, error_results *r, long *first, long end);

#endif
