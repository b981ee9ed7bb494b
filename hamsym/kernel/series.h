/* Chebyshev series with a bound on their distance from a function: models whose roundings are counted.

   A model of a function f on [-1, 1] is P = sum_k (h_k + l_k) T_k with float64 numbers h_k, l_k, and a radius R with
   |f(x) - P(x)| <= R for all x in [-1, 1]. Models are rows of arrays. Those that are not `twice` float64 have
   l_k = 0. ||P|| means sum_k |h_k| + |l_k|, which bounds |P|.

   Products. T_i T_j = (T_i+j + T_|i-j|)/2. The terms of the first factor are taken from the last to the first, so
   that small numbers are added first. With S_i = sum_{m>=i} |a_m| ||b||, the partial sums of all coefficients have a
   size of at most S_i after term i, and each coefficient takes at most three additions in each term. So the rounding
   errors sum up to at most

       PER_PRODUCT u ||a|| ||b|| + PER_SUM u sum_i S_i = u (2 ||a|| + 3 sum_i (i + 1) |a_i|) ||b||.

   In twice float64 the sums of high parts are exact but for what goes to the low parts, whose size after term i is at
   most 10u sum_{m>=i} S_m; its roundings, and products of low parts, which are left out, sum up to at most
   PRODUCT_TWICE sum_i (i + 1)(i + 2)/2 |a_i| ||b||. A factor 1 + SECOND_ORDER covers terms of second order and the
   roundings of the bounds themselves, sums of fewer than 2^30 numbers >= 0. Terms beyond the rows go to the radius.

   Integral from -1: INTEGRAL ||c||, or INTEGRAL_TWICE ||c||, bounds its roundings: c_k = (c_k-1 - c_k+1)/(2k) takes
   two, and the value at -1 sums k |c_k| <= (|c_k-1| + |c_k+1|)/2.

   Functions. A polynomial q that interpolates the function at Chebyshev points is a guess. It is proven afterwards,
   by a residual:

   - 1/f: with |1 - f q| <= e < 1, |1/f - q| <= ||q|| e/(1 - e).
   - 1/sqrt(f): with |1 - f q^2| <= e < 1, f > 0 and q has no zero; if q(1) > 0, then
     |1/sqrt(f) - q| <= ||q|| ((1 - e)^-1/2 - 1) <= ||q|| e/(2 (1 - e)).
   - g = exp(P): with s = q - q(-1) - integral(P' q) and d = g - q, v = d + s satisfies v' = P' (v - s), so
     |d| <= |s| + E (|d(-1)| + 2 ||P'|| |s|), E = exp(max P - min P). The radius of f = P + r adds |exp(r) - 1| |g|.
   - sin(P), cos(P): the same for the pair, whose equation is a rotation, so that E = 1.
   - functions with f' = g(P) P', such as log, atan or asin: integral(g P') + f(P(-1)), and r |g|.

   Angles that depend on time alone are taken modulo 2 pi, once for a window.

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
