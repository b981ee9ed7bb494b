/* The march over windows of collocation, one after the other, each to a local tolerance. */

#ifndef HAMSYM_MARCH_H
#define HAMSYM_MARCH_H

#include "arena.h"
#include "program.h"

/* At the end of the span, at a window whose equation the fixed-point iteration does not solve, at a
   window too short for float64, with its arrays full, or without memory. */
enum march_outcome { FINISHED, NEWTON, TOO_SHORT, FULL, NO_MEMORY };

#define ROUND_OFF (256 * EPS) /* of the residual, relative to the rates */
/* After some slow windows Newton's method is tried; where that did not pay, after a pause again. */
#define PAUSE 200

/* Hamilton's equations; the components of the state are dim, half of them coordinates. */
typedef struct {
  int64_t dim, separable;
  int64_t linear; /* whether H is separable and dq/dt a constant matrix times p */
  const program *velocity, *force, *hessian, *energy; /* dq/dt; dp/dt; second derivatives; H or null */
} equations;

/* Tables of a basis; see hamsym/random_features/basis.py. */
typedef struct {
  int64_t nodes, columns, between, terms;
  double order;
  const double *node, *integration, *twice; /* twice: the square of integration */
  const double *fit, *place, *to_between, *rates_between, *end, *end_low, *extrapolation;
} tables;

typedef struct {
  int64_t stops, width;           /* width of a row of signs */
  int64_t patient;                /* whether shorter windows are tried before Newton's method in systems of any size */
  double tolerance, shortest, longest;
  const double *stop;             /* times at which a window must end, the last the end of the march */
  const double *floor;            /* sizes below which no component is counted */
  const double *sign;             /* 1 and -1 at random: states and times change by an ulp with these */
  const double *parameters;
} settings;

/* State of a march between calls. */
typedef struct {
  double *clock;    /* time, length of the next window, and that of the last slow one */
  int64_t *counts;  /* windows, evaluations, stops passed, slow windows (negative: a pause of Newton's method) */
  double *size;     /* largest magnitude of each component so far */
  double *tail;     /* dim x terms: Chebyshev series of the rates in the last window */
  double *found;    /* dim x nodes: rates at the nodes of the present window */
} progress;

/* Consecutive windows: edges (room + 1), states (room + 1) x dim, readouts room x readout x dim. */
typedef struct {
  int64_t room, readout;
  double *edge, *state, *coefficient;
} windows;

/* Memory of a march: rows of the present window, at its nodes and at the points in between. */
typedef struct {
  long stride;
  machine velocity, force;
  vw *changes;
  double *times, *basis, *base, *drifted, *nearby, *readout, *late, *middle, *flow, *residual, *disturbed;
  double *scale, *weight, *sizes, *defects, *speeds, *noise;
  double beyond; /* largest residual of the last window beyond its round-off, in units of the allowed one */
} marching;

void take_machine(arena *arena, machine *machine, const program *program, long stride);
void lay_out_march(marching *m, arena *arena, const equations *H, const tables *t);
void evaluate(machine *velocity, machine *force, const double *states, const double *times, long n, double *out);
void stretch(const double *places, double h, double start, long n, double *out);
double first_length(marching *m, const equations *H, const double *z, const double *rates, double start, double end);
int march(marching *m, const equations *H, const tables *t, const settings *s, progress *p, windows *w, int given);

#endif
