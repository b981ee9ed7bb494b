/* Chebyshev series with a bound on their distance from a function: models whose roundings are counted.

   A model of a function f on [-1, 1] is P = sum_k (h_k + l_k) T_k with float64 numbers h_k, l_k, and a radius R with
   |f(x) - P(x)| <= R for all x in [-1, 1]. Models are rows of arrays. Those that are not `twice` float64 have
   l_k = 0. ||P|| means sum_k |h_k| + |l_k|, which bounds |P|.

   Lemmas 10 to 15 of examples/guide/how_proofs_work.md prove the bounds that functions here return. A polynomial q that
   interpolates a function at Chebyshev points is a guess, which is proven by a residual afterwards: 1 - f q for a
   reciprocal, 1 - f q^2 for a root, the differential equations of the others. Angles that depend on time alone are
   taken modulo 2 pi, once for a window.

   (Brisebarre & Joldes 2010 introduced such models; Brehard, Brisebarre & Joldes 2018 validate solutions of linear
   equations like exp.) */

#ifndef HAMSYM_SERIES_H
#define HAMSYM_SERIES_H

#include "balls.h"

#define MOST_TERMS 64
#define HALVING 1e-321        /* of halves of the numbers of a series, which may be subnormal */
#define SECOND_ORDER 0x1p-20  /* of a bound that is computed in float64 */
#define PER_PRODUCT 2         /* u for each product of two coefficients, */
#define PER_SUM 3             /* and for each sum of products */
#define PRODUCT_TWICE (80 * UNIT * UNIT)
#define INTEGRAL (10 * UNIT)
#define INTEGRAL_TWICE (128 * UNIT * UNIT)
#define DERIVATIVE (4 * UNIT)
#define DERIVATIVE_TWICE (64 * UNIT * UNIT)
#define AT_END 2              /* roundings of a value at an end beside one for each term */

enum series_operation {
  SUM, DIFFERENCE, OPPOSITE, PRODUCT, INVERSE, INVERSE_ROOT, EXPONENTIAL, SINE_COSINE,
  LOGARITHM, ARCTANGENT, ARCSINE, ARCCOSINE, ARSINH, ARCOSH, ARTANH, ERROR_FUNCTION, REDUCED_ANGLE
};

typedef struct { int64_t operation, out, first, second; } series_step;

/* Models in rows, and tables between values at `terms` points and series. */
typedef struct {
  int64_t terms;
  const double *values, *series; /* values[k, j] = T_k at point j; series is its inverse */
  double *high, *low;            /* rows x terms */
  double *radius;
  int64_t *length;               /* terms in use, at least one */
} series_rows;

/* An upper bound in spite of the roundings of a sum of numbers >= 0. */
INLINE double up(double value) { return value * (1 + SECOND_ORDER) + SMALL; }

/* ||P||, rounded up; low parts may be missing. */
static inline double norm_of(const double *high, const double *low, long count) {
  double total = 0.0;
  for (long k = 0; k < count; k++) total += fabs(high[k]) + (low ? fabs(low[k]) : 0.0);
  return total * (1 + 2 * (count * UNIT + GUARD));
}

/* out = vector table, the table with n columns; with the same bits for every n. */
void apply_table(const double *table, const double *vector, long count, long n, double *out);

/* Each returns a bound on its rounding errors. The product has na + nb - 1 terms and `out` room for one more; low
   parts of factors may be missing where they are not used. */
double multiply_series(const double *ah, const double *al, long na, const double *bh, const double *bl, long nb,
                       double *oh, double *ol, int twice);
double integrate_series(const double *ch, const double *cl, long count, double *oh, double *ol, int twice);
/* The value at -1 or 1. */
ball end_value(const double *high, const double *low, long count, int end);

void run_series(const series_step *program, long steps, const series_rows *rows, int twice);

#endif
