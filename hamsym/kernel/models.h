/* Arithmetic of Chebyshev models, one interval at a time.

   A model of a function on an interval is a polynomial of degree DEGREE at most with a bound on the distance
   to the function, and a range. A feature of any width inside the interval, for example a pulse between all
   sampled places, is part of that distance. Roundings are not counted.

   The polynomial is stored by its values at PLACES Chebyshev points, enough for a product of two polynomials:
   what a product has beyond the degree is truncated, and the truncated coefficients are added to the distance.
   A function f(g) is guessed at the points and bounded afterwards, by an equation that f satisfies: 1 - q p for
   a reciprocal, p - q^2 for a root, the differential equations of the others. Where a guess is worse than the
   range of f(g), a constant takes its place, so that an unresolved function costs its range and nothing more
   (Makino & Berz 2003 for Taylor models; Brisebarre & Joldes 2010 for Chebyshev models). */

#ifndef HAMSYM_MODELS_H
#define HAMSYM_MODELS_H

#include "discs.h"
#include "march.h"

#define DEGREE 31
#define PLACES 64
#define HIGH 32 /* coefficients beyond the degree, and half of the places */

/* Tables over the places, for even and odd parts; see hamsym/bounds/models.py. */
typedef struct {
  const double *coefficients;      /* values -> coefficients, 2 x HIGH x HIGH */
  const double *low, *high;        /* its first and last columns, 2 x HIGH x (HIGH / 2) each */
  const double *values_of_high;    /* high coefficients -> values, 2 x (HIGH / 2) x HIGH */
  const double *slopes_of_low;     /* low coefficients -> values of the derivative, 2 x (HIGH / 2) x HIGH */
  const double *defects;           /* slopes and values -> coefficients of the integral less the values', 2 x PLACES x HIGH */
  const double *at_middle;         /* the polynomials of those coefficients in the middle, PLACES */
} model_tables;

typedef struct {
  double value[PLACES];
  double error;     /* bound on the distance of function and polynomial */
  double rounding;  /* of the values, which the distance leaves out */
  double low, high; /* bounds on the function */
  int constant;     /* a number, which is `low`, exactly */
} model;

/* Tables of the bounds of windows. */
typedef struct {
  int64_t columns;
  const model_tables *models;
  const disc_tables *around;
  const double *places, *values, *rates; /* places in [0, 1]; columns x PLACES each */
  const double *series;                  /* columns x terms */
} bound_tables;

/* Memory of the bounds of a window; the rows of models are laid out when they are needed first. */
typedef struct {
  machine velocity, force;
  disc *disc;
  model *row;
  double *z, *rates, *found, *times, *readout, *series, *memory, *bounds, *hidden, *rounding, *limits;
} bounding;

void lay_out_bounds(bounding *m, arena *arena, const equations *H, const bound_tables *t);
int is_bounded(bounding *m, const equations *H, const bound_tables *t, double tolerance, double start, double end,
               const double *state, const double *coefficient, long count, const double *sizes,
               const double *parameters);

#endif
